"""What the law tests share: one forced motion with everything in it, and compiled runs of it."""

import contextlib
import io
import os
import re
from functools import cache, partial
from importlib import import_module
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax._xla.platform import on_cpu
from midlie_jax.cli.main import main
from midlie_jax.integrators.flights import FLIGHTS
from midlie_jax.integrators.registry import ENTRIES
from midlie_jax.integrators.runge_kutta import RungeKutta
from midlie_jax.integrators.splitting import Splitting

# Methods are chosen here by what they are. A new one in the registry is in every law.
METHODS = [entry.method for entry in ENTRIES.values() if issubclass(ml.RigidBody, entry.method.bodies)]
ROTATION = [method.name for method in METHODS]
PARTICLE = [entry.method.name for entry in ENTRIES.values() if entry.method.bodies is ml.Particles]
RIGID_FLIGHTS = [flight for flight in FLIGHTS.values() if flight.body is ml.RigidBody]
# Those that find the momentum alone by formulas of their own.
MOMENTUM_FLIGHTS = [f for f in RIGID_FLIGHTS if type(f).momentum_change is not ml.flights.Flight.momentum_change]
LIEMID = [m.name for m in METHODS if isinstance(m, Splitting) and isinstance(m.flight, ml.flights.LieMidpoint)]


def torque_classes():
    """The public classes of torques by name, with those of the applications."""
    modules = ml.torques, ml.asteroids, ml.molecules, ml.spacecraft, ml.spins
    shown = {name: getattr(module, name) for module in modules for name in dir(module)}
    return {
        name: kind for name, kind in shown.items() if isinstance(kind, type) and issubclass(kind, ml.torques.Torque)
    }


def way(method):
    if isinstance(method, RungeKutta):
        return type(method.formula), method.projects
    if not isinstance(method, Splitting):
        return type(method)
    return method.loops, method.scheme.stages[0][0], bool(method.scheme.gradients), method.scheme.displaced


def flight_of(method):
    return type(method.flight) if isinstance(method, Splitting) else type(method)


def firsts(*properties):
    """The first method that has a new value of one of the properties; of methods alike in them, a symmetric one."""
    seen, names = [set() for _ in properties], []
    for method in sorted(METHODS, key=lambda method: not method.symmetric):
        values = [value(method) for value in properties]
        if any(value not in known for value, known in zip(values, seen, strict=True)):
            names.append(method.name)
        for value, known in zip(values, seen, strict=True):
            known.add(value)
    return names


# One for each way of taking a step, for laws that cost many programs a method; one for each flight as well, for laws of
# the motion; and the rest, which `make test-full` adds.
WAYS = firsts(way)
BUILDS = firsts(way, flight_of)
# One for each flight and other class of method, for free bodies; one for each class, for what drivers do with any.
FREE = firsts(flight_of)
CLASSES = firsts(type)
DTYPES = ["float32", "float64"]
ROWS = 32
STEPS = 128
AXIS = (0.48, 0.6, 0.64)


def accepted(**options):
    """Those of the compile options that the installed XLA knows; it may drop one between two versions."""

    def known(name, value):
        try:
            jax.jit(lambda x: x, compiler_options={name: value}).lower(0.0).compile()
        except jax.errors.JaxRuntimeError as error:
            if "No such compile option" not in str(error):
                raise
            return False
        return True

    return {name: value for name, value in options.items() if known(name, value)}


def on_cpus(**options):
    """The accepted options on CPUs, none on an accelerator, whose programs are never compiled in a hurry."""
    return accepted(**options) if on_cpu() else {}


# Code that compiles in half the time; what it computes is the same, at worst rounded otherwise. For derivatives and
# long programs: the laws of the steps are held by the code that users get.
QUICK = on_cpus(
    xla_backend_optimization_level=0, xla_cpu_use_fusion_emitters=False, xla_cpu_parallel_codegen_split_count=1
)


def quick(function):
    return jax.jit(function, compiler_options=QUICK)


# The code that users get, which `conftest.py` does not make of what asks for nothing.
REAL = on_cpus(
    xla_backend_optimization_level=3, xla_cpu_use_fusion_emitters=True, xla_cpu_parallel_codegen_split_count=32
)


def real(function):
    """Compiled as for users: for the laws of rounding, of bits, of what the compiler makes, and for very long runs."""
    return jax.jit(function, compiler_options=REAL)


def refused(*cases):
    """A test that each call raises a ValueError with the message."""

    @pytest.mark.parametrize(("call", "message"), cases)
    def test(call, message):
        with pytest.raises(ValueError, match=f"(?s){message}"):
            call()

    return test


def whole(*values):
    """Parameters of the whole matrix alone, which `make test-full` runs."""
    return [pytest.param(*(x if isinstance(x, tuple) else (x,)), marks=pytest.mark.full) for x in values]


