"""`midlie chart`: errors against steps and costs as a table and a picture, for our methods or beside other programs."""

import argparse
import math
import os

from ...drivers.timing import Load, cost_clock, one_core, spread_in_words
from ...methods.registry import method as find_method
from ...methods.registry import paper_methods
from ...model.bodies import RigidBody
from .. import charts, convergence, scenes
from .output import require, show_table

_HEADS = (
    *("method", "step", "error Pi", "slope", "error R", "slope", "torque ev."),
    *("time [s]", "+- [%]", "ns/step", "ok"),
)


def chart(options: argparse.Namespace) -> None:
    """Measures, prints and draws, on one core."""
    with one_core():
        if options.rivals:
            _beside_rivals(options)
        else:
            _alone(options)


def _alone(options: argparse.Namespace) -> None:
    require("matplotlib", "tqdm", "mpmath")
    from tqdm import tqdm

    scene = scenes.scene(options.scene)
    methods = _chosen(options.methods) or [method.name for method in paper_methods()]
    rungs = convergence.ladder(scene, options.steps, options.levels or convergence.LEVELS)
    path = options.out or _in_this_folder(f"chart-{scene.name}.png")
    load, clock = Load(), cost_clock()
    reference = convergence.find_reference(scene, rungs[-1])
    title = f"{scene.name}: {scene.title}, T = {scene.duration:g}"
    known = f"{reference.source}, good to {reference.uncertainty:.0e} of its size"
    batch = f"per body in a batch of {convergence.COPIES}"
    print(f"{title}\nErrors at the end against the {known}.\n", flush=True)
    with tqdm(
        total=len(methods) * len(rungs), unit="run", mininterval=0.5, dynamic_ncols=True, leave=False, disable=None
    ) as bar:
        bar.set_description(methods[0])

        def seen(row: convergence.Row) -> None:
            bar.update()
            at = methods.index(row.method) + (row.steps == rungs[-1])
            bar.set_description(methods[at] if at < len(methods) else "timed again")

        rows, rounds = convergence.survey(scene, methods, rungs, reference, seen)
    show_table(
        list(_HEADS),
        [
            cells
            for row in rows
            for cells in ([[]] if row.steps == rungs[0] and row is not rows[0] else []) + [_cells(row)]
        ],
    )
    turns = "one round" if rounds == 1 else f"{rounds} rounds over all methods"
    spread = f"half the distance between quartiles ({spread_in_words([row.spread for row in rows])})"
    what, warning = clock.name.capitalize(), load.warning()
    print(f"\n{what}, {batch}: medians of {turns}; +-: {spread}.")
    print(warning, end="\n" if warning else "")
    charts.convergence_chart(
        rows,
        path,
        title=title,
        reference=known,
        clock=f"{what}, whole run, {batch}  [s]",
        timing=f"Times: medians of {turns}; bars either way: {spread}. {warning}",
    )
    print(f"\nwrote {path}")


def _beside_rivals(options: argparse.Namespace) -> None:
    from .. import frontier, rivals, work_precision
    from ..frontier_chart import work_precision_chart

    rivals.require()
    require("matplotlib", "mpmath")
    if options.steps or options.levels:
        raise ValueError("--steps and --levels do not go with --rivals, which finds its own.")
    scene = scenes.scene(options.scene)
    path = options.out or _in_this_folder(f"chart-{scene.name}-rivals.png")
    found = work_precision.compared(scene.name, _chosen(options.methods))
    print()
    show_table(list(frontier.HEADS), [frontier.cells(row) for row in found.ratios])
    print(f"\n{work_precision.timing_note(found)}")
    work_precision_chart(
        *(found.ours, found.rivals, work_precision.symplectic(found.ours), path),
        title=work_precision.title(found.problem),
        note=work_precision.note(found),
        clock=cost_clock().name,
    )
    print(f"\nwrote {path}")


def _chosen(names: list[str] | None) -> list[str] | None:
    """The methods named, each once, all of which move a rigid body."""
    for name in names or []:
        if find_method(name).bodies is not RigidBody:
            raise ValueError(f"method {name!r} does not move a rigid body; see `midlie methods`.")
    return list(dict.fromkeys(names)) if names else None


def _in_this_folder(name: str) -> str:
    if not os.access(".", os.W_OK):
        raise ValueError(f"cannot write {name} in this folder: permission denied; name another with --out.")
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
