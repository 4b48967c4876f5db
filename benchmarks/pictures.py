"""The pictures of docs/pictures.md, index.md, orbits.md and scatter.md.

    python benchmarks/pictures.py [PART ...] [--folder docs]

Parts: motion (motion.png, a panel of each function of `ml.plot` that draws one path), flip (flip.gif), the scenes
binary, waters, fleet and methods (binary.gif, ...), which are drawn by the code that stands in their section of the
page, face, the four small pictures of docs/index.md (face-*.png), modes (tumbling.png), scatter (scattered-tops.png,
whose table `--write` puts into its page). The heavy top has the moments 5, 5, 1 kg m^2, the brick 1, 2, 2.5.
"""

import contextlib
import re
import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import DOCS, Line, Panel, Table, chart, main
from matplotlib.colors import LinearSegmentedColormap

import midlie_jax as ml
from midlie_jax.cli.figures import INK, PANEL_TITLE, heading, new_figure, panel, write
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION

jax.config.update("jax_enable_x64", True)

import binaries as didymos  # noqa: E402, because they make bodies in float64
import flyby  # noqa: E402

TOP, GRAVITY = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
BRICK = ml.RigidBody([1.0, 2.0, 2.5])
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def axes_of_tops(axes: Any, cases: Any, steps: int, elevation: float) -> None:
    """The axes of heavy tops with a tilt and a push across: label, tilt, push, colour."""
    for label, tilt, push, colour in cases:
        start = ml.RigidState([0.0, push, 30.0], ml.so3.exp(jnp.array([tilt, 0.0, 0.0])))
        path = ml.integrate("SYMMETRIC[CHIN4A]", TOP, GRAVITY, start, dt=0.01, steps=steps)
        ml.plot.axis_path(axes, path, label=label, colour=colour)
    axes.view_init(elevation, -60)


def nutation(axes: Any) -> None:
    axes_of_tops(axes, [("tilt 0.5 rad", 0.5, 0.0, BLUE), ("tilt 1.2 rad", 1.2, 0.0, VERMILLION)], 900, 35)


def brick_path(momentum: Any, last: float, count: int, body: ml.RigidBody = BRICK) -> Any:
    return ml.free_motion(body, ml.RigidState(momentum, UPRIGHT), jnp.linspace(0.0, last, count))


def turning_over(axes: Any) -> None:
    first = np.array([0.01, 2.0, 0.01])
    second = np.array([1.0, 0.6, 0.6])
    energies = [np.sum(p**2 / np.asarray(BRICK.moments)) for p in (first, second)]
    second *= np.sqrt(energies[0] / energies[1])
    for momentum, name, colour in ((first, "turns over", BLUE), (second, "wobbles", VERMILLION)):
        ml.plot.polhode(axes, BRICK, brick_path(momentum, 40.0, 801), label=name, colour=colour)
    axes.view_init(22, 35)


def errors(axes: Any) -> None:
    panel(axes, "conserved", "time  [s]", "relative error  [-]")
    start = ml.RigidState([0.0, 0.0, 30.0], ml.so3.exp(jnp.array([0.5, 0.0, 0.0])))
    for method, colour in (("LIEMID[E1]", VERMILLION), ("LIEMID[EA]", GREEN), ("JACOBI[SRKN6b]", BLUE)):
        path = ml.integrate(method, TOP, GRAVITY, start, dt=0.01, steps=2000, save_every=4)
        ml.plot.conserved(axes, TOP, GRAVITY, path, label=method.split("[")[1].rstrip("]"), colour=colour)


# An asymmetric top, all starts with one energy and one vertical momentum.
MOMENTS, WEIGHT, ENERGY, VERTICAL = np.array([3.0, 2.0, 1.5]), 1.0, 2.0, 0.3
STARTS = ((1.0, -0.1), (0.9, -0.4), (1.0, -0.65), (1.0, -0.9), (1.0, -1.1), (1.0, -1.3), (-1.2, -1.4), (0.0, -1.9))


def section(t: Any, state: Any) -> Any:
    return state.direction[0]


def angle(t: Any, state: Any) -> Any:
    return jnp.arctan2(state.direction[1], state.direction[2])


def across(t: Any, state: Any) -> Any:
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


# ---- the small pictures of docs/index.md ----

FACE = 4.6, 3.6  # inches
OFFSET: dict[str, Any] = {"textcoords": "offset points"}


def tops(figure: Any) -> None:
    axes = figure.add_axes((0.02, -0.1, 0.86, 1.05), projection="3d")
    cases = (("let go", 0.4, 0.0, BLUE), ("pushed on", 0.8, 8.0, GREEN), ("pushed back", 1.2, -8.0, VERMILLION))
    axes_of_tops(axes, cases, 1400, 38)


