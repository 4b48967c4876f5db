"""The picture of error against cost: our methods and their frontier, the rivals thin and hollow, all named."""

import math
from collections.abc import Sequence
from typing import Any

from .figures import heading, new_figure, panel, spread_bars, write
from .frontier import by_method, envelope, frontier
from .line_labels import End, label_ends
from .line_styles import COOL, DASHED, SOLID, WARM, Style, styles
from .rivals import RIVALS
from .rivals.problem import Point


def work_precision_chart(
    ours: Sequence[Point],
    rivals: Sequence[Point],
    symplectic: Sequence[str],
    path: str,
    *,
    title: str,
    note: str,
    clock: str = "time",
) -> None:
    """Draws the points and writes a PNG.

    Args:
        ours, rivals: from `work_precision.measure`.
        symplectic: the names of our methods that are; the rest are dashed.
        path: file to write; overwritten.
        title: what moved.
        note: how it was measured.
        clock: what the times are, as "processor time".

    Raises:
        ImportError: matplotlib is missing.
        ValueError: there is nothing to draw.
        OSError: the file cannot be written.
    """
    write(work_precision_figure(ours, rivals, symplectic, title=title, note=note, clock=clock), path)


def work_precision_figure(
    ours: Sequence[Point],
    rivals: Sequence[Point],
    symplectic: Sequence[str],
    *,
    title: str,
    note: str,
    clock: str = "time",
) -> Any:
    """The same as a matplotlib figure."""
    figure = new_figure(15.0, 8.0)
    if not ours and not rivals:
        raise ValueError("no method gave a finite result, so there is nothing to draw.")
    heading(figure, title, note)
    figure.subplots_adjust(bottom=0.08, wspace=0.13)
    left, right = figure.subplots(1, 2)
    free = all(math.isnan(p.evaluations) for p in ours)
    label = "Torque evaluations, whole run  [-]  (a Taylor series has none: heyoka is not here)"
    if free:
        label = "Steps, whole run  [-]  (no torque to evaluate; heyoka's are Taylor series: not here)"
    chosen = _styles(ours, rivals, set(symplectic))
    error = "Error of attitude  |R - R*|, Frobenius, rms over the bodies judged  [-]"
    panel(left, "Against time", f"{clock.capitalize()}, whole run, per body  [s]", error)
    _draw(left, ours, rivals, chosen, "seconds")
    panel(right, "Against steps" if free else "Against torque evaluations", label, "")
    _draw(right, ours, rivals, chosen, "steps" if free else "evaluations")
    return figure


def _styles(ours: Sequence[Point], rivals: Sequence[Point], symplectic: set[str]) -> dict[str, Style]:
    """Ours in cool colours, dashed if not symplectic; rivals in warm ones, each the same on all charts."""
    mine = {
        name: style if name in symplectic else style._replace(dash=DASHED)
        for name, style in styles(by_method(ours), COOL, SOLID, ours=True).items()
    }
    return mine | styles([*(rival.label for rival in RIVALS), *by_method(rivals)], WARM, SOLID, ours=False)


def _draw(axes: Any, ours: Sequence[Point], rivals: Sequence[Point], chosen: dict[str, Style], cost: str) -> None:
    axes.set(xscale="log", yscale="log")
    ends: list[End] = []
    edge = frontier(ours, cost)
    if edge:
        axes.plot(*zip(*edge, strict=True), color="#0b2f57", linewidth=6.5, alpha=0.3, zorder=2, solid_capstyle="round")
    for name, points in by_method([*ours, *rivals]).items():
        if cost != "seconds" and name == "heyoka":
            continue
        line = envelope([getattr(p, cost) for p in points], [max(p.error, 1e-17) for p in points])
        if not line:
            continue
        style = chosen[name]
        x, y = zip(*line, strict=True)
        shape = style.drawn(1.7, 6.0) if style.ours else style.drawn(1.0, 4.6)
        axes.plot(x, y, label=name, zorder=4 if style.ours else 3, **shape)
        if cost == "seconds":
            spreads = {(p.seconds, max(p.error, 1e-17)): p.spread for p in points}
            spread_bars(axes, x, y, [spreads[at] for at in line], style.colour)
        ends.append(End(name, style.colour, x[-1], y[-1], style.ours))
    bottom = min((end.y for end in ends), default=1e-14)
    axes.set_ylim(min(bottom, 1e-13) / 3, 10)  # errors above 10 say nothing
    label_ends(axes, ends)
