"""The chart of errors measured by `convergence`, against step, time and torque evaluations.

`convergence_chart` draws Figure 1 of the paper, the errors of momentum and attitude against the step. Two more panels
show the attitude error against its cost, in time and in torque evaluations.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..plot.labels import apart
from ..plot.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from .convergence import Row
from .figures import FAINT, heading, new_figure, panel, spread_bars, write
from .line_labels import End, label_ends
from .line_styles import COOL, DASHED, RING, SOLID, WARM, Style, styles

_GUIDE_SIZE = 8.5  # points
# The methods of the paper have the same style in every chart. LIEMID[EA*] nearly coincides with LIEMID[EA], so its mark
# is a ring around the other mark.
_PAPER = {
    "LIEMID[E1]": Style(SKY, "v", SOLID, True),
    "LIEMID[E2]": Style(GREEN, "^", SOLID, True),
    "LIEMID[EA]": Style(BLUE, "o", SOLID, True),
    "LIEMID[EA*]": Style("#1B3A6B", RING, SOLID, True),
    "LIEMID[I]": Style(BLACK, "X", SOLID, True),
}
_RIVALS = {
    "AKW": Style(ORANGE, "s", DASHED, False),
    "SW": Style(VERMILLION, "D", DASHED, False),
    "NMB": Style(PURPLE, "p", DASHED, False),
}


def convergence_chart(
    rows: Sequence[Row], path: str, *, title: str, reference: str, clock: str = "Time  [s]", timing: str = ""
) -> None:
    """Draws the rows, except those that failed or have no finite error, and writes a PNG."""
    write(convergence_figure(rows, title=title, reference=reference, clock=clock, timing=timing), path)


def convergence_figure(
    rows: Sequence[Row], *, title: str, reference: str, clock: str = "Time  [s]", timing: str = ""
) -> Any:
    """The chart as a matplotlib figure, which needs no display; arguments as for `convergence_chart`."""
    figure = new_figure(14.0, 11.0)
    finite = [row for row in rows if not row.failure and math.isfinite(row.momentum_error + row.attitude_error)]
    if not finite:
        raise ValueError("no method gave a finite result, so there is nothing to draw; see the table for the reasons.")
    legend = "Bold lines, filled marks: the LIEMID family. Dashed lines, hollow marks: other methods."
    heading(figure, title, f"Errors at the end against the {reference}. {legend} {timing}")
    figure.subplots_adjust(bottom=0.062, wspace=0.16, hspace=0.27)
    panels = figure.subplots(2, 2)
    torque_free = all(row.evaluations == 0 for row in finite)
    momentum, attitude = (lambda row: row.momentum_error), (lambda row: row.attitude_error)
    pi, r = "Error of body momentum  |Π - Π*|  [mass·length²/time]", "Error of attitude  |R - R*|, Frobenius  [-]"
    effort, effort_label = (lambda row: row.evaluations), "Torque evaluations, whole run  [-]"
    if torque_free:
        effort, effort_label = (lambda row: row.steps), "Steps, whole run  [-]  (no torque to evaluate)"
    chart = _Panels(finite)
    chart.draw(panels[0, 0], _step, momentum, "Step h  [time]", pi, "Body momentum against step", finest="left")
    chart.draw(panels[1, 0], _step, attitude, "Step h  [time]", r, "Attitude against step", finest="left")
    chart.draw(panels[0, 1], _seconds, attitude, clock, r, "Attitude against time", finest="right")
    work = "Attitude against steps" if torque_free else "Attitude against torque evaluations"
    chart.draw(panels[1, 1], effort, attitude, effort_label, r, work, finest="right")
    return figure


def _step(row: Row) -> float:
    return row.dt


def _seconds(row: Row) -> float:
    return row.seconds


class _Panels:
    """Draws several panels from the same rows."""

    def __init__(self, rows: Sequence[Row]):
        self.lines = {name: [r for r in rows if r.method == name] for name in dict.fromkeys(r.method for r in rows)}
        family = [name for name in self.lines if name.startswith("LIEMID")]
        others = [name for name in self.lines if name not in family]
        self.styles = styles(family, COOL, SOLID, ours=True, fixed=_PAPER)
        self.styles |= styles(others, WARM, DASHED, ours=False, fixed=_RIVALS)

    def draw(
        self,
        axes: Any,
        across: Callable[[Row], float],
        error: Callable[[Row], float],
        x_label: str,
        y_label: str,
        title: str,
        *,
        finest: str,
    ) -> None:
        axes.set(xscale="log", yscale="log")
        panel(axes, title, x_label, y_label)
        ends = []
        for index, (name, rows) in enumerate(self.lines.items()):
            style = self.styles[name]
            x = [across(row) for row in rows]
            # An error of exactly zero has no logarithm, so it is drawn below all rounding errors.
            y = [max(error(row), 1e-17) for row in rows]
            shape = style.drawn(2.4, 7.5) if style.ours else style.drawn(1.3, 6.0)
            axes.plot(x, y, label=name, zorder=(4 if style.ours else 3) - 0.01 * index, **shape)
            if across is _seconds:
                spread_bars(axes, x, y, [row.spread for row in rows], style.colour)
            ends.append(End(name, style.colour, x[-1], y[-1], style.ours))
        if finest == "left":
            steps = sorted({across(row) for rows in self.lines.values() for row in rows})
            axes.set_xticks(steps[:: -(-len(steps) // 8)], labels=[f"{h:g}" for h in steps[:: -(-len(steps) // 8)]])
            axes.minorticks_off()
        _limits(axes)
        label_ends(axes, ends, finest)
        _guides(axes, finest)


def _limits(axes: Any) -> None:
    lines = [line for line in axes.lines if len(line.get_xdata())]
    x = np.log10(np.concatenate([line.get_xdata() for line in lines]))
    y = np.log10(np.concatenate([line.get_ydata() for line in lines]))
    width, height = max(np.ptp(x), 0.3), max(np.ptp(y), 1.0)
    axes.set_xlim(10 ** (x.min() - 0.05 * width), 10 ** (x.max() + 0.05 * width))
    axes.set_ylim(10 ** (y.min() - 0.08 * height), 10 ** (y.max() + 0.06 * height))


def _guides(axes: Any, finest: str) -> None:
    (x0, x1), (y0, y1) = np.log10(axes.get_xlim()), np.log10(axes.get_ylim())
    length = min(0.15 * (x1 - x0), 0.14 * (y1 - y0))
    inset, sign, align = 0.12 * (x1 - x0), (1 if finest == "left" else -1), ("left" if finest == "left" else "right")
    tip = x1 - inset if finest == "left" else x0 + inset
    foot, base = tip - sign * length, y0 + 0.045 * (y1 - y0)
    tops = [base + order * length for order in (1, 2)]
    unit = axes.bbox.height * 72 / axes.figure.dpi / (y1 - y0)  # points per decade
    names = apart([top * unit for top in tops], 1.3 * _GUIDE_SIZE, y0 * unit + _GUIDE_SIZE, y1 * unit)
    for order, top, name in zip((1, 2), tops, names, strict=True):
        axes.plot([10**foot, 10**tip], [10**base, 10**top], color=FAINT, linewidth=1.2, zorder=2)
        text = {"xytext": (4 * sign, name - top * unit), "textcoords": "offset points", "ha": align, "va": "center"}
        axes.annotate(f"order {order}", (10**tip, 10**top), fontsize=_GUIDE_SIZE, color="#5f5f5f", **text)
