"""The speed of runs, calls, torques, kinds of state, gradients and programs of users: docs/reports/speed.md.

    python benchmarks/speed.py bench [--quick] [--write]     `make bench`: all methods, C, diffrax and SciPy
    python benchmarks/speed.py calls first [--write]         a second call, a first one, and another number of steps
    python benchmarks/speed.py observed [--write]            what observing costs (docs/api.md)
    python benchmarks/speed.py networks [--write]            torques of many operations
    python benchmarks/speed.py kinds [--write]               kinds of state
    python benchmarks/speed.py gradients [--write]           value and gradient over value
    python benchmarks/speed.py jit gradient hessian loops craft [--write]      in programs of users, without XLA_FLAGS

On one core; programs that are compared take turns. Times are medians of processor time.
"""

import argparse
import itertools
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import limit
import numpy as np
import one_core  # noqa: F401
from harness import Table, compiled, first_call, in_turn, main
from laboratory.rivals import perturbed, program, rates
from laboratory.rivals import scene as any_scene
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options, vector_width_options
from midlie_jax.advice.timing import timed, user_clock
from midlie_jax.cli import scenes
from midlie_jax.integrators.flights import FLIGHTS
from midlie_jax.integrators.registry import ENTRIES, paper_methods

PAGE = "reports/speed.md"
P1 = scenes.scene("P1")

# ---- the cost of a step, as ratios of times measured in one run: `make bench` ----
#
# Every figure is the median of five runs of the fast top P1 after a first run, in processor time. Compile times are of
# the first call, with tracing, by the wall clock. The limit in C is `limit.c`, compiled here in several forms, which
# takes minutes.

BENCH_KEY = (
    *("LIEMID[EA]", "LIEMID[EA], 2 cores", "LIEMID[EA], float32", "JACOBI[EA]", "SYMMETRIC[EA]"),
    *("DLM[EA]", "AKW", "NMB", "JACOBI[CHIN4A]", "JACOBI[SRKN6b]", "JACOBI[SRKN14a]"),
    *("GBS12", "DOP853", "RK4", "diffrax Tsit5, vmapped, constant step"),
)


def starting(scene, batch):
    return scenes.perturbed(scene, batch, 1e-3)


def median_seconds(call, repeats=6):
    return timed(lambda: jax.block_until_ready(call()), least=1, most=repeats, clock=user_clock())[1].seconds


def wall_compiled(function, argument, options=None):
    """The function compiled, by default as `ml.ensemble` compiles it, and the seconds of tracing and compiling."""
    begin = time.perf_counter()
    first = jax.tree.leaves(argument)[0]
    options = compiler_options(first.shape[0] if first.ndim > 1 else 1) if options is None else options
    program = jax.jit(function, compiler_options=options).lower(argument).compile()
    return program, time.perf_counter() - begin


def body_step(run, scene, batch, steps, options=None):
    """Seconds a body-step of `run(start)` over a batch of starts (without vmap for 1), and seconds of compiling."""
    many = starting(scene, batch)
    if batch == 1:
        one = jax.tree.map(lambda x: x[0], many)
        program, compiling = wall_compiled(run, one, options)
        return median_seconds(lambda: program(one)) / steps, compiling
    program, compiling = wall_compiled(jax.vmap(run), many, options)
    return median_seconds(lambda: program(many)) / (steps * batch), compiling


def cost_of(name, scene, batch, steps, dtype=jnp.float64):
    scene = scenes.scene(scene.name, dtype)

    def run(start):
        return ml.integrate(name, scene.body, scene.torque, start, dt=0.005, steps=steps, save_every=steps)

    return body_step(run, scene, batch, steps)


def ambient(scene, t, y):
    state = ml.RigidState(y[:3], y[3:])
    velocity = y[:3] / scene.body.moments
    rate = state.kind.rate(tuple(y[i] for i in range(3, 7)), tuple(velocity))
    return jnp.concatenate([jnp.cross(y[:3], velocity) + scene.torque(t, state), jnp.stack(rate)])


def tsit5_run(scene, dt, steps):
    times = dt * jnp.arange(steps + 1.0)
    options = {"stepsize_controller": diffrax.StepTo(ts=times), "adjoint": diffrax.ForwardMode(), "max_steps": None}
    term = diffrax.ODETerm(lambda t, y, args: ambient(scene, t, y))

    def run(start):
        y = jnp.concatenate([start.momentum, start.attitude], axis=-1)
        return diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, dt * steps, None, y, **options).ys[-1]

    return run


def scipy_step(scene, steps):
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
    for method, dtype in itertools.product(("LIEMID", "JACOBI", "SYMMETRIC", "DOP853"), (jnp.float64, jnp.float32)):
        name = method if method == "DOP853" else f"{method}[EA]"
        own = scenes.scene(scene.name, dtype)
        many = starting(own, batch)

        def run(start, name=name, own=own):
            return ml.ensemble(name, own.body, own.torque, start, dt=0.005, steps=steps)

        program, _ = wall_compiled(run, many)
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

        many = starting(scene, batch)
        program, compiling = wall_compiled(jax.vmap(run), many)
        return lambda: program(many), compiling

    baseline, _ = prepared("LIEMID[EA]")
    paper = {method.name for method in paper_methods()}
    flights = [f"{flight.name}[EA]" for flight in FLIGHTS.values() if flight.body is ml.RigidBody]
    others = [name for name, entry in ENTRIES.items() if issubclass(ml.RigidBody, entry.method.bodies)]
    for name in dict.fromkeys(name for name in (*flights, *others) if name not in paper):
        call, compiling = prepared(name)
        ratio = statistics.median(median_seconds(baseline, 1) / median_seconds(call, 1) for _ in range(7))
        yield name, "", f"{ratio:.2f}", f"{compiling:.1f} s"


