"""The pictures of docs/pictures.md.

    python benchmarks/pictures.py [PART ...] [--folder docs]

Parts: motion (motion.png, a panel of each function of `ml.plot` that draws one path), flip (flip.gif), and the scenes
binary, waters, fleet and methods (binary.gif, ...), which are drawn by the code that stands in their section of the
page. A part takes some ten seconds, motion half a minute. The heavy top has the moments 5, 5, 1 kg m^2, the brick
1, 2, 2.5.
"""

import argparse
import contextlib
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from pages import DOCS  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax.cli.figures import PANEL_TITLE, new_figure, panel, write  # noqa: E402
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION  # noqa: E402

TOP, GRAVITY = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
BRICK = ml.RigidBody([1.0, 2.0, 2.5])
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def nutation(axes: Any) -> None:
    """A fast top that is let go at a tilt of 0.5 rad, and one that leans more."""
    for tilt, colour in ((0.5, BLUE), (1.2, VERMILLION)):
        start = ml.RigidState([0.0, 0.0, 30.0], ml.so3.exp(jnp.array([tilt, 0.0, 0.0])))
        path = ml.integrate("SYMMETRIC[CHIN4A]", TOP, GRAVITY, start, dt=0.01, steps=900)
        ml.plot.axis_path(axes, path, label=f"tilt {tilt:g} rad", colour=colour)
    axes.view_init(35, -60)


def brick_path(momentum: Any, last: float, count: int, body: ml.RigidBody = BRICK) -> Any:
    return ml.free_motion(body, ml.RigidState(momentum, UPRIGHT), jnp.linspace(0.0, last, count))


def turning_over(axes: Any) -> None:
    """Two bricks of one energy: one turns over, the other wobbles."""
    first = np.array([0.01, 2.0, 0.01])
    second = np.array([1.0, 0.6, 0.6])
    energies = [np.sum(p**2 / np.asarray(BRICK.moments)) for p in (first, second)]
    second *= np.sqrt(energies[0] / energies[1])
    for momentum, name, colour in ((first, "turns over", BLUE), (second, "wobbles", VERMILLION)):
        ml.plot.polhode(axes, BRICK, brick_path(momentum, 40.0, 801), label=name, colour=colour)
    axes.view_init(22, 35)


def errors(axes: Any) -> None:
    """Methods of order 1, 2 and 6 with the same step."""
    panel(axes, "conserved", "time  [s]", "relative error  [-]")
    start = ml.RigidState([0.0, 0.0, 30.0], ml.so3.exp(jnp.array([0.5, 0.0, 0.0])))
    for method, colour in (("LIEMID[E1]", VERMILLION), ("LIEMID[EA]", GREEN), ("JACOBI[SRKN6b]", BLUE)):
        path = ml.integrate(method, TOP, GRAVITY, start, dt=0.01, steps=2000, save_every=4)
        ml.plot.conserved(axes, TOP, GRAVITY, path, label=method.split("[")[1].rstrip("]"), colour=colour)


# An asymmetric top, all starts with one energy and one vertical momentum.
MOMENTS, WEIGHT, ENERGY, VERTICAL = np.array([3.0, 2.0, 1.5]), 1.0, 2.0, 0.3
STARTS = ((1.0, -0.1), (0.9, -0.4), (1.0, -0.65), (1.0, -0.9), (1.0, -1.1), (1.0, -1.3), (-1.2, -1.4), (0.0, -1.9))


def section(t: Any, state: Any) -> Any:
    """Axis 1 passes through the horizontal."""
    return state.direction[0]


def angle(t: Any, state: Any) -> Any:
    return jnp.arctan2(state.direction[1], state.direction[2])


def across(t: Any, state: Any) -> Any:
    """The component of the momentum across the vertical and axis 1: conjugate to the angle."""
    _, y, z = state.direction
    return state.momentum[1] * z - state.momentum[2] * y


def started(theta: float, q: float) -> ml.DirectionState | None:
    """The state on the section at (angle, momentum across) with the given energy; None if it has not enough."""
    vertical = np.array([0.0, np.sin(theta), np.cos(theta)])
    momentum = VERTICAL * vertical + q * np.array([0.0, np.cos(theta), -np.sin(theta)])
    left = ENERGY - WEIGHT * np.cos(theta) - np.sum(momentum**2 / MOMENTS) / 2
    if left < 0:
        return None
    momentum[0] = np.sqrt(2 * MOMENTS[0] * left)
    return ml.DirectionState(momentum, vertical)


def sections(axes: Any) -> None:
    panel(axes, "poincare", "angle of the vertical from e3 towards e2  [rad]", "Π across  [kg m²/s]")
    body, torque = ml.RigidBody(MOMENTS), ml.torques.HeavyTop(WEIGHT)
    colours = (BLUE, VERMILLION, GREEN, SKY, ORANGE, PURPLE, GREY, "black")
    for start, colour in zip(STARTS, colours, strict=True):
        state = started(*start)
        if state is None:
            raise ValueError(f"there is no state of this energy at {start}.")
        path = ml.integrate("JACOBI[CHIN4A]", body, torque, state, dt=0.05, steps=40_000, save_every=4)
        ml.plot.poincare(axes, path, section, angle, across, colour=colour, size=1.6)


def motion() -> Any:
    figure = new_figure(11.5, 8.2)
    top, bottom = (figure.add_subplot(2, 2, i, projection="3d") for i in (1, 2))
    for axes, title, draw in ((top, "axis_path", nutation), (bottom, "polhode", turning_over)):
        axes.set_title(title, loc="left", fontsize=PANEL_TITLE, weight="bold")
        draw(axes)
    errors(figure.add_subplot(2, 2, 3))
    sections(figure.add_subplot(2, 2, 4))
    figure.subplots_adjust(left=0.095, right=0.9, top=0.96, bottom=0.07, wspace=0.75, hspace=0.12)
    return figure


def flip(folder: Path) -> None:
    ml.plot.animate(
        BRICK, brick_path([0.01, 2.0, 0.01], 18.0, 361), folder / "flip.gif",
        axis="e2", frames=48, size=240, rate=16.0, azimuth=50.0,
    )  # fmt: skip


# The scenes, and the titles of their sections.
SCENES = {
    "binary": "A binary asteroid",
    "waters": "A box of molecules",
    "fleet": "A fleet of satellites",
    "methods": "Methods side by side",
}
PARTS = ("motion", "flip", *SCENES)


def draw_scene(name: str, folder: Path) -> None:
    """Runs the code of a scene as the page shows it, after the first code of the page, in a folder of its own.

    The picture goes to `folder` as NAME.gif, and so does the page NAME.html, unless the folder is that of the pages.
    """
    text = (DOCS / "pictures.md").read_text()
    first, *others = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)
    section = dict(zip(others[::2], others[1::2], strict=True))[SCENES[name]]
    code = [block for part in (first, section) for block in re.findall(r"^```python\n(.*?)^```$", part, re.M | re.S)]
    with tempfile.TemporaryDirectory() as place:
        with contextlib.chdir(place):
            exec("\n".join(code), {})
        for ending in (".gif",) if folder == DOCS else (".gif", ".html"):
            shutil.copy(Path(place) / (name + ending), folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; by default all")
    parser.add_argument("--folder", type=Path, default=DOCS)
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}.")
    folder = options.folder.resolve()
    for part in options.parts or PARTS:
        if part == "motion":
            write(motion(), str(folder / "motion.png"))
        elif part == "flip":
            flip(folder)
        else:
            draw_scene(part, folder)
        file = folder / ("motion.png" if part == "motion" else f"{part}.gif")
        print(f"{file.name}: {file.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
