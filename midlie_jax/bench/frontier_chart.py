"""The chart of error against cost: our methods with their frontier, and the rivals in thin lines with hollow marks."""

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
        symplectic: the names of our symplectic methods; the others are dashed.
        path: file to write; an existing file is replaced.
        title: the scene.
        note: how errors and times were measured.
        clock: the kind of time, such as "processor time".

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
    """The chart as a matplotlib figure. Arguments as for `work_precision_chart`."""
    figure = new_figure(15.0, 8.0)
    if not ours and not rivals:
        raise ValueError(
            "no method gave a finite result, so there is nothing to draw; see the failures printed before."
        )
    heading(figure, title, note)
    figure.subplots_adjust(bottom=0.08, wspace=0.13)
    left, right = figure.subplots(1, 2)
    torque_free = all(math.isnan(p.evaluations) for p in ours)
    label = "Torque evaluations, whole run  [-]  (without heyoka, whose Taylor series evaluates no torque)"
    if torque_free:
        label = "Steps, whole run  [-]  (no torque to evaluate; without heyoka, whose steps are Taylor series)"
    line_styles = _styles(ours, rivals, set(symplectic))
    error = "Error of attitude  |R - R*|, Frobenius, rms over the bodies  [-]"
    panel(left, "Against time", f"{clock.capitalize()}, whole run, per body  [s]", error)
    _draw(left, ours, rivals, line_styles, "seconds")
    panel(right, "Against steps" if torque_free else "Against torque evaluations", label, "")
    _draw(right, ours, rivals, line_styles, "steps" if torque_free else "evaluations")
    return figure


def _styles(ours: Sequence[Point], rivals: Sequence[Point], symplectic: set[str]) -> dict[str, Style]:
    """Cool colours for our methods, dashed if not symplectic; warm colours for rivals, the same on all charts."""
    our_styles = {
        name: style if name in symplectic else style._replace(dash=DASHED)
        for name, style in styles(by_method(ours), COOL, SOLID, ours=True).items()
    }
    return our_styles | styles([*(rival.label for rival in RIVALS), *by_method(rivals)], WARM, SOLID, ours=False)


def _draw(axes: Any, ours: Sequence[Point], rivals: Sequence[Point], line_styles: dict[str, Style], cost: str) -> None:
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
        style = line_styles[name]
        x, y = zip(*line, strict=True)
        shape = style.drawn(1.7, 6.0) if style.ours else style.drawn(1.0, 4.6)
        axes.plot(x, y, label=name, zorder=4 if style.ours else 3, **shape)
        if cost == "seconds":
            spreads = {(p.seconds, max(p.error, 1e-17)): p.spread for p in points}
            spread_bars(axes, x, y, [spreads[point] for point in line], style.colour)
        ends.append(End(name, style.colour, x[-1], y[-1], style.ours))
    bottom = min((end.y for end in ends), default=1e-14)
    axes.set_ylim(min(bottom, 1e-13) / 3, 10)  # an error above 10 has no meaning
    label_ends(axes, ends)