def bench_rows(scene, quick):
    batch, steps = 4096, 100 if quick else 400
    reference, compiling = cost_of("LIEMID[EA]", scene, batch, steps)
    yield "LIEMID[EA]", f"{1e-6 / reference:.1f} M body-steps/s", "1", f"{compiling:.1f} s"
    yield from limits(scene, batch, steps)
    if (os.cpu_count() or 1) > 1:
        both = statistics.median(elsewhere() / elsewhere("--all-cores") for _ in range(3))
        yield f"LIEMID[EA], {os.cpu_count()} cores", "relative to one core", f"{both:.2f}", ""
    cost, compiling = cost_of("LIEMID[EA]", scene, batch, steps, jnp.float32)
    yield "LIEMID[EA], float32", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    for name in (method.name for method in paper_methods() if method.name != "LIEMID[EA]"):
        cost, compiling = cost_of(name, scene, batch, steps)
        yield name, "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    yield from flight_rows(scene, batch, steps)
    cost, compiling = body_step(tsit5_run(scene, 0.005, steps), scene, batch, steps, vector_width_options())
    yield "diffrax Tsit5, vmapped, constant step", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    solo, _ = cost_of("LIEMID[EA]", scene, 1, 20_000)
    cost, _ = body_step(tsit5_run(scene, 0.005, 20_000), scene, 1, 20_000)
    yield "diffrax Tsit5, 1 body", f"{1e6 * cost:.2f} µs per step", f"{solo / cost:.4f} of LIEMID[EA]'s", ""
    cost = scipy_step(scene, 2000)
    yield "SciPy RK45, 1 body", f"{1e6 * cost:.0f} µs per step", f"{solo / cost:.4f} of LIEMID[EA]'s", ""


def is_key(row):
    return row[0] in BENCH_KEY or row[0].endswith("float64, relative to C")


BENCH_HEADS = ("LIEMID[EA] on P1, 4096 bodies, float64, unless stated", "measured", "relative speed", "first call")
BENCH = Table(PAGE, "bench", BENCH_HEADS, data="speed", key=is_key, columns=(0, 2, 3))


def bench(options):
    scene = scenes.scene("P1")
    if options.only_first:
        print("RESULT", cost_of("LIEMID[EA]", scene, 4096, 100)[0])
        return
    BENCH.show(options.write, bench_rows(scene, options.quick))


ARGUMENTS = {
    "--quick": {"action": "store_true"},
    "--only-first": {"action": "store_true", "help": argparse.SUPPRESS},
    "--all-cores": {"action": "store_true", "help": argparse.SUPPRESS},
}


# ---- what a call costs besides its steps: a second call, a first one, and one with another number of steps ----
#
# A second call is of the same body and torque and takes two steps, so it consists of checks, of the search for the
# compiled program, and of its dispatch. First calls run in a process of their own; they include tracing and compiling,
# not imports.

CALL_BODIES = 64
ONE, MANY = P1.start, scenes.perturbed(P1, CALL_BODIES, 1e-3)
RUN = {"dt": 0.005, "steps": 2}


def solve(start):
    term, solver = ml.diffrax.RigidBodyTerm(P1.body, P1.torque), ml.diffrax.LieSolver("SYMMETRIC[EA]")
    return diffrax.diffeqsolve(term, solver, 0.0, 0.01, 0.005, start, adjoint=diffrax.ForwardMode()).ys


CALLS: dict[str, tuple[Any, Callable[[Any], Any]]] = {
    "`ml.integrate`": (ONE, lambda x: ml.integrate("SYMMETRIC[EA]", P1.body, P1.torque, x, save_every=None, **RUN)),
    "`ml.integrate` in `jax.vmap`, 64 bodies": (
        MANY,
        jax.vmap(lambda x: ml.integrate("SYMMETRIC[EA]", P1.body, P1.torque, x, save_every=None, **RUN)),
    ),
    "`ml.ensemble`, 64 bodies": (MANY, lambda x: ml.ensemble("SYMMETRIC[EA]", P1.body, P1.torque, x, **RUN)),
    "`ml.integrate_variable_step`": (
        ONE,
        lambda x: ml.integrate_variable_step(
            "SYMMETRIC[EA]", P1.body, P1.torque, x, density=even_density, save_every=None, **RUN
        ),
    ),
    "`ml.free_motion`": (ONE, lambda x: ml.free_motion(P1.body, x, [0.0, 0.005, 0.01])),
    "`diffeqsolve` with `ml.diffrax.LieSolver`": (ONE, solve),
}


def even_density(t, state):
    return 1.0 + 0.0 * state.momentum[0]


def call_rows() -> Iterator[list[str]]:
    for name, (start, call) in CALLS.items():
        compiled = jax.jit(call)
        times = in_turn((lambda: call(start), lambda: compiled(start)), 101, 301)  # noqa: B023  (called here)
        yield [name, *(f"{1e3 * seconds:.2f} ms" for seconds in times)]


def orbiting(name: str, bodies: int | None, steps: int) -> Any:
    orbit = ml.orbits.KeplerOrbit(jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 1.1, 0.0]), 1.0)
    return driven(name, ml.spacecraft.GravityGradient(None, orbit, 1.0), bodies, steps)


def topping(name: str, bodies: int | None, steps: int) -> Any:
    return driven(name, P1.torque, bodies, steps)


