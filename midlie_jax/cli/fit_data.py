"""Measurements from a CSV file for `midlie fit`. Ambiguous files raise an error with the line or the column."""

import argparse
import csv
import io
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import chain, permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .tables import is_number

UNITS_OF_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
UNITS_OF_RATE = {"rad/s": 1.0, "deg/s": np.pi / 180}
_MISSING = ("", "nan", "na", "n/a", "null", "none")
_NAMED_TIMES = {
    "ms": ("ms", "msec", "millis", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanosecond", "nanoseconds"),
    "s": ("s", "sec", "secs", "second", "seconds"),
}
_NAMED_RATES = {"deg/s": ("deg", "degs", "degree", "degrees", "dps"), "rad/s": ("rad", "rads", "radian", "radians")}
_MOMENT = re.compile(  # a date and a time of ISO 8601, a fraction of a second, and a zone
    r"(\d{4}-?\d\d-?\d\d[T ]\d\d:?\d\d(?::?\d\d)?)(?:[.,](\d{1,9})\d*)? ?(Z|[+-]\d\d(?::?\d\d)?)?", re.IGNORECASE
)
_ORDERS = ("xyz", "123", "012", "pqr", "abc", "uvw", ("roll", "pitch", "yaw"))


class Moment(NamedTuple):
    """A date and time: nanoseconds since 1970 in UTC, or on a clock without a zone."""

    ns: int
    zoned: bool

    @classmethod
    def of(cls, where: str, text: str) -> "Moment | None":
        """The moment of a text in ISO 8601; None for other texts, and a ValueError for dates that do not exist."""
        found = _MOMENT.fullmatch(text)
        if found is None:
            return None
        whole, fraction, zone = found.groups()
        try:
            seconds = datetime.fromisoformat(f"{whole}{zone or 'Z'}".upper()).astimezone(UTC).timestamp()
        except ValueError:
            raise ValueError(f"{where} must be an existing date and time, got {text!r}.") from None
        return cls(round(seconds) * 10**9 + int((fraction or "").ljust(9, "0")), zone is not None)

    def after(self, where: str, zero: "Moment | None") -> float:
        """The seconds from another moment, of the same file or of a file compared with it."""
        if zero is None:
            raise ValueError(f"{where} must be a number, like the times before it; got a date.")
        if self.zoned != zero.zoned:
            raise ValueError(f"{where} must have a zone like Z or +02:00 in all times or in none.")
        return (self.ns - zero.ns) / 1e9


_FASTER = 1000.0  # a rate above the usual one by this factor counts as an error in the file


class Table(NamedTuple):
    """The rows of an instrument, with times in seconds; if the times of the file are dates, from its first row."""

    times: np.ndarray  # (n,)
    values: np.ndarray  # rates or vectors (n, 3), or quaternions (n, 4); NaN where a cell is empty
    lines: np.ndarray  # the number of each row's line in the file, from 1, (n,)
    span: tuple[float, float] = (-np.inf, np.inf)  # the times between which rows are used
    unit: float = 1.0  # of the file's times, in seconds
    zero: Moment | None = None  # the date of the file's first row

    def shown(self, time: float) -> str:
        """A time in seconds as the file and `--from` write it."""
        if self.zero is None:
            return f"{time / self.unit:.15g}"
        return f"{np.datetime64(self.zero.ns // 1000 + round(time * 1e6), 'us')}{'Z' * self.zero.zoned}"

    @property
    def complete(self) -> tuple[np.ndarray, np.ndarray]:
        """The times and the values of the rows without a missing value; of rows at the same time, the first."""
        whole = self.chosen(np.all(np.isfinite(self.values), axis=1))
        times, first = np.unique(whole.times, return_index=True)
        return times, whole.values[first]

    def within(self, first: float, last: float) -> "Table":
        return self.chosen((self.times >= first) & (self.times <= last))._replace(span=(first, last))

    def chosen(self, kept: np.ndarray) -> "Table":
        return self._replace(times=self.times[kept], values=self.values[kept], lines=self.lines[kept])


class _Cells(NamedTuple):
    """The header, the names of the requested columns, their numbers (n, k), the line of each row, the first date."""

    header: list[str]
    names: list[str]
    numbers: np.ndarray
    lines: np.ndarray
    zero: Moment | None


def read(options: argparse.Namespace) -> tuple[Table, Table | None, Table | None]:
    """The rates in a CSV file with a header, and the magnetometer and the star tracker, if requested.

    Cells are separated by commas, semicolons or tabs; with semicolons or tabs, numbers may have decimal commas. Times
    are numbers or dates in ISO 8601. Lines that begin with # are comments, and a line `sep=;` may come first.

    Raises:
        ValueError: the file has no header, a column is missing or its name contradicts its use, a row does not have the
            cells of the header, a cell is not a number, a time is missing or goes back, or the last row may
            be truncated. The message names the line or the column.
    """
    path, tracker = options.data, options.tracker or []
    field = [] if options.magnetometer_data else options.magnetometer or []
    cells = _cells(path, options.columns, [*field, *tracker], "--columns")
    if not options.columns:
        _check_order(path, cells.header, cells.names)
    unit = _unit_of_times(cells, options.time_unit, "--time-unit")
    for name in cells.names[1:4]:
        _check_unit(name, _NAMED_RATES, options.unit, "--unit")
    times = cells.numbers[:, 0] * unit
    rates, fields, quaternions = np.split(cells.numbers[:, 1:], [3, 3 + len(field)], axis=1)
    span = _bound("--from", options.first, unit, cells.zero), _bound("--to", options.last, unit, cells.zero)
    if span[0] >= span[1]:
        raise ValueError(f"--from must be before --to, got {options.first} and {options.last}.")
    whole = Table(times, rates * UNITS_OF_RATE[options.unit], cells.lines, span, unit, cells.zero)
    table = whole.within(*span)
    if not len(table.times):
        first, last = whole.shown(times[0]), whole.shown(times[-1])
        raise ValueError(f"{path} has no rows between --from and --to; its times go from {first} to {last}.")
    of_field = Table(times, fields, cells.lines) if field else None
    if options.magnetometer_data:
        of_field = _own_file(options, cells.zero)
    return table, of_field, Table(times, quaternions, cells.lines) if tracker else None


def _bound(option: str, text: str | None, unit: float, zero: Moment | None) -> float:
    if text is None:
        return -np.inf if option == "--from" else np.inf
    if is_number(text):
        return float(text) * unit
    moment = Moment.of(option, text)
    if moment is None:
        raise ValueError(f"{option} must be a number or a date such as 2026-04-13T21:45:00Z, got {text!r}.")
    return moment.after(f"{option} {text}", zero)


def _own_file(options: argparse.Namespace, zero: Moment | None) -> Table:
    """The measurements of a magnetometer in its own CSV file; `zero` is of the rates' `Table`."""
    path, names = options.magnetometer_data, [options.magnetometer_time, *options.magnetometer]
    cells = _cells(path, names, [], "--magnetometer-time and --magnetometer")
    unit = _unit_of_times(cells, options.magnetometer_time_unit, "--magnetometer-time-unit")
    if zero is not None and cells.zero is None:
        raise ValueError(f"{path} must have dates as times, as the file of the rates has; got numbers.")
    since = 0.0 if cells.zero is None else cells.zero.after(f"{path}, {names[0]}", zero)
    if np.isnan(cells.numbers[:, 1:]).any(axis=1).all():
        raise ValueError(f"{path} has no row with all of {', '.join(names[1:])}.")
    return Table(cells.numbers[:, 0] * unit + since, cells.numbers[:, 1:], cells.lines)


def _cells(path: str, columns: list[str] | None, more: list[str], options: str) -> _Cells:
    """The cells of these columns, by default of the first four, and of more; `options` choose them."""
    text, rows = _rows(path)
    if len(rows) < 2:
        raise ValueError(f"{path} has no rows of data below a header.")
    (line, header), cells = rows[0], rows[1:]
    names = [*(columns or header[:4]), *more]
    if len(names) < 4:
        raise ValueError(f"four columns are needed, time and three rates; {path} has {', '.join(header)}.")
    places = _places(path, line, header, names, options)
    commas, zero = _separator(text) != ",", None
    table = np.full((len(cells), len(places)), np.nan)
    for i, (line, row) in enumerate(cells):
        _check_length(path, line, header, row)
        for k, place in enumerate(places):
            where, cell = f"{path}, line {line}: {names[k]}", row[place] if place < len(row) else ""
            moment = None if k else Moment.of(where, cell)
            zero = moment if i == k == 0 else zero
            if zero is not None and not k and moment is None and cell.lower() not in _MISSING:
                raise ValueError(f"{where} must be a date, as in the rows above, got {cell!r}.")
            table[i, k] = _number(where, cell, commas) if moment is None else moment.after(where, zero)
    lines = np.array([line for line, _ in cells])
    _check_times(path, names[0], lines, table[:, 0], [row[places[0]] for _, row in cells])
    if not text.endswith(("\n", "\r")):
        _check_last(path, cells, places)
    return _Cells(header, names, table, lines, zero)


def _separator(text: str) -> str:
    first = next((line for line in text.splitlines() if line.strip() and not _is_comment(line)), "")
    return max(",;\t", key=first.count)


def _is_comment(line: str) -> bool:
    return bool(re.match(r"\s*\"?(#|sep=)", line, re.IGNORECASE))


def _rows(path: str) -> tuple[str, list[tuple[int, list[str]]]]:
    """The text of a file, and its rows of cells with the numbers of their lines."""
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not text in UTF-8; save it as CSV in UTF-8.") from None
    if "\0" in text:
        raise ValueError(f"{path} is not text: line {text[: text.index(chr(0))].count(chr(10)) + 1} holds a zero byte.")
    found: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=_separator(text))
    try:
        for row in reader:
            if any(cell.strip() for cell in row) and not _is_comment(row[0]):
                found.append((reader.line_num, [cell.strip() for cell in row]))
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.line_num}: {error}.") from None
    return text, found


