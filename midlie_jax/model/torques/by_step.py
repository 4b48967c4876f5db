"""Torques that jump in time, with a constant value in each step: `Held` and `Pulses`.

A method evaluates a torque at its own instants, and integrates one that jumps wrongly. These classes instead give each
step one value, the mean over that step: `System.in_step` replaces them by it, at any depth of the tree of a torque.
"""

from abc import abstractmethod
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_finite, as_not_negative, as_positive, shown
from ..._math import components as cp
from ..._xla.fusion import split
from ..free_body import Wrench
from ..state import Time
from .base import Torque

_SLACK = 16.0  # rounding of a time, in units of eps


class ByStep(Torque):
    """Base class of functions of time, and torques, that have a constant value in each step of a run."""

    @abstractmethod
    def mean(self, t0: Array, t1: Array, h: Array) -> Any:
        """The mean over the step from t0 to t1 of length h = t1 - t0; finite, though meaningless, for h = 0."""


class _Constant(Torque):
    value: Any

    def __call__(self, t: Time, state: Any = None) -> Any:
        return self.value


class Held(ByStep):
    """Controls: a torque that is constant in intervals of one length, one value for each (a zero-order hold).

    A step within an interval uses the value of that interval only; a step across its end uses the mean over the step.
    Let dt of the run be the length of the intervals or an integer fraction of it. The torque is zero outside of all
    intervals. It is also a function of time alone, as in `Thrust(force=Held(...), lever=...)`. In a custom function the
    value is the one at an instant; keep a `Held` in a field of a class, or as a term of the torque.

    Attributes:
        values: the torques, body frame, (K, 3), interval n from t0 + n dt on; (K, N, 3) for N coupled bodies. For
            bodies that translate also a `Wrench` of such arrays, with the force in the space frame.
        dt: the length of an interval, (), positive; a longer step of the run is an error, or gives NaN if traced.
        t0: the time at which the first interval begins, ().

    Examples:
        >>> controls = ml.torques.Held(np.array([[0.0, 0.0, 0.5], [0.0, 0.0, -0.5]]), dt=10.0)
        >>> body, start = ml.RigidBody([2.0, 3.0, 4.0]), ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.integrate("JACOBI[EA]", body, controls, start, dt=2.5, steps=8, save_every=4)
        >>> path.states.momentum[:, 2]  # after 10 and after 20 s
        Array([0., 5., 0.], dtype=float64)
    """

    values: Any
    dt: Float[Array, "*batch"]
    t0: Float[Array, "*batch"]

    def __init__(self, values: Any, dt: Any, t0: Any = 0.0):
        self.values = _rows("values", values, 2)
        self.dt, self.t0 = as_positive("dt", dt), as_finite("t0", t0)

    def __call__(self, t: Time, state: Any = None) -> Any:
        place = (t - self.t0) / self.dt
        return self._value(jnp.floor(place + _slack(place)))

    def mean(self, t0: Array, t1: Array, h: Array) -> Any:
        ends = (t0 - self.t0) / self.dt, (t1 - self.t0) / self.dt  # in intervals
        low, high, length = jnp.minimum(*ends), jnp.maximum(*ends), jnp.abs(h) / self.dt
        slack = _slack(jnp.maximum(jnp.abs(low), jnp.abs(high)))
        middle = jnp.floor((low + high) / 2)

        def share(over: Array) -> Array:
            return jnp.where(over > slack, over, 0) / jnp.where(length > 0, length, 1)

        before, after = share(middle - low), share(high - middle - 1)
        before = jnp.where(length > 1 + slack, jnp.nan, before)
        here, earlier, later = (self._value(middle + k) for k in (0, -1, 1))
        return jax.tree.map(lambda x, y, z: x + before * (y - x) + after * (z - x), here, earlier, later)

    def _value(self, number: Array) -> Any:
        def of(values: Array) -> Array:
            values = _vectors("values", values, 2)
            within = (number >= 0) & (number < len(values))
            index = jnp.clip(number, 0, len(values) - 1).astype(jnp.int32)
            return jnp.where(within, values[index], jnp.zeros_like(values[0]))

        return jax.tree.map(of, self.values)