def driven(name: str, torque: Any, bodies: int | None, steps: int) -> Any:
    body = P1.body if name.startswith("SYMMETRIC") else ml.RigidBody([5.0, 4.5, 1.0])
    if bodies is None:
        return ml.integrate(name, body, torque, ONE, dt=0.005, steps=steps, save_every=None)
    return ml.ensemble(name, body, torque, MANY, dt=0.005, steps=steps)


DRIVES = {"top": topping, "orbit": orbiting}
PROGRAMS = [
    (name, kind, bodies)
    for kind in DRIVES
    for name in ("SYMMETRIC[EA]", "JACOBI[EA]", "GBS12")
    for bodies in (None, CALL_BODIES)
    if not (kind == "orbit" and name == "SYMMETRIC[EA]")
]


def first_rows() -> Iterator[list[str]]:
    for name, kind, bodies in PROGRAMS:
        parts = name, kind, str(bodies or "")
        first, both = first_call(__file__, *parts), first_call(__file__, *parts, "again")
        what = "a heavy top" if kind == "top" else "gravity gradient on an orbit"
        who = "`ml.integrate`" if bodies is None else f"`ml.ensemble`, {bodies} bodies"
        yield [f"{name}, {what}, {who}", f"{first:.1f} s", f"{1e3 * both:.0f} ms"]


def one_process(name: str, kind: str, bodies: str, again: str = "") -> Callable[[], Any]:
    run, count = DRIVES[kind], int(bodies) if bodies else None
    if again:
        jax.block_until_ready(run(name, count, 1000))
    return lambda: run(name, count, 1001 if again else 1000)


KEPT = ("JACOBI[EA], a heavy top", "GBS12, gravity gradient")  # on the page
CALLS_TABLE = Table(PAGE, "calls", ("call", "second call", "inside `jax.jit`"), call_rows)
FIRST = Table(
    *(PAGE, "first calls", ("method, torque", "first call", "another number of steps"), first_rows),
    *("first-calls", lambda row: row[0].startswith(KEPT)),
)
# ---- what it costs to observe 10,000 free tops at every step: their states, or a statistic of one component ----

OBSERVED_BODIES, OBSERVED_STEPS, TURNS = 10_000, 100, 11


def component(t: Any, state: Any) -> Any:
    return state.momentum[0]


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    yield "nothing", {"save_every": None}
    yield "the states", {"save_every": 1}
    yield "`Mean`", {"save_every": 1, "observe": ml.observe.Mean(component)}
    for bins in (10, 100, 1000):
        edges = np.linspace(-3, 3, bins + 1)
        yield f"`Histogram` of {bins} bins", {"save_every": 1, "observe": ml.observe.Histogram(component, edges)}