def _places(path: str, line: int, header: list[str], names: list[str], options: str) -> list[int]:
    known = ", ".join(header)
    if any(is_number(name) for name in header):
        raise ValueError(
            f"{path}, line {line}: numbers in place of column names; write a header above them, such as t,wx,wy,wz."
        )
    for name in names:
        if name not in header:
            raise ValueError(f"{path} has no column {name!r}; it has {known}. Give {options}.")
        if header.count(name) > 1 or names.count(name) > 1:
            raise ValueError(f"column {name!r} occurs twice; {path} has {known}. Each column needs a unique name.")
    return [header.index(name) for name in names]


def _check_order(path: str, header: list[str], names: list[str]) -> None:
    cure = "name the columns of time and of the rates about axes 1, 2, 3 by --columns."
    elsewhere = [name for name in header[1:] if _is_time(name)]
    if elsewhere and not _is_time(names[0]):
        raise ValueError(f"{path} has the time in column {elsewhere[0]!r}, not in the first, {names[0]!r}; {cure}")
    rates = "\n".join(names[1:]).lower()
    for first, second, third in chain.from_iterable([*permutations(order)][1:] for order in _ORDERS):
        # What comes before and after the letter of the axis is the same in all three names.
        if re.fullmatch(rf"(.*){first}(.*)\n(?:\1){second}\2\n(?:\1){third}\2", rates):
            raise ValueError(f"{path} has the rates in the order {', '.join(names[1:])}; {cure}")


