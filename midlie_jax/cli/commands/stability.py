"""`midlie stability`: maps of the worst energy error over step and spin, shape or field, for several methods."""

import argparse
import time

import numpy as np

from .. import chosen
from ..figures import write
from ..stability import METHODS, Map, lines, measure, sweeps
from ..stability_chart import stability_figure
from .output import require, show_table


def stability(options: argparse.Namespace) -> None:
    """Measures the maps, prints the share of each that fails, and draws them."""
    require("matplotlib")
    scene, methods = chosen.scene(options.scene), chosen.methods(options.methods or METHODS)
    steps, varied = sweeps(scene, options.grid)
    if options.sweeps:
        there = [sweep.name for sweep in varied]
        if missing := [name for name in options.sweeps if name not in there]:
            raise ValueError(
                f"scene {scene.name!r} has no {' and no '.join(missing)} to vary; it has {', '.join(there)}."
            )
        varied = [sweep for sweep in varied if sweep.name in options.sweeps]
    for method in methods:  # raises for an unsupported method, before any method is measured
        method.fitted(scene.body)
    path = options.out or f"stability-{scene.name}.png"
    maps, rows = [], []
    for method in methods:
        began = time.perf_counter()
        maps.append(measure(method, scene, steps, varied, options.steps))
        seconds = time.perf_counter() - began
        rows += [
            [
                method.name,
                sweep.name,
                *(f"{100 * np.mean(x):.0f}" for x in (found.blown_up, found.failed)),
                f"{_median(found):.0e}",
                f"{seconds:.0f}" if sweep is varied[0] else "",
            ]
            for sweep, found in zip(varied, maps[-1], strict=True)
        ]
    heads = ["method", "sweep", "blows up [%]", "fails [%]", "median error elsewhere", "time [s]"]
    show_table(heads, rows)
    limits = {(method.name, sweep.name): lines(method, scene, sweep) for method in methods for sweep in varied}
    figure = stability_figure(
        maps,
        limits,
        steps,
        varied,
        title=f"{scene.name}: {scene.title}",
        note=(
            f"Each point of a map is one run of {options.steps} steps from the start of the scene "
            "with its spin, shape or field changed. Lines: theoretical limits for the initial state."
        ),
        time_unit=scene.time_unit,
    )
    write(figure, path)
    print(f"\nwrote {path}")


def _median(found: Map) -> float:
    good = found.worst[~(found.failed | found.blown_up)]
    return float(np.median(good)) if good.size else float("nan")