def observed_rows() -> Iterator[list[str]]:
    random = np.random.default_rng(0)
    attitudes = random.normal(size=(OBSERVED_BODIES, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    start = ml.RigidState(jnp.asarray(random.normal(size=(OBSERVED_BODIES, 3))), jnp.asarray(attitudes))
    body = ml.RigidBody(jnp.array([2.0, 2.0, 1.0]))
    names, runs = zip(*((name, partial(observed_run, body, start, options)) for name, options in cases()), strict=True)
    times = [seconds / (OBSERVED_BODIES * OBSERVED_STEPS) * 1e9 for seconds in in_turn(runs, TURNS)]
    for name, nanoseconds in zip(names, times, strict=True):
        yield [name, f"{nanoseconds:.0f}", f"{nanoseconds - times[0]:.0f}"]


def observed_run(body: Any, start: Any, options: dict[str, Any]) -> Any:
    return ml.ensemble("SYMMETRIC[EA]", body, None, start, dt=0.05, steps=OBSERVED_STEPS, **options)


OBSERVED_HEADS = "at each step", "ns per body-step", "more than the motion alone, ns"
OBSERVED = Table("api.md", "observed", OBSERVED_HEADS, observed_rows)


# ---- torques of many operations, as neural networks are: first calls, and the time of a step ----
#
# The torque is an MLP of the attitude with two hidden layers and tanh, or a formula on arrays whose numbers are fitted.
# Value and gradient with respect to all weights are those of |Pi|^2 at the end: of one body by `ml.integrate`, and of
# 1000 by `ml.ensemble`, in float64. Times of a step are medians, for one body.

METHOD, NETWORK_BODIES, NETWORK_DT = "JACOBI[EA]", 1000, 0.005
WIDTHS = 1, 2, 4, 8, 16, 32, 64, 128
NETWORK_STEPS = {"integrate": 2000, "ensemble": 64}
BODY = ml.RigidBody(jnp.array([1.0, 2.0, 2.5]))


class Network(eqx.Module):
    layers: eqx.nn.MLP

    def __call__(self, t, state):
        del t
        return self.layers(state.attitude)


class Formula(eqx.Module):
    numbers: jax.Array
    function: Callable = eqx.field(static=True)

    def __call__(self, t, state):
        return self.function(self.numbers, t, ml.so3.to_matrix(state.attitude))


def facets(normals, t, rotation):
    normals = normals.reshape(-1, 3)
    lit = jnp.maximum(normals @ (rotation.T @ jnp.array([1.0, 0.0, 0.0])), 0.0)
    return jnp.cross(0.3 * normals, -lit[:, None] * normals).sum(0)


def gradient_of_gravity(tensor, t, rotation):
    down = rotation.T @ jnp.array([jnp.cos(t), jnp.sin(t), 0 * t])
    return 3 * jnp.cross(down, tensor.reshape(3, 3) @ down)


FORMULAS = {"gradient of gravity": (gradient_of_gravity, 9), "4 facets": (facets, 12), "12 facets": (facets, 36)}


def formula(name):
    function, count = FORMULAS[name]
    return Formula(jax.random.normal(jax.random.key(2), (count,)), function)


def network(width):
    return Network(eqx.nn.MLP(4, 3, width, depth=2, activation=jnp.tanh, key=jax.random.key(0)))


def run_of(driver):
    turns = 0.1 * jax.random.normal(jax.random.key(1), (NETWORK_BODIES, 3))
    states = jax.vmap(lambda turn: ml.RigidState(jnp.array([1.0, 0.8, -1.3]), ml.so3.exp(turn)))(turns)
    steps = NETWORK_STEPS[driver]

    def end(torque):
        if driver == "integrate":
            one = jax.tree.map(lambda x: x[0], states)
            momentum = ml.integrate(
                METHOD, BODY, torque, one, dt=NETWORK_DT, steps=steps, save_every=steps
            ).states.momentum[-1]
        else:
            run = ml.ensemble(METHOD, BODY, torque, states, dt=NETWORK_DT, steps=steps, torque_axes=None)
            momentum = run.states.momentum
        return jnp.sum(momentum**2)

    return end, steps * (1 if driver == "integrate" else NETWORK_BODIES)


def measured(transform, function, torque, body_steps):
    arrays, rest = eqx.partition(torque, eqx.is_array)
    program = jax.jit(transform(lambda arrays: function(eqx.combine(arrays, rest))))
    began = time.process_time()
    jax.block_until_ready(program(arrays))
    first = time.process_time() - began
    (later,) = in_turn([lambda: program(arrays)], 3, 9, longest=2.0)
    return f"{first:.1f} s", f"{1e9 * later / body_steps:.0f} ns"


NETWORK_KEY = ("gradient of gravity", "network of width 16", "network of width 128", "12 facets")


def network_rows():
    networks = {f"network of width {width}": network(width) for width in WIDTHS}
    torques = networks | {name: formula(name) for name in FORMULAS}
    end, _ = run_of("integrate")
    measured(lambda f: f, end, ml.torques.HeavyTop(1.0), 1)  # what every program compiles once
    for name, torque in torques.items():
        for driver in NETWORK_STEPS:
            end, body_steps = run_of(driver)
            value = measured(lambda f: f, end, torque, body_steps)
            both = measured(jax.value_and_grad, end, torque, body_steps)
            yield [name, f"`{driver}`", *value, *both]


NETWORKS = Table(
    *(PAGE, "networks"),
    ("torque", "driver", "value: first call", "time per step", "value and gradient: first call", "time per step"),
    network_rows,
    data="networks",
    key=lambda row: row[0] in NETWORK_KEY and row[1] == "`ensemble`",
    columns=(0, 2, 3, 4, 5),
)


# ---- what a body-step costs with each kind of state: 4096 bodies through `ml.ensemble` ----

KIND_BODIES, KIND_DT, ROUNDS = 4096, 0.005, 9
KIND_STEPS = {"EA": 800, "SRKN6b": 160, "SRKN14a": 80, "GBS12": 80, "DOP853": 160}  # by scheme or method
PULL = ml.torques.UniformGravity([0.0, 0.0, -9.81])
DTYPES = ("float64", "float32")


def rigid(name: str) -> tuple[Any, Any, Any]:
    found = any_scene(name)
    return found.body, found.torque, perturbed(found.start, KIND_BODIES, 1e-3)


def thrown() -> tuple[Any, ...]:
    return tuple(jnp.broadcast_to(jnp.array(x), (KIND_BODIES, 3)) for x in ([1.0, 0.0, 2.0], [0.0, 0.0, 1.0]))


def travelling() -> tuple[Any, Any, Any]:
    body, torque, starts = rigid("asymmetric-top")
    return ml.FreeBody(body, 3.0), torque + PULL, ml.FreeState(starts.momentum, starts.attitude, *thrown())


def axis() -> tuple[Any, Any, Any]:
    body, torque, starts = rigid("P1-tilted")
    return ml.SymmetricRotor(body.moments[0]), torque, ml.AxisState.of(starts)


def direction() -> tuple[Any, Any, Any]:
    body, torque, starts = rigid("asymmetric-top")
    return body, torque, ml.DirectionState(starts.momentum, ml.so3.to_matrix(starts.attitude)[:, 2])


def travelling_axis() -> tuple[Any, Any, Any]:
    rotor, torque, starts = axis()
    start = ml.FreeAxisState(starts.momentum, starts.axis, *thrown())
    return ml.FreeBody(rotor, 3.0), torque + PULL, start


def coupled() -> tuple[Any, Any, Any]:
    """The tops that travel, two in a state: they could act on each other and do not."""
    body, wrench, starts = travelling()
    pairs = jax.tree.map(lambda x: x.reshape(-1, 2, x.shape[-1]), vars(starts))
    return body, ml.torques.OnEach(wrench), ml.CoupledState(**pairs)


def compensated() -> tuple[Any, Any, Any]:
    body, torque, starts = rigid("asymmetric-top")
    return body, torque, ml.CompensatedState(starts.momentum, starts.attitude)


def free(attitude: bool) -> tuple[Any, Any, Any]:
    body, _, starts = rigid("asymmetric-top")
    return body, None, starts if attitude else ml.MomentumState(starts.momentum)


# By flight or method the states that are compared with the first of them: what makes body, torque and starts.
TOP = partial(rigid, "asymmetric-top")
FREE = {"RigidState, no torque": partial(free, True), "MomentumState, no torque": partial(free, False)}
SYSTEMS: dict[str, dict[str, Callable[[], tuple[Any, Any, Any]]]] = {
    "JACOBI": {
        "RigidState": TOP,
        "DirectionState": direction,
        "FreeState": travelling,
        "CoupledState": coupled,
        "CompensatedState": compensated,
        **FREE,
    },
    "SYMMETRIC": {"RigidState": partial(rigid, "P1-tilted"), "AxisState": axis, "FreeAxisState": travelling_axis},
    **{name: {"RigidState": TOP, "DirectionState": direction, **FREE} for name in ("GBS12", "DOP853")},
}
KIND_METHODS = [f"{flight}[{scheme}]" for flight in ("JACOBI", "SYMMETRIC") for scheme in ("EA", "SRKN6b", "SRKN14a")]
CASES = [(name, state) for name in (*KIND_METHODS, "GBS12", "DOP853") for state in SYSTEMS[name.partition("[")[0]]]


def relative_to(state: str) -> str:
    return "RigidState" + state.partition("State")[2]


def cast(tree: Any, dtype: str) -> Any:
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, tree)


def steps_of(method: str) -> int:
    return KIND_STEPS[method.removesuffix("]").rpartition("[")[2]]


def ensemble(method: str, state: str, dtype: str) -> tuple[Callable[[Any], Any], Any]:
    body, torque, starts = cast(SYSTEMS[method.partition("[")[0]][state](), dtype)
    return lambda start: ml.ensemble(method, body, torque, start, dt=KIND_DT, steps=steps_of(method)), starts


def timed_run(*case: str) -> Callable[[], Any]:
    run, starts = ensemble(*case)
    call = compiled(run, starts, bodies=KIND_BODIES)
    if not bool(jnp.all(call().ok)):
        raise RuntimeError(f"{' '.join(case)} failed; take a shorter step.")
    return call


def kind_rows() -> Iterator[list[str]]:
    keys = [(*case, dtype) for case in CASES for dtype in DTYPES]
    times = in_turn([timed_run(*key) for key in keys], ROUNDS)
    costs = {key: 1e9 * t / (KIND_BODIES * steps_of(key[0])) for key, t in zip(keys, times, strict=True)}
    for method, state in CASES:
        own = [costs[method, state, dtype] for dtype in DTYPES]
        whole = [costs[method, relative_to(state), dtype] for dtype in DTYPES]
        cells = [text for mine, its in zip(own, whole, strict=True) for text in (f"{mine:.3g}", f"{mine / its:.2f}")]
        yield [f"`{method}`", re.sub(r"\w+State", r"`\g<0>`", state), *cells]


def is_short(row: list[str]) -> bool:
    return row[0] in ("`JACOBI[EA]`", "`SYMMETRIC[EA]`") and not row[1].startswith("`RigidState`")


OVER = "relative to `RigidState`"
KINDS = Table(
    *(PAGE, "kinds", ("method", "state", "float64, ns", OVER, "float32, ns", OVER), kind_rows),
    *("kinds-of-state", is_short, range(4)),
)
# ---- value and gradient over value, first calls and memory ----
#
# The gradient is that of |Pi|^2 at the end of 128 steps with respect to the three moments and the weight, for each of
# 1000 fast tops P1. The memory is what the compiled gradient of one top needs. diffrax's Tsit5 takes as many steps of
# the same length, with its default adjoint. Our programs have both options of the compiler; Tsit5, which is faster
# without the second, has the first. Of 128 steps the default, `Checkpointed()`, keeps every state, as `every=1` does.

GRADIENT_BODIES, GRADIENT_STEPS, GRADIENT_DT = 1000, 128, 0.005
LONG = (1_000, 100_000)  # steps of the runs whose memory is compared
GRADIENT_METHODS = ("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]")
PARAMETERS = (P1.body.moments, P1.torque.mgl)


def end_by(name, adjoint, steps):
    def end(parameters, start):
        moments, weight = parameters
        run = {"dt": GRADIENT_DT, "steps": steps, "save_every": steps, "adjoint": adjoint}
        path = ml.integrate(name, ml.RigidBody(moments), ml.torques.HeavyTop(weight), start, **run)
        return jnp.sum(path.states.momentum[-1] ** 2)

    return end


def tsit5(parameters, start):
    moments, weight = parameters

    def field(t, y, args):
        momentum, attitude = y[:3], y[3:]
        velocity = momentum / moments
        up = ml.so3.to_matrix(attitude)[2]
        torque = weight * jnp.stack([up[1], -up[0], 0 * weight])
        turning = 0.5 * ml.so3.multiply(attitude, jnp.concatenate([jnp.zeros(1), velocity]))
        return jnp.concatenate([jnp.cross(momentum, velocity) + torque, turning])

    term = diffrax.ODETerm(field)
    y = jnp.concatenate([start.momentum, start.attitude])
    options = {
        "stepsize_controller": diffrax.StepTo(ts=GRADIENT_DT * jnp.arange(GRADIENT_STEPS + 1.0)),
        "max_steps": GRADIENT_STEPS,
    }
    found = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, GRADIENT_DT * GRADIENT_STEPS, None, y, **options)
    return jnp.sum(found.ys[-1, :3] ** 2)


