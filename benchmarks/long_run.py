"""Energy over ten million steps: who wanders off and who does not.

    python benchmarks/long_run.py [--steps 10000000] [--write]

For the fast top P1 and an asymmetric heavy top, at a coarse step: the largest error of the energy, and how much its
mean over the last tenth of the run differs from that over the first, both relative to the energy at the start. A
symplectic method's energy wavers within a band that does not move. `--write` puts the table between the markers in
README.md and the picture in docs/long-run.png.
"""

import argparse
import os
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import midlie_jax as ml  # noqa: E402
from midlie_jax import scenes  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- long run -->", "<!-- /long run -->"
KEPT = 20_000
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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, scene_name in zip(figure.subplots(1, 2), METHODS, strict=True):
        axes.set(xscale="log", yscale="log", xlabel="Time t  [time]")
        axes.set_ylabel("Largest energy error so far  |E - E0| / |E0|  [-]")
        axes.set_title(f"{scene_name}, step {STEP[scene_name]:g}", loc="left", weight="bold")
        axes.grid(which="major", color="#e3e3e3")
        axes.spines[["top", "right"]].set_visible(False)
        mine = [r for r in results if r[0] == scene_name]
        for colour, (_, name, times, error, _, _) in zip(
            ("#D55E00", "#0072B2", "#009E73", "#56B4E9", "#CC79A7"), mine, strict=False
        ):
            largest = np.maximum.accumulate(np.abs(error[1:]))
            axes.plot(times[1:], largest, color=colour, linewidth=2)
            axes.annotate(
                name, (times[-1], largest[-1]), xytext=(5, 0), textcoords="offset points", color=colour, va="center"
            )
        axes.set_xlim(right=times[-1] * 12)
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
