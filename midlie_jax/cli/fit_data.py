"""Measurements from a CSV file for `midlie fit`. Ambiguous files raise an error with the line or the column."""

import csv
import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
_ORDERS = ("xyz", "123", "012", "pqr", "abc", "uvw", ("roll", "pitch", "yaw"))


class Columns(NamedTuple):
    """The columns to read, and their units.

    Attributes:
        rates: the names of the columns of time and of the three rates; None for the first four columns.
        field: the names of the three columns of a magnetometer in the same rows; None if there is none.
        rate_unit: one of `UNITS_OF_RATE`.
        time_unit: one of `UNITS_OF_TIME`; None for seconds, in which case a name with another unit is rejected.
        first, last: the times of the first and the last row that is used, in the unit of the file; None for all.
    """

    rates: Sequence[str] | None
    field: Sequence[str] | None
    rate_unit: str
    time_unit: str | None
    first: float | None = None
    last: float | None = None


class FieldColumns(NamedTuple):
    """The columns to read of a magnetometer file, and the unit of its time, as for `Columns`."""

    time: str
    field: Sequence[str]
    time_unit: str | None


_FASTER = 1000.0  # a rate above the usual one by this factor counts as an error in the file


class Table(NamedTuple):
    """The rows of a file, in seconds and radians per second.

    Attributes:
        times: (n,), the times of the file, in seconds.
        rates: (n, 3); NaN where a cell is empty.
        lines: (n,), the number of each row's line in the file, from 1.
    """

    times: np.ndarray
    rates: np.ndarray
    lines: np.ndarray


class Field(NamedTuple):
    """The data of a magnetometer: times (m,), seconds; vectors (m, 3), in the unit of the file; lines (m,)."""

    times: np.ndarray
    vectors: np.ndarray
    lines: np.ndarray


class _Cells(NamedTuple):
    """The header, the names of the requested columns, their numbers (n, k), and the line of each row."""

    header: list[str]
    names: list[str]
    numbers: np.ndarray
    lines: np.ndarray


def read(path: str, wanted: Columns) -> tuple[Table, Field | None]:
    """The measurements in a CSV file with a header, and the magnetometer data in its rows, if requested.

    Cells are separated by commas, semicolons or tabs; with semicolons or tabs, numbers may have decimal commas.

    Raises:
        ValueError: the file has no header, a column is missing or its name contradicts its use, a row does not have the
            cells of the header, a cell is not a number, a time is missing or goes back, a row is far faster than the
            others, or the last row may be truncated. The message names the line or the column.
    """

    def named(header: list[str]) -> list[str]:
        names = [*(wanted.rates or header[:4]), *(wanted.field or [])]
        if len(names) < 4:
            raise ValueError(f"four columns are needed, time and three rates; {path} has {', '.join(header)}.")
        return names

    cells = _cells(path, named, "--columns")
    if not wanted.rates:
        _check_order(path, cells.header, cells.names)
    _check_time_unit(cells.names[0], wanted.time_unit, "--time-unit")
    _check_rate_units(cells.names[1:4], wanted.rate_unit)
    cells = _within(path, cells, wanted.first, wanted.last)
    _check_rates(path, cells.lines, cells.numbers[:, 1:4])
    times = cells.numbers[:, 0] * UNITS_OF_TIME[wanted.time_unit or "s"]
    field = Field(times, cells.numbers[:, 4:], cells.lines) if wanted.field else None
    return Table(times, cells.numbers[:, 1:4] * UNITS_OF_RATE[wanted.rate_unit], cells.lines), field


def read_field(path: str, wanted: FieldColumns) -> Field:
    """The measurements of a magnetometer in a separate CSV file; errors as for `read`."""
    cells = _cells(path, lambda header: [wanted.time, *wanted.field], "--magnetometer-time and --magnetometer")
    _check_time_unit(cells.names[0], wanted.time_unit, "--magnetometer-time-unit")
    if np.isnan(cells.numbers[:, 1:]).any(axis=1).all():
        raise ValueError(f"{path} has no row with all of {', '.join(wanted.field)}.")
    return Field(cells.numbers[:, 0] * UNITS_OF_TIME[wanted.time_unit or "s"], cells.numbers[:, 1:], cells.lines)


def _cells(path: str, named: Callable[[list[str]], list[str]], options: str) -> _Cells:
    text = _text(path)
    rows = _rows(path, text)
    if len(rows) < 2:
        raise ValueError(f"{path} has no rows of data below a header.")
    (line, header), cells = rows[0], rows[1:]
    names = named(header)
    places = _places(path, line, header, names, options)
    commas = _separator(text) != ","
    table = np.full((len(cells), len(places)), np.nan)
    for i, (line, row) in enumerate(cells):
        _check_length(path, line, header, row)
        for k, place in enumerate(places):
            table[i, k] = _number(f"{path}, line {line}: {names[k]}", row[place] if place < len(row) else "", commas)
    lines = np.array([line for line, _ in cells])
    _check_times(path, names[0], lines, table[:, 0])
    if not text.endswith(("\n", "\r")):
        _check_last(path, cells, places)
    return _Cells(header, names, table, lines)


