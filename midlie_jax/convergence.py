"""Every method over a ladder of step sizes: errors at the end of a scene, and what they cost. The charts' numbers.

A run is a chain of equal chunks of steps, each started from the last one's end. The step size and the index of the
first step are arguments of the compiled chunk, so one compile a method serves the whole ladder, and by the
contract of `integrate` the chain is, bit for bit, the run in one piece.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import so3
from .bodies import RigidBody
from .closed_form import Numbering, exact_ends
from .integrate import integrate
from .methods import method as find_method
from .methods import methods as all_methods
from .scenes import Scene

COPIES = 256  # bodies moved side by side when a run is timed: enough to drown the cost of starting each loop
LEVELS = 5
_TIMINGS = 5  # at least so many chunks are timed
_COARSEST = {"P1": 500}  # steps on the first rung where the paper's figure has them; elsewhere twice the scene's step
_ROMBERG = 4  # runs extrapolated where no closed form is known
_REFERENCE = "LIEMID[EA]"


class Reference(NamedTuple):
    """Where a scene truly ends.

    Attributes:
        momentum: body-frame angular momentum, (3,).
        attitude: rotation matrix, body to space, (3, 3).
        source: how it was found.
        uncertainty: what it may be wrong by, as far as is known, relative to the norms of both.
    """

    momentum: np.ndarray
    attitude: np.ndarray
    source: str
    uncertainty: float


class Row(NamedTuple):
    """One method at one step size.

    Attributes:
        method: its name.
        dt: step, in the scene's unit of time.
        steps: number of steps.
        momentum_error: |Pi - Pi_reference| at the end, body frame.
        attitude_error: |R - R_reference| at the end, Frobenius norm.
        momentum_slope, attitude_slope: order seen between this rung and the one before; NaN on the first.
        evaluations: torque evaluations of the run; 0 without torque.
        seconds: wall time of the run for one body, moved in a batch of `COPIES`; compiling not counted.
        ok: whether every solve converged and every number stayed finite.
        failure: what stopped the method; "" if nothing did.
    """

    method: str
    dt: float
    steps: int
    momentum_error: float = math.nan
    attitude_error: float = math.nan
    momentum_slope: float = math.nan
    attitude_slope: float = math.nan
    evaluations: int = 0
    seconds: float = math.nan
    ok: bool = False
    failure: str = ""


def body_methods() -> list[str]:
    """The methods that move a rigid body, the seven of the paper's Figure 1 first."""
    return [name for name in all_methods() if find_method(name).bodies is RigidBody]


