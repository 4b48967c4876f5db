"""`midlie chart`: a table and a chart of errors against steps and costs."""

import argparse
import math
import os
from contextlib import suppress
from typing import Any

from ...advice.timing import Load, cost_clock, one_core, spread_in_words
from ...methods.base import Method
from ...methods.registry import ENTRIES, methods_of_figure_1
from ...model.bodies import RigidBody
from ...model.states import AxisState
from .. import charts, chosen, convergence
from ..scenes import Scene
from .output import progress_bar, require, show_table

_OF_OTHER_BODIES = (  # methods measured on translating bodies and on axes, if they support them
    *("JACOBI[EA]", "SYMMETRIC[EA]", "JACOBI[SRKN6b]", "SYMMETRIC[SRKN6b]", "LIEMID[EA]", "GBS12", "RK4"),
)
_HEADS = (
    *("method", "step", "error Pi", "slope", "error R", "slope", "torque ev."),
    *("time [s]", "+- [%]", "ns/step", "ok"),
)


def chart(options: argparse.Namespace) -> None:
    """Measures on one core, prints the table and draws the chart."""
    with one_core():
        _measure_and_draw(options)


def _measure_and_draw(options: argparse.Namespace) -> None:
    require("matplotlib", "tqdm", "mpmath")
    scene = chosen.scene(options.scene)
    if scene.start.several:
        raise ValueError(
            f"scene {scene.name!r} has {scene.start.count} coupled bodies, and a chart measures one; "
            f"use midlie run {scene.name} --plot run.png."
        )
    methods = chosen.methods(options.methods or (), scene.body) or _usual(scene.body)
    names = [method.name for method in methods]
    rungs = convergence.ladder(scene, options.steps, options.levels or convergence.LEVELS)
    path = options.out or _in_current_folder(f"chart-{scene.name}.png")
    load, clock = Load(), cost_clock()
    reference = convergence.find_reference(scene, rungs[-1])
    title = f"{scene.name}: {scene.title}, T = {scene.duration:g}"
    described = f"{reference.source}, relative uncertainty {reference.uncertainty:.0e}"
    batch = f"per body in a batch of {convergence.COPIES}"
    print(f"{title}\nErrors at the end against the {described}.", flush=True)
    note = _not_figure_1(scene)
    print(f"{note}\n" if note else "", flush=True)
    with progress_bar(len(methods) * len(rungs), "run") as bar:
        bar.set_description(names[0])

        def show_progress(row: convergence.Row) -> None:
            bar.update()
            index = names.index(row.method) + (row.steps == rungs[-1])
            bar.set_description(names[index] if index < len(names) else "further timings")

        rows, rounds = convergence.survey(scene, methods, rungs, reference, show_progress)
    travels = reference.position is not None
    show_table(
        [*_HEADS[:6], *(["error x"] if travels else []), *_HEADS[6:]],
        [
            cells
            for row in rows
            for cells in ([[]] if row.steps == rungs[0] and row is not rows[0] else []) + [_cells(row, travels)]
        ],
    )
    medians = "medians of one round" if rounds == 1 else f"medians of {rounds} rounds over all methods"
    spread = f"half the distance between quartiles ({spread_in_words([row.spread for row in rows])})"
    time_name, warning = clock.name.capitalize(), load.warning()
    print(f"\n{time_name}, {batch}: {medians}; +-: {spread}.")
    print(warning, end="\n" if warning else "")
    charts.convergence_chart(
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


def _not_figure_1(scene: Scene) -> str:
    """A line if this is not the figure of the paper; "" otherwise."""
    if isinstance(scene.body, RigidBody):
        return ""
    what = "the axis" if isinstance(scene.start, AxisState) else "the attitude"
    body = type(scene.body).__name__
    return f"Not the paper's Figure 1, which is for rigid bodies without translation: this is a {body}. R is {what}."


def _in_current_folder(name: str) -> str:
    if not os.access(".", os.W_OK):
        raise ValueError(f"cannot write {name} in this folder: permission denied; give another file with --out.")
    return name


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
