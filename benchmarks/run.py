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
from functools import partial
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
from laboratory.kinds import rates  # noqa: E402
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


def ours(name, scene, batch, steps, dtype=jnp.float64, torque=None):
    scene = scenes.scene(scene.name, dtype)
    torque = scene.torque if torque is None else torque

    def run(start):
        return ml.integrate(ml.method(name), scene.body, torque, start, dt=0.005, steps=steps, save_every=steps)

    return body_step(run, scene, batch, steps)


def ambient(scene, t, y):
    """d/dt of momentum and quaternion as one array (7,), for a general solver."""
    state = ml.RigidState(y[:3], y[3:])
    velocity = y[:3] / scene.body.moments
    rate = state.kind.rate(tuple(y[i] for i in range(3, 7)), tuple(velocity))
    return jnp.concatenate([jnp.cross(y[:3], velocity) + scene.torque(t, state), jnp.stack(rate)])


def in_diffrax(term, solver, times, start):
    """The end of steps between these times, without a derivative."""
    options = {"stepsize_controller": diffrax.StepTo(ts=times), "adjoint": diffrax.ForwardMode(), "max_steps": None}
    return diffrax.diffeqsolve(term, solver, times[0], times[-1], None, start, **options).ys


def tsit5_run(scene, dt, steps):
    """diffrax's Tsit5 on momentum and quaternion with a constant step, as a function of the start."""

    def run(start):
        y = jnp.concatenate([start.momentum, start.attitude], axis=-1)
        return in_diffrax(
            diffrax.ODETerm(lambda t, y, args: ambient(scene, t, y)), diffrax.Tsit5(), dt * jnp.arange(steps + 1.0), y
        )[-1]

    return run


def scipy_step(scene, steps):
    """Seconds a step of SciPy's RK45 at a constant step, on Python floats, which are faster here than NumPy's."""
    field = rates(scene)
    start = np.concatenate([np.asarray(scene.start.momentum), np.asarray(scene.start.attitude)])
    options = {"method": "RK45", "first_step": 0.005, "max_step": 0.005, "rtol": 1e-2, "atol": 1e3}

    def run():
        return solve_ivp(lambda t, y: field(y.tolist()), (0, 0.005 * steps), start, **options).t

    return median_seconds(run) / (len(run()) - 1)


def equal_time_errors(scene, ratio, time=1.0, steps=400):
    """Errors of the momentum at `time`: LIEMID[EA] with `steps` steps, and Tsit5 with `ratio` times as many."""
    tsit5_steps = max(1, round(steps * ratio))

    def momentum(count):
        return ml.integrate("LIEMID[EA]", scene.body, scene.torque, scene.start, dt=time / count, steps=count).states

    liemid = momentum(steps).momentum[-1]
    tsit5 = tsit5_run(scene, time / tsit5_steps, tsit5_steps)(scene.start)[:3]
    exact = tsit5_run(scene, time / 8000, 8000)(scene.start)[:3]
    return float(jnp.linalg.norm(liemid - exact)), float(jnp.linalg.norm(tsit5 - exact))


def through_diffrax(scene, batch, steps):
    """Cost of LIEMID[EA] as a solver of diffrax, with the steps and the end of `ours` and no derivative."""
    term, times = ml.diffrax.RigidBodyTerm(scene.body, scene.torque), 0.005 * jnp.arange(steps + 1.0)
    run = partial(in_diffrax, term, ml.diffrax.LieSolver("LIEMID[EA]"), times)
    return body_step(run, scene, batch, steps)


def elsewhere(*options, **environment):
    """Seconds a body-step of LIEMID[EA], batch 4096, measured in a separate process."""
    command = [sys.executable, __file__, "--quick", "--only-first", *options]
    environment = {**os.environ, **environment}
    out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    return float(re.findall(r"RESULT ([\d.eE+-]+)", out)[0])


def ensemble_step(name, scene, starting, steps):
    """A call that moves all bodies by `steps` steps through `ml.ensemble`, and its compiled program."""

    def run(start):
        return ml.ensemble(name, scene.body, scene.torque, start, dt=0.005, steps=steps)

    program, _ = compiled(run, starting)
    return lambda: program(starting), program