def each():
    starts = scenes.perturbed(P1, GRADIENT_BODIES, 1e-3)

    def row(label, adjoint, end, options):
        functions = (lambda start: end(PARAMETERS, start), lambda start: jax.value_and_grad(end)(PARAMETERS, start))
        calls = [compiled(jax.vmap(function), starts, options=options) for function in functions]
        value, both = in_turn(calls, 31, 61)
        nanoseconds = f"{1e9 * both / GRADIENT_BODIES / GRADIENT_STEPS:.0f}"
        return [label, adjoint, f"{both / value:.1f}", nanoseconds, f"{calls[1].seconds:.0f} s"]

    for name in GRADIENT_METHODS:
        for adjoint in (ml.adjoints.Checkpointed(every=1), ml.adjoints.Reversible()):
            ends = [end_by(name, adjoint, n) for n in LONG]
            gradients = [compiled(jax.grad(end), PARAMETERS, P1.start, options={}) for end in ends]
            label = "`Reversible()`" if isinstance(adjoint, ml.adjoints.Reversible) else "`Checkpointed(every=1)`"
            sizes = [f"{gradient.memory / 1e3:.0f} kB" for gradient in gradients]
            yield [*row(name, label, end_by(name, adjoint, GRADIENT_STEPS), compiler_options(GRADIENT_BODIES)), *sizes]
    yield [*row("diffrax Tsit5", "`RecursiveCheckpointAdjoint()`", tsit5, vector_width_options()), *("" for _ in LONG)]


