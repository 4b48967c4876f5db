"""`midlie chart`: a table and a chart of errors against step, time and torque evaluations.

Two panels are Figure 1 of the paper; two more show the attitude error against its cost, in time and in evaluations.
"""

import argparse
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from ..advice.timing import Load, cost_clock, one_core, spread_in_words
from ..integrators.base import Method
from ..integrators.registry import ENTRIES, methods_of_figure_1
from ..model.bodies import RigidBody
from ..model.states import AxisState
from ..plot.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from . import chosen, convergence
from .convergence import Row
from .figures import (
    COOL,
    DASHED,
    FAINT,
    RING,
    SOLID,
    WARM,
    Style,
    heading,
    new_figure,
    panel,
    spread_bars,
    styles,
    write,
)
from .tables import progress_bar, require, show_table

_OF_OTHER_BODIES = (  # methods measured on translating bodies and on axes, if they support them
    *("JACOBI[EA]", "SYMMETRIC[EA]", "JACOBI[SRKN6b]", "SYMMETRIC[SRKN6b]", "LIEMID[EA]", "GBS12", "RK4"),
)
_HEADS = (
    *("method", "step", "error Pi", "slope", "error R", "slope", "torque ev."),
    *("time [s]", "+- [%]", "ns/step", "ok"),
)
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


@one_core()
def chart(options: argparse.Namespace) -> None:
    require("matplotlib", "tqdm")
    scene = chosen.scene(options.scene)
    if scene.start.several:
        raise ValueError(
            f"scene {scene.name!r} has {scene.start.count} coupled bodies, and a chart measures one; "
            f"use midlie run {scene.name} --plot run.png."
        )
    methods = chosen.methods(options.methods or (), scene.body) or _usual(scene.body)
    names = [method.name for method in methods]
    rungs = convergence.ladder(scene, options.steps, options.levels or convergence.LEVELS)
    path = options.out or f"chart-{scene.name}.png"
    if not (options.out or os.access(".", os.W_OK)):
        raise ValueError(f"cannot write {path} in this folder: permission denied; give another file with --out.")
    load, clock = Load(), cost_clock()
    reference = convergence.find_reference(scene, rungs[-1])
    title = f"{scene.name}: {scene.title}, T = {scene.duration:g}"
    described = f"{reference.source}, relative uncertainty {reference.uncertainty:.0e}"
    batch = f"per body in a batch of {convergence.COPIES}"
    print(f"{title}\nErrors at the end against the {described}.", flush=True)
    if not isinstance(scene.body, RigidBody):
        what = "the axis" if isinstance(scene.start, AxisState) else "the attitude"
        body = f"{type(scene.body).__name__}. R is {what}"
        print(f"Not the paper's Figure 1, which is for rigid bodies without translation: this is a {body}.")
    print(flush=True)
    with progress_bar(len(methods) * len(rungs), "run") as bar:
        bar.set_description(names[0])

        def show_progress(row: convergence.Row) -> None:
            bar.update()
            index = names.index(row.method) + (row.steps == rungs[-1])
            bar.set_description(names[index] if index < len(names) else "further timings")

        rows, rounds = convergence.survey(scene, methods, rungs, reference, show_progress)
    travels = reference.position is not None
    table = list[list[str]]()
    for row in rows:
        table += [[]] if table and row.steps == rungs[0] else []
        table.append(_cells(row, travels))
    show_table([*_HEADS[:6], *(["error x"] if travels else []), *_HEADS[6:]], table)
    medians = f"medians of {rounds} rounds over all methods"
    spread = f"half the distance between quartiles ({spread_in_words([row.spread for row in rows])})"
    time_name, warning = clock.name.capitalize(), load.warning()
    print(f"\n{time_name}, {batch}: {medians}; +-: {spread}.")
    print(warning, end="\n" if warning else "")
    convergence_chart(
        rows,
        path,
        title=title,
        reference=described,
        clock=f"{time_name}, whole run, {batch}  [s]",
        timing=f"Times: {medians}; bars: {spread}. {warning}",
    )
    print(f"\nwrote {path}")


def _usual(body: Any) -> list[Method]:
    """The methods of the paper and later alternatives; for a translating body or an axis, a few that support it."""
    if isinstance(body, RigidBody):
        return methods_of_figure_1()
    found = list[Method]()
    for method in (entry.method for entry in ENTRIES.values() if entry.method.name in _OF_OTHER_BODIES):
        with suppress(ValueError):  # SYMMETRIC rejects moments that are all different
            found += [method.fitted(body)] if method.moves(body) else []
    return found


def _cells(row: convergence.Row, travels: bool) -> list[str]:
    if row.failure:
        return [row.method, f"{row.dt:.6g}", f"failed: {row.failure}"]
    return [
        row.method,
        f"{row.dt:.6g}",
        f"{row.momentum_error:.2e}",
        "" if math.isnan(row.momentum_slope) else f"{row.momentum_slope:.2f}",
        f"{row.attitude_error:.2e}",
        "" if math.isnan(row.attitude_slope) else f"{row.attitude_slope:.2f}",
        *([f"{row.position_error:.2e}"] if travels else []),
        str(row.evaluations),
        f"{row.seconds:.2e}",
        f"{100 * row.spread:.0f}",
        f"{1e9 * row.seconds / row.steps:.1f}",
        "yes" if row.ok else "NO",
    ]