class Pulses(ByStep):
    """Pulses of constant torque: thrusters that fire, impacts.

    Each step gets its exact share of the impulse, the mean torque over the step, even if a pulse is much shorter than a
    step or several overlap. The effect is accurate to first order in the step, or to the order of the method if the
    steps end at the edges. It is also a function of time alone, like `Held`.

    Attributes:
        starts: the start times of the pulses, (P,).
        width: their duration, () or (P,), not negative.
        torque: as a value of `Held`, (3,) for all or (P, 3), one for each pulse; (P, N, 3) for N coupled bodies.

    Examples:
        >>> thruster = ml.torques.Pulses(starts=[0.0, 3.0, 6.0], width=0.02, torque=[0.0, 0.0, 5.0])
        >>> body, start = ml.RigidBody([2.0, 3.0, 4.0]), ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.integrate("JACOBI[EA]", body, thruster, start, dt=0.5, steps=20)
        >>> round(float(path.states.momentum[-1, 2]), 12)  # three times 0.02 * 5
        0.3
    """

    starts: Float[Array, "*batch P"]
    width: Float[Array, "*batch"]
    torque: Any

    def __init__(self, starts: Any, width: Any, torque: Any):
        self.starts, self.width = as_finite("starts", starts), as_not_negative("width", width)
        if self.starts.ndim == 0:
            raise ValueError(f"starts must be an array of times (P,), got {shown(starts)}; write [{shown(starts)}].")
        self.torque = _rows("torque", torque, 1)

    def __call__(self, t: Time, state: Any = None) -> Any:
        since = t - self._starts()
        return self._weighted(((since >= 0) & (since < self.width)).astype(since.dtype))

    def mean(self, t0: Array, t1: Array, h: Array) -> Any:
        # Times since the start of a pulse rather than clock times, so that the ends of a pulse have no rounding.
        starts = self._starts()
        lasted = jnp.clip(t1 - starts, 0, self.width) - jnp.clip(t0 - starts, 0, self.width)
        return self._weighted(lasted / jnp.where(h == 0, 1, h))

    def _starts(self) -> Array:
        if self.starts.ndim != 1 or self.width.shape not in ((), self.starts.shape):
            raise ValueError(
                f"starts must have shape (P,) and width () or (P,), got {self.starts.shape} and {self.width.shape}. "
                "Give one time per pulse."
            )
        return self.starts

    def _weighted(self, weights: Array) -> Any:
        def of(torque: Array) -> Array:
            torque = _vectors("torque", torque, 1)
            if torque.ndim < 2:
                return jnp.sum(weights) * torque
            if len(torque) != len(weights):
                raise ValueError(
                    f"torque must be one or one for each of the {len(weights)} pulses, got {torque.shape}."
                )
            # Not a product of matrices, which XLA's CPU compiler calculates body by body.
            return jnp.sum(weights.reshape(-1, *[1] * (torque.ndim - 1)) * torque, axis=0)

        return jax.tree.map(of, self.torque)


def is_by_step(tree: Any) -> bool:
    return bool(parts_by_step(tree))


def parts_by_step(tree: Any) -> list[ByStep]:
    return list(filter(_is_node, jax.tree.leaves(tree, is_leaf=_is_node)))


def values_in_step(tree: Any, t0: Array, t1: Array, h: Array) -> list[Any]:
    return [part.mean(t0, t1, h) for part in parts_by_step(tree)]


def with_values(tree: Any, values: Iterable[Any]) -> Any:
    """A torque in which each `ByStep`, at any depth, is replaced by its value in a step."""
    own = iter(values)
    return jax.tree.map(lambda leaf: _Constant(next(own)) if _is_node(leaf) else leaf, tree, is_leaf=_is_node)


def in_step(tree: Any, t0: Array, t1: Array, h: Array) -> Any:
    return with_values(tree, split(values_in_step(tree, t0, t1, h)))


class OfValues(eqx.Module):
    torque: Any

    def __call__(self, values: list[Any], t: Time, state: Any) -> Any:
        torque = with_values(self.torque, values) if values else self.torque
        return torque(t, state)


def check_steps(tree: Any, h: Any) -> None:
    for held in parts_by_step(tree):
        if not isinstance(held, Held) or cp.is_traced(h, held.dt):
            continue
        longest, shortest = float(np.max(np.abs(np.asarray(h)))), float(np.min(np.asarray(held.dt)))
        if longest > shortest * (1 + _SLACK * float(np.finfo(np.asarray(h).dtype).eps)):
            raise ValueError(
                f"dt must be at most the interval of midlie_jax.torques.Held, {shortest:g}, got {longest:g}; take an "
                "integer fraction of it."
            )


def _is_node(value: Any) -> bool:
    return isinstance(value, ByStep)


def _slack(place: Array) -> Array:
    return _SLACK * cp.epsilon(place) * (1 + jnp.abs(place))


def _rows(name: str, value: Any, axes: int) -> Any:
    if isinstance(value, Wrench):
        return Wrench(_rows(name, value.torque, axes), _rows(name, value.force, axes))
    return _vectors(name, as_finite(name, value), axes)


def _vectors(name: str, array: Array, axes: int) -> Array:
    if array.ndim < axes or array.shape[-1] != 3:
        shape = "(K, 3), one row for each interval" if axes == 2 else "(3,), or (P, 3) with one row for each pulse"
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}; stack the vectors along the first axis.")
    return array
