"""A random search for wrong results: `make fuzz`, or `python tests/fuzz.py --minutes 60`.

Bodies, states, scales, steps, methods, dtypes and batch shapes are drawn by hypothesis, which also simplifies what it
finds. Every run is held against the method's own equations in extended precision (`extended.py`): no body may be wrong
by more than its bound while `ok` is True, and nothing may be raised from inside jit.

A program is compiled once for each method, dtype, kind of torque and batch; all else is data, many bodies at a time.
Arguments that make no sense (`fuzz_arguments.py`) and runs that are changed between stop and resumption
(`fuzz_resume.py`) get a tenth of the time each, and execution paths (`fuzz_paths.py`) a fifth.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import conftest  # also for float64 and strict promotion
import extended
import fuzz_paths
import fuzz_resume
import jax
import jax.numpy as jnp
import numpy as np
from extended import Motion
from fuzz_arguments import calls, check_call
from fuzz_csv import check_damage, damages
from fuzz_rows import check_rows, drawn
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import midlie_jax as ml
from midlie_jax.integrators.runge_kutta import RungeKutta

ROWS, STEPS = 192, 2
FLIGHTS = list(extended.FLIGHTS)
METHODS = [f"{flight}[{scheme}]" for flight in FLIGHTS for scheme in ("EA", "E1", "SRKN6b")] + list(extended.OTHERS)
# The last two move a DirectionState, the vertical seen from the body, instead of an attitude: with the
# same flights, but with Runge-Kutta stages of its own.
TORQUES = ("none", "top", "swing", "direction, none", "direction, top")
BATCHES = ("one", "vmap", "ensemble")
# Units in the last place, for each step, of the condition number below, or of the growth.
BOUND = 16
# The implicit methods take a solve for settled at this residual (`implicit/_common.py`).
IMPLICIT = dict.fromkeys(("LIEMID[I]", "AKW", "SW", "NMB"), 1024)


class Case(NamedTuple):
    """What hypothesis chooses; `bodies` makes the numbers from it."""

    method: str
    dtype: str
    torque: str
    batch: str
    numbers: int  # seed
    spread: float  # decades between the masses that make the moments
    equal: str  # none, two, nearly, three
    mass: float  # decades of the unit of mass
    rate: float  # decades of the angular velocity
    turn: float  # decades of the radians a step
    lean: str  # direction of the momentum: any, axis, near an axis, separatrix, by velocity
    pull: float  # decades of torque times step over momentum


class Numbers(NamedTuple):
    """Arrays for ROWS bodies, in the dtype of the case."""

    moments: np.ndarray
    momentum: np.ndarray
    attitude: np.ndarray
    dt: np.ndarray
    weight: np.ndarray


CASES = st.builds(
    Case,
    method=st.sampled_from(METHODS),
    dtype=st.sampled_from(["float64", "float32"]),
    torque=st.sampled_from(TORQUES),
    batch=st.sampled_from(BATCHES),
    numbers=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([0.0, 0.3, 1.0, 3.0, 6.0]),
    equal=st.sampled_from(["none", "two", "nearly", "three"]),
    mass=st.integers(-20, 20).map(float),
    rate=st.integers(-8, 8).map(float),
    turn=st.floats(-9, 1.5),
    lean=st.sampled_from(["any", "axis", "near an axis", "separatrix", "by velocity"]),
    pull=st.floats(-8, 0.5),
).filter(lambda case: not (isinstance(ml.method(case.method), RungeKutta) and case.torque.startswith("direction")))


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
    attitude = rng.normal(size=(ROWS, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    numbers = (moments * mass, momentum * rate * mass, attitude, dt, weight)
    return Numbers(*(x.astype(case.dtype) for x in numbers))


def swing(weight, dt, t, state):
    """A torque written on arrays, of the attitude and the time."""
    turn = 0.3 * t / dt
    field = jnp.stack([jnp.cos(turn), jnp.sin(turn), jnp.ones_like(turn)])
    return weight * jnp.cross(jnp.array([0.3, -0.5, 0.4], field.dtype), ml.so3.to_matrix(state.attitude).T @ field)


def torque_of(case: Case, weight, dt):
    if case.torque.endswith("none"):
        return None
    return ml.torques.HeavyTop(weight) if case.torque.endswith("top") else jax.tree_util.Partial(swing, weight, dt)


@cache
def program(method: str, dtype: str, torque: str, batch: str):
    """Momentum, attitude and flag of every body after STEPS steps."""
    case = Case(method, dtype, torque, batch, 0, 0, "none", 0, 0, 0, "any", 0)
    kind = ml.DirectionState if torque.startswith("direction") else ml.RigidState

    def one(moments, momentum, attitude, dt, weight):
        start, field = kind(momentum, attitude), torque_of(case, weight, dt)
        body = ml.RigidBody(moments, physical=False)
        path = ml.integrate(method, body, field, start, dt=dt, steps=STEPS, save_every=STEPS)
        momentum, pose = jax.tree.leaves(path.states)
        return momentum[-1], pose[-1], path.ok

    def many(moments, momentum, attitude, dt, weight):
        start, field = kind(momentum, attitude), torque_of(case, weight, dt)
        body = ml.RigidBody(moments, physical=False)
        path = ml.ensemble(method, body, field, start, dt=dt, steps=STEPS, chunk=80)
        return *jax.tree.leaves(path.states), path.ok

    return jax.jit({"one": one, "vmap": jax.vmap(one), "ensemble": many}[batch])


def vertical(attitude: np.ndarray) -> np.ndarray:
    """The space z axis seen from the body."""
    return extended.back(
        attitude.astype(extended.LONG), np.array([0, 0, 1], extended.LONG) + np.zeros((len(attitude), 3))
    )


def run(case: Case, numbers: Numbers):
    """What the package makes of the bodies; of the first few alone where the batch is one."""
    made = program(case.method, case.dtype, case.torque, case.batch)
    if case.torque.startswith("direction"):
        numbers = numbers._replace(attitude=vertical(numbers.attitude).astype(case.dtype))
    if case.batch != "one":
        return [np.asarray(x) for x in made(*numbers)]
    solo = [made(*(x[k] for x in numbers)) for k in range(4)]
    return [np.stack([np.asarray(s[k]) for s in solo]) for k in range(3)]


def reference(case: Case, numbers: Numbers):
    """The motion at the end, and whether it was found, in extended precision."""
    moments, momentum, attitude = (x.astype(extended.LONG) for x in numbers[:3])
    dt, weight = (x.astype(extended.LONG)[:, None] for x in numbers[3:])

    def seen(q, v):
        """R^T v as the package has it inside a Runge-Kutta step, where the quaternion is not quite unit."""
        return extended.dot(q, q) * extended.back(q, v)

    def torque(t, q):
        if case.torque.endswith("none"):
            return 0 * moments
        if case.torque.endswith("top"):
            up = np.array([0, 0, 1], extended.LONG)
            return weight * np.cross(seen(q, up + 0 * moments), up)
        turn = extended.LONG(np.asarray(0.3, case.dtype)) * t / dt
        field = np.concatenate([np.cos(turn), np.sin(turn), 1 + 0 * turn], axis=1)
        lever = np.array([0.3, -0.5, 0.4], case.dtype).astype(extended.LONG)
        return weight * np.cross(lever, seen(q, field))

    step = extended.composed(extended.step_of(case.method), STEPS)
    end, found = step(moments, torque, 0 * dt, dt, Motion(momentum, attitude))
    if case.torque.startswith("direction"):
        end = end._replace(attitude=vertical(end.attitude / np.linalg.norm(end.attitude, axis=1, keepdims=True)))
    return end, found


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
    """How much the method itself enlarges a small error at the start, tried in some directions.

    Near a fold of its equation, and in the chaos of very long steps, it does so more than `condition` tells.
    """
    rng, small, most = np.random.default_rng(0), 1e-9, 0.0
    for _ in range(8):
        pushes = [rng.normal(size=x.shape) for x in (numbers.momentum, numbers.attitude)]
        scaled = [small * x / np.linalg.norm(x, axis=1, keepdims=True) for x in pushes]
        size = np.linalg.norm(numbers.momentum.astype(float), axis=1, keepdims=True)
        attitude = numbers.attitude + scaled[1]
        attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
        moved = numbers._replace(momentum=numbers.momentum + size * scaled[0].astype(extended.LONG), attitude=attitude)
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
    ends = Motion(momentum[ok].astype(extended.LONG), attitude[ok].astype(extended.LONG))
    off, away = errors(ends, exact, numbers)
    unit = IMPLICIT.get(case.method, BOUND) * STEPS * np.finfo(case.dtype).eps
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


def rounds(
    minutes: float, first: int, strategy: st.SearchStrategy, test: Callable[[Any], None], examples: int = 100
) -> int:
    """Rounds of hypothesis until the time is up; the number of failures, each of which is printed."""
    end, failures, turn = time.monotonic() + 60 * minutes, 0, first
    while time.monotonic() < end:

        @seed(turn)
        @settings(
            max_examples=examples,
            deadline=None,
            database=None,
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.generate, Phase.shrink],
        )
        @given(strategy)
        def one(value: Any) -> None:
            test(value)
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


def counted(call: Any) -> None:
    TALLY["calls"] += 1
    check_call(call)


def rows_counted(case: Any) -> None:
    TALLY[check_rows(case)] += 1


def resumed(case: fuzz_resume.Case) -> None:
    TALLY["resumed"] += 1
    fuzz_resume.check(case)


def along_paths(drawn: fuzz_paths.Drawn) -> None:
    TALLY["paths"] += 1
    with tempfile.TemporaryDirectory() as folder:
        fuzz_paths.check(drawn, Path(folder))


def counted_file(damage: Any) -> None:
    TALLY["files"] += 1
    TALLY[f"files {check_damage(damage)}"] += 1


class Search(NamedTuple):
    """A class of search: its share of the time, how its cases are drawn, the test, and how many cases a round has."""

    share: float
    cases: Callable[[], st.SearchStrategy]
    test: Callable[[Any], None]
    examples: int = 100


CLASSES = {
    "arguments": Search(0.1, calls, counted),
    "rows": Search(0.1, drawn, rows_counted),
    "resume": Search(0.1, lambda: fuzz_resume.CASES, resumed, examples=10),
    "files": Search(0.1, damages, counted_file, examples=10),
    "paths": Search(0.2, lambda: fuzz_paths.CASES, along_paths, examples=20),
    "motion": Search(0.4, lambda: CASES, check),
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=5.0, help="of all classes together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=CLASSES, help="all of the time for this class")
    parser.add_argument("--methods", nargs="+", choices=METHODS, help="of the class motion")
    chosen = parser.parse_args()
    failures = 0
    for name in [chosen.only] if chosen.only else CLASSES:
        search = CLASSES[name]
        strategy = search.cases()
        if name == "motion" and chosen.methods:
            strategy = strategy.filter(lambda case: case.method in chosen.methods)
        minutes = chosen.minutes * (1 if chosen.only else search.share)
        failures += rounds(minutes, chosen.seed, strategy, search.test, search.examples)
    sys.exit(failures > 0)
