"""What the pages docs/coming-from/*.md share: both columns run as they stand, their difference, the rows of a table."""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .alone import Outcome, run

FOLDER = Path(__file__).resolve().parents[3] / "docs" / "coming-from"
MARK = "measured"
Row = tuple[str, str, str, str]  # what is measured, the other program, midlie_jax, and the first over the second

_TABLE = re.compile(r"^<table>.*?^</table>$", re.MULTILINE | re.DOTALL)
_BLOCK = re.compile(r"^```(py|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Page(NamedTuple):
    """A page, which shows the same run in another program and in this one.

    Attributes:
        title: the program, as the page and its tables call it.
        needs: the packages that the left column imports, beside this one; a name in capitals is that of an environment
            variable which says in which folder a program stands.
        within: the largest difference between the quantities of the two columns that the page allows.
        rows: yields the rows of the measured table.
        heads: the programs at the head of the left columns, where a page has several.
        further: as `within`, of the last of several tables.
        quantities: what both columns end with.
    """

    title: str
    needs: tuple[str, ...]
    within: float
    rows: Callable[[], Iterator[Row]]
    heads: tuple[str, ...] = ()
    further: float | None = None
    quantities: tuple[str, ...] = ("times", "attitude")


PAGES: dict[str, Page] = {}  # by the names of their files


def missing(name: str) -> list[str]:
    """The packages and programs of the left column that are not installed."""
    return [need for need in PAGES[name].needs if not (os.environ.get(need) if need.isupper() else find_spec(need))]


def tables(name: str) -> list[tuple[str, str]]:
    """The two programs (left, right) of each table of a page whose columns are programs."""
    found: list[tuple[str, str]] = []
    for table in _TABLE.findall((FOLDER / f"{name}.md").read_text()):
        blocks = _BLOCK.findall(table)
        if [language for language, _ in blocks] != ["py", "python"]:
            raise ValueError(f"a table of {name}.md has not one py block and then one python block.")
        found.append((blocks[0][1], blocks[1][1]))
    return found


def columns(name: str) -> tuple[str, str]:
    """The two programs (left, right) of the first table of a page, "The same run in both"."""
    return tables(name)[0]


def joined(name: str) -> tuple[str, str]:
    """The two programs of all tables of a page, where a later one needs what stands in the first."""
    left, right = ("\n".join(codes) for codes in zip(*tables(name), strict=True))
    return left, right


def changed(code: str, *changes: tuple[str, str]) -> str:
    """A program with other texts, given as (old, new)."""
    for old, new in changes:
        if old not in code:
            raise ValueError(f"{old!r} is not in the program\n{code}")
        code = code.replace(old, new)
    return code


def gap(name: str, theirs: np.ndarray, ours: np.ndarray) -> float:
    """The largest difference of a quantity between two programs.

    Of attitudes, quaternions (w, x, y, z) in the last axis, the angle in radians between the two; of others the
    difference relative to the largest value.
    """
    if theirs.shape != ours.shape:
        raise ValueError(f"{name} has the shape {theirs.shape} on the left and {ours.shape} on the right.")
    if name == "attitude":
        sign = np.sign(np.sum(theirs * ours, axis=-1, keepdims=True))
        return float(np.max(2 * np.linalg.norm(sign * theirs - ours, axis=-1)))
    return float(np.max(np.abs(theirs - ours)) / np.max(np.abs(ours)))


def agree(name: str, theirs: Outcome, ours: Outcome, within: float | None = None) -> None:
    """Checks that both programs have the same motion."""
    allowed = PAGES[name].within if within is None else within
    for quantity, value in ours.values.items():
        difference = gap(quantity, theirs.values[quantity], value)
        assert difference <= allowed, f"{quantity} of {name} differs by {difference:.1e}, more than {allowed:.1e}"


def both(name: str, later: int = 0, codes: tuple[str, str] | None = None) -> tuple[Outcome, Outcome]:
    """The outcomes of both columns of a page, each run as it stands, which have the same motion.

    Args:
        name: the page.
        later: how often the last paragraph of each is run again.
        codes: the two programs; by default those of the first table of the page.
    """
    left, right = codes or columns(name)
    theirs, ours = (run(code, PAGES[name].quantities, later) for code in (left, right))
    agree(name, theirs, ours)
    return theirs, ours


def row(label: str, theirs: float, ours: float, form: str = "seconds") -> Row:
    """The cells of a row; `form` is "seconds", or a format such as ".1e"."""
    left, right = (in_words(value) if form == "seconds" else format(value, form) for value in (theirs, ours))
    ratio = theirs / ours
    return label, left, right, f"{ratio:.0f}" if 10 <= ratio < 1e4 else f"{ratio:.2g}"


def times(theirs: Outcome, ours: Outcome, label: str = "the run above") -> Iterator[Row]:
    """The rows of later runs and of the first ones."""
    yield row(label, theirs.later, ours.later)
    yield row("its first call, with compiling", theirs.first, ours.first)


def error(outcome: Outcome, fine: Outcome, quantity: str = "attitude") -> float:
    """How far a quantity is from that of a far finer run; of attitudes the largest angle."""
    return gap(quantity, outcome.values[quantity], fine.values[quantity])


def errors(label: str, both: Iterable[Outcome], fine: Outcome, quantity: str = "attitude", form: str = ".1e") -> Row:
    """The row of the errors of two programs."""
    theirs, ours = (error(outcome, fine, quantity) for outcome in both)
    return row(label, theirs, ours, form)


def in_words(seconds: float) -> str:
    """Two digits of a time, in the unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= 0.995 * size or unit == "µs":
            value = seconds / size
            return f"{value:.2g} {unit}" if value < 99.5 else f"{value:.0f} {unit}"
    raise AssertionError


def as_they_stand(name: str, later: int = 5) -> Iterator[Row]:
    """The first rows of a page: its two columns, the first run and later ones."""
    yield from times(*both(name, later))
