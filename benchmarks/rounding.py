"""Rounding errors and the energy over many steps, for docs/reports/rounding.md.

    python benchmarks/rounding.py free [--write]      what free flights conserve, over 1e6 steps
    python benchmarks/rounding.py growth [--write]    how errors grow, over up to 1e8 steps; rounding-growth.png
    python benchmarks/rounding.py cost [--write]      what a step costs with each state and dtype that `growth` compares
    python benchmarks/rounding.py bias                why a compensated P1 keeps a bias in float32
    python benchmarks/rounding.py long [--write]      the energy over 1e7 steps: which methods drift; docs/long-run.png

`--steps` takes another number of steps. With `--parts` growth keeps each run in a folder and continues where it was
stopped. Times are nanoseconds of processor time for a step of one body, on one core: medians of runs that take turns.

Of free flights, each figure is the root mean square over 16 bodies of the relative change of the spatial momentum R Pi,
the length of Pi or, if the flight is exact, the energy, in units of eps times the square root of the number of steps,
for the worst of six angles per step, 1e-5 to 1 radian. If it is the same for any number of steps, rounding errors grow
as a random walk.

Of the bias: SYMMETRIC turns attitude and momentum about the axis of the top by the same angle, with coefficients that
are rounded one by one, alike in every step. First: by how much the two turns differ in float32, for 16 tops like P1.
Second: how far the vertical momentum drifts in float64 if the two turns are made to differ by a given angle.

Of long runs, for P1 and an asymmetric top at a coarse step: the largest error of the energy, and how much its mean over
the last tenth of the run differs from that over the first, both relative to the energy at the start. A symplectic
method's energy stays within a band that does not move.
"""

from contextlib import contextmanager
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import DOCS, Line, Panel, Table, chart, main
from laboratory import rounding_growth
from laboratory.free_bodies import TURNS, free_bodies, spatial_momentum

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.integrators.flights import FLIGHTS, symmetric

BODIES, SHOWN = 16, ("JACOBI", "SYMMETRIC", "SLIEMID4", "DLM", "LIEMID")  # SHOWN: flights on the page
STATES = {"float64": ml.RigidState, "float32": ml.CompensatedState}
QUANTITIES = ("R Pi", "length of Pi", "energy")


def constants(flight, dtype, steps):
    """The figure for each of QUANTITIES; None for the energy of a flight that does not conserve it."""
    inputs = free_bodies(flight.equal_moments, dtype, count=BODIES, seed=2)

    def run(moments, momentum, attitude, dt):
        start = STATES[dtype](momentum, attitude)
        method, body = ml.method(flight, "E1"), ml.RigidBody(moments)
        return ml.integrate(method, body, None, start, dt=dt, steps=steps, save_every=steps)

    path = jax.jit(jax.vmap(run))(*inputs)
    if not path.ok.all():
        raise RuntimeError(f"{flight.name} failed: a solve did not succeed, or a number is not finite.")
    moments, momentum, attitude, *low = (
        np.asarray(x, np.longdouble) for x in (inputs[0], *jax.tree.leaves(path.states))
    )
    if low:
        momentum, attitude = momentum + low[0], attitude + low[1]
    space, square = spatial_momentum(attitude, momentum), np.sum(momentum**2, axis=-1)
    energy = np.sum(momentum**2 / moments[:, None], axis=-1)
    changes = (
        np.linalg.norm(space[:, 1] - space[:, 0], axis=-1) / np.sqrt(square[:, 0]),
        np.sqrt(square[:, 1] / square[:, 0]) - 1,
        energy[:, 1] / energy[:, 0] - 1 if flight.order is None else None,
    )
    unit = np.finfo(dtype).eps * steps**0.5
    return [None if c is None else float(worst(c / unit)) for c in changes]


def worst(change):
    return np.sqrt(np.mean(change.reshape(len(TURNS), BODIES) ** 2, axis=1)).max()


def free_rows(steps):
    for flight in (flight for flight in FLIGHTS.values() if flight.body is ml.RigidBody):
        figures = [c for dtype in ("float64", "float32") for c in constants(flight, dtype, steps)]
        yield [f"`{flight.name}`", *("" if c is None else f"{c:.2f}" for c in figures)]


FREE = Table(
    *("reports/rounding.md", "rounding"),
    ("flight", *(f"{quantity}, {dtype}" for dtype in ("float64", "float32") for quantity in QUANTITIES)),
    data="rounding",
    key=lambda row: row[0].strip("`") in SHOWN,
)

# ---- the bias of a compensated P1 in float32 ----

TOP, TOPS, DT = scenes.scene("P1"), 16, float(np.float32(0.005))
PHASES, TILT = 100_000, 0.1  # momenta across the axis, in all directions
IMPOSED = (1e-8, 1e-6)


