"""Room for names beside panels, on figures without a layout engine, such as those of `plt.subplots()`.

A layout engine ("constrained", "tight") moves panels until all text around them fits. Without one, matplotlib lets
names run off the page or over the next panel. With this module a panel gives up some of its width, or moves, whenever
it is drawn, so it follows later changes of limits, sizes and labels. This uses an axes locator, matplotlib's hook for
the purpose.
"""

from collections.abc import Callable
from typing import Any

from .style import is_3d

_EDGE = 3.0  # points that stay free at the edges of the page and before the next panel
_LEAST = 0.25  # the share of its width, or of its size if it is 3-D, that a panel keeps at least
_SAME = 1e-6  # places on the page that differ by a smaller fraction of it count as the same

Rule = Callable[[Any, Any], Any]


class Locator:
    """Places axes by a rule when they are drawn, unless a layout engine places them.

    Attributes:
        axes: the axes.
        rule: returns the place of the axes, in fractions of the page, from the axes and the renderer.
    """

    def __init__(self, axes: Any, rule: Rule):
        self.axes, self.rule = axes, rule

    def __call__(self, axes: Any, renderer: Any) -> Any:
        return self.rule(axes, renderer) if _lacks_engine(axes) else axes.get_position(original=True)

    def get_subplotspec(self) -> Any:
        """For `tight_layout`, which asks the locator instead of the axes."""
        return self.axes.get_subplotspec()


def locate(axes: Any, rule: Rule) -> None:
    """Lets a rule place the axes, unless something else places them already."""
    if axes.get_axes_locator() is None:
        axes.set_axes_locator(Locator(axes, rule))


def _lacks_engine(axes: Any) -> bool:
    from matplotlib.layout_engine import ConstrainedLayoutEngine, TightLayoutEngine

    return not isinstance(axes.figure.get_layout_engine(), ConstrainedLayoutEngine | TightLayoutEngine)


def in_same_column(axes: Any, rule: Rule) -> list[Any]:
    """All axes placed by this rule that would have the same left and right edge without it.

    Axes at the same edges that share their x axis with the panel, or lie on top of it, are placed by the rule from now
    on, too: with other edges their scales would not match.
    """
    column = [other for other in axes.figure.axes if _alike(axes, other, "x")]
    for other in column:
        if axes.get_shared_x_axes().joined(axes, other) or _alike(axes, other, "y"):
            locate(other, rule)
    return [other for other in column if _rule(other) is rule]


def _alike(axes: Any, other: Any, letter: str) -> bool:
    """Whether two panels would have the same edges in one direction without this module."""
    intervals = [one.get_position(original=True) for one in (axes, other)]
    mine, its = ([getattr(box, f"{letter}{end}") for end in (0, 1)] for box in intervals)
    return all(abs(a - b) < _SAME for a, b in zip(mine, its, strict=True))


def _rule(axes: Any) -> Any:
    locator = axes.get_axes_locator()
    return locator.rule if isinstance(locator, Locator) else None


def own_place(axes: Any) -> Any:
    """Where the axes would be without this module, in pixels."""
    return axes.get_position(original=True).transformed(axes.figure.transSubfigure)


def on_page(axes: Any, x0: float, y0: float, x1: float, y1: float) -> Any:
    """A place given in pixels, in the form that a locator returns."""
    from matplotlib.transforms import Bbox

    return Bbox.from_extents(x0, y0, x1, y1).transformed(axes.figure.transSubfigure.inverted())


def narrowed(axes: Any, needed: float, renderer: Any) -> float:
    """The right edge, in pixels, of a plain panel that leaves room for names `needed` pixels wide."""
    place = own_place(axes)
    limit = reach(axes, renderer)[1] - needed
    return max(min(place.x1, limit), place.x0 + _LEAST * place.width)


def fitted(axes: Any, middle: float, picture: float, left: float, right: float, renderer: Any) -> tuple[float, float]:
    """The factor for the size of a 3-D panel, and its shift in pixels, that bring picture and names onto the page.

    Args:
        axes: 3-D axes, placed at `own_place`.
        middle: the middle of the picture, pixels.
        picture: half the width of the picture, pixels.
        left, right: widths of the names on either side, with their leaders, pixels.
        renderer: the renderer of the figure.
    """
    low, high = reach(axes, renderer)
    factor = min(1.0, max(_LEAST, (high - low - left - right) / (2 * picture)))
    centre = (axes.bbox.x0 + axes.bbox.x1) / 2  # the centre of the panel, around which it shrinks
    middle = centre + factor * (middle - centre)
    start, end = middle - factor * picture - left, middle + factor * picture + right
    return factor, min(0.0, high - end) if end > high else max(0.0, low - start)


def reach(axes: Any, renderer: Any) -> tuple[float, float]:
    """How far to the left and to the right, in pixels, names beside the axes may reach."""
    place, page, free = own_place(axes), axes.figure.bbox, _EDGE * axes.figure.dpi / 72
    low, high = page.x0, page.x1
    for other in axes.figure.axes:
        its = own_place(other)
        if other is axes or not other.get_visible() or its.y1 <= place.y0 or its.y0 >= place.y1:
            continue
        tolerance = _SAME * page.width
        if its.x0 >= place.x1 - tolerance:
            high = min(high, _border(axes, other, place.x1, its.x0, renderer))
        elif is_3d(axes) and its.x1 <= place.x0 + tolerance:  # plain panels have names only to the right
            low = max(low, _border(axes, other, place.x0, its.x1, renderer))
    return low + free, high - free


def _border(axes: Any, other: Any, mine: float, its: float, renderer: Any) -> float:
    """The border between two panels whose facing edges are at `mine` and `its`.

    A plain panel keeps the room for its labels. A 3-D panel cannot be asked for that: its answer would need this
    border.
    """
    if not is_3d(other):
        extent = other.get_tightbbox(renderer)
        return extent.x0 if its >= mine else extent.x1
    return (mine + its) / 2 if is_3d(axes) else its
