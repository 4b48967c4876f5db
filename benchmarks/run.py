"""`make bench`: a table of the cost of a step, as ratios of times measured in one run.

    python benchmarks/run.py [--quick] [--write]

Every figure is the median of five runs of the fast top P1 after a first run, in processor time on one core; the process
pins itself to that core. Compile times are of the first call, with tracing, by the wall clock. The limit in C is
`limit.c`, which is compiled here in several forms; that takes minutes. `--write` puts the table into
docs/reports/speed.md.
"""

import argparse
import itertools
import os
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

ONE_CORE = "--all-cores" not in sys.argv
if hasattr(os, "sched_setaffinity"):  # before XLA counts the cores
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))} if ONE_CORE else range(os.cpu_count() or 1))

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import limit  # noqa: E402
import numpy as np  # noqa: E402
from harness import Table, main  # noqa: E402
from laboratory.rivals import rates  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax._xla.compiler import compiler_options, vector_width_options  # noqa: E402
from midlie_jax.advice.timing import timed, user_clock  # noqa: E402
from midlie_jax.cli import scenes  # noqa: E402
from midlie_jax.integrators.flights import FLIGHTS  # noqa: E402
from midlie_jax.integrators.registry import ENTRIES, paper_methods  # noqa: E402

jax.config.update("jax_enable_x64", True)
KEY = (
    *("LIEMID[EA]", "LIEMID[EA], 2 cores", "LIEMID[EA], float32", "JACOBI[EA]", "SYMMETRIC[EA]"),
    *("DLM[EA]", "AKW", "NMB", "JACOBI[CHIN4A]", "JACOBI[SRKN6b]", "JACOBI[SRKN14a]"),
    *("GBS12", "DOP853", "RK4", "diffrax Tsit5, vmapped, constant step"),
)


def starts(scene, batch):
    return scenes.perturbed(scene, batch, 1e-3)


def median_seconds(call, repeats=6):
    """Median time of the runs after the first."""
    return timed(lambda: jax.block_until_ready(call()), least=1, most=repeats, clock=user_clock())[1].seconds


def compiled(function, argument, options=None):
    """The function compiled, by default as `ml.ensemble` compiles it, and the seconds of tracing and compiling."""
    begin = time.perf_counter()
    first = jax.tree.leaves(argument)[0]
    options = compiler_options(first.shape[0] if first.ndim > 1 else 1) if options is None else options
    program = jax.jit(function, compiler_options=options).lower(argument).compile()
    return program, time.perf_counter() - begin


def body_step(run, scene, batch, steps, options=None):
    """Seconds a body-step of `run(start)` over a batch of starts (without vmap for 1), and seconds of compiling."""
    many = starts(scene, batch)
    if batch == 1:
        one = jax.tree.map(lambda x: x[0], many)
        program, compiling = compiled(run, one, options)
        return median_seconds(lambda: program(one)) / steps, compiling
    program, compiling = compiled(jax.vmap(run), many, options)
    return median_seconds(lambda: program(many)) / (steps * batch), compiling


def ours(name, scene, batch, steps, dtype=jnp.float64):
    scene = scenes.scene(scene.name, dtype)

    def run(start):
        return ml.integrate(name, scene.body, scene.torque, start, dt=0.005, steps=steps, save_every=steps)

    return body_step(run, scene, batch, steps)


def ambient(scene, t, y):
    """d/dt of momentum and quaternion as one array (7,), for a general solver."""
    state = ml.RigidState(y[:3], y[3:])
    velocity = y[:3] / scene.body.moments
    rate = state.kind.rate(tuple(y[i] for i in range(3, 7)), tuple(velocity))
    return jnp.concatenate([jnp.cross(y[:3], velocity) + scene.torque(t, state), jnp.stack(rate)])


def tsit5_run(scene, dt, steps):
    """diffrax's Tsit5 on momentum and quaternion with a constant step, as a function of the start."""
    times = dt * jnp.arange(steps + 1.0)
    options = {"stepsize_controller": diffrax.StepTo(ts=times), "adjoint": diffrax.ForwardMode(), "max_steps": None}
    term = diffrax.ODETerm(lambda t, y, args: ambient(scene, t, y))

    def run(start):
        y = jnp.concatenate([start.momentum, start.attitude], axis=-1)
        return diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, dt * steps, None, y, **options).ys[-1]

    return run


def scipy_step(scene, steps):
    """Seconds a step of SciPy's RK45 at a constant step, on Python floats, which are faster here than NumPy's."""
    field = rates(scene)
    start = np.concatenate([np.asarray(scene.start.momentum), np.asarray(scene.start.attitude)])
    options = {"method": "RK45", "first_step": 0.005, "max_step": 0.005, "rtol": 1e-2, "atol": 1e3}

    def run():
        return solve_ivp(lambda t, y: field(y.tolist()), (0, 0.005 * steps), start, **options).t

    return median_seconds(run) / (len(run()) - 1)