def _is_time(name: str) -> bool:
    return bool({"t", "time", "timestamp", "seconds", "elapsed"} & set(_words(name)))


def _words(name: str) -> list[str]:
    """The words of a name such as "gyro_x [deg/s]", without those in a denominator."""
    return re.findall(r"[^\W\d_]+", re.sub(r"/\s*\w+", "", name.lower()))


def _unit_of_times(cells: _Cells, unit: str | None, option: str) -> float:
    if cells.zero is None:
        _check_unit(cells.names[0], _NAMED_TIMES, unit or "s", option)
        return UNITS_OF_TIME[unit or "s"]
    if unit is not None:
        raise ValueError(f"{option} must be left out for dates, got {unit}.")
    return 1.0


def _check_unit(name: str, known: dict[str, tuple[str, ...]], unit: str, option: str) -> None:
    said = next((unit for unit, words in known.items() if set(words) & set(_words(name))), None)
    if said is not None and said != unit:
        raise ValueError(f"column {name!r} is in {said} by its name; give {option} {said}, or rename it.")


def _check_length(path: str, line: int, header: list[str], row: list[str]) -> None:
    counted = f"{path}, line {line} has {len(row)} cells and the header {len(header)}"
    if len(row) < len(header) and any(header[len(row) :]):
        raise ValueError(f"{counted}: the row is truncated; complete it or delete it.")
    if any(row[len(header) :]):
        raise ValueError(f"{counted}; numbers with decimal commas need semicolons between the cells.")


