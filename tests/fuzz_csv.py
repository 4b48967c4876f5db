"""Damaged files for `midlie fit`, a part of `make fuzz`.

A log of a gyroscope is damaged in one or two ways at random places. `midlie fit` must refuse it with the line, the
column or the unit, or say that the fit is not ok, or find what it finds in the file that is not damaged, within the
intervals. What a file cannot show is not asked: that the values of two columns were exchanged below names that were
not, for the mirror image of a free body moves like another free body.
"""

import contextlib
import io
import re
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

import midlie_jax as ml
from midlie_jax.cli.main import main

Place = float  # a share of the file, from 0 to 1
MOMENTS, RATE, TIMES = np.array([1.0, 3.2, 4.0]), np.array([0.8, 1.2, 2.0]), np.arange(61) * 0.1
NAMES = ["t", "wx", "wy", "wz"]
RATIO = re.compile(r"^moments\[\d\] / moments\[2\] +(\S+) +\[(\S+), (\S+)\]", re.M)
SAID = re.compile(r"line \d+|column|--unit|--time-unit|is not text|not ok|no rows of data")


@cache
def whole() -> str:
    """The file as it should be."""
    body = ml.RigidBody(MOMENTS)
    states = ml.free_motion(body, ml.MomentumState(body.momentum(jnp.asarray(RATE))), TIMES).states
    rates = np.asarray(states.momentum) / MOMENTS + 0.01 * np.random.default_rng(0).standard_normal((len(TIMES), 3))
    return joined([NAMES, *([f"{x:.5f}" for x in (t, *row)] for t, row in zip(TIMES, rates, strict=True))])