def each(names=ROTATION, few=BUILDS):
    """Parameters: the names among the few, and in the whole matrix the others."""
    return [*(name for name in names if name in few), *whole(*(name for name in names if name not in few))]


def by_turns(names=ROTATION, few=BUILDS):
    """Parameters (name, dtype): each of the few with one of the dtypes, in turns; the rest in the whole matrix."""
    turn = {name: n for n, name in enumerate(dict.fromkeys([*BUILDS, *ROTATION, *names]))}
    chosen = [(name, DTYPES[turn[name] % 2]) for name in names if name in few]
    return [*chosen, *whole(*(pair for pair in product(names, DTYPES) if pair not in chosen))]


def equal_moments(name) -> bool:
    """Whether the method moves only bodies with two equal moments."""
    method = ml.method(name) if isinstance(name, str) else name
    return isinstance(method, Splitting) and method.flight.equal_moments


def suited(name, moments):
    """The moments, the second like the first where the method moves no other body."""
    return moments[..., jnp.array([0, 0, 2])] if equal_moments(name) else moments


class Setup(NamedTuple):
    """One run, or with leading axes a batch. The torque is that of a heavy top plus `swing`."""

    moments: np.ndarray
    weight: np.ndarray
    strength: np.ndarray
    momentum: np.ndarray
    attitude: np.ndarray
    dt: np.ndarray
    t0: np.ndarray
    first_step: np.ndarray


def turn(*vector: float) -> np.ndarray:
    """The quaternion of a rotation vector, by SciPy."""
    return Rotation.from_rotvec(np.array(vector)).as_quat(scalar_first=True)


def setup(**changes) -> Setup:
    """An asymmetric body in a generic state."""
    values = {
        "moments": [1.0, 2.0, 2.5],
        "weight": 2.0,
        "strength": 1.0,
        "momentum": [1.0, 0.8, -1.3],
        "attitude": turn(0.5, -0.3, 0.8),
        "dt": 1 / 64,
        "t0": 0.3,
    }
    values = {name: np.asarray(value, np.float64) for name, value in (values | changes).items() if name != "first_step"}
    return Setup(**values, first_step=np.asarray(changes.get("first_step", 0), np.int32))


OTHER = {"moments": [2.2, 0.9, 1.6], "momentum": [-0.7, 1.1, 0.4], "attitude": turn(-1.4, 0.9, 0.2), "weight": -1.5}


def rows(*setups: Setup) -> Setup:
    return Setup(*(np.stack(column) for column in zip(*setups, strict=True)))


def swing(strength, t, state):
    """A torque that turns with time, written on arrays as a user would."""
    pull = jnp.stack([jnp.cos(2 * t), jnp.sin(3 * t), jnp.ones_like(t)])
    lever = jnp.array([0.3, -0.5, 0.4], t.dtype)
    return strength * jnp.cross(lever, ml.so3.to_matrix(state.attitude).T @ pull)


def integrate(name, s: Setup, *, steps=STEPS, save_every=1, forced=True, state=ml.RigidState, axis=AXIS):
    """The run of a setup; for a `DirectionState` the top alone, without `swing`."""
    torque = ml.torques.HeavyTop(s.weight, axis) if forced else None
    if state is ml.RigidState:
        start = ml.RigidState(s.momentum, s.attitude)
        torque = torque + jax.tree_util.Partial(swing, s.strength) if forced else None
    elif state is ml.DirectionState:
        start = ml.DirectionState(s.momentum, ml.so3.to_matrix(s.attitude)[2])
    else:
        start = ml.MomentumState(s.momentum)
    return ml.integrate(
        name,
        ml.RigidBody(suited(name, s.moments), physical=False),  # two of them equal, the third may be too large
        torque,
        start,
        dt=s.dt,
        steps=steps,
        save_every=save_every,
        t0=s.t0,
        first_step=s.first_step,
    )


@cache
def compiled(name: str, solo: bool = False, hurried: bool | None = None, **options):
    """As for users for one method of each class, and in the whole matrix for all; the others in a hurry."""
    if hurried is None:
        hurried = name not in CLASSES and "XLA_FLAGS" in os.environ
    function = partial(integrate, name, **options)
    return (quick if hurried else real)(function if solo else jax.vmap(function))


def benchmark(name: str) -> Any:
    """The module of a benchmark, which is a script outside the package; pytest has their folder on its path."""
    return import_module(name)


def loop_bodies(text: str) -> list[str]:
    """The bodies of the loops of a compiled program, from its HLO."""
    computations = {c.split()[0].lstrip("%"): c for c in re.split(r"\n}\n+", text) if c.split()}
    return [computations[name] for name in set(re.findall(r"body=%?([\w.\-]+)", text))]