def _number(where: str, cell: str, commas: bool) -> float:
    if cell.lower() in _MISSING:
        return np.nan
    text = cell.replace(",", ".") if commas else cell
    if not is_number(text):
        raise ValueError(f"{where} must be a number, got {cell!r}.")
    if not np.isfinite(float(text)):
        raise ValueError(f"{where} must be finite, got {cell!r}; leave the cell empty if the value is missing.")
    return float(text)


def _check_times(path: str, name: str, lines: np.ndarray, times: np.ndarray, texts: Sequence[str]) -> None:
    missing = np.flatnonzero(np.isnan(times))
    if missing.size:
        raise ValueError(f"{path}, line {lines[missing[0]]}: {name} is missing; delete the row or complete it.")
    back = np.flatnonzero(np.diff(times) < 0)
    if back.size:
        i = back[0]
        raise ValueError(
            f"{path}, line {lines[i + 1]}: times must ascend, but {name} goes back from {texts[i]} to "
            f"{texts[i + 1]}; sort the rows, and check that {name} is the time."
        )


def check_rates(path: str, lines: np.ndarray, rates: np.ndarray) -> None:
    """Raises if one row is far faster than the others; a free body's speed ratio cannot exceed its moment ratio."""
    speeds = np.linalg.norm(rates, axis=1)
    usual = np.median(speeds[~np.isnan(speeds)]) if not np.all(np.isnan(speeds)) else 0.0
    fastest = int(np.argmax(np.nan_to_num(speeds, posinf=np.inf)))
    if 0 < _FASTER * usual < speeds[fastest]:
        raise ValueError(
            f"{path}, line {lines[fastest]}: the rate is {speeds[fastest]:.3g}, but usually "
            f"{usual:.3g}; check the decimal point, and correct the row or delete it."
        )


def _check_last(path: str, cells: list[tuple[int, list[str]]], places: list[int]) -> None:
    """Raises if the last number has fewer digits than all others in its column: the last line may be truncated.

    A truncated number with as many digits as another one has an error no larger than its rounding.
    """
    line, row = cells[-1]
    last = max(k for k, cell in enumerate(row) if cell)
    others = [_digits(other[last]) for _, other in cells[:-1] if last < len(other) and other[last]]
    if last in places and (not others or _digits(row[last]) < min(others)):
        raise ValueError(
            f"{path}, line {line} is truncated: it has no line break, and its last number, "
            f"{row[last]!r}, has fewer digits than all above it; complete the row or delete it."
        )


def _digits(cell: str) -> int:
    """The number of characters after the decimal point, or of the whole number if it has no point."""
    return len(re.split("[.,]", cell.lstrip("+-"))[-1])