RATIO = "value and gradient over value", "ns per body-step"
GRADIENTS = Table(
    *(PAGE, "gradients"),
    ("method", "adjoint", *RATIO, "first call", *(f"memory, {steps} steps" for steps in LONG)),
    *(each, "gradients", lambda row: row[0] != "LIEMID[EA]", (0, 1, 2, 3, 6)),
)


# ---- steps in programs of users: their own `jax.jit`, `jax.grad` and `lax.scan`, and a controller in the loop ----

USER_METHODS = "SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]", "JACOBI[SRKN14a]", "GBS12"
MOMENTS = {"SYMMETRIC[EA]": [5.0, 5.0, 1.0]}


def seconds(*calls: Callable[[], Any]) -> list[float]:
    return in_turn(calls, 5, 15)


def tops(method: str, count: int, dtype: str = "float64") -> tuple[ml.RigidBody, ml.RigidState]:
    rng = np.random.default_rng(0)
    momentum = rng.normal(size=(count, 3)) + np.array([0, 0, 9])
    attitude = np.tile([1.0, 0, 0, 0], (count, 1))
    body = ml.RigidBody(jnp.asarray(MOMENTS.get(method, [5.0, 4.0, 1.0]), dtype))
    return body, ml.RigidState(jnp.asarray(momentum, dtype), jnp.asarray(attitude, dtype))


def rk4(slope: Callable[[Any], Any], y: Any, h: Any) -> Any:
    """A step by hand; the second part of y is a unit quaternion."""

    def moved(k: Any, h: Any) -> Any:
        return jax.tree.map(lambda a, b: a + h * b, y, k)

    k1 = slope(y)
    k2 = slope(moved(k1, h / 2))
    k3 = slope(moved(k2, h / 2))
    k4 = slope(moved(k3, h))
    first, q, *rest = moved(jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4), h)
    return first, q / jnp.linalg.norm(q), *rest


def end(method: str, body: Any, weight: Any, start: Any, steps: int) -> Any:
    torque = ml.torques.HeavyTop(weight)
    return ml.integrate(method, body, torque, start, dt=0.01, steps=steps, save_every=None).states


def in_jit() -> Iterator[list[str]]:
    steps = 256
    for method in USER_METHODS:
        for dtype in ("float64", "float32"):
            for count in (64, 1024):
                body, starts = tops(method, count, dtype)
                weight = jnp.asarray(20.0, dtype)
                torque = ml.torques.HeavyTop(weight)
                users = jax.jit(jax.vmap(lambda s, m=method, b=body, w=weight: end(m, b, w, s, steps)))
                times = seconds(
                    partial(users, starts),
                    lambda m=method, b=body, t=torque, s=starts: ml.ensemble(m, b, t, s, dt=0.01, steps=steps),
                )
                own, ours = (1e9 * t / steps / count for t in times)
                yield [method, dtype, str(count), f"{own:.1f}", f"{ours:.1f}", f"{own / ours:.2f}"]


def gradients() -> Iterator[list[str]]:
    for method in ("SYMMETRIC[EA]", "JACOBI[EA]", "JACOBI[SRKN6b]", "DOP853", "GBS12"):
        for steps, count in ((128, 1000), (1000, 256), (10000, 64))[: 3 if "EA" in method else 1]:
            body, starts = tops(method, count)

            def of_weight(weight: Any, m: str = method, b: Any = body, s: Any = starts, n: int = steps) -> Any:
                return jnp.sum(jax.vmap(lambda one: end(m, b, weight, one, n).momentum)(s) ** 2)

            def of_moments(moments: Any, loss: Any = of_weight) -> Any:
                return loss(20.0, b=ml.RigidBody(moments))

            for parameter, loss, x in (("weight", of_weight, 20.0), ("moments", of_moments, body.moments)):
                both, alone = seconds(partial(jax.jit(jax.value_and_grad(loss)), x), partial(jax.jit(loss), x))
                size = f"{steps} x {count}"
                yield [method, parameter, size, f"{1e9 * both / steps / count:.1f}", f"{both / alone:.1f}"]