def differences():
    """For each top the mean angle by which the momentum turns further about the axis than the attitude."""
    body = ml.RigidBody(jnp.asarray(TOP.body.moments, jnp.float32))
    spins = np.asarray(scenes.perturbed(TOP, TOPS, 1e-3).momentum, np.float32)[:, 2]
    phase = 2 * np.pi * np.arange(PHASES) / PHASES
    across = TILT * np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    fly = jax.jit(jax.vmap(lambda p: symmetric.Symmetric()(body.inertia(), jnp.float32(DT), (p[0], p[1], p[2]))[:2]))
    for spin in spins:
        momenta = np.concatenate([across, np.full((PHASES, 1), spin)], axis=1).astype(np.float32)
        increments, changes = (np.stack([np.asarray(x, float) for x in parts], axis=-1) for parts in fly(momenta))
        increments /= np.linalg.norm(increments, axis=1, keepdims=True)
        ends = momenta + changes
        turned = np.asarray(ml.so3.rotate(ml.so3.conjugate(jnp.asarray(increments)), jnp.asarray(momenta, float)))
        sines = turned[:, 0] * ends[:, 1] - turned[:, 1] * ends[:, 0]
        yield float(np.mean(sines / np.sum(turned[:, :2] ** 2, axis=1)))


@contextmanager
def turning_further(angle):
    """While it is open, SYMMETRIC turns the momentum by so much more about the third axis than the attitude."""
    library = symmetric.Symmetric.formula

    def formula(self, inertia, h, momentum):
        flown = library(self, inertia, h, momentum)
        x, y = (p + c for p, c in zip(momentum[:2], flown.change[:2], strict=True))
        return flown._replace(change=(flown.change[0] - angle * y, flown.change[1] + angle * x, flown.change[2]))

    symmetric.Symmetric.formula = formula
    try:
        yield
    finally:
        symmetric.Symmetric.formula = library


def drift(steps):
    """The change of the vertical momentum per step over the momentum: root mean square over the tops."""
    starts = scenes.perturbed(TOP, TOPS, 1e-3)
    path = ml.ensemble("SYMMETRIC[EA]", TOP.body, TOP.torque, starts, dt=DT, steps=steps, torque_axes=None)
    before, after = (np.asarray(ml.observe.spatial_momentum(s))[:, 2] for s in (starts, path.states))
    return float(np.sqrt(np.mean(((after - before) / np.linalg.norm(starts.momentum, axis=1)) ** 2))) / steps


def bias(options):
    found = np.abs(list(differences()))
    print(f"float32: the turns of {TOPS} tops differ by {found.min():.1e} to {found.max():.1e} rad a step")
    for angle in IMPOSED:
        with turning_further(angle):
            jax.clear_caches()
            found = drift(int(options.steps or 1e6))
            print(f"float64: a difference of {angle:g} rad drifts by {found:.2e} of the momentum a step")


# ---- the energy over long runs ----

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
        return path.times, jax.vmap(lambda s: ml.observe.energy(scene.body, scene.torque, s))(path.states), path.ok

    times, energy, ok = run(scene.start)
    energy = np.asarray(energy)
    return np.asarray(times), (energy - energy[0]) / abs(energy[0]), bool(ok)


def long_runs(steps):
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


def draw_long(results, path):
    """Draws the largest difference so far of the mean energy error of a part of the run from the first part's."""
    colours = ("#D55E00", "#0072B2", "#009E73", "#56B4E9", "#CC79A7")

    def line(colour, name, times, error):
        return Line(name, *shifts(times, error), colour, bold=True, options={"linewidth": 2})

    panels = []
    for scene in METHODS:
        runs = [result[1:4] for result in results if result[0] == scene]
        lines = [line(colour, *one) for colour, one in zip(colours, runs, strict=True)]
        title, up = f"{scene}, step {STEP[scene]:g}", "shift of the mean energy error [initial energy]"
        options = {"yscale": "log", "xlim": (0, runs[0][1][-1])}
        panels.append(Panel(title, "time [unit of time]", up, lines, options, lambda axes: axes.ticklabel_format(
            axis="x", style="sci", scilimits=(5, 5))))  # fmt: skip
    peaks = {name: shifts(times, error)[1].max() for scene, name, times, error, *_ in results if scene == MOVED}
    ratio = peaks.pop("LIEMID[EA]") / max(peaks.values())
    title = f"On the asymmetric top, the energy of LIEMID[EA] shifts {ratio:.0f} times more than with other methods"
    note = f"Means of the energy error over {PARTS} parts of the run; the largest difference so far."
    chart(path, [panels], (13.0, 5.6), title, note, bottom=0.11, wspace=0.2)


def long_row(scene_name, name, _, error, trend, ok):
    note = "" if ok else " (a solve failed)"
    return [f"{scene_name}, step {STEP[scene_name]:g}", f"`{name}`", f"{np.abs(error).max():.1e}{note}", f"{trend:.1e}"]


def long(options):
    steps, results = int(options.steps or 1e7), []
    table = Table(
        *("reports/rounding.md", "long run"),
        (f"scene, {steps:.0e} steps", "method", "largest energy error", "shift of its mean"),
        data="long-run",
        key=lambda row: "CHIN4A" not in row[1] and "DLM" not in row[1],
    )
    table.show(options.write, (results.append(result) or long_row(*result) for result in long_runs(steps)))
    if options.write:
        draw_long(results, DOCS / "long-run.png")


MEASURED = {
    "free": lambda options: FREE.show(options.write, free_rows(int(options.steps or 1e6))),
    "growth": rounding_growth.measure,
    "cost": rounding_growth.COST,
    "bias": bias,
    "long": long,
}
ARGUMENTS = {"--steps": {"type": float}, "--parts": {"type": Path, "help": "the folder with the runs of growth"}}

if __name__ == "__main__":
    main(__doc__, MEASURED, ARGUMENTS)
