"""`read`: an Attitude Ephemeris Message in KVN, versions 1.0 and 2.0."""

from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..._checks.arguments import unknown
from ..._math.euler import sequence_of
from .epochs import Epoch, check_system
from .message import FORMS, AttitudeFile, Segment, check_frame, is_of_body

# The keywords, by version of the standard: tables 4-2 and 4-3.
_HEADER = ("CLASSIFICATION", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
_NEEDED_IN_HEADER = ("CREATION_DATE", "ORIGINATOR")
_NEEDED = (
    "OBJECT_NAME", "OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "START_TIME", "STOP_TIME", "ATTITUDE_TYPE",
)  # fmt: skip
_METADATA = (
    *_NEEDED, "CENTER_NAME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "EULER_ROT_SEQ", "INTERPOLATION_METHOD",
    "INTERPOLATION_DEGREE",
)  # fmt: skip
_ONLY_IN = {"1.0": ("ATTITUDE_DIR", "QUATERNION_TYPE", "RATE_FRAME"), "2.0": ("ANGVEL_FRAME",)}
_UNIT = 1e-3  # allowed deviation of the length of a quaternion from 1, because a file holds rounded numbers


def read(file: str | Path, *, body: str | None = None, frames: Collection[str] = ()) -> AttitudeFile:
    """Reads an Attitude Ephemeris Message (CCSDS 504.0-B-1 or 504.0-B-2), written as keywords and values (KVN).

    Args:
        file: the file.
        body: "A" or "B", the frame that rotates with the body, if the frame names do not determine it. Names of the
            registry do, such as SC_BODY_1 with EME2000.
        frames: names of frames that are not in the registries of CCSDS and that both sides agreed upon.

    Returns:
        The message: `times` in seconds after its first line, `attitudes` (n, 4) from body to space, and the whole
        content of the file in `header` and `segments`. Interpolation keywords are stored but not used.

    Raises:
        ValueError: the file is not a valid message: a keyword is unknown, missing or duplicated, a frame or time system
            is unknown, a line does not have the numbers of its ATTITUDE_TYPE, epochs do not ascend or are outside
            START_TIME and STOP_TIME, or the length of a quaternion is not 1 to 1e-3. The message names file and line.
        OSError: the file cannot be read.

    Examples:
        >>> message = ml.spacecraft.attitudes.read("satellite.aem")  # the file from the example of `write`
        >>> message.attitudes[0]  # from body to space
        array([1., 0., 0., 0.])
    """
    if body not in (None, "A", "B"):
        raise ValueError(f"body must be 'A' or 'B', the frame that rotates with the body, or None, got {body!r}.")
    try:
        text = Path(file).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{file} must be a text file, such as an Attitude Ephemeris Message in KVN.") from None
    if text.lstrip().startswith("<"):
        raise ValueError(f"{file} is XML; only keyword-value (KVN) messages are supported.")
    return _Reader(str(file), body, tuple(frames)).message(text)


class _Line(NamedTuple):
    number: int
    text: str


def _without_comments(lines: Iterator[_Line], comments: list[str]) -> Iterator[_Line]:
    """The other lines; the texts of comments are appended to a list."""
    for line in lines:
        if line.text.startswith("COMMENT"):
            comments.append(line.text[len("COMMENT") :].strip())
        else:
            yield line


class _Reader(NamedTuple):
    file: str
    body: str | None
    frames: tuple[str, ...]

    def error(self, line: _Line, what: str) -> ValueError:
        return ValueError(f"{self.file}, line {line.number}: {what}")

    def message(self, text: str) -> AttitudeFile:
        lines = iter([_Line(i, line.strip()) for i, line in enumerate(text.splitlines(), 1) if line.strip()])
        first = next(lines, _Line(1, ""))
        keyword, version = self.pair(first) if "=" in first.text else ("", "")
        if keyword != "CCSDS_AEM_VERS":
            raise self.error(first, f"must be CCSDS_AEM_VERS = 2.0 or 1.0, got {first.text!r}.")
        if version not in _ONLY_IN:
            raise self.error(first, f"CCSDS_AEM_VERS must be 1.0 or 2.0, got {version!r}.")
        header, comments, last = self.block(lines, _HEADER, "META_START", first)
        for needed in _NEEDED_IN_HEADER:
            if needed not in header:
                raise self.error(last, f"the header above has no {needed}.")
        segments = [self.segment(lines, version, last)]
        for last in lines:
            if last.text != "META_START":
                raise self.error(last, f"after DATA_STOP only META_START may follow, got {last.text!r}.")
            segments.append(self.segment(lines, version, last))
        kept = {name: value for name, (value, _) in header.items()}
        return AttitudeFile(version, kept, tuple(comments), tuple(segments))

    def pair(self, line: _Line) -> tuple[str, str]:
        name, equals, value = line.text.partition("=")
        if not equals:
            raise self.error(line, f"must be KEYWORD = value, got {line.text!r}.")
        return name.strip(), value.strip()

    def block(
        self, lines: Iterator[_Line], known: Collection[str], end: str, last: _Line
    ) -> tuple[dict[str, tuple[str, _Line]], list[str], _Line]:
        """Keywords with their values and lines, and comments, up to the line `end`, which is also returned."""
        found: dict[str, tuple[str, _Line]] = {}
        comments: list[str] = []
        for last in _without_comments(lines, comments):
            if last.text == end:
                return found, comments, last
            name, value = self.pair(last)
            if name not in known:
                raise self.error(last, str(unknown("keyword", name, known)))
            if name in found:
                raise self.error(last, f"{name} occurs a second time.")
            if not value:
                raise self.error(last, f"{name} has no value; add one, or remove the keyword.")
            found[name] = value, last
        raise self.error(last, f"the file ends before {end}.")

    def segment(self, lines: Iterator[_Line], version: str, begin: _Line) -> Segment:
        known = (*_METADATA, *_ONLY_IN[version])
        found, comments, end = self.block(lines, known, "META_STOP", begin)
        metadata = {name: value for name, (value, _) in found.items()}
        form = metadata.get("ATTITUDE_TYPE", "").upper()
        for needed in _needed_in(version, form):
            if needed not in metadata:
                raise self.error(end, f"the metadata from line {begin.number} on have no {needed}.")
        if form not in FORMS or version not in FORMS[form].versions:
            choices = [name for name, one in FORMS.items() if version in one.versions]
            raise self.error(found["ATTITUDE_TYPE"][1], str(unknown("ATTITUDE_TYPE", form, choices)))
        metadata["ATTITUDE_TYPE"] = form
        self.check_values(found, metadata)
        start = next(lines, end)
        if start.text != "DATA_START":
            raise self.error(start, f"DATA_START must follow META_STOP, got {start.text!r}.")
        epochs, rows, more = self.data(lines, metadata, found, start)
        scalar_first = metadata.get("QUATERNION_TYPE", "LAST").upper() == "FIRST" and form.startswith("QUATERNION")
        columns = FORMS[form].columns
        if scalar_first:  # the names stay with their numbers
            columns = (*columns[3:4], *columns[:3], *columns[4:])
            columns = (*columns[:4], *columns[7:8], *columns[4:7]) if form.endswith("/DERIVATIVE") else columns
        numbers = dict(zip(columns, np.array(rows).T, strict=True))
        a, b = (is_of_body(metadata[name]) for name in ("REF_FRAME_A", "REF_FRAME_B"))
        side = self.body or ("" if a == b else "A" if a else "B")
        return Segment(metadata, (*comments, *more), tuple(epochs), numbers, side)

    def check_values(self, found: dict[str, tuple[str, _Line]], metadata: dict[str, str]) -> None:
        """Raises for an invalid value of the metadata; converts some values to a standard form."""
        checks: dict[str, Callable[[str], str]] = {
            "REF_FRAME_A": lambda name: check_frame("REF_FRAME_A", name, self.frames),
            "REF_FRAME_B": lambda name: check_frame("REF_FRAME_B", name, self.frames),
            "TIME_SYSTEM": check_system,
            "ATTITUDE_DIR": partial(_one_of, ("A2B", "B2A")),
            "QUATERNION_TYPE": partial(_one_of, ("FIRST", "LAST")),
            "EULER_ROT_SEQ": sequence_of,
        }
        for name, check in checks.items():
            if name in metadata:
                try:
                    metadata[name] = check(metadata[name])
                except ValueError as error:
                    raise self.error(found[name][1], f"{name}: {error}") from None

    def data(
        self, lines: Iterator[_Line], metadata: dict[str, str], found: dict[str, tuple[str, _Line]], last: _Line
    ) -> tuple[list[Epoch], list[list[float]], list[str]]:
        epochs: list[Epoch] = []
        rows: list[list[float]] = []
        comments: list[str] = []
        limits = "START_TIME", "STOP_TIME"
        begin, end = (self.epoch(found[name][1], metadata, metadata[name], name) for name in limits)
        form, count = metadata["ATTITUDE_TYPE"], len(FORMS[metadata["ATTITUDE_TYPE"]].columns)
        for line in _without_comments(lines, comments):
            last = line
            if line.text == "DATA_STOP":
                if not epochs:
                    raise self.error(line, "there are no data between DATA_START and DATA_STOP.")
                return epochs, rows, comments
            cells = line.text.split()
            if len(cells) != count + 1:
                got = len(cells) - 1
                raise self.error(line, f"{form} needs an epoch and {count} numbers, got {got} after the first.")
            epoch = self.epoch(line, metadata, cells[0], "the epoch")
            if epochs and epoch.seconds <= epochs[-1].seconds:
                raise self.error(line, f"epochs must ascend, and {cells[0]} is not after the previous epoch.")
            if not begin.seconds <= epoch.seconds <= end.seconds:
                between = f"START_TIME {begin.text()} and STOP_TIME {end.text()}"
                raise self.error(line, f"{cells[0]} is not between {between} of its segment.")
            rows.append([self.number(line, cell) for cell in cells[1:]])
            size = np.linalg.norm(rows[-1][:4])
            if form.startswith("QUATERNION") and abs(size - 1) > _UNIT:
                raise self.error(line, f"the quaternion must have length 1 to {_UNIT:g}, got {size:.6g}.")
            epochs.append(epoch)
        raise self.error(last, "the file ends before DATA_STOP.")

    def epoch(self, line: _Line, metadata: dict[str, str], text: str, name: str) -> Epoch:
        try:
            return Epoch.of(metadata["TIME_SYSTEM"], text)
        except ValueError as error:
            raise self.error(line, f"{name} {error}") from None

    def number(self, line: _Line, cell: str) -> float:
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value) or "_" in cell:
            raise self.error(line, f"must hold finite numbers, got {cell!r}.")
        return value


def _one_of(choices: tuple[str, ...], value: str) -> str:
    if value.upper() not in choices:
        raise ValueError(f"must be {' or '.join(choices)}, got {value!r}.")
    return value.upper()


def _needed_in(version: str, form: str) -> tuple[str, ...]:
    """The required keywords of the metadata, for an ATTITUDE_TYPE."""
    more = {
        "ATTITUDE_DIR": version == "1.0",
        "QUATERNION_TYPE": version == "1.0" and form.startswith("QUATERNION"),
        "EULER_ROT_SEQ": form.startswith("EULER_ANGLE"),
        "ANGVEL_FRAME": form.endswith("/ANGVEL"),
    }
    return (*_NEEDED, *(name for name, needed in more.items() if needed))