def joined(rows: list[list[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in rows)


def of_rows(change: Callable[..., None]) -> Callable[[str, Place, Place], str]:
    """A damage of the rows (row, place) of cells, as one of the text."""

    def damage(text: str, first: Place, second: Place) -> str:
        rows = [line.split(",") for line in text.splitlines()]
        row = 1 + int(first * (len(rows) - 2))
        change(rows, row, int(second * (len(rows[row]) - 1e-9)))
        return joined(rows)

    return damage


def set_cell(value: str) -> Callable[..., None]:
    def change(rows: list[list[str]], row: int, column: int) -> None:
        rows[row][column] = value

    return change


def change_cell(function: Callable[[str], str]) -> Callable[..., None]:
    def change(rows: list[list[str]], row: int, column: int) -> None:
        rows[row][column] = function(rows[row][column])

    return change


def other_digit(digit: re.Match[str]) -> str:
    return str((int(digit[0]) + 3) % 10)


def scale(columns: range, factor: float) -> Callable[..., None]:
    def change(rows: list[list[str]], row: int, column: int) -> None:
        for cells in rows[1:]:
            for k in columns:
                with contextlib.suppress(ValueError, IndexError):
                    cells[k] = f"{float(cells[k]) * factor:.5f}"

    return change


def exchange_columns(rows: list[list[str]], row: int, column: int) -> None:
    for cells in rows:
        if len(cells) == 4:
            other = (column + 1 + row % 3) % 4
            cells[column % 4], cells[other] = cells[other], cells[column % 4]


def exchange_cells(rows: list[list[str]], row: int, column: int) -> None:
    other = (column + 1) % len(rows[row])
    rows[row][column], rows[row][other] = rows[row][other], rows[row][column]


def exchange_rows(rows: list[list[str]], row: int, column: int) -> None:
    rows[row], rows[row - 1] = rows[row - 1], rows[row]


def one_time(rows: list[list[str]], row: int, column: int) -> None:
    if row > 1:
        rows[row][0] = rows[row - 1][0]


def cut_inside(text: str, first: Place, second: Place) -> str:
    start = int(first * len(text))
    return text[:start] + text[start + 1 + int(second * 60) :]


DAMAGES: dict[str, Callable[[str, Place, Place], str]] = {
    "cut at the end": lambda text, first, second: text[: len(text) - 1 - int(first * 70)],
    "cut inside": cut_inside,
    "no header": lambda text, first, second: text.partition("\n")[2],
    "columns exchanged": of_rows(exchange_columns),
    "cells exchanged": of_rows(exchange_cells),
    "rows exchanged": of_rows(exchange_rows),
    "NaN": of_rows(set_cell("NaN")),
    "infinite": of_rows(set_cell("inf")),
    "an empty cell": of_rows(set_cell("")),
    "a word": of_rows(set_cell("error")),
    "a zero": of_rows(set_cell("0")),
    "another sign": of_rows(change_cell(lambda cell: cell[1:] if cell.startswith("-") else "-" + cell)),
    "another digit": of_rows(change_cell(lambda cell: re.sub(r"\d", other_digit, cell, count=1))),
    "no decimal point": of_rows(change_cell(lambda cell: cell.replace(".", ""))),
    "a row twice": of_rows(lambda rows, row, column: rows.insert(row, list(rows[row]))),
    "a row lost": of_rows(lambda rows, row, column: rows.pop(row) and None),
    "a time twice": of_rows(one_time),
    "milliseconds": of_rows(scale(range(1), 1e3)),
    "degrees": of_rows(scale(range(1, 4), 180 / np.pi)),
    "empty lines": lambda text, first, second: text.replace("\n", "\n\n", 1 + int(5 * first)),
    "a comment": of_rows(lambda rows, row, column: rows.insert(row, ["# restarted"])),
    "byte order mark": lambda text, first, second: "\ufeff" + text,
    "line ends of Windows": lambda text, first, second: text.replace("\n", "\r\n"),
    "semicolons": lambda text, first, second: text.replace(",", ";"),
    "decimal commas": lambda text, first, second: text.replace(",", ";").replace(".", ","),
    "decimal commas alone": lambda text, first, second: text.replace(".", ","),
    "tabs": lambda text, first, second: text.replace(",", "\t"),
    "spaces": lambda text, first, second: text.replace(",", " , "),
    "quotes": lambda text, first, second: re.sub(r"[^,\n]+", lambda cell: f'"{cell[0]}"', text),
    "a separator at the end": lambda text, first, second: text.replace("\n", ",\n"),
}
_AT_LAST = ("byte order mark", "line ends of Windows", "semicolons", "decimal commas", "tabs", "spaces", "quotes")


@st.composite
def damages(draw) -> list[tuple[str, Place, Place]]:
    """One or two damages and where; those that change all cells come last, so that the other is what it says."""
    place = st.floats(0, 1, exclude_max=True)
    names = draw(st.lists(st.sampled_from(list(DAMAGES)), min_size=1, max_size=2, unique=True))
    return [(name, draw(place), draw(place)) for name in sorted(names, key=_AT_LAST.__contains__)]


def damaged(damage: list[tuple[str, Place, Place]]) -> str:
    text = whole()
    for name, first, second in damage:
        text = DAMAGES[name](text, first, second)
    return text


def run(text: str) -> tuple[int, str, str]:
    """What `midlie fit` makes of a file: its exit code, and what it prints."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log.csv"
        file.write_bytes(text.encode())
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(["fit", str(file), "--unit", "rad/s"])
    return code, out.getvalue(), err.getvalue()


@cache
def expected() -> np.ndarray:
    """The ratios and their intervals from the whole file, (2, 3)."""
    code, out, err = run(whole())
    assert code == 0, err
    return np.array(RATIO.findall(out), float)


def check_damage(damage: list[tuple[str, Place, Place]]) -> str:
    """Raises AssertionError where a damaged file is silently taken for a good one; what became of it otherwise."""
    code, out, err = run(damaged(damage))
    if code:
        assert SAID.search(err), f"{damage}: the message names no line, column or unit: {err}"
        return "not ok" if "not ok" in err else "refused"
    found, (ratios, low, high) = np.array(RATIO.findall(out), float)[:, 0], expected().T
    assert np.all((low <= found) & (found <= high)), (
        f"{damage}: ok with the ratios {found}, and without the damage {ratios} in {low} to {high}"
    )
    return "as if whole"
