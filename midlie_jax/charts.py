"""Pictures of what `convergence` measured, with matplotlib, which comes with an extra and is imported when used.

`convergence_chart` draws the paper's Figure 1, the errors of momentum and attitude against the step, and beside it
the attitude error against what it costs, in time and in torque evaluations.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .convergence import COPIES, Row

_LABEL_GAP = 11.0  # points from one label's middle to the next
_LABEL_WIDTH = 70.0  # points; labels nearer than this sideways are kept apart upwards
_LABEL_OFFSET = 20.0  # points from a line's end to its label
_LABEL_SIZE = 8.5
_INK, _FAINT = "#222222", "#8a8a8a"
_RING = "ring"  # a marker to see round another: LIEMID[EA*] nearly coincides with LIEMID[EA]


class _Style(NamedTuple):
    colour: str
    marker: str
    paper: bool  # the LIEMID family: bold, filled; its rivals: thin, dashed, hollow


# Okabe and Ito's colours, which every kind of colour vision tells apart: cool for the LIEMID family, warm for rivals.
_STYLES = {
    "LIEMID[E1]": _Style("#56B4E9", "v", True),
    "LIEMID[E2]": _Style("#009E73", "^", True),
    "LIEMID[EA]": _Style("#0072B2", "o", True),
    "LIEMID[EA*]": _Style("#1B3A6B", _RING, True),
    "LIEMID[I]": _Style("#000000", "X", True),
    "AKW": _Style("#E69F00", "s", False),
    "SW": _Style("#D55E00", "D", False),
    "NMB": _Style("#CC79A7", "p", False),
}
_COOL = ("#56B4E9", "#009E73", "#0072B2", "#1B3A6B", "#000000")
_WARM = ("#E69F00", "#D55E00", "#CC79A7", "#8C510A", "#7A7A00")
_MARKERS = "o^vXPsDphd*<>"


def convergence_chart(rows: Sequence[Row], path: str, *, title: str, reference: str) -> None:
    """Draws the rows and writes a PNG.

    Args:
        rows: from `convergence.measure`; failed ones and those without a finite error are left out.
        path: file to write; overwritten.
        title: what moved.
        reference: what the errors were measured against.

    Raises:
        ImportError: matplotlib is missing.
        ValueError: there is nothing to draw.
        OSError: the file cannot be written.
    """
    figure = convergence_figure(rows, title=title, reference=reference)
    figure.savefig(path, format="png", metadata={"Software": "midlie_jax"})


def convergence_figure(rows: Sequence[Row], *, title: str, reference: str) -> Any:
    """The same as a matplotlib figure, for those who want to change it; it needs no display."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install 'midlie_jax[cli]'.") from error
    good = [row for row in rows if not row.failure and math.isfinite(row.momentum_error + row.attitude_error)]
    if not good:
        raise ValueError("no method gave a finite result, so there is nothing to draw; see the table for the reasons.")
    figure = Figure(figsize=(14, 11), dpi=110)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.065, right=0.985, bottom=0.062, top=0.895, wspace=0.16, hspace=0.27)
    panels = figure.subplots(2, 2)
    figure.text(0.065, 0.975, title, fontsize=15, weight="bold", color=_INK, va="top")
    legend = "Bold lines, filled marks: the LIEMID family. Dashed lines, hollow marks: its rivals."
    figure.text(
        0.065, 0.944, f"Errors at the end against the {reference}.  {legend}", fontsize=10, color=_INK, va="top"
    )

    torque_free = all(row.evaluations == 0 for row in good)
    momentum, attitude = (lambda row: row.momentum_error), (lambda row: row.attitude_error)
    pi, r = "Error of body momentum  |Π - Π*|  [mass·length²/time]", "Error of attitude  |R - R*|, Frobenius  [-]"
    effort, effort_label = (lambda row: row.evaluations), "Torque evaluations, whole run  [-]"
    if torque_free:
        effort, effort_label = (lambda row: row.steps), "Steps, whole run  [-]  (no torque to evaluate)"
    panel = _Panel(good)
    panel.draw(panels[0, 0], _step, momentum, "Step h  [time]", pi, "Body momentum against step", finest="left")
    panel.draw(panels[1, 0], _step, attitude, "Step h  [time]", r, "Attitude against step", finest="left")
    clock = f"Wall time, whole run, per body in a batch of {COPIES}  [s]"
    panel.draw(panels[0, 1], _seconds, attitude, clock, r, "Attitude against wall time", finest="right")
    work = "Attitude against steps" if torque_free else "Attitude against torque evaluations"
    panel.draw(panels[1, 1], effort, attitude, effort_label, r, work, finest="right")
    return figure


