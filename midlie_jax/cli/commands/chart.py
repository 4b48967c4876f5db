"""`midlie chart`: a table and a chart of errors against steps and costs."""

import argparse
import math
import os

from ...advice.timing import Load, cost_clock, one_core, spread_in_words
from ...methods.registry import paper_methods
from .. import charts, chosen, convergence
from .output import progress_bar, require, show_table

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
    methods = chosen.methods(options.methods or ()) or paper_methods()
    names = [method.name for method in methods]
    rungs = convergence.ladder(scene, options.steps, options.levels or convergence.LEVELS)
    path = options.out or _in_current_folder(f"chart-{scene.name}.png")
    load, clock = Load(), cost_clock()
    reference = convergence.find_reference(scene, rungs[-1])
    title = f"{scene.name}: {scene.title}, T = {scene.duration:g}"
    described = f"{reference.source}, relative uncertainty {reference.uncertainty:.0e}"
    batch = f"per body in a batch of {convergence.COPIES}"
    print(f"{title}\nErrors at the end against the {described}.\n", flush=True)
    with progress_bar(len(methods) * len(rungs), "run") as bar:
        bar.set_description(names[0])

        def show_progress(row: convergence.Row) -> None:
            bar.update()
            index = names.index(row.method) + (row.steps == rungs[-1])
            bar.set_description(names[index] if index < len(names) else "further timings")

        rows, rounds = convergence.survey(scene, methods, rungs, reference, show_progress)
    show_table(
        list(_HEADS),
        [
            cells
            for row in rows
            for cells in ([[]] if row.steps == rungs[0] and row is not rows[0] else []) + [_cells(row)]
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


def _in_current_folder(name: str) -> str:
    if not os.access(".", os.W_OK):
        raise ValueError(f"cannot write {name} in this folder: permission denied; give another file with --out.")
    return name


def _cells(row: convergence.Row) -> list[str]:
    if row.failure:
        return [row.method, f"{row.dt:.6g}", f"failed: {row.failure}"]
    return [
        row.method,
        f"{row.dt:.6g}",
        f"{row.momentum_error:.2e}",
        "" if math.isnan(row.momentum_slope) else f"{row.momentum_slope:.2f}",
        f"{row.attitude_error:.2e}",
        "" if math.isnan(row.attitude_slope) else f"{row.attitude_slope:.2f}",
        str(row.evaluations),
        f"{row.seconds:.2e}",
        f"{100 * row.spread:.0f}",
        f"{1e9 * row.seconds / row.steps:.1f}",
        "yes" if row.ok else "NO",
    ]
