"""The search of a spin state over ranges, and the figure of the two modes: docs/reports/applications.md, orbits.md.

    python benchmarks/search.py search               starts per second: a tumbling ellipsoid from 400 magnitudes
    python benchmarks/search.py modes [--write]      what periods, pole and modes mean; tumbling.png

The scene is the one of tests/photometry_scene.py, made by NumPy and SciPy alone: eight nights and sparse values, nine
zero points, 2 % noise, 3 % outliers. 19 numbers are unknown, and ranges are 30 %. Times are processor times on one core
without compilation. A published search of this kind took 3.2 h for 1e5 starts of nine unknowns.
"""

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401 # first
from harness import DOCS, ROOT, Line, Panel, Table, chart, main

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.fitting.parameters import Layout
from midlie_jax.fitting.search import minima_of, starts_over

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(ROOT / "tests"))
import photometry_scene  # noqa: E402

STARTS, SEEDS, SPAN, PUBLISHED = 512, (1, 2), 56.0, 1e5 / (3.2 * 3600)
GUESS = {
    "moments": fitting.Moments([0.5, 0.9, 1.0], scale="fixed"),
    "precession": fitting.Positive(7.9),
    "rotation": fitting.Positive(46.0),
    "pole": fitting.UnitVector([0.0, 0.0, 1.0]),
    "phases": fitting.Periodic([0.0, 0.0], period=[1.0, 2 * np.pi]),
    "axes": fitting.Positive([1.4, 1.1]),
}
RANGES = {"precession": 0.3, "rotation": 0.3, "moments": 0.3, "axes": 0.3, "pole": "all", "phases": "all"}


def model(values):
    body, (s, phi) = ml.RigidBody(values["moments"]), values["phases"]
    return body, None, ml.asteroids.tumbling(
        body, precession_period=values["precession"], rotation_period=values["rotation"], axis="short",
        pole=values["pole"], phases=(s, phi), mode="short",
    )  # fmt: skip


def light(values, sun, observer):
    return ml.asteroids.EllipsoidBrightness(jnp.append(values["axes"], 0.85), sun, observer)


def searches():
    """Rows of the table: seed of the noise, starts, seconds, starts per second, and the minimum against the truth."""
    for seed in SEEDS:
        scene = photometry_scene.scene(seed)
        given = {name: scene[name] for name in ("sun", "observer", "night", "light_time")}
        seen = ml.asteroids.Photometry(scene["times"], scene["values"], photometry_scene.SIGMA, light, **given)
        plan = fitting.prepare(model, GUESS, seen, method="free_motion", t0=250.0, loss="huber")
        layout = Layout(GUESS)

        def run(count, layout=layout, plan=plan, seen=seen):
            drawn = starts_over(layout, RANGES, count, 0)
            began = time.process_time()
            found = minima_of(plan.problem, layout, (seen,), drawn, SPAN, progress=False)
            return time.process_time() - began, found

        run(64)  # compiles
        seconds, minima = run(STARTS)
        best = minima[0].values
        errors = [
            abs(float(best[name]) / truth - 1)
            for name, truth in zip(("precession", "rotation"), photometry_scene.PERIODS, strict=True)
        ]
        yield (
            str(seed), str(STARTS), f"{seconds:.0f}", f"{STARTS / seconds:.1f}", f"{STARTS / seconds / PUBLISHED:.1f}",
            f"{errors[0]:.1e}, {errors[1]:.1e}", f"{minima[0].chi_squared:.0f}",
        )  # fmt: skip


HEADS = (
    "noise seed", "starts", "seconds", "starts per second", "relative to the published search",
    "relative errors of the periods", "least chi-squared",
)  # fmt: skip


def modes(options):
    """The momentum in the body frame, and the path of an axis around the pole, for both modes."""
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
    file = DOCS / "tumbling.png" if options.write else ROOT / "tumbling.png"
    chart(file, [row], (9.5, 3.6), left=0.02, right=0.99, bottom=0.04, top=0.9, wspace=0.05)
    print(file)


SEARCH = Table("", "", HEADS, searches)

if __name__ == "__main__":
    main(__doc__, {"search": SEARCH, "modes": modes})