def _step(row: Row) -> float:
    return row.dt


def _seconds(row: Row) -> float:
    return row.seconds


class _Panel:
    """Draws panels of the same rows."""

    def __init__(self, rows: Sequence[Row]):
        self.lines = {name: [r for r in rows if r.method == name] for name in dict.fromkeys(r.method for r in rows)}

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
        """One panel; `finest` is the side on which the smallest steps lie, and so the labels."""
        axes.set(xscale="log", yscale="log")
        axes.set_title(title, loc="left", fontsize=11.5, weight="bold", color=_INK)
        axes.set_xlabel(x_label, color=_INK)
        axes.set_ylabel(y_label, color=_INK)
        axes.grid(which="major", color="#e3e3e3", linewidth=0.8)
        axes.tick_params(which="both", colors=_INK, labelsize=9)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_axisbelow(True)
        ends = []
        for index, (name, rows) in enumerate(self.lines.items()):
            style = _style(name, index)
            x = np.array([across(row) for row in rows])
            # An error of exactly zero has no logarithm: it is shown at a twentieth of rounding.
            y = np.maximum([error(row) for row in rows], 1e-17)
            axes.plot(
                x,
                y,
                color=style.colour,
                linewidth=2.4 if style.paper else 1.3,
                linestyle="-" if style.paper else (0, (4, 2)),
                zorder=(4 if style.paper else 3) - 0.01 * index,
                **_marks(style),
            )
            ends.append((name, style, float(x[-1]), float(y[-1])))
        if finest == "left":
            steps = sorted({across(row) for rows in self.lines.values() for row in rows})
            axes.set_xticks(steps[:: -(-len(steps) // 8)], labels=[f"{h:g}" for h in steps[:: -(-len(steps) // 8)]])
            axes.minorticks_off()
        _room(axes, finest)
        _guides(axes, finest)
        _labels(axes, ends, finest)


def _style(name: str, index: int) -> _Style:
    if name in _STYLES:
        return _STYLES[name]
    paper = name.startswith("LIEMID")
    return _Style((_COOL if paper else _WARM)[index % 5], _MARKERS[index % len(_MARKERS)], paper)


def _marks(style: _Style) -> dict[str, Any]:
    if style.marker == _RING:
        return {"marker": "o", "markersize": 12, "markerfacecolor": "none", "markeredgecolor": style.colour}
    if style.paper:
        return {"marker": style.marker, "markersize": 7.5, "markeredgecolor": "white", "markeredgewidth": 0.7}
    return {"marker": style.marker, "markersize": 6, "markerfacecolor": "white", "markeredgewidth": 1.3}


def _room(axes: Any, finest: str) -> None:
    """Space for the labels at the fine end, and below the lines for the guides."""
    lines = [line for line in axes.lines if len(line.get_xdata())]
    x = np.log10(np.concatenate([line.get_xdata() for line in lines]))
    y = np.log10(np.concatenate([line.get_ydata() for line in lines]))
    width, height = max(np.ptp(x), 0.3), max(np.ptp(y), 1.0)
    left, right = x.min() - 0.05 * width, x.max() + 0.05 * width
    if finest == "left":
        left -= 0.26 * width
    else:
        right += 0.26 * width
    axes.set_xlim(10**left, 10**right)
    axes.set_ylim(10 ** (y.min() - 0.08 * height), 10 ** (y.max() + 0.06 * height))


def _guides(axes: Any, finest: str) -> None:
    """The slopes of orders 1 and 2, in the corner that falling errors leave free."""
    (x0, x1), (y0, y1) = np.log10(axes.get_xlim()), np.log10(axes.get_ylim())
    length = min(0.15 * (x1 - x0), 0.14 * (y1 - y0))
    inset, sign, align = 0.12 * (x1 - x0), (1 if finest == "left" else -1), ("left" if finest == "left" else "right")
    tip = x1 - inset if finest == "left" else x0 + inset
    foot, base = tip - sign * length, y0 + 0.045 * (y1 - y0)
    for order in (1, 2):
        top = base + order * length
        axes.plot([10**foot, 10**tip], [10**base, 10**top], color=_FAINT, linewidth=1.2, zorder=2)
        text = {"xytext": (4 * sign, 0), "textcoords": "offset points", "ha": align, "va": "center"}
        axes.annotate(f"order {order}", (10**tip, 10**top), fontsize=_LABEL_SIZE, color="#5f5f5f", **text)


def _labels(axes: Any, ends: list[tuple[str, _Style, float, float]], finest: str) -> None:
    """Names beside the fine ends of the lines, pushed apart where they would overlap."""
    from matplotlib.patheffects import withStroke

    points = 72 / axes.figure.dpi
    sign, align = (-1, "right") if finest == "left" else (1, "left")
    low, high = axes.bbox.y0 * points + 6, axes.bbox.y1 * points - 6
    places = [axes.transData.transform((x, y)) * points for _, _, x, y in ends]
    for cluster in _clusters([place[0] for place in places], _LABEL_WIDTH):
        edge = max((places[i][0] for i in cluster), key=lambda at: sign * at) + sign * _LABEL_OFFSET
        heights = _apart([places[i][1] for i in cluster], _LABEL_GAP, low, high)
        for i, height in zip(cluster, heights, strict=True):
            name, style, x, y = ends[i]
            line = {"arrowstyle": "-", "color": style.colour, "linewidth": 0.7, "shrinkA": 1, "shrinkB": 5}
            axes.annotate(
                name,
                (x, y),
                xytext=axes.transData.inverted().transform((edge / points, height / points)),
                textcoords="data",
                ha=align,
                va="center",
                fontsize=_LABEL_SIZE,
                color=style.colour,
                weight="bold" if style.paper else "normal",
                arrowprops=line,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
                zorder=6,
            )


def _clusters(values: Sequence[float], near: float) -> list[list[int]]:
    """Indices in groups; a value belongs to the group of any other that is near."""
    order = sorted(range(len(values)), key=lambda i: values[i])
    groups: list[list[int]] = []
    for i in order:
        if groups and values[i] - values[groups[-1][-1]] < near:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _apart(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """The nearest heights, in the sense of least squares, that are `gap` apart and in the same order.

    With the gaps subtracted this is isotonic regression: neighbours out of order are pooled at their mean.
    """
    order = sorted(range(len(heights)), key=lambda i: heights[i])
    pools: list[list[float]] = []  # (mean, members)
    for rank, i in enumerate(order):
        pools.append([heights[i] - rank * gap, 1])
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            mean, members = pools.pop()
            pools[-1] = [
                (pools[-1][0] * pools[-1][1] + mean * members) / (pools[-1][1] + members),
                pools[-1][1] + members,
            ]
    room = max(low, high - (len(heights) - 1) * gap)
    placed = [min(max(mean, low), room) for mean, members in pools for _ in range(int(members))]
    result = [0.0] * len(heights)
    for rank, i in enumerate(order):
        result[i] = placed[rank] + rank * gap
    return result