def convergence_chart(rows: Sequence[Row], path: str, **words: str) -> None:
    """Draws the rows, except those that failed or have no finite error, and writes a PNG."""
    write(convergence_figure(rows, **words), path)


def convergence_figure(
    rows: Sequence[Row], *, title: str, reference: str, clock: str = "Time  [s]", timing: str = ""
) -> Any:
    """The chart as a matplotlib figure, which needs no display."""
    figure = new_figure(14.0, 11.0)
    finite = [row for row in rows if not row.failure and math.isfinite(row.momentum_error + row.attitude_error)]
    if not finite:
        raise ValueError("no method gave a finite result, so there is nothing to draw; see the table for the reasons.")
    legend = "Bold lines, filled marks: the LIEMID family. Dashed lines, hollow marks: other methods."
    heading(figure, title, f"Errors at the end against the {reference}. {legend} {timing}")
    lines = {
        name: [row for row in finite if row.method == name] for name in dict.fromkeys(row.method for row in finite)
    }
    looks, torque_free = _looks(list(lines)), all(row.evaluations == 0 for row in finite)
    pi, r = "Error of body momentum  |Π - Π*|  [mass·length²/time]", "Error of attitude  |R - R*|, Frobenius  [-]"
    effort, label, work = "evaluations", "Torque evaluations, whole run  [-]", "torque evaluations"
    if torque_free:
        effort, label, work = "steps", "Steps, whole run  [-]  (no torque to evaluate)", "steps"
    panels = figure.subplots(2, 2)
    for axes, x, y, x_label, y_label, name in (
        (panels[0, 0], "dt", "momentum_error", "Step h  [time]", pi, "Body momentum against step"),
        (panels[1, 0], "dt", "attitude_error", "Step h  [time]", r, "Attitude against step"),
        (panels[0, 1], "seconds", "attitude_error", clock, r, "Attitude against time"),
        (panels[1, 1], effort, "attitude_error", label, r, f"Attitude against {work}"),
    ):
        panel(axes, name, x_label, y_label)
        _draw(axes, lines, looks, x, y)
    handles = panels[0, 0].get_legend_handles_labels()
    columns = min(len(handles[0]), 7)
    inches = 0.45 + 0.22 * -(-len(handles[0]) // columns)  # of the legend, below the panels
    figure.legend(*handles, loc="lower center", ncols=columns, fontsize=10, frameon=False)
    figure.subplots_adjust(bottom=(inches + 0.35) / figure.get_figheight(), wspace=0.16, hspace=0.27)
    return figure


def _looks(names: Sequence[str]) -> dict[str, Style]:
    """The style of each line: colours of the LIEMID family are cool and of the others warm, while there are any."""
    family = [name for name in names if name.startswith("LIEMID")]
    looks = styles(family, (*COOL, *WARM), SOLID, ours=True, fixed=_PAPER)
    used = {style.colour for style in looks.values()}
    left = [colour for colour in (*WARM, *COOL) if colour not in used] or WARM
    return looks | styles([name for name in names if name not in looks], left, DASHED, ours=False, fixed=_RIVALS)


def _draw(axes: Any, lines: dict[str, list[Row]], looks: dict[str, Style], across: str, error: str) -> None:
    axes.set(xscale="log", yscale="log")
    for index, (name, rows) in enumerate(lines.items()):
        style = looks[name]
        x = [getattr(row, across) for row in rows]
        # An error of exactly zero has no logarithm, so it is drawn below all rounding errors.
        y = [max(getattr(row, error), 1e-17) for row in rows]
        shape = style.drawn(2.4, 7.5) if style.ours else style.drawn(1.3, 6.0)
        axes.plot(x, y, label=name, zorder=(4 if style.ours else 3) - 0.01 * index, **shape)
        if across == "seconds":
            spread_bars(axes, x, y, [row.spread for row in rows], style.colour)
    axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())
    if across == "dt":
        steps = sorted({row.dt for rows in lines.values() for row in rows})
        steps = steps[:: -(-len(steps) // 8)]
        axes.set_xticks(steps, labels=[f"{h:g}" for h in steps])
        axes.minorticks_off()
    # Slopes of order 1 and 2, in the corner that the lines leave empty.
    (x0, x1), (y0, y1) = np.log10(axes.get_xlim()), np.log10(axes.get_ylim())
    length, base = min(0.5 * (x1 - x0), 0.14 * (y1 - y0)), y0 + 0.03 * (y1 - y0)
    foot, tip = (x1 - length, x1) if across == "dt" else (x0 + length, x0)
    for order, dash in ((1, ":"), (2, "--")):
        ends = [10**foot, 10**tip], [10**base, 10 ** (base + order * length)]
        axes.plot(*ends, color=FAINT, linestyle=dash, label=f"order {order}")