def limits(scene, batch, steps):
    """Rows that compare with hand-written C of the same methods, timed alternately under the same conditions."""
    for method, dtype in itertools.product(("LIEMID", "JACOBI", "SYMMETRIC", "DOP853"), (jnp.float64, jnp.float32)):
        name = method if method == "DOP853" else f"{method}[EA]"
        own = scenes.scene(scene.name, dtype)
        call, _ = ensemble_step(name, own, starts(own, batch), steps)
        rivals = {method: "relative to C"}
        if method == "LIEMID":
            rivals["LIEMID_EARLY"] = "relative to C that stops solves early"
        digits = jnp.dtype(dtype).name
        for rival, words in rivals.items():
            kind = limit.best(rival, digits)
            pairs = [(limit.limit(rival, digits), median_seconds(call) / (batch * steps)) for _ in range(3)]
            share = statistics.median(c / cost for c, cost in pairs)
            speed = f"limit {1e-6 / min(c for c, _ in pairs):.1f} M/s by {Path(kind.compiler).name}: {kind.form}"
            yield f"{name}, {digits}, {words}", speed, f"{share:.2f}", ""


def sizes(scene, name, reference):
    for many in (1, 100, 10_000, 1_000_000):
        steps = {1: 20_000, 100: 2000, 10_000: 100}.get(many, 20)
        starting = starts(scene, many)
        call, program = ensemble_step(name, scene, starting, steps)
        cost = median_seconds(call) / (steps * many)
        memory = program.memory_analysis()
        body_bytes = (memory.output_size_in_bytes + memory.temp_size_in_bytes) / many
        note = f"{1e9 * cost:.1f} ns per body-step"
        if many == 1_000_000:
            note += f"; memory besides the start: {body_bytes / 56:.1f} times the start"
        yield f"{name}, ensemble of {many}", note, f"{reference / cost:.2f}", ""


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


def state_rows(batch, steps):
    """Rows for each kind of state: free bodies, and bodies under a torque of time; timed alternately.

    The direction and the attitude follow the same motion as the momentum alone, so their ratio is what they cost.
    """
    rng = np.random.default_rng(0)
    attitude, direction = jnp.array([1.0, 0, 0, 0]), jnp.array([0.0, 0, 1.0])
    kinds = {
        "the attitude": lambda momentum: ml.RigidState(momentum, attitude),
        "one direction": lambda momentum: ml.DirectionState(momentum, direction),
        "the momentum alone": ml.MomentumState,
    }
    control = ml.torques.Prescribed(lambda t: jnp.stack([0.1 * t * t, 0.2 * t, 0.1 - t]))
    many = jnp.asarray(rng.normal(size=(batch, 3)))
    for name, moments in (("JACOBI[EA]", [1.0, 2.0, 2.5]), ("SYMMETRIC[EA]", [2.0, 2.0, 2.5])):
        for label, torque in (("free", None), ("a torque of time", control)):

            def prepared(kind, name=name, moments=moments, torque=torque):
                def run(momentum):
                    body = ml.RigidBody(moments)
                    path = ml.integrate(name, body, torque, kind(momentum), dt=0.01, steps=steps, save_every=steps)
                    return path.states

                program, compiling = compiled(jax.vmap(run), many)
                return lambda: program(many), compiling

            programs = {state: prepared(kind) for state, kind in kinds.items()}
            times = {state: [] for state in kinds}
            for _ in range(7):
                for state, (call, _) in programs.items():
                    times[state].append(median_seconds(call, 1) / (steps * batch))
            for state, (_, compiling) in programs.items():
                ratio = statistics.median(
                    whole / own for whole, own in zip(times["the attitude"], times[state], strict=True)
                )
                speed = f"{1e-6 / statistics.median(times[state]):.1f} M body-steps/s"
                yield f"{name}, {label}, {state}", speed, f"{ratio:.2f}", f"{compiling:.1f} s"


