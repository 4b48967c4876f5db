"""A random search for wrong results: `make fuzz`, or `python tests/fuzz.py --minutes 60`.

Drawn by hypothesis, which also simplifies what it finds:

- motion: bodies, states, scales, steps, methods, dtypes and batch shapes, against the method in fifty digits
  (`fifty_digits.py`): no body may be wrong by more than its bound while `ok` is True, and nothing may be raised from
  inside jit. A program is compiled once for each method, dtype, kind of torque and batch.
- arguments: some arguments of a sensible call are replaced by another type, shape, dtype, number or name. An error that
  is no ValueError, or from inside XLA, is a failure.
"""

import argparse
import sys
import time
from collections import Counter
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import conftest  # also for float64 and strict promotion
import jax
import jax.numpy as jnp
import numpy as np
from cases import METHODS as REGISTERED
from cases import RIGID_FLIGHTS
from fifty_digits import exact, in_fifty_digits
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import midlie_jax as ml
from midlie_jax.integrators.runge_kutta import RungeKutta
from midlie_jax.integrators.splitting import Splitting

ROWS, STEPS = 48, 2
METHODS = [f"{flight.name}[{scheme}]" for flight in RIGID_FLIGHTS for scheme in ("EA", "E1", "SRKN6b")]
# Of others those whose equations the oracle can evaluate: a root of `jax.lax.custom_root` it cannot.
METHODS += [
    m.name for m in REGISTERED if not isinstance(m, Splitting) and m.name not in ("LIEMID[I]", "AKW", "SW", "NMB")
]
# The last two move a DirectionState, the vertical seen from the body, instead of an attitude: with the
# same flights, but with Runge-Kutta stages of its own.
TORQUES = ("none", "top", "swing", "direction, none", "direction, top")
BATCHES = ("one", "vmap", "ensemble")
# Units in the last place, for each step, of the condition number below, or of the growth.
BOUND = 16


class Motion(NamedTuple):
    """Momenta (n, 3) and attitudes (n, 4), or directions (n, 3)."""

    momentum: np.ndarray
    attitude: np.ndarray


class Numbers(NamedTuple):
    """Arrays for ROWS bodies, in the dtype of the case."""

    moments: np.ndarray
    momentum: np.ndarray
    attitude: np.ndarray
    dt: np.ndarray
    weight: np.ndarray


# What hypothesis chooses; `bodies` makes the numbers from it.
CHOICES = {
    "method": st.sampled_from(METHODS),
    "dtype": st.sampled_from(["float64", "float32"]),
    "torque": st.sampled_from(TORQUES),
    "batch": st.sampled_from(BATCHES),
    "numbers": st.integers(0, 2**32 - 1),  # seed
    "spread": st.sampled_from([0.0, 0.3, 1.0, 3.0, 6.0]),  # decades between the masses that make the moments
    "equal": st.sampled_from(["none", "two", "nearly", "three"]),
    "mass": st.integers(-20, 20).map(float),  # decades of the unit of mass
    "rate": st.integers(-8, 8).map(float),  # decades of the angular velocity
    "turn": st.floats(-9, 1.5),  # decades of the radians a step
    "lean": st.sampled_from(["any", "axis", "near an axis", "separatrix", "by velocity"]),  # of the momentum
    "pull": st.floats(-8, 0.5),  # decades of torque times step over momentum
}
Case = SimpleNamespace
CASES = st.fixed_dictionaries(CHOICES).map(lambda chosen: Case(**chosen))
CASES = CASES.filter(
    lambda case: not (isinstance(ml.method(case.method), RungeKutta) and case.torque.startswith("direction"))
)