def elsewhere(*options):
    """Seconds a body-step of LIEMID[EA], batch 4096, measured in a separate process."""
    command = [sys.executable, __file__, "--quick", "--only-first", *options]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return float(re.findall(r"RESULT ([\d.eE+-]+)", out)[0])


def limits(scene, batch, steps):
    """Rows that compare with hand-written C of the same methods, timed alternately under the same conditions."""
    for method, dtype in itertools.product(("LIEMID", "JACOBI", "SYMMETRIC", "DOP853"), (jnp.float64, jnp.float32)):
        name = method if method == "DOP853" else f"{method}[EA]"
        own = scenes.scene(scene.name, dtype)
        many = starts(own, batch)

        def run(start, name=name, own=own):
            return ml.ensemble(name, own.body, own.torque, start, dt=0.005, steps=steps)

        program, _ = compiled(run, many)
        digits = jnp.dtype(dtype).name
        kind = limit.best(method, digits)
        pairs = [
            (limit.limit(method, digits), median_seconds(lambda p=program, s=many: p(s)) / (batch * steps))
            for _ in range(3)
        ]
        share = statistics.median(c / cost for c, cost in pairs)
        speed = f"limit {1e-6 / min(c for c, _ in pairs):.1f} M/s by {Path(kind.compiler).name}: {kind.form}"
        yield f"{name}, {digits}, relative to C", speed, f"{share:.2f}", ""


def flight_rows(scene, batch, steps):
    """Rows that compare with LIEMID[EA], timed alternately, so that a change of the machine's speed affects both."""

    def prepared(name):
        def run(start):
            return ml.integrate(name, scene.body, scene.torque, start, dt=0.005, steps=steps, save_every=steps)

        many = starts(scene, batch)
        program, compiling = compiled(jax.vmap(run), many)
        return lambda: program(many), compiling

    baseline, _ = prepared("LIEMID[EA]")
    paper = {method.name for method in paper_methods()}
    flights = [f"{flight.name}[EA]" for flight in FLIGHTS.values() if flight.body is ml.RigidBody]
    others = [name for name, entry in ENTRIES.items() if issubclass(ml.RigidBody, entry.method.bodies)]
    for name in dict.fromkeys(name for name in (*flights, *others) if name not in paper):
        call, compiling = prepared(name)
        ratio = statistics.median(median_seconds(baseline, 1) / median_seconds(call, 1) for _ in range(7))
        yield name, "", f"{ratio:.2f}", f"{compiling:.1f} s"


def rows(scene, quick):
    batch, steps = 4096, 100 if quick else 400
    reference, compiling = ours("LIEMID[EA]", scene, batch, steps)
    yield "LIEMID[EA]", f"{1e-6 / reference:.1f} M body-steps/s", "1", f"{compiling:.1f} s"
    yield from limits(scene, batch, steps)
    if (os.cpu_count() or 1) > 1:
        both = statistics.median(elsewhere() / elsewhere("--all-cores") for _ in range(3))
        yield f"LIEMID[EA], {os.cpu_count()} cores", "relative to one core", f"{both:.2f}", ""
    cost, compiling = ours("LIEMID[EA]", scene, batch, steps, jnp.float32)
    yield "LIEMID[EA], float32", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    for name in (method.name for method in paper_methods() if method.name != "LIEMID[EA]"):
        cost, compiling = ours(name, scene, batch, steps)
        yield name, "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    yield from flight_rows(scene, batch, steps)
    cost, compiling = body_step(tsit5_run(scene, 0.005, steps), scene, batch, steps, vector_width_options())
    yield "diffrax Tsit5, vmapped, constant step", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    solo, _ = ours("LIEMID[EA]", scene, 1, 20_000)
    cost, _ = body_step(tsit5_run(scene, 0.005, 20_000), scene, 1, 20_000)
    yield "diffrax Tsit5, 1 body", f"{1e6 * cost:.2f} µs per step", f"{solo / cost:.4f} of LIEMID[EA]'s", ""
    cost = scipy_step(scene, 2000)
    yield "SciPy RK45, 1 body", f"{1e6 * cost:.0f} µs per step", f"{solo / cost:.4f} of LIEMID[EA]'s", ""


def is_key(row):
    return row[0] in KEY or row[0].endswith("float64, relative to C")


HEADS = ("LIEMID[EA] on P1, 4096 bodies, float64, unless stated", "measured", "relative speed", "first call")
TABLE = Table("reports/speed.md", "bench", HEADS, data="speed", key=is_key, columns=(0, 2, 3))


def measure(options):
    scene = scenes.scene("P1")
    if options.only_first:
        print("RESULT", ours("LIEMID[EA]", scene, 4096, 100)[0])
        return
    TABLE.show(options.write, rows(scene, options.quick))


ARGUMENTS = {
    "--quick": {"action": "store_true"},
    "--only-first": {"action": "store_true", "help": argparse.SUPPRESS},
    "--all-cores": {"action": "store_true", "help": argparse.SUPPRESS},
}

if __name__ == "__main__":
    main(__doc__, measure, ARGUMENTS)