def free_motion_row(batch, count=16):
    """What one state of `free_motion` costs, over a batch of bodies with `count` times each."""
    body, attitude = ml.RigidBody([1.0, 2.0, 2.5]), jnp.array([1.0, 0, 0, 0])
    times = jnp.logspace(-2, 6, count)
    many = jnp.asarray(np.random.default_rng(0).normal(size=(batch, 3)))
    run = jax.vmap(lambda momentum: ml.free_motion(body, ml.RigidState(momentum, attitude), times).states)
    program, compiling = compiled(run, many)
    cost = median_seconds(lambda: program(many)) / (batch * count)
    yield "free_motion, a state with attitude", f"{1e9 * cost:.0f} ns", "", f"{compiling:.1f} s"


def rows(scene, quick):
    batch, steps = 4096, 100 if quick else 400
    reference, compiling = ours("LIEMID[EA]", scene, batch, steps)
    yield "LIEMID[EA]", f"{1e-6 / reference:.1f} M body-steps/s", "1", f"{compiling:.1f} s"
    yield from limits(scene, batch, steps)
    if (os.cpu_count() or 1) > 1:
        both = statistics.median(elsewhere() / elsewhere("--all-cores") for _ in range(3))
        yield f"LIEMID[EA], {os.cpu_count()} cores", "relative to one core", f"{both:.2f}", ""
    for label, torque in (
        ("a torque written on arrays", lambda t, s: 20 * jnp.cross(ml.so3.to_matrix(s.attitude)[2], jnp.eye(3)[2])),
        ("a torque from a potential", ml.torques.FromPotential(lambda t, s: 20 * ml.so3.to_matrix(s.attitude)[2, 2])),
    ):
        cost, compiling = ours("LIEMID[EA]", scene, batch, steps, torque=torque)
        yield f"LIEMID[EA], {label}", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    cost, compiling = ours("LIEMID[EA]", scene, batch, steps, jnp.float32)
    yield "LIEMID[EA], float32", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    if not quick:
        option = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=true"
        cost = elsewhere(XLA_FLAGS=f"{os.environ.get('XLA_FLAGS', '')} {option}".strip())
        yield "LIEMID[EA], XLA's multi-output fusion on", "", f"{reference / cost:.2f}", ""
    for name in (method.name for method in paper_methods() if method.name != "LIEMID[EA]"):
        cost, compiling = ours(name, scene, batch, steps)
        yield name, "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    yield from flight_rows(scene, batch, steps)
    yield from state_rows(batch, steps)
    yield from free_motion_row(batch)
    cost, compiling = body_step(tsit5_run(scene, 0.005, steps), scene, batch, steps, vector_width_options())
    yield "diffrax Tsit5, vmapped, constant step", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    liemid, tsit5 = equal_time_errors(scene, reference / cost)
    yield "error of Pi at equal time, T = 1", f"LIEMID[EA] {liemid:.1e}, Tsit5 {tsit5:.1e}", "", ""
    yield from sizes(scene, "LIEMID[EA]", reference)
    yield from sizes(scene, "SYMMETRIC[EA]", reference)
    solo, _ = ours("LIEMID[EA]", scene, 1, 20_000)
    cost, _ = body_step(tsit5_run(scene, 0.005, 20_000), scene, 1, 20_000)
    yield "diffrax Tsit5, 1 body", f"{1e6 * cost:.2f} µs per step", f"{solo / cost:.4f} of LIEMID[EA]'s", ""
    cost = scipy_step(scene, 2000)
    yield "SciPy RK45, 1 body", f"{1e6 * cost:.0f} µs per step", f"{solo / cost:.4f} of LIEMID[EA]'s", ""
    for many in (1, 1000, 100_000):
        steps = 100_000 // many if many < 1000 else 40
        alone, _ = ours("LIEMID[EA]", scene, many, steps)
        cost, compiling = through_diffrax(scene, many, steps)
        label = f"LIEMID[EA] through diffrax, {many} bodies"
        yield label, f"{cost / alone:.2f} times `ml.integrate`", f"{reference / cost:.2f}", f"{compiling:.1f} s"


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
