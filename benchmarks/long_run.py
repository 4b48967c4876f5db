"""Energy over ten million steps: who wanders off and who does not.

    python benchmarks/long_run.py [--steps 10000000] [--write]

For the fast top P1 and an asymmetric heavy top, at a coarse step: the largest error of the energy, and how much its
mean over the last tenth of the run differs from that over the first, both relative to the energy at the start. A
symplectic method's energy wavers within a band that does not move. `--write` puts the table between the markers in
README.md and the picture in docs/long-run.png.
"""

import argparse
from pathlib import Path

import jax
import numpy as np

import midlie_jax as ml
from midlie_jax import scenes
from midlie_jax.rivals.problem import pin

jax.config.update("jax_enable_x64", True)
pin()

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- long run -->", "<!-- /long run -->"
KEPT, PARTS = 20_000, 40
METHODS = {
    "P1": ("LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "SYMMETRIC[EA]", "SYMMETRIC[CHIN4A]"),
    "asymmetric-top": ("LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "JACOBI[EA]", "JACOBI[CHIN4A]"),
}
STEP = {"P1": 0.02, "asymmetric-top": 0.05}


def energies(name, scene, dt, steps):
    """(times, relative error of the energy), kept every so often, and whether every solve succeeded."""
    every = steps // KEPT

    @jax.jit
    def run(start):
        path = ml.integrate(name, scene.body, scene.torque, start, dt=dt, steps=steps, save_every=every)
        return path.times, jax.vmap(lambda s: ml.energy(scene.body, scene.torque, s))(path.states), path.ok

    times, energy, ok = run(scene.start)
    energy = np.asarray(energy)
    return np.asarray(times), (energy - energy[0]) / abs(energy[0]), bool(ok)


def measured(steps):
    for scene_name, names in METHODS.items():
        scene = scenes.scene(scene_name)
        for name in names:
            times, error, ok = energies(name, scene, STEP[scene_name], steps)
            tenth = len(error) // 10
            trend = abs(error[-tenth:].mean() - error[:tenth].mean())
            yield scene_name, name, times, error, trend, ok


def draw(results, path):
    """How far the mean of each fortieth of the run has gone from that of the first."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from midlie_jax.charts import _apart

    figure = Figure(figsize=(13, 5), dpi=110)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.07, right=0.89, bottom=0.12, top=0.92, wspace=0.55)
    for axes, scene_name in zip(figure.subplots(1, 2), METHODS, strict=True):
        axes.set(yscale="log", xlabel="Time t  [time]")
        axes.set_ylabel("Shift of the mean energy error  [of E at the start]")
        axes.set_title(f"{scene_name}, step {STEP[scene_name]:g}", loc="left", weight="bold")
        axes.grid(which="major", color="#e3e3e3")
        axes.spines[["top", "right"]].set_visible(False)
        ends = []
        mine = [r for r in results if r[0] == scene_name]
        colours = ("#D55E00", "#0072B2", "#009E73", "#56B4E9", "#CC79A7")
        for colour, (_, name, times, error, _, _) in zip(colours, mine, strict=True):
            means = np.array([part.mean() for part in np.array_split(error, PARTS)])
            middles = np.array([part.mean() for part in np.array_split(times, PARTS)])
            shift = np.maximum(np.abs(means - means[0])[1:], 1e-16)
            axes.plot(middles[1:], shift, color=colour, linewidth=2)
            ends.append((name, colour, middles[-1], shift[-1]))
        axes.set_xlim(0, times[-1])
        axes.ticklabel_format(axis="x", style="sci", scilimits=(5, 5))
        axes.set_ylim(*axes.get_ylim())
        figure.draw_without_rendering()  # which settles the scales
        points = 72 / figure.dpi
        places = [axes.transData.transform((x, y))[1] * points for *_, x, y in ends]
        low, high = axes.bbox.y0 * points, axes.bbox.y1 * points
        for (name, colour, x, y), place in zip(ends, _apart(places, 13, low, high), strict=True):
            height = axes.transData.inverted().transform((0, place / points))[1]
            right = axes.get_xlim()[1] * 1.03
            line = {"arrowstyle": "-", "color": colour, "linewidth": 0.7}
            axes.annotate(
                name, (x, y), xytext=(right, height), color=colour, va="center", arrowprops=line, annotation_clip=False
            )
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    lines = [
        f"| scene, {options.steps:.0e} steps | method | largest energy error | shift of its mean |",
        "|---|---|---|---|",
    ]
    print("\n".join(lines), flush=True)
    results = []
    for result in measured(options.steps):
        scene_name, name, _, error, trend, ok = result
        note = "" if ok else " (a solve failed)"
        label = f"{scene_name}, step {STEP[scene_name]:g}"
        lines.append(f"| {label} | `{name}` | {np.abs(error).max():.1e}{note} | {trend:.1e} |")
        print(lines[-1], flush=True)
        results.append(result)
    if options.write:
        readme = ROOT / "README.md"
        head, rest = readme.read_text().split(BEGIN)
        readme.write_text(head + BEGIN + "\n" + "\n".join(lines) + "\n" + END + rest.split(END)[1])
        draw(results, ROOT / "docs" / "long-run.png")


if __name__ == "__main__":
    main()
