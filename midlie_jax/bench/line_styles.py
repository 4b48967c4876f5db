"""Colour, dash and mark of every line of a chart, no two alike.

The colours are those of Okabe and Ito (Color Universal Design, 2008) and a few dark ones that keep as far from them in
any colour vision (`tests/test_charts.py`): cool ones for our methods, warm ones for others. They are few, so marks tell
apart the lines that share one.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

COOL = ("#0072B2", "#009E73", "#56B4E9", "#1B3A6B", "#000000")
WARM = ("#D55E00", "#E69F00", "#CC79A7", "#A03060", "#662506")
_MARKS = ("o", "^", "s", "v", "D", "P", "X", "<", "p", ">", "d", "h", "*")  # 13: no factor in common with 5 colours
SOLID, DASHED = "-", (0, (4, 2))
_DASHES = ((0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (8, 2, 1, 2, 1, 2)))  # for more lines than colours times marks
RING = "ring"  # a mark to see round another


class Style(NamedTuple):
    """Attributes:
    colour: as matplotlib writes it.
    mark: matplotlib's marker, or `RING`.
    dash: matplotlib's line style.
    ours: heavy line and filled marks; else thin and hollow.
    """

    colour: str
    mark: str
    dash: Any
    ours: bool

    def drawn(self, width: float, size: float) -> dict[str, Any]:
        """The arguments of `Axes.plot` for a line of a width and marks of a size, points."""
        line = {"color": self.colour, "linewidth": width, "linestyle": self.dash}
        if self.mark == RING:
            return line | {"marker": "o", "markersize": 1.6 * size, "markerfacecolor": "none"}
        if self.ours:
            return line | {"marker": self.mark, "markersize": size, "markeredgecolor": "white", "markeredgewidth": 0.6}
        return line | {"marker": self.mark, "markersize": size, "markerfacecolor": "white", "markeredgewidth": 1.1}


def styles(
    names: Iterable[str],
    colours: Sequence[str],
    dash: Any,
    *,
    ours: bool,
    fixed: Mapping[str, Style] | None = None,
) -> dict[str, Style]:
    """A style for each name, in order; those `fixed` keep theirs, and nobody else has one like it."""
    names, fixed = list(dict.fromkeys(names)), fixed or {}
    taken = {(style.colour, style.mark) for style in fixed.values()}
    fresh = _fresh(colours, dash, taken)
    return {name: fixed[name] if name in fixed else Style(*next(fresh), ours) for name in names}


def _fresh(colours: Sequence[str], dash: Any, taken: set[tuple[str, str]]) -> Iterator[tuple[str, str, Any]]:
    for i in count():
        turn, rest = divmod(i, len(colours) * len(_MARKS))
        pair = (colours[rest % len(colours)], _MARKS[rest % len(_MARKS)])
        if pair not in taken:
            yield *pair, dash if turn == 0 else _DASHES[(turn - 1) % len(_DASHES)]