def bodies(case: Case) -> Numbers:
    """ROWS bodies of a case, each a little different."""
    rng = np.random.default_rng(case.numbers)
    masses = 10 ** rng.uniform(-case.spread, 0, (ROWS, 3))
    eps = np.finfo(case.dtype).eps
    if case.equal in ("two", "nearly") or case.method.startswith("SYMMETRIC"):
        masses[:, 1] = masses[:, 0]
    if case.equal == "nearly" and not case.method.startswith("SYMMETRIC"):
        masses[:, 1] *= 1 + eps * 10 ** rng.uniform(0, 8, ROWS)
    if case.equal == "three":
        masses[:] = masses[:, :1]
    moments = masses.sum(1, keepdims=True) - masses
    order = rng.permuted(np.tile(np.arange(3), (ROWS, 1)), axis=1)
    if case.method.startswith(("SYMMETRIC", "NEARSYM")):
        order = np.tile(np.arange(3), (ROWS, 1))
    moments = np.take_along_axis(moments, order, 1)
    momentum = rng.normal(size=(ROWS, 3))
    if case.lean == "axis":
        momentum *= np.eye(3)[rng.integers(0, 3, ROWS)]
    if case.lean == "near an axis":
        momentum *= np.where(np.eye(3)[rng.integers(0, 3, ROWS)] == 1, 1, 10 ** rng.uniform(-12, -1, (ROWS, 1)))
    if case.lean == "by velocity":
        momentum *= moments
    if case.lean == "separatrix":
        low, middle, high = np.argsort(moments, axis=1).T
        rows = np.arange(ROWS)
        i, j, k = moments[rows, low], moments[rows, middle], moments[rows, high]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.sqrt(k * (j - i) / (i * (k - j)))
        momentum[rows, high] = momentum[rows, low] * np.where(np.isfinite(share), share, 1)
    momentum /= np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    rate, mass = 10**case.rate, 10 ** (case.mass * (1 if case.dtype == "float32" else 5))
    dt = 10 ** (case.turn + rng.uniform(-0.3, 0.3, ROWS)) / rate
    size = np.linalg.norm(momentum, axis=1) * rate * mass
    weight = size / dt * 10 ** (case.pull + rng.uniform(-0.5, 0.5, ROWS))
    weight *= weight > 1e6 * np.finfo(case.dtype).tiny  # XLA takes what is not a normal number for zero
    attitude = rng.normal(size=(ROWS, 3 if case.torque.startswith("direction") else 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    numbers = (moments * mass, momentum * rate * mass, attitude, dt, weight)
    return Numbers(*(x.astype(case.dtype) for x in numbers))


def swing(weight, dt, t, state):
    turn = 0.3 * t / dt
    field = jnp.stack([turn, 1 - turn * turn, jnp.ones_like(turn)])
    return weight * jnp.cross(jnp.array([0.3, -0.5, 0.4], field.dtype), ml.so3.to_matrix(state.attitude).T @ field)


def torque_of(torque: str, weight, dt):
    if torque.endswith("none"):
        return None
    return ml.torques.HeavyTop(weight) if torque.endswith("top") else jax.tree_util.Partial(swing, weight, dt)


def kind_of(torque: str):
    return ml.DirectionState if torque.startswith("direction") else ml.RigidState


def one_of(method: str, torque: str):
    """Momentum, pose and flag of one body after STEPS steps, as a function of its numbers."""
    kind = kind_of(torque)

    def one(moments, momentum, attitude, dt, weight):
        start, field = kind(momentum, attitude), torque_of(torque, weight, dt)
        body = ml.RigidBody(moments, physical=False)
        path = ml.integrate(method, body, field, start, dt=dt, steps=STEPS, save_every=STEPS)
        momentum, pose = jax.tree.leaves(path.states)
        return momentum[-1], pose[-1], path.ok

    return one


@cache
def program(method: str, dtype: str, torque: str, batch: str):
    """The same for a batch, compiled once."""
    del dtype  # a part of the key
    one = one_of(method, torque)
    kind = kind_of(torque)

    def many(moments, momentum, attitude, dt, weight):
        start, field = kind(momentum, attitude), torque_of(torque, weight, dt)
        body = ml.RigidBody(moments, physical=False)
        path = ml.ensemble(method, body, field, start, dt=dt, steps=STEPS, chunk=20)
        return *jax.tree.leaves(path.states), path.ok

    return jax.jit({"one": one, "vmap": jax.vmap(one), "ensemble": many}[batch])


@cache
def exact_program(method: str, torque: str):
    """The same in fifty digits; its series and solves are those of float64."""
    pose = np.eye(3)[2] if torque.startswith("direction") else np.eye(4)[0]
    return in_fifty_digits(one_of(method, torque), *(np.ones(3), np.ones(3), pose, np.float64(0.1), np.float64(1)))


def run(case: Case, numbers: Numbers):
    """What the package makes of the bodies; of the first few alone where the batch is one."""
    made = program(case.method, case.dtype, case.torque, case.batch)
    if case.batch != "one":
        return [np.asarray(x) for x in made(*numbers)]
    solo = [made(*(x[k] for x in numbers)) for k in range(4)]
    return [np.stack([np.asarray(s[k]) for s in solo]) for k in range(3)]


def reference(case: Case, numbers: Numbers):
    """The motion at the end, and whether it was found, in fifty digits rounded to extended precision."""
    made = exact_program(case.method, case.torque)
    ends = [made(*(exact(np.asarray(x, float)) for x in body)) for body in zip(*numbers, strict=True)]
    momentum, pose, ok = zip(*ends, strict=True)
    return Motion(np.array(momentum, np.longdouble), np.array(pose, np.longdouble)), np.array(ok)


def condition(numbers: Numbers) -> np.ndarray:
    """How much an error of eps in the momentum, of the size of the largest entry, turns the body in the steps."""
    size = (
        np.linalg.norm(numbers.momentum.astype(float), axis=1) + abs(numbers.weight.astype(float) * numbers.dt) * STEPS
    )
    return 1 + STEPS * numbers.dt.astype(float) * size / numbers.moments.astype(float).min(axis=1)


def errors(ends: Motion, exact: Motion, numbers: Numbers) -> tuple[np.ndarray, np.ndarray]:
    """Of the momentum, relative to the larger of its sizes at both ends, and of the pose."""
    size = np.linalg.norm(exact.momentum.astype(float), axis=1)
    size = np.maximum(size, np.linalg.norm(numbers.momentum.astype(float), axis=1))
    off = np.linalg.norm((ends.momentum - exact.momentum).astype(float), axis=1) / size
    ours, theirs = (x.attitude / np.linalg.norm(x.attitude, axis=1, keepdims=True) for x in (ends, exact))
    # A quaternion stands for the same attitude as its negative.
    sign = np.sign(np.sum(ours * theirs, axis=1, keepdims=True)) if ours.shape[1] == 4 else 1
    return off, np.linalg.norm((sign * ours - theirs).astype(float), axis=1)


def growth(case: Case, numbers: Numbers, exact: Motion) -> np.ndarray:
    """How much the method itself enlarges a small error at the start, near a fold of its equation or in chaos."""
    rng, small, most = np.random.default_rng(0), 1e-9, 0.0
    for _ in range(8):
        pushes = [rng.normal(size=x.shape) for x in (numbers.momentum, numbers.attitude)]
        scaled = [small * x / np.linalg.norm(x, axis=1, keepdims=True) for x in pushes]
        size = np.linalg.norm(numbers.momentum.astype(float), axis=1, keepdims=True)
        attitude = numbers.attitude + scaled[1]
        attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
        moved = numbers._replace(momentum=numbers.momentum + size * scaled[0], attitude=attitude)
        end, _ = reference(case, moved)
        most = np.maximum(most, np.maximum(*errors(end, exact, numbers)) / small)
    return np.asarray(most)


TALLY: Counter[str] = Counter()


def check(case: Case) -> None:
    """Raises AssertionError where a body is wrong by more than its bound and `ok` is True."""
    numbers = bodies(case)
    momentum, attitude, ok = run(case, numbers)
    TALLY["bodies"] += len(ok)
    TALLY["ok"] += int(ok.sum())
    if not ok.any():
        return
    numbers = Numbers(*(x[: len(ok)][ok] for x in numbers))
    exact, found = reference(case, numbers)
    TALLY["judged"] += int(found.sum())
    ends = Motion(momentum[ok].astype(np.longdouble), attitude[ok].astype(np.longdouble))
    off, away = errors(ends, exact, numbers)
    unit = BOUND * STEPS * np.finfo(case.dtype).eps
    limit = unit * condition(numbers)
    bad = found & ~((off <= limit) & (away <= limit))
    if bad.any():
        few = Numbers(*(x[bad] for x in numbers))
        grown = growth(case, few, Motion(exact.momentum[bad], exact.attitude[bad]))
        limit[bad] = np.maximum(limit[bad], unit * grown)
        bad = found & ~((off <= limit) & (away <= limit))
    if bad.any():
        worst = int(np.argmax(np.where(bad, np.maximum(off, away) / limit, 0)))
        raise AssertionError(
            f"{case}\n{int(bad.sum())} of {len(bad)} bodies are wrong with ok True; momentum by {off[worst]:.2e}, "
            f"attitude by {away[worst]:.2e}, bound {limit[worst]:.2e}; moments {numbers.moments[worst].tolist()}, "
            f"momentum {numbers.momentum[worst].tolist()}, attitude {numbers.attitude[worst].tolist()}, "
            f"dt {numbers.dt[worst]}, weight {numbers.weight[worst]}"
        )


# ---- arguments ----

NUMBERS = [0, 1, -1, 2, 0.1, -0.5, 1e30, 1e300, -0.0, float("nan"), float("inf"), True, None, "0.1", 1j, 2**31, 2**70]
ARRAYS = [
    np.array(value, dtype)
    for value in (0.1, [0.1], [1, 2, 3], [1, 0, 0, 0], [[1, 2, 3]], [[1, 0, 0, 0], [0, 1, 0, 0]], [], [0, 0, 0])
    for dtype in (np.float64, np.float32, np.float16, np.int32, bool, complex)
]
OBJECTS = [object(), "LIEMID[EA]", [1, 2, "3"], [[1, 2], [3]], {}, {"a": 1.0}, (), lambda t, state: 1.0]
STATES = [
    ml.RigidState([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0]),
    ml.RigidState(jnp.ones((2, 3), "float32"), jnp.tile(jnp.array([1.0, 0, 0, 0], "float32"), (2, 1))),
    ml.MomentumState([1.0, 2.0, 3.0]),
    ml.DirectionState([1.0, 2.0, 3.0], [0.0, 0.0, 1.0]),
    ml.ParticleState([1.0, 2.0], [0.0, 1.0]),
]
ACTING = [
    None,
    ml.torques.HeavyTop(1.0),
    ml.torques.HeavyTop(np.ones(2)),
    ml.torques.Damping(0.1),
    lambda t, state: state.momentum,
    lambda t, state: jnp.ones(2),
    lambda t, state: np.ones(3, np.float32),
    lambda t, state: None,
    lambda t, state: jnp.cross(state.attitude[1:], state.momentum) if t > 0 else state.momentum,
]
BODIES = [
    ml.RigidBody([1.0, 2.0, 2.5]),
    ml.RigidBody(np.array([[1.0, 2, 2.5], [1, 1, 1]])),
    ml.TensorBody(np.diag([1.0, 2.0, 2.5])),
    ml.Particles([1.0, 2.0]),
]
NAMES = ["LIEMID[EA]", "liemid[ea]", "JACOBI", "SYMMETRIC[EA]", "Verlet", "RK4", "JACOBI[RK4]", "", "[", "LIEMID[EA"]
ANYTHING = st.sampled_from([*NUMBERS, *ARRAYS, *OBJECTS, *STATES, *ACTING, *BODIES, *NAMES])

SENSIBLE = {"method": "LIEMID[EA]", "body": BODIES[0], "torque": None, "dt": 0.1, "steps": 2, "save_every": 1}
SENSIBLE |= {"t0": 0.0, "first_step": 0}
CALLS = {
    "integrate": (ml.integrate, SENSIBLE | {"start": STATES[0]}),
    "ensemble": (ml.ensemble, SENSIBLE | {"start": STATES[1], "chunk": 1, "torque_axes": "auto"}),
}
LIKELY = {"body": BODIES, "torque": ACTING, "start": STATES, "method": NAMES, "motion": STATES, "name": NAMES}
PARTS = {
    "RigidBody": (ml.RigidBody, {"moments": [1.0, 2.0, 2.5]}),
    "TensorBody": (ml.TensorBody, {"tensor": np.eye(3)}),
    "RigidState": (ml.RigidState, {"momentum": [1.0, 2.0, 3.0], "attitude": [1.0, 0.0, 0.0, 0.0]}),
    "HeavyTop": (ml.torques.HeavyTop, {"mgl": 1.0, "axis": (0.0, 0.0, 1.0)}),
    "Held": (ml.torques.Held, {"values": np.ones((2, 3)), "dt": 0.1, "t0": 0.0}),
    "Pulses": (ml.torques.Pulses, {"starts": [0.0, 1.0], "width": 0.1, "torque": [0.0, 0.0, 1.0]}),
    "Sum": (lambda one, two: ml.torques.Sum(one, two), {"one": ACTING[1], "two": ACTING[3]}),
    "method": (ml.method, {"name": "JACOBI", "scheme": "EA"}),
    "Scheme": (ml.schemes.Scheme, {"name": "mine", "order": 1, "stages": (("kick", 1.0), ("flight", 1.0))}),
    "energy": (ml.observe.energy, {"body": BODIES[0], "torque": ACTING[1], "motion": STATES[0], "t": None}),
    "KeplerOrbit": (ml.orbits.KeplerOrbit, {"position": [1.0, 0, 0], "velocity": [0.0, 1, 0], "mu": 1.0}),
}


@st.composite
def calls(draw):
    """A function's name and its arguments."""
    name = draw(st.sampled_from([*CALLS, *CALLS, *PARTS]))
    arguments = dict((CALLS | PARTS)[name][1])
    for key in draw(st.lists(st.sampled_from(sorted(arguments)), min_size=1, max_size=3, unique=True)):
        arguments[key] = draw(st.one_of(ANYTHING, st.sampled_from(LIKELY[key])) if key in LIKELY else ANYTHING)
    return name, arguments


def check_call(call) -> None:
    name, arguments = call
    function = (CALLS | PARTS)[name][0]
    if isinstance(arguments.get("steps"), int) and arguments["steps"] > 10**6:
        arguments["steps"] = 4  # sensible, and long
    try:
        jax.block_until_ready(function(**arguments))
    except ValueError as error:
        if "XLA" in str(error) or "xla" in type(error).__module__:
            raise AssertionError(f"{name}: {error}") from error


# ---- the search ----


# The share of the time, how cases are drawn, and the test.
CLASSES: dict[str, tuple[float, st.SearchStrategy, Any]] = {
    "arguments": (0.1, calls(), check_call),
    "motion": (0.9, CASES, check),
}


def rounds(name: str, minutes: float, first: int, strategy: st.SearchStrategy, test: Any) -> int:
    """Rounds of hypothesis until the time is up; the number of failures, each of which is printed."""
    end, failures, turn = time.monotonic() + 60 * minutes, 0, first
    while time.monotonic() < end:

        @seed(turn)
        @settings(
            max_examples=100,
            deadline=None,
            database=None,
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.generate, Phase.shrink],
        )
        @given(strategy)
        def one(value: Any) -> None:
            TALLY[f"{name} {test(value) or 'tried'}"] += 1
            conftest.leave_maps_of_memory()

        try:
            one()
        except Exception as error:  # whatever it is, it is what the search is for
            failures += 1
            print(f"seed {turn}: {type(error).__name__}: {error}\n", flush=True)
            print(*getattr(error, "__notes__", ()), flush=True)
        turn += 1
        print(f"{(end - time.monotonic()) / 60:.1f} minutes left, {dict(TALLY)}, {failures} failures", flush=True)
    return failures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=5.0, help="of all classes together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=CLASSES, help="all of the time for this class")
    parser.add_argument("--methods", nargs="+", choices=METHODS, help="of the class motion")
    chosen = parser.parse_args()
    failures = 0
    for name in [chosen.only] if chosen.only else CLASSES:
        share, strategy, test = CLASSES[name]
        if name == "motion" and chosen.methods:
            strategy = strategy.filter(lambda case: case.method in chosen.methods)
        failures += rounds(name, chosen.minutes * (1 if chosen.only else share), chosen.seed, strategy, test)
    sys.exit(failures > 0)
