"""The chart of error against cost: the frontiers of our three families in bold, beside the rivals and single methods.

The left panel compares our families with other programs, by time. The right panel shows the methods that make the
frontiers, by torque evaluations. One legend names all lines."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from midlie_jax.cli.figures import SOLID, WARM, Style, heading, new_figure, panel, spread_bars, styles
from midlie_jax.plot.style import BLACK, BLUE, GREEN

from .frontier import FAMILIES, best_at, by_method, envelope, frontier, members
from .kinds import RIGID
from .rivals import RIVALS
from .rivals.problem import Point


class Band(NamedTuple):
    """How the frontier of a family of methods is drawn.

    Attributes:
        colour: of the line, of the name of the family, and of its methods.
        width: points.
        alpha: opacity.
    """

    colour: str
    width: float
    alpha: float


# From the widest to the narrowest, drawn in this order: where frontiers coincide, each is seen beside the next.
BANDS = {
    "general": Band(BLUE, 11.0, 0.4),
    "conserving": Band(GREEN, 6.0, 1.0),
    "symplectic": Band(BLACK, 2.4, 1.0),
}


LEGEND = "Bold: the fastest methods of midlie_jax in three families. Hollow: other programs."
CLOSED = "free_motion is the closed form and takes no steps."
ATTITUDE = RIGID.measured
_LEAST = 1e-17  # an error of exactly zero has no logarithm: it is drawn below rounding
_TOP = 10.0  # of the panels: a larger error of a rotation matrix has no meaning
_NAMED = 5  # thin lines of the right panel, beside three bold ones
_MOST = 1.0  # at larger errors a method does not follow the motion, and the frontiers show nothing


def work_precision_figure(
    ours: Sequence[Point],
    rivals: Sequence[Point],
    families: Mapping[str, str],
    *,
    title: str,
    note: str,
    measured: str = ATTITUDE,
    clock: str = "time",
) -> Any:
    """The chart as a matplotlib figure, for `write`.

    Args:
        ours, rivals: from `work_precision.measure`.
        families: the smallest family of each of our methods, by its name.
        title: the scene.
        note: how errors and times were measured.
        measured: what the errors are of.
        clock: the kind of time, such as "processor time".

    Raises:
        ImportError: matplotlib is missing.
        ValueError: there is nothing to draw.
    """
    figure = new_figure(15.0, 8.0)
    if not ours and not rivals:
        raise ValueError(
            "no method gave a finite result, so there is nothing to draw; see the failures printed before."
        )
    heading(figure, title, note)
    figure.subplots_adjust(bottom=0.08, right=0.855, wspace=0.05)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.2, 1.0))
    torque_free = all(math.isnan(p.evaluations) for p in ours)
    what = "steps" if torque_free else "torque evaluations"
    label = f"{what}, whole run [-]"
    error = f"error of {measured}, rms over the bodies [-]"
    panel(left, "Run time", f"{clock}, whole run, per body [s]", error)
    panel(right, f"Number of {what}", label, "")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log")
    bottom = min(max(p.error, _LEAST) for p in (*ours, *rivals))
    left.set_ylim(min(bottom, 1e-13) / 3, _TOP)
    our_styles = _our_styles(families)
    # All rivals have a style, measured or not: the same on all charts.
    rival_styles = styles([*(rival.label for rival in RIVALS), *by_method(rivals)], WARM, SOLID, ours=False)
    # A closed form is cheaper and more exact than all methods: with it the frontiers would be one point.
    useful = [p for p in ours if p.error <= _MOST and not math.isnan(p.steps)]
    for axes, cost in ((left, "seconds"), (right, "steps" if torque_free else "evaluations")):
        edges = {name: frontier(members(useful, families, name), cost) for name in FAMILIES}
        _draw_frontiers(axes, edges)
        if axes is left:  # with the closed form, which the right panel, by steps, does not show
            _draw_lines(axes, [p for p in ours if math.isnan(p.steps)], our_styles, cost)
            _draw_lines(axes, rivals, rival_styles, cost)
        else:
            leading = _leading(useful or ours, families, edges, cost)
            _draw_lines(axes, [p for p in ours if p.method in leading], our_styles, cost)
    named = {}
    for axes in (left, right):
        handles, names = axes.get_legend_handles_labels()
        named |= dict(zip(names, handles, strict=True))
    figure.legend(named.values(), named, loc="center right", fontsize=9, frameon=False)
    return figure


def _leading(
    points: Sequence[Point], families: Mapping[str, str], edges: Mapping[str, Sequence[tuple[float, float]]], cost: str
) -> list[str]:
    """At most `_NAMED` methods: those that make most of the frontiers, or the first ones if there is no frontier."""
    counts = Counter(
        best_at(members(points, families, name), error, cost).method
        for name, edge in edges.items()
        for _, error in edge
    )
    return [name for name, _ in counts.most_common(_NAMED)] or list(by_method(points))[:_NAMED]


def _our_styles(families: Mapping[str, str]) -> dict[str, Style]:
    """For each of our methods the colour of its family, and a mark of its own in that family."""
    found: dict[str, Style] = {}
    for name in FAMILIES:
        found |= styles(
            [m for m, family in families.items() if family == name], (BANDS[name].colour,), SOLID, ours=True
        )
    return found


def _draw_frontiers(axes: Any, edges: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    for order, (name, band) in enumerate(BANDS.items()):
        if edges[name]:
            shape = {"color": band.colour, "linewidth": band.width, "alpha": band.alpha, "zorder": 2.6 + 0.1 * order}
            axes.plot(
                *zip(*edges[name], strict=True), label=name, solid_capstyle="round", solid_joinstyle="round", **shape
            )


def _draw_lines(axes: Any, points: Sequence[Point], line_styles: Mapping[str, Style], cost: str) -> None:
    """Draws a thin line for each method or program, ours below the frontiers."""
    for name, own in by_method(points).items():
        line = envelope([getattr(p, cost) for p in own], [max(p.error, _LEAST) for p in own])
        if not line or line[-1][1] > _TOP:  # all of it is above the panel
            continue
        style = line_styles[name]
        x, y = zip(*line, strict=True)
        shape = style.drawn(0.9, 4.5) if style.ours else style.drawn(1.3, 5.0)
        axes.plot(x, y, label=name, zorder=2 if style.ours else 4, **shape)
        if cost == "seconds" and not style.ours:
            spreads = {(p.seconds, max(p.error, _LEAST)): p.spread for p in own}
            spread_bars(axes, x, y, [spreads[point] for point in line], style.colour)