def hessians() -> Iterator[list[str]]:
    _, starts = tops("JACOBI[EA]", 1)
    start = jax.tree.map(lambda x: x[0], starts)

    def with_package(method: str, x: Any) -> Any:
        states = end(method, ml.RigidBody(x[1:]), x[0], start, 100)
        return jnp.sum(states.momentum**2) + jnp.sum(states.attitude**3)

    def by_hand(x: Any) -> Any:
        def slope(y: Any) -> Any:
            momentum, q = y
            rate = momentum / x[1:]
            down = ml.so3.rotate(q * jnp.array([1.0, -1.0, -1.0, -1.0]), jnp.array([0.0, 0.0, -1.0]))
            turn = jnp.cross(momentum, rate) + x[0] * jnp.cross(jnp.array([0.0, 0.0, 1.0]), down)
            return turn, 0.5 * ml.so3.multiply(q, jnp.concatenate([jnp.zeros(1), rate]))

        begin = start.momentum, start.attitude
        momentum, q = jax.lax.scan(lambda y, _: (rk4(slope, y, 0.01), None), begin, length=100)[0]
        return jnp.sum(momentum**2) + jnp.sum(q**3)

    at = jnp.array([20.0, 5.0, 4.0, 1.0])
    losses = {method: partial(with_package, method) for method in ("JACOBI[EA]", "LIEMID[EA]", "RK4")}
    for name, loss in (losses | {"RK4 by hand": by_hand}).items():
        begin = time.perf_counter()
        traced = jax.jit(jax.hessian(loss)).trace(at)
        between = time.perf_counter()
        compiled = traced.lower().compile()
        first, tracing = time.perf_counter() - begin, between - begin
        yield [name, f"{first:.0f} s", f"{tracing:.0f} s", f"{1e3 * seconds(partial(compiled, at))[0]:.2f} ms"]


def loops() -> Iterator[list[str]]:
    count, steps = 1024, 400
    for method in USER_METHODS[:3]:
        body, starts = tops(method, count)

        def stepped(start: Any, m: str = method, b: Any = body) -> Any:
            one = ml.stepper(m, b, ml.torques.HeavyTop(20.0), start, dt=0.01)
            carry = jax.lax.scan(lambda c, _: (one.step(c), None), one.init(), length=steps, unroll=2)[0]
            return one.state(carry)

        plain = jax.jit(jax.vmap(lambda s, m=method, b=body: end(m, b, 20.0, s, steps)))
        own = jax.jit(jax.vmap(stepped))
        same = all(jax.tree.leaves(jax.tree.map(lambda x, y: bool(jnp.all(x == y)), own(starts), plain(starts))))
        scan, ours = seconds(partial(own, starts), partial(plain, starts))
        yield [f"{method}, `stepper.step` in `lax.scan`", f"{scan / ours:.2f} of `integrate`", "yes" if same else "no"]
    body, starts = tops("JACOBI[EA]", 1000)
    free = ml.stepper("JACOBI[EA]", body, lambda t, state: jnp.zeros(3), jax.tree.map(lambda x: x[0], starts), dt=0.02)
    samples, each = 40, 13  # of 20 ms: about 4 Hz

    def controlled(start: Any) -> Any:
        def sample(loop: Any, _: None) -> tuple[Any, None]:
            carry, applied, on = loop
            rate = body.velocity(free.state(carry).momentum)
            on = jnp.where(on, jnp.linalg.norm(rate) > 0.02, jnp.linalg.norm(rate) > 0.05)
            wanted = jnp.where(on, -5.0 * jnp.sign(rate), 0.0)
            carry = free.step(carry, torque=lambda t, state: applied)  # a pulse of 20 ms, of the last sample
            return (free.advance(carry, each - 1), wanted, on), None

        begin = free.init(start), jnp.zeros(3), jnp.array(False)
        return free.state(jax.lax.scan(sample, begin, length=samples)[0][0])

    many = jax.jit(jax.vmap(controlled))
    run = {"dt": 0.02, "steps": samples * each}
    times = seconds(partial(many, starts), lambda: ml.ensemble("JACOBI[EA]", body, None, starts, **run))
    yield ["JACOBI[EA], 1000 craft, controller of 4 Hz with pulses", f"{times[0] / times[1]:.2f} of `ensemble`", ""]


