"""Draws the light curve of a tumbling ellipsoid beside those of slower tumbling, and what its shape does to it."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import midlie_jax as ml
from midlie_jax.cli.figures import few_colours, panel
from midlie_jax.plot.style import BLUE, SIZE, VERMILLION, new_figure

HOUR = 3600.0
SEMI_AXES, DENSITY = (150.0, 75.0, 60.0), 2500.0  # m, kg/m^3
SUN, OBSERVER = (1.0, 0.0, 0.0), (0.8, 0.6, 0.0)
SPINS = {"about its shortest axis": (0.0, 0.0, 1.0), "tumbling": (0.65, 0.1, 0.75)}  # directions of the momentum
_MESSAGES = {
    "about its shortest axis": "Spin about the shortest axis: all minima are equal",
    "tumbling": "Tumbling: no two minima in a row are equal",
}
PERIOD, HOURS, EVERY = 27.0, 120.0, 0.1  # hours: of a turn by the largest moment, of the run, between samples


def light_curve(direction: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Hours and magnitudes relative to their mean."""
    body, surface = ml.Surface.ellipsoid(SEMI_AXES).principal(DENSITY)
    seen = ml.observe.Brightness(surface, SUN, OBSERVER, ml.observe.LommelSeeliger(lambert=0.1), magnitude=True)
    towards = np.array(direction) / np.linalg.norm(direction)
    momentum = 2 * np.pi / (PERIOD * HOUR) * body.moments[2] * jnp.asarray(towards)
    start = ml.RigidState(momentum, ml.so3.exp(jnp.array([0.4, 0.2, 0.0])))
    options: Any = {"dt": EVERY * HOUR, "steps": round(HOURS / EVERY), "observe": seen}
    path: Any = ml.integrate("JACOBI[EA]", body, None, start, **options)
    values = np.asarray(path.states)
    return np.asarray(path.times) / HOUR, values - values.mean()


def draw(out: Path | None) -> None:
    """Prints the ranges of the curves; with a path, draws them one above the other."""
    curves = {name: light_curve(direction) for name, direction in SPINS.items()}
    for name, (_, values) in curves.items():
        print(f"{name}: {np.ptp(values):.2f} mag from the brightest to the faintest")
    if out is None:
        return
    figure = new_figure(9, 5.2)
    axes = figure.subplots(2, 1, sharex=True, sharey=True)
    figure.subplots_adjust(left=0.09, right=0.985, top=0.93, bottom=0.11, hspace=0.28)
    for one, colour, (name, (hours, values)) in zip(axes, (BLUE, VERMILLION), curves.items(), strict=True):
        panel(one, _MESSAGES[name], "", "relative magnitude [mag]")
        one.plot(hours, values, color=colour, linewidth=1.3)
        one.yaxis.label.set_fontsize(SIZE + 2)
    axes[0].invert_yaxis()
    axes[1].set_xlabel("time [h]", fontsize=SIZE + 2)
    axes[0].set_xlim(0, HOURS)
    figure.savefig(out, dpi=110)
    out.write_bytes(few_colours(out.read_bytes()))