def asteroid(figure: Any) -> None:
    axes = figure.add_axes((0.15, 0.15, 0.81, 0.8))
    panel(axes, "", "time from the perigee, April 2029  [h]", "rotation rate  [revolutions per day]")
    starts = flyby.starts(60)
    path = ml.ensemble(
        "JACOBI[SRKN6b]", flyby.body(), flyby.torque(), starts, dt=600.0, steps=576, t0=-flyby.HALF, save_every=2
    )
    rate = ml.asteroids.tumble(flyby.body(), path.states).effective_rate * 86400 / (2 * np.pi)
    within = np.abs(path.times) <= 15 * flyby.HOUR
    shade = np.interp(rate[:, -1], [rate.min(), rate[:, 0].mean(), rate.max()], [0.0, 0.5, 1.0])
    colours = LinearSegmentedColormap.from_list("slower to faster", [BLUE, GREY, VERMILLION])
    for turns, colour in zip(np.asarray(rate), colours(shade), strict=True):
        axes.plot(path.times[within] / flyby.HOUR, turns[within], color=colour, linewidth=0.9)
    axes.set(xlim=(-15, 15), ylim=(0, None))


def binary(figure: Any) -> None:
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.98))
    gravity = ml.asteroids.MutualGravity(didymos.G)
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
    axes = figure.add_axes((0.15, 0.15, 0.81, 0.8))
    panel(axes, "", "cosine of the angle to the field  [-]", "probability density  [-]")
    n, kT, x = 2000, 0.7, 2.0
    start = ml.RigidState(jnp.zeros((n, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, 1)))
    heat = ml.baths.Langevin(kT, friction=1.0, key=jax.random.split(jax.random.key(0), n))
    path = ml.ensemble(
        "SYMMETRIC[BAOAB]", ml.RigidBody([1.0, 1.0, 0.5]), ml.torques.HeavyTop(-x * kT), start,
        bath=heat, dt=0.1, steps=2000, save_every=20, observe=ml.observe.Axis(),
    )  # fmt: skip
    axes.hist(np.ravel(path.states[:, 10:, 2]), np.linspace(-1, 1, 41), density=True, color=SKY)
    cosine = np.linspace(-1, 1, 200)
    density = x * np.exp(x * cosine) / (2 * np.sinh(x))
    axes.plot(cosine, density, color=VERMILLION)
    axes.annotate("Boltzmann", (cosine[160], density[160]), (-8, 4), ha="right", color=VERMILLION, **OFFSET)
    axes.annotate("the run", (0.98, 0.06), (-4, 0), ha="right", color=INK, **OFFSET)
    axes.set(xlim=(-1, 1))


FACES = {"face-tops.png": tops, "face-asteroid.png": asteroid, "face-binary.png": binary, "face-bath.png": bath}


# ---- tumbling.png of docs/orbits.md ----


def modes(options: Any) -> None:
    body, view = ml.RigidBody([0.5, 0.85, 1.0]), np.array([[-0.55, 0.83, 0.0], [-0.25, -0.16, 0.95]])
    around = np.linspace(0, 2 * np.pi, 200)
    panels = [[Line("", np.cos(around), np.sin(around), "#bbbbbb")] for _ in range(2)]
    marks = [[], []]
    for mode, axis, rotation, colour in (("short", 2, 10.8, "#0072b2"), ("long", 0, 4.0, "#d55e00")):
        start = ml.asteroids.tumbling(
            body, precession_period=3.0, rotation_period=rotation, axis=mode, pole=[0.0, 0.0, 1.0], phases=(0.0, 0.0),
            mode=mode,
        )  # fmt: skip
        turn = np.asarray(ml.free_motion(body, start, np.linspace(0, rotation, 400)).states.momentum)
        across = turn / np.linalg.norm(turn[0]) @ view.T
        panels[0].append(Line("", across[:, 0], across[:, 1], colour))
        end = np.eye(3)[axis] @ view.T
        panels[0].append(Line("", end[:1], end[1:], colour, "o"))
        marks[0].append((*end, f"  {mode} axis", colour))
        marks[0].append((1.1, 0.6 - 0.55 * axis, f"{mode}-axis mode:\nL circles the\n{mode} axis", colour))
        attitudes = ml.free_motion(body, start, np.linspace(0, 3.0, 400)).states.attitude
        along = np.asarray(jax.vmap(lambda q, a=axis: ml.so3.rotate(q, jnp.eye(3)[a]))(attitudes))
        panels[1].append(Line("", along[:, 0], along[:, 1], colour))
        marks[1].append((1.1, 0.6 - 0.55 * axis, f"{mode}-axis mode:\npath of the\n{mode} axis", colour))
    marks[1].append((0.03, 0.03, "pole", "black"))
    panels[1].append(Line("", [0.0], [0.0], "black", "o"))

    def written(texts):
        def more(axes):
            axes.grid(visible=False)
            for x, y, text, colour in texts:
                axes.text(x, y, text, color=colour, fontsize=10, va="center")

        return more

    square = {"aspect": "equal", "xlim": (-1.1, 2.0), "ylim": (-1.1, 1.1), "xticks": [], "yticks": []}
    titles = "Body frame, one rotation period", "Space frame, one precession period"
    row = [
        Panel(title, "", "", lines, square, written(texts))
        for title, lines, texts in zip(titles, panels, marks, strict=True)
    ]
    chart(options.folder / "tumbling.png", [row], (9.5, 3.6), left=0.02, right=0.99, bottom=0.04, top=0.9, wspace=0.05)


