"""Energy over ten million steps: which methods drift and which do not.

    python benchmarks/long_run.py [--steps 10000000] [--write]

For the fast top P1 and an asymmetric heavy top, at a coarse step: the largest error of the energy, and how much its
mean over the last tenth of the run differs from that over the first, both relative to the energy at the start. A
symplectic method's energy stays within a band that does not move. `--write` puts the table between the markers in
docs/reports/rounding.md and the picture in docs/long-run.png.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from pages import publish

import midlie_jax as ml
from midlie_jax.advice.timing import pin
from midlie_jax.cli import scenes

jax.config.update("jax_enable_x64", True)
pin()

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- long run -->", "<!-- /long run -->"
KEPT, PARTS = 20_000, 40
METHODS = {
    "P1": ("LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "SYMMETRIC[EA]", "SYMMETRIC[CHIN4A]"),
    "asymmetric-top": ("LIEMID[EA]", "SLIEMID[EA]", "DLM[EA]", "JACOBI[EA]", "JACOBI[CHIN4A]"),
}
MOVED = "asymmetric-top"  # where the energy of LIEMID[EA] shifts
STEP = {"P1": 0.02, "asymmetric-top": 0.05}


def energies(name, scene, dt, steps):
    """Times, relative energy errors at these times, and whether every solve succeeded."""
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


def shifts(times, error):
    """Middles of the parts after the first, and the largest shift so far of their mean error from the first part's."""
    middles, means = (np.array([part.mean() for part in np.array_split(x, PARTS)]) for x in (times, error))
    return middles[1:], np.maximum.accumulate(np.maximum(np.abs(means - means[0])[1:], 1e-16))


def draw(results, path):
    """Draws the largest difference so far of the mean energy error of a part of the run from the first part's."""
    from midlie_jax.cli.figures import heading, new_figure, panel, write
    from midlie_jax.cli.line_labels import End, label_ends

    figure = new_figure(13.0, 5.6)
    peaks = {name: shifts(times, error)[1].max() for scene, name, times, error, *_ in results if scene == MOVED}
    ratio = peaks.pop("LIEMID[EA]") / max(peaks.values())
    title = f"On the asymmetric top, the energy of LIEMID[EA] shifts {ratio:.0f} times more than with other methods"
    heading(figure, title, f"Means of the energy error over {PARTS} parts of the run; the largest difference so far.")
    figure.subplots_adjust(bottom=0.11, wspace=0.2)
    colours = ("#D55E00", "#0072B2", "#009E73", "#56B4E9", "#CC79A7")
    for axes, scene_name in zip(figure.subplots(1, 2), METHODS, strict=True):
        axes.set(yscale="log")
        title = f"{scene_name}, step {STEP[scene_name]:g}"
        panel(axes, title, "time [unit of time]", "shift of the mean energy error [initial energy]")
        ends = []
        scene_results = [r for r in results if r[0] == scene_name]
        for colour, (_, name, times, error, _, _) in zip(colours, scene_results, strict=True):
            middles, shift = shifts(times, error)
            axes.plot(middles, shift, color=colour, linewidth=2)
            ends.append(End(name, colour, middles[-1], shift[-1], True))
        axes.set_xlim(0, times[-1])
        axes.ticklabel_format(axis="x", style="sci", scilimits=(5, 5))
        axes.set_ylim(*axes.get_ylim())
        label_ends(axes, ends, size=9.0)
    write(figure, path)


def write(lines):
    """Puts the whole table into its data file, and the methods of order 2 but one into the page."""
    key = lambda row: "CHIN4A" not in row[1] and "DLM" not in row[1]  # noqa: E731
    publish("reports/rounding.md", BEGIN, END, lines, "long-run", key)


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
        write(lines)
        draw(results, ROOT / "docs" / "long-run.png")


if __name__ == "__main__":
    main()