def _within(path: str, cells: _Cells, first: float | None, last: float | None) -> _Cells:
    times = cells.numbers[:, 0]
    kept = (times >= (-np.inf if first is None else first)) & (times <= (np.inf if last is None else last))
    if not kept.any():
        raise ValueError(
            f"{path} has no rows between --from and --to; its times go from {times[0]:g} to {times[-1]:g}, in the unit "
            "of the file."
        )
    return cells._replace(numbers=cells.numbers[kept], lines=cells.lines[kept])


def _text(path: str) -> str:
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not text in UTF-8; save it as CSV in UTF-8.") from None
    if "\0" in text:
        raise ValueError(f"{path} is not text: line {text[: text.index(chr(0))].count(chr(10)) + 1} holds a zero byte.")
    return text


def _separator(text: str) -> str:
    first = next((line for line in text.splitlines() if line.strip()), "")
    return max(",;\t", key=first.count)


def _rows(path: str, text: str) -> list[tuple[int, list[str]]]:
    found: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=_separator(text))
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                found.append((reader.line_num, [cell.strip() for cell in row]))
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.line_num}: {error}.") from None
    return found


def _places(path: str, line: int, header: list[str], names: list[str], options: str) -> list[int]:
    known = ", ".join(header)
    if any(_is_number(name) for name in header):
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
    endings = [name.lower() for name in names[1:]]
    common = re.escape(_common(endings)), re.escape(_common([name[::-1] for name in endings])[::-1])
    parts = [re.sub(f"^{common[0]}|{common[1]}$", "", name) for name in endings]
    for order in _ORDERS:
        if sorted(parts) == sorted(order) and parts != list(order):
            raise ValueError(f"{path} has the rates in the order {', '.join(names[1:])}; {cure}")


def _common(words: list[str]) -> str:
    count = 0
    while count < min(map(len, words)) and len({word[count] for word in words}) == 1:
        count += 1
    return words[0][:count]


def _is_time(name: str) -> bool:
    return bool({"t", "time", "timestamp", "seconds", "elapsed"} & set(_words(name)))


def _words(name: str) -> list[str]:
    """The words of a name such as "gyro_x [deg/s]", without those in a denominator."""
    return re.findall(r"[^\W\d_]+", re.sub(r"/\s*\w+", "", name.lower()))


def _check_time_unit(name: str, unit: str | None, option: str) -> None:
    said = next((unit for unit, known in _NAMED_TIMES.items() if set(known) & set(_words(name))), None)
    if said is not None and said != (unit or "s"):
        raise ValueError(f"column {name!r} is in {said} by its name; give {option} {said}, or rename it.")


def _check_rate_units(names: list[str], unit: str) -> None:
    for name in names:
        said = next((unit for unit, known in _NAMED_RATES.items() if set(known) & set(_words(name))), None)
        if said is not None and said != unit:
            raise ValueError(f"column {name!r} is in {said} by its name; give --unit {said}, or rename it.")


def _check_length(path: str, line: int, header: list[str], row: list[str]) -> None:
    if len(row) < len(header) and any(header[len(row) :]):
        raise ValueError(
            f"{path}, line {line} has {len(row)} cells and the header {len(header)}: the row is "
            "truncated; complete it or delete it."
        )
    if any(row[len(header) :]):
        raise ValueError(
            f"{path}, line {line} has {len(row)} cells and the header {len(header)}; numbers with decimal commas need "
            "semicolons between the cells."
        )


def _number(where: str, cell: str, commas: bool) -> float:
    if cell.lower() in _MISSING:
        return np.nan
    text = cell.replace(",", ".") if commas else cell
    if not _is_number(text):
        raise ValueError(f"{where} must be a number, got {cell!r}.")
    if not np.isfinite(float(text)):
        raise ValueError(f"{where} must be finite, got {cell!r}; leave the cell empty if the value is missing.")
    return float(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # Python accepts 1_000


def _check_times(path: str, name: str, lines: np.ndarray, times: np.ndarray) -> None:
    missing = np.flatnonzero(np.isnan(times))
    if missing.size:
        raise ValueError(f"{path}, line {lines[missing[0]]}: {name} is missing; delete the row or complete it.")
    back = np.flatnonzero(np.diff(times) < 0)
    if back.size:
        i = back[0]
        raise ValueError(
            f"{path}, line {lines[i + 1]}: times must ascend, but {name} goes back from {times[i]:g} to "
            f"{times[i + 1]:g}; sort the rows, and check that {name} is the time."
        )


def _check_rates(path: str, lines: np.ndarray, rates: np.ndarray) -> None:
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