def cast(s: Setup, dtype: str) -> Setup:
    return jax.tree.map(lambda x: jnp.asarray(x, x.dtype if x.dtype == np.int32 else dtype), s)


def numbers(path):
    return jax.tree.map(np.asarray, path)


def run(name: str, dtype: str, s: Setup, **options) -> ml.Path:
    count = len(s.dt)
    padded = jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[:1], ROWS - count, axis=0)]), s)
    return jax.tree.map(lambda x: np.asarray(x)[:count], compiled(name, **options)(cast(padded, dtype)))


def run_solo(name: str, dtype: str, s: Setup, **options) -> ml.Path:
    """One setup, without vmap."""
    return numbers(compiled(name, solo=True, **options)(cast(s, dtype)))


def at(states, *index):
    """The states at an index, as (momentum, attitude)."""
    return states.momentum[index], states.attitude[index]


def continued(s: Setup, path: ml.Path, **changes) -> Setup:
    momentum, attitude = at(path.states, slice(None), -1)
    return s._replace(momentum=momentum.astype(np.float64), attitude=attitude.astype(np.float64), **changes)


def gap(a, b) -> float:
    """The largest difference between two states' arrays, each relative to its size."""
    return max(float(np.max(np.abs(x - y)) / np.max(np.abs(y))) for x, y in zip(a, b, strict=True))


def true_motion(s: Setup, times: np.ndarray, torque=None) -> tuple[np.ndarray, np.ndarray]:
    """Momentum (n, 3) and attitude (n, 4) at times since the start, by DOP853 at 1e-13."""

    def swung(t, r):
        pull = np.array([np.cos(2 * t), np.sin(3 * t), 1.0])
        return s.weight * np.cross(r[2], AXIS) + s.strength * np.cross([0.3, -0.5, 0.4], r.T @ pull)

    def rate(t, y):
        momentum, q = y[:3], y[3:]
        r = Rotation.from_quat(q, scalar_first=True).as_matrix()
        velocity = momentum / s.moments
        w, u = q[0], q[1:]
        turning = np.concatenate([[-u @ velocity], w * velocity + np.cross(u, velocity)]) / 2
        return np.concatenate([np.cross(momentum, velocity) + (torque or swung)(t, r), turning])

    start = np.concatenate([s.momentum, s.attitude])
    span = (s.t0, s.t0 + times[-1])
    y = solve_ivp(rate, span, start, "DOP853", t_eval=s.t0 + times, rtol=1e-13, atol=1e-14).y.T
    return y[:, :3], y[:, 3:]


def tumbled(moments, rate, times, attitude=None):
    """The rates of a free body by the closed form; from an attitude also its attitudes, as rotations of SciPy."""
    body = ml.RigidBody(moments)
    momentum = body.momentum(jnp.asarray(rate))
    start: Any = ml.MomentumState(momentum) if attitude is None else ml.RigidState(momentum, attitude)
    states = ml.free_motion(body, start, times).states
    turned = None if attitude is None else Rotation.from_quat(np.asarray(states.attitude), scalar_first=True)
    return np.asarray(states.momentum) / moments, turned


LEVEL = (1.0, 0.0, 0.0, 0.0)


def keys(count, seed=1):
    return jax.random.split(jax.random.key(seed), count)


def still(count, dtype="float64"):
    """Bodies at rest, level."""
    return ml.RigidState(jnp.zeros((count, 3), dtype), jnp.tile(jnp.array(LEVEL, dtype), (count, 1)))


def epsilon(dtype: str) -> float:
    return float(np.finfo(dtype).eps)


def worst(found, expected) -> float:
    return float(np.max(np.abs(np.asarray(found) - np.asarray(expected))))


def half_last_digit(text: str) -> float:
    """Half a unit of the last digit of a published number such as 4.4e-3."""
    mantissa, exponent = text.split("e")
    return 0.5 * 10.0 ** (int(exponent) - len(mantissa.partition(".")[2]))


class Outcome(NamedTuple):
    """What the command `midlie` returns and prints."""

    code: int
    out: str
    err: str

    @property
    def facts(self) -> dict[str, str]:
        """The report of a run by its left column."""
        assert self.code == 0, self.err
        pairs = (line.strip().split("  ", 1) for line in self.out.splitlines()[1:] if "  " in line.strip())
        return {name: value.strip() for name, value in pairs}


def midlie(*arguments: Any) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(map(str, arguments)))
    return Outcome(code, out.getvalue(), err.getvalue())


def assert_one_line(arguments: Any, words: Any) -> None:
    """The command ends with code 2 and one line that holds these words."""
    outcome = midlie(*arguments)
    assert (outcome.code, outcome.err.count("\n")) == (2, 1), outcome
    assert outcome.err.startswith("midlie: ")
    assert all(word in outcome.err for word in words), outcome.err
