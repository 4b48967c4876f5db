"""Damaged files for `midlie fit`, a part of `make fuzz`.

A log of a gyroscope is damaged in one or two ways at random places. `midlie fit` must refuse it with the line, the
column or the unit, or say that the fit is not ok, or find what it finds in the file that is not damaged, within the
intervals. What a file cannot show is not asked: that the values of two columns were exchanged below names that were
not, for the mirror image of a free body moves like another free body.
"""

import contextlib
import re
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from cases import Outcome, midlie, tumbled
from hypothesis import strategies as st

Rows = list[list[str]]
Damage = tuple[str, float, float]  # its name, and the row and the column as shares of the file
MOMENTS, RATE, TIMES = np.array([1.0, 3.2, 4.0]), np.array([0.8, 1.2, 2.0]), np.arange(61) * 0.1
RATIO = re.compile(r"^moments\[\d\] / moments\[2\] +(\S+) +\[(\S+), (\S+)\]", re.M)
SAID = re.compile(r"line \d+|column|--unit|--time-unit|is not text|not ok|no rows of data")


@cache
def whole() -> str:
    """The file as it should be."""
    rates = tumbled(MOMENTS, RATE, TIMES)[0] + 0.01 * np.random.default_rng(0).standard_normal((len(TIMES), 3))
    rows = (",".join(f"{x:.5f}" for x in (t, *row)) for t, row in zip(TIMES, rates, strict=True))
    return "\n".join(["t,wx,wy,wz", *rows]) + "\n"


def scale(rows: Rows, columns: range, factor: float) -> None:
    for cells in rows[1:]:
        for k in columns:
            with contextlib.suppress(ValueError, IndexError):
                cells[k] = f"{float(cells[k]) * factor:.5f}"


def exchange_columns(rows: Rows, row: int, column: int) -> None:
    for cells in rows:
        if len(cells) == 4:
            other = (column + 1 + row % 3) % 4
            cells[column % 4], cells[other] = cells[other], cells[column % 4]


def exchange(cells: list[str], place: int) -> None:
    other = (place + 1) % len(cells)
    cells[place], cells[other] = cells[other], cells[place]


# What becomes of one cell, of all rows at a row and a column, and of the text.
OF_CELLS: dict[str, Callable[[str], str]] = {
    **{value: lambda cell, value=value: value for value in ("NaN", "inf", "", "error", "0")},
    "another sign": lambda cell: cell[1:] if cell.startswith("-") else "-" + cell,
    "another digit": lambda cell: re.sub(r"\d", lambda digit: str((int(digit[0]) + 3) % 10), cell, count=1),
    "no decimal point": lambda cell: cell.replace(".", ""),
}
OF_ROWS: dict[str, Callable[[Rows, int, int], object]] = {
    "columns exchanged": exchange_columns,
    "cells exchanged": lambda rows, row, column: exchange(rows[row], column),
    "rows exchanged": lambda rows, row, column: rows.insert(row - 1, rows.pop(row)),
    "a row twice": lambda rows, row, column: rows.insert(row, list(rows[row])),
    "a row lost": lambda rows, row, column: rows.pop(row),
    "a time twice": lambda rows, row, column: rows[row].__setitem__(0, rows[max(row - 1, 1)][0]),
    "milliseconds": lambda rows, row, column: scale(rows, range(1), 1e3),
    "degrees": lambda rows, row, column: scale(rows, range(1, 4), 180 / np.pi),
    "a comment": lambda rows, row, column: rows.insert(row, ["# restarted"]),
}
OF_TEXT: dict[str, Callable[[str, float, float], str]] = {
    "cut at the end": lambda text, first, second: text[: len(text) - 1 - int(first * 70)],
    "cut inside": lambda text, first, second: (
        text[: int(first * len(text))] + text[int(first * len(text)) + 1 + int(second * 60) :]
    ),
    "no header": lambda text, first, second: text.partition("\n")[2],
    "empty lines": lambda text, first, second: text.replace("\n", "\n\n", 1 + int(5 * first)),
    "decimal commas alone": lambda text, first, second: text.replace(".", ","),
    "a separator at the end": lambda text, first, second: text.replace("\n", ",\n"),
    # These change all cells, so they come last: the other damage is then what it says.
    "byte order mark": lambda text, first, second: "\ufeff" + text,
    "line ends of Windows": lambda text, first, second: text.replace("\n", "\r\n"),
    "semicolons": lambda text, first, second: text.replace(",", ";"),
    "decimal commas": lambda text, first, second: text.replace(",", ";").replace(".", ","),
    "tabs": lambda text, first, second: text.replace(",", "\t"),
    "spaces": lambda text, first, second: text.replace(",", " , "),
    "quotes": lambda text, first, second: re.sub(r"[^,\n]+", lambda cell: f'"{cell[0]}"', text),
}
NAMES = [*OF_CELLS, *OF_ROWS, *OF_TEXT]


@st.composite
def damages(draw) -> list[Damage]:
    """One or two damages and where."""
    place = st.floats(0, 1, exclude_max=True)
    names = draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=2, unique=True))
    return [(name, draw(place), draw(place)) for name in sorted(names, key=NAMES.index)]


def damaged(damage: list[Damage]) -> str:
    text = whole()
    for name, first, second in damage:
        if name in OF_TEXT:
            text = OF_TEXT[name](text, first, second)
            continue
        rows = [line.split(",") for line in text.splitlines()]
        row = 1 + int(first * (len(rows) - 2))
        column = int(second * (len(rows[row]) - 1e-9))
        if name in OF_CELLS:
            rows[row][column] = OF_CELLS[name](rows[row][column])
        else:
            OF_ROWS[name](rows, row, column)
        text = "".join(",".join(cells) + "\n" for cells in rows)
    return text


def fitted(text: str) -> Outcome:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log.csv"
        file.write_bytes(text.encode())
        return midlie("fit", file, "--unit", "rad/s")


@cache
def expected() -> np.ndarray:
    """The ratios and their intervals from the whole file, (2, 3)."""
    outcome = fitted(whole())
    assert outcome.code == 0, outcome.err
    return np.array(RATIO.findall(outcome.out), float)


def check_damage(damage: list[Damage]) -> str:
    """Raises AssertionError where a damaged file is silently taken for a good one; what became of it otherwise."""
    code, out, err = fitted(damaged(damage))
    if code:
        assert SAID.search(err), f"{damage}: the message names no line, column or unit: {err}"
        return "not ok" if "not ok" in err else "refused"
    found, (ratios, low, high) = np.array(RATIO.findall(out), float)[:, 0], expected().T
    assert np.all((low <= found) & (found <= high)), (
        f"{damage}: ok with the ratios {found}, and without the damage {ratios} in {low} to {high}"
    )
    return "as if whole"
