"""The four small pictures of README.md: tops, an asteroid past the Earth, a binary asteroid, dipoles in a bath.

    python benchmarks/face.py [--folder docs]

writes face-*.png, in half a minute.
"""

import argparse
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from laboratory import flyby  # noqa: E402
from laboratory.binaries import didymos  # noqa: E402
from matplotlib.colors import LinearSegmentedColormap  # noqa: E402
from pages import DOCS  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax.cli.figures import INK, new_figure, panel, write  # noqa: E402
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION  # noqa: E402

SIZE = 4.6, 3.6  # inches
OFFSET: dict[str, Any] = {"textcoords": "offset points"}


def tops(figure: Any) -> None:
    """The axes of three heavy tops: let go at rest, pushed forwards, pushed backwards."""
    axes = figure.add_axes((0.02, -0.1, 0.86, 1.05), projection="3d")
    top, gravity = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
    cases = (("let go", 0.4, 0.0, BLUE), ("pushed on", 0.8, 8.0, GREEN), ("pushed back", 1.2, -8.0, VERMILLION))
    for name, tilt, push, colour in cases:
        start = ml.RigidState([0.0, push, 30.0], ml.so3.exp(jnp.array([tilt, 0.0, 0.0])))
        path = ml.integrate("SYMMETRIC[CHIN4A]", top, gravity, start, dt=0.01, steps=1400)
        ml.plot.axis_path(axes, path, label=name, colour=colour)
    axes.view_init(38, -60)


def asteroid(figure: Any) -> None:
    """The rotation rate of Apophis in sixty of the phases in which it may pass the Earth."""
    axes = figure.add_axes((0.15, 0.15, 0.81, 0.8))
    panel(axes, "", "time from the perigee, April 2029  [h]", "rotation rate  [revolutions per day]")
    starts = flyby.starts(60)
    path = ml.ensemble(
        "JACOBI[SRKN6b]", flyby.body(), flyby.torque(), starts, dt=600.0, steps=576, t0=-flyby.HALF, save_every=2
    )
    rate = ml.tumble(flyby.body(), path.states).effective_rate * 86400 / (2 * np.pi)
    within = np.abs(path.times) <= 15 * flyby.HOUR
    shade = np.interp(rate[:, -1], [rate.min(), rate[:, 0].mean(), rate.max()], [0.0, 0.5, 1.0])
    colours = LinearSegmentedColormap.from_list("slower to faster", [BLUE, GREY, VERMILLION])
    for turns, colour in zip(np.asarray(rate), colours(shade), strict=True):
        axes.plot(path.times[within] / flyby.HOUR, turns[within], color=colour, linewidth=0.9)
    axes.set(xlim=(-15, 15), ylim=(0, None))


def binary(figure: Any) -> None:
    """Didymos and its moon from above, to scale, every hour of an orbit."""
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.98))
    gravity = ml.torques.MutualGravity(didymos.G)
    path = ml.integrate("JACOBI[SRKN14a]", didymos.BODY, gravity, didymos.start(), dt=300.0, steps=144)
    places, turns = path.states.position, ml.so3.to_matrix(path.states.attitude)
    axes.plot(*np.asarray(places[:, 1, :2]).T, color=GREY, linewidth=0.8)
    hours = range(0, 144, 12)
    for moments, mass, colour, which, times in zip(
        didymos.MOMENTS, didymos.MASSES, (SKY, ORANGE), (0, 1), (hours[:1], hours), strict=True
    ):
        squares = 5 / (2 * mass) * (np.sum(moments) - 2 * np.array(moments))  # of the semi-axes of an ellipsoid
        for n in times:
            place, turn = np.asarray(places[n, which]), np.asarray(turns[n, which])
            axes.fill(*_outline(place, turn, squares), color=colour)
            ends = np.array([-1.0, 1.0])[:, None] * np.sqrt(squares[0]) * turn[:2, 0] + place[:2]
            axes.plot(*ends.T, color=INK, linewidth=0.9)
    axes.annotate("Didymos", (0, -440), ha="center", va="top", color=INK)
    axes.annotate("Dimorphos, every hour", (0, -1010), ha="center", color=INK)
    axes.plot([900, 1400], [-1290, -1290], color=INK, linewidth=1.2)
    axes.annotate("500 m", (1150, -1270), ha="center", va="bottom", color=INK)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _outline(place: np.ndarray, turn: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """The edge of an ellipsoid as seen along z, (2, n): its support in each direction of the plane."""
    angle = np.linspace(0, 2 * np.pi, 100)
    shadow = (turn * squares) @ turn.T
    root = np.linalg.cholesky(shadow[:2, :2])
    return place[:2, None] + root @ np.stack([np.cos(angle), np.sin(angle)])


def bath(figure: Any) -> None:
    """Tilts of two thousand dipoles in a field, once they have the temperature of the bath."""
    axes = figure.add_axes((0.15, 0.15, 0.81, 0.8))
    panel(axes, "", "cosine of the angle to the field  [-]", "probability density  [-]")
    n, kT, x = 2000, 0.7, 2.0
    start = ml.RigidState(jnp.zeros((n, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, 1)))
    heat = ml.torques.Langevin(kT, friction=1.0, key=jax.random.split(jax.random.key(0), n))
    path = ml.ensemble(
        "SYMMETRIC[BAOAB]", ml.RigidBody([1.0, 1.0, 0.5]), ml.torques.HeavyTop(-x * kT) + heat, start,
        dt=0.1, steps=2000, save_every=20, observe=ml.observe.Axis(),
    )  # fmt: skip
    axes.hist(np.ravel(path.states[:, 10:, 2]), np.linspace(-1, 1, 41), density=True, color=SKY)
    cosine = np.linspace(-1, 1, 200)
    density = x * np.exp(x * cosine) / (2 * np.sinh(x))
    axes.plot(cosine, density, color=VERMILLION)
    axes.annotate("Boltzmann", (cosine[160], density[160]), (-8, 4), ha="right", color=VERMILLION, **OFFSET)
    axes.annotate("the run", (0.98, 0.06), (-4, 0), ha="right", color=INK, **OFFSET)
    axes.set(xlim=(-1, 1))


PICTURES = {"face-tops.png": tops, "face-asteroid.png": asteroid, "face-binary.png": binary, "face-bath.png": bath}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=DOCS)
    folder = parser.parse_args().folder
    for name, draw in PICTURES.items():
        figure = new_figure(*SIZE)
        draw(figure)
        write(figure, str(folder / name))


if __name__ == "__main__":
    main()
