"""The states of a run at any times: on a grid of steps, and between grid times by one shorter step of the method.

The shorter step has the method's order, stays on the group and is differentiable like any step.
"""

import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from .._checks.arguments import require, require_finite, require_resolved
from .._math.components import is_traced
from ..drivers.arguments import as_method, check_clock
from ..drivers.clock import time_of
from ..drivers.free_motion import free_motion
from ..drivers.integrate import integrate
from ..drivers.path import Path
from ..integrators.base import Method
from ..model.state import StateT

# A time is on the grid if its distance is less than the first number, as a share of a step, plus the rounding of the
# time; but never more than the second. All other times are reached by a shorter step, which is always correct.
_ON_GRID, _MOST_OFF = {"float64": 1e-9, "float32": 1e-4}, 0.05
_ROUNDING_OF_CLOSED_FORM = 1e4  # for a thousand rotations
_MARGIN, _LONGEST = 8, 2.0  # steps after the last time if a clock is fitted; the longest last step, in steps


class Grid(eqx.Module):
    """The steps of a run, cut into equal segments that can be integrated side by side."""

    dt: float = eqx.field(static=True)
    t0: float = eqx.field(static=True)  # the time of the initial state
    steps: int = eqx.field(static=True)  # of each segment
    segments: int = eqx.field(static=True)
    every: int = eqx.field(static=True)  # the steps between saved states; divides `steps`
    exact: bool = eqx.field(static=True)  # whether all times lie on saved states, so that no shorter step is needed

    @classmethod
    def of(cls, times: np.ndarray, dt: float, t0: float, segments: int = 1, moving: bool = False) -> "Grid":
        """The grid that reaches the last of the times (n,); a clock may shift `moving` ones by a few steps."""
        tolerance = _ON_GRID[times.dtype.name]
        offsets = (np.asarray(times, np.float64) - t0) / dt
        least = max(1, math.ceil(float(offsets.max()) - tolerance)) + _MARGIN * moving
        steps = -(-least // segments)
        nearest = np.rint(offsets).astype(int)
        blurred = tolerance + 2 * np.finfo(times.dtype).eps * (np.abs(offsets) + abs(t0 / dt))
        exact = bool(np.all(np.abs(offsets - nearest) <= np.minimum(blurred, _MOST_OFF))) and not moving
        every = math.gcd(steps, *np.unique(nearest).tolist()) if exact else 1
        return cls(dt, t0, steps, segments, every, exact)

    @property
    def rounding(self) -> float:
        """The rounding error of a run, in units of the rounding error of a number."""
        return 4 * math.sqrt(self.steps * self.segments)

    def whole(self) -> "Grid":
        """The same steps in one segment."""
        return replace(self, steps=self.steps * self.segments, segments=1)

    def place(self, times: Float[Array, " n"]) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
        """For each time its segment, and the index of the last saved state in that segment that is not after it."""
        offsets = (times - self.t0) / self.dt
        index = jnp.rint(offsets) if self.exact else jnp.floor(offsets)
        index = jnp.clip(index.astype(jnp.int32), 0, self.steps * self.segments)
        segment = jnp.minimum(index // self.steps, self.segments - 1)
        return segment, (index - segment * self.steps) // self.every

    def run(self, method: Method, body: Any, torque: Any, starts: StateT) -> Path[StateT]:
        """The paths of all segments, (segments, saved, ...), from their initial states (segments, ...)."""

        def segment(start: StateT, first: Array) -> Path[StateT]:
            every, t0 = self.every, self.t0
            return integrate(
                method, body, torque, start, dt=self.dt, steps=self.steps, save_every=every, t0=t0, first_step=first
            )

        first = self.steps * jnp.arange(self.segments, dtype=jnp.int32)
        if self.segments == 1:
            return jax.tree.map(lambda x: x[None], segment(jax.tree.map(lambda x: x[0], starts), first[0]))
        return jax.vmap(segment)(starts, first)

    def sample(self, method: Method, body: Any, torque: Any, paths: Path[StateT], times: Array) -> tuple[StateT, Array]:
        """The states (n, ...) at the times, and whether each can be trusted, (n,)."""
        segment, index = self.place(times)
        states = jax.tree.map(lambda x: x[segment, index], paths.states)
        on_grid = index < paths.first_bad[segment]
        if self.exact:
            return states, on_grid
        one = jnp.asarray(1, times.dtype)
        before = time_of(self.t0 * one, self.dt * one, (segment * self.steps + index).astype(jnp.int32))

        def last_step(start: StateT, t: Array, h: Array) -> tuple[StateT, Array]:
            path = integrate(method, body, torque, start, dt=h, steps=1, t0=t)
            return jax.tree.map(lambda x: x[-1], path.states), path.ok

        rest = times - before
        states, ok = jax.vmap(last_step)(states, before, rest)
        # A fitted clock may move times beyond either end of the run: the last step to them is then longer.
        return states, on_grid & ok & (jnp.abs(rest) <= _LONGEST * self.dt)


class Closed(eqx.Module):
    """In place of a `Grid`: the closed form of free motion, which needs no steps."""

    t0: float = eqx.field(static=True)
    segments: int = eqx.field(static=True, default=1)

    @property
    def rounding(self) -> float:
        return _ROUNDING_OF_CLOSED_FORM

    def whole(self) -> "Closed":
        return self

    def run(self, method: Method, body: Any, torque: Any, starts: StateT) -> Path[StateT]:
        start = jax.tree.map(lambda x: x[0], starts)
        path = free_motion(body, start, np.array([self.t0]), t0=self.t0)
        return jax.tree.map(lambda x: x[None], path)

    def sample(self, method: Method, body: Any, torque: Any, paths: Path[StateT], times: Array) -> tuple[StateT, Array]:
        path = free_motion(body, jax.tree.map(lambda x: x[0, 0], paths.states), times, t0=self.t0)
        return path.states, jnp.broadcast_to(path.ok, times.shape)


def states_at(
    method: Method | str, body: Any, torque: Any, start: StateT, times: Any, *, dt: float, t0: float = 0.0
) -> Path[StateT]:
    """The states of one run at any ascending times, accurate to the order of the method.

    A time within a step is reached from the beginning of that step by one shorter step. Differentiable with respect to
    body, torque and initial state.

    Args:
        method, body, torque, start: as for `midlie_jax.integrate`.
        times: (n,), ascending, not before `t0`; concrete, because they decide the number of steps.
        dt: the step, positive.
        t0: the time of the initial state.

    Raises:
        ValueError: an argument is invalid.

    Examples:
        >>> body, start = ml.RigidBody([2.0, 3.0, 4.0]), ml.MomentumState([1.0, 0.6, 0.4])
        >>> path = ml.fitting.states_at("RK4", body, None, start, [0.0, 0.33, 1.7], dt=0.1)
        >>> path.times, path.states.momentum.shape, bool(path.ok)
        (Array([0.  , 0.33, 1.7 ], dtype=float64), (3, 3), True)
    """
    if is_traced(times):
        raise ValueError("times must be concrete, got a traced array; close over them.")
    known = np.asarray(times, start.momentum.dtype)  # of NumPy, because inside jit a JAX array would be traced
    if known.ndim != 1 or not known.size:
        raise ValueError(f"times must have shape (n,) with n >= 1, got {known.shape}.")
    require_finite("times", known)
    require("times", known, lambda x: np.diff(x) >= 0, "must ascend", "sort them.")
    require_resolved("times", times, known.dtype, t0)
    check_grid(known, dt, t0)
    times = jnp.asarray(known)
    grid = Grid.of(known, float(dt), float(t0))
    method = as_method(method)
    paths = grid.run(method, body, torque, jax.tree.map(lambda x: x[None], start))
    states, ok = grid.sample(method, body, torque, paths, times)
    first_bad = jnp.argmin(jnp.append(ok, False)).astype(jnp.int32)
    return Path(times, states, jnp.all(ok) & jnp.all(paths.ok), first_bad)


def require_positive(name: str, number: Any) -> None:
    if not (isinstance(number, (int, float)) and math.isfinite(number) and number > 0):
        raise ValueError(f"{name} must be a positive finite Python number, got {number!r}.")


def check_grid(times: np.ndarray, dt: Any, t0: Any) -> None:
    """Raises a ValueError unless the step is positive and changes the time, and no time is before the initial one."""
    require_positive("dt", dt)
    if not (isinstance(t0, (int, float)) and math.isfinite(t0)):
        raise ValueError(f"t0 must be a finite Python number, got {t0!r}.")
    if times.min() < t0:
        raise ValueError(f"times must not be before the start at t0 = {t0:g}, got {times.min():g}; give an earlier t0.")
    check_clock(np.asarray(t0, times.dtype), np.asarray(dt, times.dtype))
