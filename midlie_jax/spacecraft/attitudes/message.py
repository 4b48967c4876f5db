"""`AttitudeFile` and its `Segment`s: the content of an attitude file; and the names of frames."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._checks.arguments import shown, unknown
from .epochs import Epoch
from .forms import FORMS, rotations

# Names in the registries of CCSDS (sanaregistry.org).
_CELESTIAL = (
    "ALIGN_CB", "ALIGN_EARTH", "B1950", "CIRS", "EFG", "EME2000", "FIXED_CB", "FIXED_EARTH", "GCRF", "GRC", "GTOD",
    "ICRF", "INERTIAL_CB", "ITRF", "ITRF-93", "ITRF-97", "J2000", "J2000A", "J2000_ECLIPTIC", "MCI", "MOD_CB",
    "MOD_EARTH", "MOD_MOON", "MOE_CB", "MOE_EARTH", "MOON_ME", "MOON_MEIAUE", "MOON_PA", "TDR", "TEME",
    "TEMEOFDATE", "TEMEOFEPOCH", "TIRS", "TOD", "TOD_CB", "TOD_EARTH", "TOD_MOON", "TOE_CB", "TOE_EARTH",
    "TOE_MOON", "TRUE_ECLIPTIC", "UVW_GO_INERTIAL", "WGS84",
)  # fmt: skip
_LOCAL = ("LVLH", "NSW", "NTW", "RSW", "SEZ", "TNW", "VNC")
_ORBITAL = (
    *("EQW_INERTIAL", "PQW_INERTIAL", "QSW", "RIC", "RTN"),
    *(f"{name}{kind}" for name in _LOCAL for kind in ("", "_ROTATING", "_INERTIAL")),
)
_NUMBERED = re.compile(r"(ITRF|DTRF|ICRF|GCRF|MOON_PA)_?\d+")  # of a year or an edition
_OF_BODY = re.compile(
    r"(ACC|ACTUATOR|AST|CSS|DSS|ESA|GYRO|GYRO_FRAME|IMU_FRAME|INSTRUMENT|MTA|RW|SA|SC_BODY|SENSOR|STARTRACKER|TAM)"
    r"(_\w+)?"
)


@dataclass(frozen=True)
class Segment:
    """A continuous piece of the motion: one block of metadata and its data.

    Attributes:
        metadata: the keywords as in the file, such as "OBJECT_NAME", "REF_FRAME_A" or "INTERPOLATION_METHOD", which is
            stored but not used.
        comments: the texts of the comments among metadata and data.
        epochs: the times of the lines.
        columns: the numbers of the lines by their names in the standard, such as "Q1", each (n,); angles in degrees,
            rates in degrees per second.
        body_is: "A" or "B", the frame that rotates with the body; "" if the frame names do not determine it.

    Examples:
        >>> (segment,) = ml.spacecraft.attitudes.read("satellite.aem").segments  # the file from the example of `write`
        >>> segment.metadata["OBJECT_NAME"], segment.body_is, segment.columns["QC"][:1]
        ('SATELLITE', 'B', array([1.]))
    """

    metadata: Mapping[str, str]
    comments: tuple[str, ...]
    epochs: tuple[Epoch, ...]
    columns: Mapping[str, np.ndarray]
    body_is: str

    @property
    def attitudes(self) -> np.ndarray:
        """(n, 4), unit quaternions (w, x, y, z) from the frame of the body to the other one.

        Raises:
            ValueError: the data hold a spin axis and a nutation, and no attitude; or the frame of the body is unknown.
        """
        name = self.metadata["ATTITUDE_TYPE"]
        kind = FORMS[name].kind
        if not kind:
            raise ValueError(f"a segment of ATTITUDE_TYPE {name} gives no attitudes; its numbers are in `columns`.")
        if not self.body_is:
            a, b = self.metadata["REF_FRAME_A"], self.metadata["REF_FRAME_B"]
            raise ValueError(
                f"the frame that rotates with the body is unknown, REF_FRAME_A ({a}) or REF_FRAME_B "
                f"({b}); pass read(..., body='A') or body='B'."
            )
        numbers = np.stack([self.columns[column] for column in FORMS[name].columns], axis=1)
        found = rotations(kind, numbers, self.metadata.get("EULER_ROT_SEQ", ""))
        turned = (self.body_is == "A") != (self.metadata.get("ATTITUDE_DIR") == "B2A")
        return found * np.array([1.0, -1.0, -1.0, -1.0]) if turned else found

    def seconds_after(self, epoch: Epoch) -> np.ndarray:
        """(n,), the seconds of the lines after an epoch."""
        return np.array([float(one.seconds - epoch.seconds) for one in self.epochs])


@dataclass(frozen=True)
class AttitudeFile:
    """An Attitude Ephemeris Message.

    Attributes:
        version: "1.0" or "2.0".
        header: its keywords, such as "ORIGINATOR".
        comments: the texts of the comments in the header.
        segments: the pieces of the motion, one after the other.

    Examples:
        >>> message = ml.spacecraft.attitudes.read("satellite.aem")  # the file from the example of `write`
        >>> message.version, message.header["ORIGINATOR"], message.epoch
        ('2.0', 'LAB', '2026-04-13T21:45:00.000000000')
        >>> message.times[:2].tolist(), message.attitudes.shape
        ([0.0, 10.0], (7, 4))
    """

    version: str
    header: Mapping[str, str]
    comments: tuple[str, ...]
    segments: tuple[Segment, ...]

    @property
    def epoch(self) -> str:
        """The epoch of the first line, the origin of `times`."""
        return self.segments[0].epochs[0].text()

    @property
    def times(self) -> np.ndarray:
        """(n,), the seconds of all lines after the first; in UTC with leap seconds."""
        return np.concatenate([segment.seconds_after(self.segments[0].epochs[0]) for segment in self._of_one()])

    @property
    def attitudes(self) -> np.ndarray:
        """(n, 4), unit quaternions (w, x, y, z) of all lines, from the frame of the body to the other one."""
        return np.concatenate([segment.attitudes for segment in self._of_one()])

    def _of_one(self) -> tuple[Segment, ...]:
        for keyword in ("OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B"):
            names = {segment.metadata[keyword].upper() for segment in self.segments}
            if len(names) > 1:
                raise ValueError(
                    f"the segments have several {keyword}: {', '.join(sorted(names))}; use each of `segments` "
                    "separately."
                )
        return self.segments


def is_of_body(name: str) -> bool:
    """Whether a frame of the registry rotates with a spacecraft: the spacecraft itself or its equipment."""
    return bool(_OF_BODY.fullmatch(name.upper()))


def check_frame(keyword: str, name: Any, agreed: Collection[str] = ()) -> str:
    """The name of a frame; a ValueError if it is neither in the registries nor agreed upon."""
    if not isinstance(name, str) or not name.strip():
        raise ValueError(f"{keyword} must be the name of a frame, got {shown(name)}.")
    known = name.upper() in (*_CELESTIAL, *_ORBITAL) or _NUMBERED.fullmatch(name.upper()) or is_of_body(name)
    if not known and name not in agreed:
        listed = ("EME2000", "ICRF", "GCRF", "ITRF2014", "TEME", "LVLH", "RTN", "SC_BODY_1", "STARTRACKER_1")
        note = f"If both sides agreed on this name, pass frames=({name!r},)."
        raise unknown(f"frame of {keyword}", name, listed, more=(*_CELESTIAL, *_ORBITAL), note=note)
    return name


def body_of(frame_a: str, frame_b: str, said: str | None) -> str:
    """The frame of the body among two: "A", "B", or "" if neither their names nor the argument determine it."""
    if said:
        return said
    a, b = is_of_body(frame_a), is_of_body(frame_b)
    return "" if a == b else ("A" if a else "B")