def model(body: Any, integrator: str, mass: float, gravity: float, dt: float) -> Any:
    """MuJoCo's model of a body: a free joint, and everything else off."""
    mujoco = program("mujoco")
    flags = ("contact", "constraint", "equality", "limit", "spring", "damper", "sensor", "actuation", "warmstart")
    off = " ".join(f'{flag}="disable"' for flag in flags)
    made = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option integrator="{integrator}" timestep="{dt!r}" gravity="0 0 {-gravity!r}">
        <flag {off}/></option>
        <worldbody><body><freejoint/><inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/></body></worldbody>
        </mujoco>"""
    )
    made.body_inertia[1] = np.asarray(body.body.moments)
    mujoco.mj_setConst(made, mujoco.MjData(made))
    return made


QUADROTORS = 4096


def craft() -> Iterator[list[str]]:
    """Quadrotors in float32 at 200 Hz: thrust and torque are the action, with and without a policy."""
    rng = np.random.default_rng(1)
    f32 = partial(np.asarray, dtype=np.float32)
    inertia = f32([0.006, 0.006, 0.011])
    body = ml.FreeBody(ml.RigidBody(inertia), f32(0.5))
    zeros, attitude = f32(np.zeros((QUADROTORS, 3))), f32(np.tile([1.0, 0, 0, 0], (QUADROTORS, 1)))
    starts = ml.FreeState(f32(1e-3 * rng.normal(size=(QUADROTORS, 3))), attitude, zeros, zeros)
    actions = f32(rng.normal(size=(QUADROTORS, 4)) * [0.5, 1e-3, 1e-3, 1e-3] + [4.9, 0, 0, 0])
    weights = [f32(0.1 * rng.normal(size=shape)) for shape in ((64, 13), (64, 64), (4, 64))]
    steps, dt = 200, np.float32(0.005)
    weight = f32([0.0, 0.0, -9.81 * 0.5])

    def policy(momentum: Any, attitude: Any, linear: Any, position: Any, action: Any) -> Any:
        seen = jnp.concatenate([momentum, attitude, linear, position])
        hidden = jnp.tanh(weights[1] @ jnp.tanh(weights[0] @ seen))
        return action + np.float32(1e-3) * jnp.tanh(weights[2] @ hidden)

    def wrench(action: Any) -> Any:
        def force(t: Any, state: Any) -> Any:
            up = ml.so3.rotate(state.attitude, jnp.stack([0 * action[0], 0 * action[0], action[0]]))
            return ml.torques.Wrench(action[1:], up + weight)

        return force

    def with_stepper(method: str, learned: bool) -> Any:
        def run(start: Any, action: Any) -> Any:
            one = ml.stepper(method, body, wrench(action), start, dt=dt)

            def act(carry: Any, _: None) -> tuple[Any, None]:
                if not learned:
                    return one.step(carry), None
                s: Any = one.state(carry)
                command = policy(s.momentum, s.attitude, s.linear, s.position, action)
                return one.step(carry, torque=wrench(command)), None

            return one.state(jax.lax.scan(act, one.init(), length=steps, unroll=1 if learned else 2)[0])

        return jax.jit(jax.vmap(run))

    moments = np.asarray(inertia)

    def slope(y: Any, action: Any) -> Any:
        momentum, q, linear, _ = y
        rate = momentum / moments
        spin = jnp.concatenate([jnp.zeros(1, jnp.float32), rate])
        up = ml.so3.rotate(q, jnp.stack([0 * action[0], 0 * action[0], action[0]]))
        turn = jnp.cross(momentum, rate) + action[1:]
        return turn, np.float32(0.5) * ml.so3.multiply(q, spin), up + weight, linear / np.float32(0.5)

    def by_hand(learned: bool) -> Any:
        def run(start: Any, action: Any) -> Any:
            def act(y: Any, _: None) -> tuple[Any, None]:
                command = policy(*y, action) if learned else action

                return rk4(partial(slope, action=command), y, dt), None

            begin = start.momentum, start.attitude, start.linear, start.position
            return jax.lax.scan(act, begin, length=steps)[0]

        return jax.jit(jax.vmap(run))

    def with_mjx(integrator: str, learned: bool) -> Any:
        mjx = program("mujoco.mjx")
        with jax.enable_x64(False):
            made = mjx.put_model(model(body, integrator, mass=0.5, gravity=9.81, dt=0.005))
            data = mjx.make_data(made)

        def run(start: Any, action: Any) -> Any:
            def act(data: Any, _: None) -> tuple[Any, None]:
                place, q = data.qpos[:3], data.qpos[3:]
                linear, momentum = np.float32(0.5) * data.qvel[:3], moments * data.qvel[3:]
                command = policy(momentum, q, linear, place, action) if learned else action
                up = ml.so3.rotate(q, jnp.stack([0 * command[0], 0 * command[0], command[0]]))
                return mjx.step(made, data.replace(qfrc_applied=jnp.concatenate([up, command[1:]]))), None

            velocity = jnp.concatenate([start.linear / np.float32(0.5), start.momentum / moments])
            first = data.replace(qpos=jnp.concatenate([start.position, start.attitude]), qvel=velocity)
            last = jax.lax.scan(act, first, length=steps)[0]
            return last.qpos, last.qvel

        return jax.enable_x64(False)(jax.jit(jax.vmap(run)))

    makers = {name: partial(with_stepper, name) for name in ("JACOBI[EA]", "SYMMETRIC[EA]", "RK4")}
    makers |= {"RK4 by hand, on arrays": by_hand}
    makers |= {f"MJX, {integrator}": partial(with_mjx, integrator) for integrator in ("Euler", "RK4")}
    for name, maker in makers.items():
        times = seconds(*(partial(maker(learned), starts, actions) for learned in (False, True)))
        yield [name, *(f"{QUADROTORS * steps / t / 1e6:.1f}" for t in times)]


JIT = "method", "dtype", "bodies", "custom `jit(vmap)`, ns", "`ml.ensemble`, ns", "ratio"
GRADIENT = "method", "with respect to", "steps x bodies", "value and gradient, ns", "over value"
HESSIAN = "method", "until it runs", "of this, tracing", "a call"
CRAFT = "method", "million steps per second", "with the policy"
JIT = "method", "dtype", "bodies", "custom `jit(vmap)`, ns", "`ml.ensemble`, ns", "ratio"
GRADIENT = "method", "with respect to", "steps x bodies", "value and gradient, ns", "over value"
HESSIAN = "method", "until it runs", "of this, tracing", "a call"
CRAFT = "method", "million steps per second", "with the policy"
PARTS = {
    "bench": bench,
    "calls": CALLS_TABLE,
    "first": FIRST,
    "observed": OBSERVED,
    "networks": NETWORKS,
    "kinds": KINDS,
    "gradients": GRADIENTS,
    "jit": Table(PAGE, "jit", JIT, in_jit, "custom-programs", lambda row: row[1:3] == ["float64", "1024"]),
    "gradient": Table(PAGE, "gradient", GRADIENT, gradients, "custom-gradients", lambda row: row[2] == "128 x 1000"),
    "hessian": Table(PAGE, "hessian", HESSIAN, hessians),
    "loops": Table(PAGE, "loops", ("loop", "time", "same bits"), loops),
    "craft": Table(PAGE, "craft", CRAFT, craft),
}

if __name__ == "__main__":
    main(__doc__, PARTS, ARGUMENTS, first=one_process)