def ladder(scene: Scene, coarsest: int | None = None, levels: int = LEVELS) -> list[int]:
    """Numbers of steps, each twice the one before.

    Args:
        scene: from `midlie_jax.scenes.scene`.
        coarsest: steps on the first rung; without it, the paper's figure's or twice the scene's own step.
        levels: number of rungs.

    Raises:
        ValueError: a number is not positive.
    """
    if coarsest is None:
        coarsest = _COARSEST.get(scene.name, max(1, scene.steps // 2))
    if coarsest < 1 or levels < 1:
        raise ValueError(f"steps and levels must be positive, got {coarsest} and {levels}.")
    return [coarsest * 2**level for level in range(levels)]


def measure(scene: Scene, methods: Sequence[str], rungs: Sequence[int], reference: Reference) -> Iterator[Row]:
    """A row for each method and rung, in that order, each as soon as it is known.

    A method that raises gives rows that say so, and the next one is tried.

    Args:
        scene: from `midlie_jax.scenes.scene`.
        methods: names.
        rungs: from `ladder`.
        reference: from `find_reference`.
    """
    for name in methods:
        before, chain = None, None
        for steps in rungs:
            dt = scene.duration / steps
            try:
                chain = chain or _Chain(name, scene, rungs[0], COPIES)
                before = _row(chain, dt, steps, reference, before)
            except Exception as error:  # one broken method must not cost the user the others
                reason = str(error).strip().split("\n")[0]
                before = Row(name, dt, steps, failure=f"{type(error).__name__}: {reason}")
            yield before


def find_reference(scene: Scene, finest: int) -> Reference:
    """The end of a scene: in closed form where one is known, else by extrapolation.

    Args:
        scene: from `midlie_jax.scenes.scene`.
        finest: steps of the finest run to be judged; the extrapolation starts from twice as many.

    Raises:
        ValueError: the reference run failed.
        ImportError: a closed form needs mpmath.
    """
    closed = _closed_form(scene)
    return closed if closed is not None else _extrapolated(scene, finest)


def by_halving(scene: Scene, name: str, steps: int) -> Reference:
    """The end of a scene by twice `steps` steps of a method; it is in doubt by what the step's halving changed.

    Raises:
        ValueError: the run failed.
    """
    chain = _Chain(name, scene, steps, copies=1)
    coarse, _, _ = chain.run(scene.duration / steps, steps)
    fine, ok, _ = chain.run(scene.duration / (2 * steps), 2 * steps)
    doubt = float(np.linalg.norm(_matrix(fine.attitude) - _matrix(coarse.attitude)))
    if not ok or not math.isfinite(doubt):
        raise ValueError(f"no reference: {name} failed with {2 * steps} steps; check the torque for NaN.")
    return Reference(fine.momentum, _matrix(fine.attitude), f"{name} with {2 * steps} steps", doubt)


class _Chain:
    """One method on one scene, compiled once, for any step size and any multiple of `steps`."""

    def __init__(self, name: str, scene: Scene, steps: int, copies: int):
        self.method = find_method(name)
        self.steps = steps
        self.start = jax.tree.map(lambda leaf: jnp.tile(leaf, (copies, 1)), scene.start)
        self.torque = scene.torque

        def chunk(start: Any, dt: Any, first: Any) -> Any:
            path = integrate(
                self.method, scene.body, scene.torque, start, dt=dt, steps=self.steps, save_every=self.steps,
                first_step=first,
            )  # fmt: skip
            return jax.tree.map(lambda leaf: leaf[-1], path.states), path.ok

        dtype = scene.start.momentum.dtype
        self.arguments: Callable[[float, int], tuple[Any, Any]] = lambda dt, first: (
            jnp.asarray(dt, dtype),
            jnp.asarray(first, jnp.int32),
        )
        self.chunk = jax.jit(jax.vmap(chunk, in_axes=(0, None, None)))
        self.chunk = self.chunk.lower(self.start, *self.arguments(scene.duration, 0)).compile()
        jax.block_until_ready(self.chunk(self.start, *self.arguments(0.0, 0)))  # the first call is never typical

    def run(self, dt: float, steps: int) -> tuple[Any, bool, float]:
        """The first copy's end, whether all went well, and the seconds that it took for one copy."""
        state, fine, clock = self.start, True, []

        def timed(start: Any, first: int) -> Any:
            arguments = self.arguments(dt, first)
            began = time.perf_counter()
            result = jax.block_until_ready(self.chunk(start, *arguments))
            clock.append(time.perf_counter() - began)
            return result

        for first in range(0, steps, self.steps):
            state, ok = timed(state, first)
            fine = fine and bool(jnp.all(ok))
        while len(clock) < _TIMINGS:
            timed(self.start, 0)
        # Chunks differ only by what else the machine did meanwhile, so the quickest is the truest (as in `timeit`).
        seconds = min(clock) * (steps // self.steps) / state.momentum.shape[0]
        return jax.tree.map(lambda leaf: np.asarray(leaf[0]), state), fine, seconds


def _row(chain: _Chain, dt: float, steps: int, reference: Reference, before: Row | None) -> Row:
    state, ok, seconds = chain.run(dt, steps)
    momentum = float(np.linalg.norm(state.momentum - reference.momentum))
    attitude = float(np.linalg.norm(_matrix(state.attitude) - reference.attitude))
    return Row(
        method=chain.method.name,
        dt=dt,
        steps=steps,
        momentum_error=momentum,
        attitude_error=attitude,
        momentum_slope=_slope(before.momentum_error if before else math.nan, momentum),
        attitude_slope=_slope(before.attitude_error if before else math.nan, attitude),
        evaluations=0 if chain.torque is None else chain.method.evaluations * steps,
        seconds=seconds,
        ok=ok,
    )


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    return np.asarray(so3.to_matrix(jnp.asarray(quaternion)))


def _slope(coarse: float, fine: float) -> float:
    return math.log2(coarse / fine) if coarse > 0 and fine > 0 else math.nan


def _closed_form(scene: Scene) -> Reference | None:
    numbering = Numbering.of(scene)
    third = numbering.apply(scene)
    if third is None:
        return None
    start = np.concatenate([np.asarray(third.start.momentum), np.asarray(third.start.attitude)])
    found = exact_ends(third, [start])
    if found is None:
        return None
    momentum, attitude = numbering.undo(found.momenta[0], found.attitudes[0])
    return Reference(momentum, _matrix(attitude), found.source, 1e-14)


def _extrapolated(scene: Scene, finest: int) -> Reference:
    """Romberg's extrapolation of a symmetric method, whose error holds even powers of the step only."""
    chain = _Chain(_REFERENCE, scene, finest, copies=1)
    row: list[np.ndarray] = []
    doubt, steps = math.inf, finest
    for _ in range(_ROMBERG):
        steps *= 2
        state, ok, _ = chain.run(scene.duration / steps, steps)
        if not ok:
            raise ValueError(f"no reference for scene {scene.name!r}: {_REFERENCE} failed with {steps} steps.")
        above, row = row, [np.concatenate([state.momentum, state.attitude])]
        for power, coarse in enumerate(above, start=1):
            row.append(row[-1] + (row[-1] - coarse) / (4**power - 1))
        if above:
            change = np.abs(row[-1] - above[-1])
            doubt = float(max(change[:3].max() / np.linalg.norm(row[-1][:3]), change[3:].max()))
    momentum, attitude = row[-1][:3], row[-1][3:]
    matrix = _matrix(attitude / np.linalg.norm(attitude))
    return Reference(momentum, matrix, f"extrapolation of {_REFERENCE} from up to {steps} steps", doubt)
