"""Colour, dash and mark of every line of a chart; no two lines have the same combination.

The colours come from Okabe and Ito (Color Universal Design, 2008), with a few dark colours that are equally easy to
distinguish in any colour vision (`tests/test_charts.py`). Cool colours are for the methods of this package, warm
colours for others. There are few colours, so lines of the same colour have different marks.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

from ..plot.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

COOL = (BLUE, GREEN, SKY, "#1B3A6B", BLACK)
WARM = (VERMILLION, ORANGE, PURPLE, "#A03060", "#662506")
_MARKS = ("o", "^", "s", "v", "D", "P", "X", "<", "p", ">", "d", "h", "*")  # 13: coprime to the 5 colours
SOLID, DASHED = "-", (0, (4, 2))
_DASHES = ((0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (8, 2, 1, 2, 1, 2)))  # for more lines than colour-mark pairs
RING = "ring"  # a mark that is visible around another mark


class Style(NamedTuple):
    """Attributes:
    colour: as in matplotlib.
    mark: matplotlib's marker, or `RING`.
    dash: matplotlib's line style.
    ours: whether marks are filled, for methods of this package, or hollow.
    """

    colour: str
    mark: str
    dash: Any
    ours: bool

    def drawn(self, width: float, size: float) -> dict[str, Any]:
        """The arguments of `Axes.plot` for a line; width of the line and size of the marks in points."""
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
    """A style for each name, in order; names in `fixed` have the style given there, and no other name gets it."""
    names, fixed = list(dict.fromkeys(names)), fixed or {}
    taken = {(style.colour, style.mark) for style in fixed.values()}
    unused = _unused(colours, dash, taken)
    return {name: fixed[name] if name in fixed else Style(*next(unused), ours) for name in names}


def _unused(colours: Sequence[str], dash: Any, taken: set[tuple[str, str]]) -> Iterator[tuple[str, str, Any]]:
    for i in count():
        turn, rest = divmod(i, len(colours) * len(_MARKS))
        pair = (colours[rest % len(colours)], _MARKS[rest % len(_MARKS)])
        if pair not in taken:
            yield *pair, dash if turn == 0 else _DASHES[(turn - 1) % len(_DASHES)]