# ---- scattered-tops.png and the table of docs/scatter.md ----
#
# A top that stands upright does not fall while the square of its momentum about its axis exceeds 4 I1 times the weight
# (weight times lever). The nominal tops have twice this limit, and 1.2 times. A deviation that is harmless in the first
# tips some of the second over. Both ensembles draw from one key, so body k has the same moments, weight and attitude.

STEP, STEPS, EVERY = 0.02, 1000, 5  # seconds, steps
TOPS, I1, PULL, TILT = 1000, 5.0, 20.0, 0.05  # kg m^2, N m, rad
LIMIT = 4 * I1 * PULL
SAFETY = (2.0, 1.2)  # nominal squares of the momentum over the limit
SCATTER_HEADS = (
    *("nominal momentum about the axis, kg m²/s", "tops below the limit", "tilt after 20 s: 5 %", "median", "95 %"),
    *("largest tilt", "largest relative energy error"),
)
SCATTER = Table("scatter.md", "tops", SCATTER_HEADS)


class Outcome(NamedTuple):
    """Times (n,), tilts from upright (bodies, n) in degrees (NaN once a top failed), share of tops below the limit."""

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
        weight=d.Normal(PULL, 1.0),
        momentum=d.Normal([0.0, 0.0, momentum], [0.0, 0.0, 1.0]),
        attitude=d.RotationNear(ml.so3.exp(jnp.array([TILT, 0.0, 0.0])), 0.02),
    )


def outcome(bodies: int, momentum: float) -> Outcome:
    drawn = drawn_tops(bodies, momentum)
    body, torque = ml.RigidBody(drawn["moments"]), ml.torques.HeavyTop(drawn["weight"])
    start = ml.RigidState(drawn["momentum"], drawn["attitude"])
    path = ml.ensemble("JACOBI[CHIN4A]", body, torque, start, dt=STEP, steps=STEPS, save_every=EVERY)
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


def draw_scatter(results: dict[float, Outcome], bodies: int, path: str) -> None:
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
        axes.set_xticks(np.linspace(0, STEP * STEPS, 5))
    panels[0].set(ylim=(0, 1.06 * max(peaks)), yticks=np.arange(0, 1.06 * max(peaks), 3))
    for axes, found in zip(panels, results.values(), strict=True):
        ml.plot.bands(axes, found.times, found.tilt)
    write(figure, path)


def scatter(options: Any) -> None:
    results = {safety: outcome(TOPS, momentum_of(safety)) for safety in SAFETY}
    SCATTER.show(options.write, (row(safety, found) for safety, found in results.items()))
    draw_scatter(results, TOPS, str(options.folder / "scattered-tops.png"))


def drawn(part: str, options: Any) -> None:
    folder = options.folder.resolve()
    names = {"motion": ["motion.png"], "face": list(FACES)}.get(part, [f"{part}.gif"])
    if part == "motion":
        write(motion(), str(folder / "motion.png"))
    elif part == "flip":
        flip(folder)
    elif part == "face":
        for name, draw in FACES.items():
            figure = new_figure(*FACE)
            draw(figure)
            write(figure, str(folder / name))
    else:
        draw_scene(part, folder)
    for name in names:
        print(f"{name}: {(folder / name).stat().st_size / 1000:.0f} kB", flush=True)


PARTS = {part: partial(drawn, part) for part in ("motion", "flip", *SCENES, "face")}
PARTS |= {"modes": modes, "scatter": scatter}

if __name__ == "__main__":
    main(__doc__, PARTS, {"--folder": {"type": Path, "default": DOCS}})
