"""A thousand heavy tops with scattered moments, weight, spin and attitude: quantiles of the tilt against time.

    python benchmarks/scattered_tops.py [--bodies 1000] [--write]

A top that stands upright does not fall while the square of its momentum about its axis exceeds 4 I1 times the weight
(weight times lever). The nominal tops have twice this limit, and 1.2 times. A deviation that is harmless in the first
tips some of the second over. Both ensembles draw from one key, so body k has the same moments, weight and attitude in
both. `--write` puts the table between the markers in docs/scatter.md and the picture into docs/scattered-tops.png.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import DOCS, Table, main

import midlie_jax as ml
from midlie_jax.cli.figures import heading, new_figure, panel, write

jax.config.update("jax_enable_x64", True)
DT, STEPS, EVERY = 0.02, 1000, 5  # seconds, steps
I1, WEIGHT, TILT = 5.0, 20.0, 0.05  # kg m^2, N m, rad
LIMIT = 4 * I1 * WEIGHT
SAFETY = (2.0, 1.2)  # nominal squares of the momentum over the limit
HEADS = (
    *("nominal momentum about the axis, kg m²/s", "tops below the limit", "tilt after 20 s: 5 %", "median", "95 %"),
    *("largest tilt", "largest relative energy error"),
)
TABLE = Table("scatter.md", "tops", HEADS)


class Outcome(NamedTuple):
    """Attributes:
    times: (n,), seconds.
    tilt: of the axis from upright, (bodies, n), degrees; NaN from where a top failed.
    below: share of the drawn tops below the limit.
    energy_error: the largest, relative to the energy at the start.
    """

    times: np.ndarray
    tilt: np.ndarray
    below: float
    energy_error: float


def momentum_of(safety: float) -> float:
    return float(np.sqrt(safety * LIMIT))


def drawn_tops(bodies: int, momentum: float) -> dict[str, Any]:
    d = ml.distributions
    return ml.scatter(
        jax.random.key(2004),
        bodies,
        moments=d.LogNormal([I1, I1, 1.0], 0.03),
        weight=d.Normal(WEIGHT, 1.0),
        momentum=d.Normal([0.0, 0.0, momentum], [0.0, 0.0, 1.0]),
        attitude=d.RotationNear(ml.so3.exp(jnp.array([TILT, 0.0, 0.0])), 0.02),
    )


def outcome(bodies: int, momentum: float) -> Outcome:
    drawn = drawn_tops(bodies, momentum)
    body, torque = ml.RigidBody(drawn["moments"]), ml.torques.HeavyTop(drawn["weight"])
    start = ml.RigidState(drawn["momentum"], drawn["attitude"])
    path = ml.ensemble("JACOBI[CHIN4A]", body, torque, start, dt=DT, steps=STEPS, save_every=EVERY)
    energy = np.asarray(jax.vmap(ml.observe.energy)(body, torque, path.states))
    height = np.asarray(ml.so3.to_matrix(path.states.attitude))[..., 2, 2]
    # The limit is that of a top with two equal moments; the larger of the two decides.
    below = drawn["momentum"][:, 2] ** 2 < 4 * drawn["moments"][:, :2].max(axis=1) * drawn["weight"]
    tilt = np.degrees(np.arccos(np.clip(height, -1, 1)))
    tilt[~np.asarray(path.ok)] = np.nan
    error = np.nanmax(np.abs(energy / energy[:, :1] - 1))
    return Outcome(np.asarray(path.times), tilt, float(jnp.mean(below)), float(error))


def row(safety: float, found: Outcome) -> list[str]:
    end = found.tilt[:, -1]
    tilts = [*np.nanquantile(end, [0.05, 0.5, 0.95]), np.nanmax(found.tilt)]
    share = f"{100 * found.below:.1f} %"
    return [f"{momentum_of(safety):.1f}", share, *(f"{x:.1f}°" for x in tilts), f"{found.energy_error:.0e}"]


def draw(results: dict[float, Outcome], bodies: int, path: str) -> None:
    figure = new_figure(12.0, 5.4)
    peaks = [np.nanquantile(found.tilt, 0.95, axis=0).max() for found in results.values()]
    title = f"Near the limit 95 % of the tops stay below {peaks[-1]:.0f}°, far from it below {peaks[0]:.0f}°"
    heading(figure, title, f"Bands: shares of {bodies:,} scattered tops, nominally tilted by {np.degrees(TILT):.1f}°.")
    figure.subplots_adjust(bottom=0.11, wspace=0.22)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, safety in zip(panels, results, strict=True):
        title = f"Squared momentum {safety:g} times the limit"
        panel(axes, title, "time [s]", "tilt of the axis from upright [degrees]" if axes is panels[0] else "")
        axes.tick_params(labelleft=True)
        axes.set_xticks(np.linspace(0, DT * STEPS, 5))
    panels[0].set(ylim=(0, 1.06 * max(peaks)), yticks=np.arange(0, 1.06 * max(peaks), 3))
    for axes, found in zip(panels, results.values(), strict=True):
        ml.plot.bands(axes, found.times, found.tilt)
    write(figure, path)


def whole(options: Any) -> None:
    results = {safety: outcome(options.bodies, momentum_of(safety)) for safety in SAFETY}
    TABLE.show(options.write, (row(safety, found) for safety, found in results.items()))
    if options.write:
        draw(results, options.bodies, str(DOCS / "scattered-tops.png"))


if __name__ == "__main__":
    main(__doc__, whole, {"--bodies": {"type": int, "default": 1000}})
