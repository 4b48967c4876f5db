"""The picture of error against cost: our methods and their frontier, the rivals thin and named at their ends."""

import math
from collections.abc import Sequence
from typing import Any

from .charts import _FAINT, _INK, _apart
from .frontier import by_method, envelope, frontier
from .rivals.problem import Point

_OURS = ("#0072B2", "#009E73", "#56B4E9", "#1B3A6B", "#5B8C85", "#3C78A8", "#7FA8D1", "#2F4B7C")
_RIVALS = {
    "heyoka": "#D55E00",
    "diffrax Tsit5": "#E69F00",
    "diffrax Dopri8": "#B8860B",
    "SciPy DOP853": "#CC79A7",
    "MuJoCo RK4": "#8C510A",
    "MuJoCo implicitfast": "#BF812D",
    "RKMK4": "#7A7A00",
    "CF4": "#A03060",
}
_GAP, _SIZE = 11.5, 8.5  # points


def work_precision_chart(
    ours: Sequence[Point], rivals: Sequence[Point], symplectic: Sequence[str], path: str, *, title: str, note: str
) -> None:
    """Draws the points and writes a PNG.

    Args:
        ours, rivals: from `work_precision.measure`.
        symplectic: the names of our methods that are; the rest are dashed.
        path: file to write; overwritten.
        title: what moved.
        note: how it was measured.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: there is nothing to draw.
        OSError: the file cannot be written.
    """
    figure = work_precision_figure(ours, rivals, symplectic, title=title, note=note)
    figure.savefig(path, format="png", metadata={"Software": "midlie_jax"})


def work_precision_figure(
    ours: Sequence[Point], rivals: Sequence[Point], symplectic: Sequence[str], *, title: str, note: str
) -> Any:
    """The same as a matplotlib figure."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install 'midlie_jax[cli]'.") from error
    if not ours and not rivals:
        raise ValueError("no method gave a finite result, so there is nothing to draw.")
    figure = Figure(figsize=(15, 7.6), dpi=110)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.055, right=0.992, bottom=0.085, top=0.85, wspace=0.13)
    panels = figure.subplots(1, 2)
    figure.text(0.055, 0.975, title, fontsize=15, weight="bold", color=_INK, va="top")
    figure.text(0.055, 0.928, note, fontsize=9.5, color=_INK, va="top", linespacing=1.4)
    free = all(math.isnan(p.evaluations) for p in ours)
    label = "Torque evaluations, whole run  [-]  (a Taylor series has none: heyoka is not here)"
    if free:
        label = "Steps, whole run  [-]  (no torque to evaluate; heyoka's are Taylor series: not here)"
    for axes, cost, x_label, name in (
        (panels[0], "seconds", "Time, whole run, per body  [s]", "Against time"),
        (
            panels[1],
            "steps" if free else "evaluations",
            label,
            "Against steps" if free else "Against torque evaluations",
        ),
    ):
        _panel(axes, ours, rivals, set(symplectic), cost)
        axes.set_title(name, loc="left", fontsize=11.5, weight="bold", color=_INK)
        axes.set_xlabel(x_label, color=_INK)
    panels[0].set_ylabel("Error of attitude  |R - R*|, Frobenius, rms over the bodies judged  [-]", color=_INK)
    return figure


def _panel(axes: Any, ours: Sequence[Point], rivals: Sequence[Point], symplectic: set[str], cost: str) -> None:
    axes.set(xscale="log", yscale="log")
    axes.grid(which="major", color="#e8e8e8", linewidth=0.8)
    axes.tick_params(which="both", colors=_INK, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_axisbelow(True)
    ends: list[tuple[str, str, bool, float, float]] = []
    edge = frontier(ours, cost)
    if edge:
        axes.plot(*zip(*edge, strict=True), color="#0b2f57", linewidth=6.5, alpha=0.3, zorder=2, solid_capstyle="round")
    for group, mine in ((by_method(ours), True), (by_method(rivals), False)):
        for index, (name, points) in enumerate(group.items()):
            if cost != "seconds" and name == "heyoka":
                continue
            line = envelope([getattr(p, cost) for p in points], [max(p.error, 1e-17) for p in points])
            if not line:
                continue
            colour = _OURS[index % len(_OURS)] if mine else _RIVALS.get(name, _FAINT)
            x, y = zip(*line, strict=True)
            dashes = "-" if not mine or name in symplectic else (0, (4, 2))
            axes.plot(
                *(x, y),
                color=colour,
                linewidth=1.7 if mine else 1.0,
                linestyle=dashes,
                marker="o" if mine else "s",
                markersize=3.6 if mine else 3.2,
                markerfacecolor=colour if mine else "white",
                markeredgewidth=0.9,
                zorder=4 if mine else 3,
            )
            ends.append((name, colour, mine, x[-1], y[-1]))
    _limits(axes, ends)
    _name(axes, ends)


def _limits(axes: Any, ends: Sequence[tuple[str, str, bool, float, float]]) -> None:
    """Errors above 10 say nothing; to the right, room for the names."""
    low, high = axes.get_xlim()
    span = math.log10(high / low)
    axes.set_xlim(low, 10 ** (math.log10(high) + 0.32 * span))
    bottom = min((end[4] for end in ends), default=1e-14)
    axes.set_ylim(min(bottom, 1e-13) / 3, 10)


def _name(axes: Any, ends: Sequence[tuple[str, str, bool, float, float]]) -> None:
    """Names in one column at the right edge, in the order of the lines' ends, each with a thin leader."""
    from matplotlib.patheffects import withStroke

    points = 72 / axes.figure.dpi
    low, high = axes.bbox.y0 * points + 6, axes.bbox.y1 * points - 6
    places = [axes.transData.transform((x, y)) * points for _, _, _, x, y in ends]
    column = axes.bbox.x1 * points - 118
    heights = _apart([place[1] for place in places], _GAP, low, high)
    for (name, colour, mine, x, y), height in zip(ends, heights, strict=True):
        line = {"arrowstyle": "-", "color": colour, "linewidth": 0.6, "alpha": 0.75, "shrinkA": 1, "shrinkB": 3}
        axes.annotate(
            name,
            (x, y),
            xytext=axes.transData.inverted().transform((column / points, height / points)),
            textcoords="data",
            ha="left",
            va="center",
            fontsize=_SIZE,
            color=colour,
            weight="bold" if mine else "normal",
            arrowprops=line,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            zorder=6,
        )
