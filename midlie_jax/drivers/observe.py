"""What an ensemble saves in place of its states: `observe=` of `ensemble` and `simulate`.

An *observable* is computed from the state of each body at each saved time, on the device, so that only its values leave
the device: any function of (t, state), one of the classes of this module, or a dict of these. A *statistic* (`Mean`,
`Histogram`) combines these values over all bodies that can be trusted at that time.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from .._checks.arguments import as_floats, described, require_finite, shown
from .._math import components as cp
from ..model import observables, so3
from ..model.bodies import Body
from ..model.state import AnyState
from ..model.states import AxisState, FreeAxisState, attitude_of
from ..model.torques import TorqueLike, on_body


class Observable(eqx.Module):
    """A quantity of one body at one time."""

    @abstractmethod
    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        """The value of the observable, an array or a pytree of arrays, for the state of one body at the time t."""


class Function(Observable):
    """A function of the time and the state of one body, `function(t, state)`; returns an array or a pytree of them."""

    function: Callable[[Any, Any], Any]

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return self.function(t, state)


class Together(Observable):
    """Several observables by name."""

    parts: dict[str, Observable]

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return {name: part.of(t, state, body, torque) for name, part in self.parts.items()}


class Energy(Observable):
    """The energy (), kinetic plus potential. A ValueError for a torque without a potential."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.energy(body, torque, state, t)


class Axis(Observable):
    """The direction in space of an axis that is fixed in the body, a unit vector (3,); by default the third axis.

    An `AxisState` knows the third axis alone; for another axis, a ValueError.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __check_init__(self) -> None:
        if not np.all(np.isfinite(self.axis)) or not np.any(self.axis):
            raise ValueError(f"axis must be three finite numbers, not all zero, got {shown(self.axis)}.")

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        if isinstance(state, AxisState | FreeAxisState):
            return cp.pack(state.in_one_frame(tuple(map(float, axis)))[0])
        return so3.rotate(attitude_of(state), jnp.asarray(axis, state.momentum.dtype))


class SpatialMomentum(Observable):
    """The angular momentum in the space frame about its origin, (3,)."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.spatial_momentum(cast(Any, state))


class AngularVelocity(Observable):
    """The angular velocity in the body frame, (3,), radians per unit of time."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.angular_velocity(body, state)


class Position(Observable):
    """The position of the centre of mass of a body that travels, space frame, (3,)."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        observables.linear_momentum(state)  # which raises for a state that does not travel
        return state.position  # pyright: ignore[reportAttributeAccessIssue]


class Velocity(Observable):
    """The velocity of the centre of mass of a body that travels, space frame, (3,)."""

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        return observables.velocity(body, state)


class Statistic(eqx.Module):
    """A quantity of all bodies at one time: parts are computed from groups of bodies and then merged.

    Attributes:
        observable: the observable whose values are combined.
    """

    observable: Observable = eqx.field(converter=lambda value: as_observable("observable", value))

    @abstractmethod
    def part(self, values: Any, good: Array) -> Any:
        """The part of a group of bodies, from its values (bodies, ...); bodies that are not `good` do not count.

        The values, also those of observed integers and booleans, have the dtype of the run or one with more digits.
        """

    @abstractmethod
    def merged(self, parts: Any) -> Any:
        """The part of the union of several groups, from their parts stacked along the first axis."""

    def finished(self, merged: Any) -> Any:
        """What a file holds of the merged parts, a pytree of arrays."""
        return merged

    def attributes(self) -> dict[str, Any]:
        """What a file says about the statistic besides its numbers."""
        return {}


class Moments(NamedTuple):
    """Mean and covariance of a quantity with m components over the bodies at one time.

    Attributes:
        number: (), how many bodies were counted.
        mean: (m,); NaN where no body was counted.
        scatter: (m, m), the sum of (x - mean) (x - mean)^T over the bodies, from which `covariance` is computed.
    """

    number: Int[Array, "*batch"]
    mean: Float[Array, "*batch m"]
    scatter: Float[Array, "*batch m m"]

    @property
    def covariance(self) -> Float[Array, "*batch m m"]:
        """The unbiased estimate of the covariance; NaN for fewer than two bodies."""
        degrees = self.number.astype(self.scatter.dtype) - 1
        return self.scatter / jnp.where(degrees > 0, degrees, jnp.nan)[..., None, None]


class Mean(Statistic):
    """Mean and covariance of an observable over the bodies: `Moments` for each array that the observable returns.

    An array is taken as the vector of all its numbers. One value that is not finite makes the mean not finite. Parts
    are merged by the formulas of Chan, Golub and LeVeque (1983), which do not lose digits where the mean is much larger
    than the deviations.
    """

    def part(self, values: Any, good: Array) -> Any:
        number = jnp.sum(good, dtype=jnp.int32)

        def of_array(x: Array) -> Moments:
            x = jnp.where(good[:, None], x.reshape(len(good), -1), 0)
            mean = jnp.sum(x, axis=0) / number.astype(x.dtype)
            away = jnp.where(good[:, None], x - mean[None], 0)
            return Moments(number, mean, jnp.sum(away[:, :, None] * away[:, None, :], axis=0))

        return jax.tree.map(of_array, values)

    def merged(self, parts: Any) -> Any:
        def of_moments(part: Moments) -> Moments:
            number = jnp.sum(part.number, axis=0, dtype=jnp.int32)
            weight = part.number[..., None].astype(part.mean.dtype)
            means = jnp.where(weight > 0, part.mean, 0)  # the mean of an empty group is NaN
            mean = jnp.sum(weight * means, axis=0) / number[..., None].astype(means.dtype)
            away = jnp.where(weight > 0, means - mean[None], 0)
            between = jnp.sum(weight[..., None] * away[..., :, None] * away[..., None, :], axis=0)
            return Moments(number, mean, jnp.sum(part.scatter, axis=0) + between)

        return _on_moments(of_moments, parts)

    def finished(self, merged: Any) -> Any:
        """Number, mean and covariance; if a single number is observed, mean and variance have no axis (m,)."""

        def of_moments(m: Moments) -> dict[str, Array]:
            single = m.mean.shape[-1] == 1
            mean, covariance = (m.mean[..., 0], m.covariance[..., 0, 0]) if single else (m.mean, m.covariance)
            return {"number": m.number, "mean": mean, "variance" if single else "covariance": covariance}

        return _on_moments(of_moments, merged)


def _on_moments(function: Callable[[Moments], Any], tree: Any) -> Any:
    return jax.tree.map(function, tree, is_leaf=lambda x: isinstance(x, Moments))


class Histogram(Statistic):
    """How many bodies have a value in each bin: an integer array (bins,) for each number that the observable returns.

    A bin contains its lower edge, and the last bin also its upper edge, as in `numpy.histogram`. Values outside all
    bins are not counted, nor is NaN. Values and edges are compared in the dtype of whichever has more digits.

    Attributes:
        edges: (bins + 1,), increasing.
    """

    edges: Array

    def __init__(self, observable: Any, edges: Any):
        self.observable = observable
        self.edges = as_floats("edges", edges)
        require_finite("edges", self.edges)
        if self.edges.ndim != 1 or len(self.edges) < 2 or not bool(jnp.all(jnp.diff(self.edges) > 0)):
            raise ValueError(f"edges must be at least two increasing numbers, got {described(edges)}.")

    def part(self, values: Any, good: Array) -> Any:
        bins = len(self.edges) - 1

        def of_numbers(x: Array) -> Array:
            x = _promoted(x, self.edges.dtype)
            edges = self.edges.astype(x.dtype)
            # The time of a search and a count hardly depends on the number of bins.
            place = jnp.searchsorted(edges, x, side="right").astype(jnp.int32) - 1
            place = jnp.where(x == edges[-1], bins - 1, place)
            inside = good & (place >= 0)
            counts = jnp.zeros(bins, jnp.int32)
            return counts.at[jnp.where(inside, place, bins)].add(1, mode="drop")  # a place behind the bins is dropped

        def of_array(x: Array) -> Array:
            columns = x.reshape(len(good), -1)
            counts = jax.vmap(of_numbers, in_axes=1)(columns)
            return counts.reshape(*x.shape[1:], bins)

        return jax.tree.map(of_array, values)

    def merged(self, parts: Any) -> Any:
        return jax.tree.map(lambda part: jnp.sum(part, axis=0, dtype=part.dtype), parts)

    def attributes(self) -> dict[str, Any]:
        return {"bin_edges": self.edges.tolist()}


Observe = Observable | Statistic


def as_observable(name: str, value: Any) -> Observable:
    """The argument as an observable: an observable, a function of (t, state), or a dict of both."""
    if isinstance(value, Observable):
        return value
    if isinstance(value, dict) and value and all(isinstance(key, str) for key in value):
        return Together({key: as_observable(f"{name}[{key!r}]", part) for key, part in value.items()})
    if callable(value) and not isinstance(value, (type, Statistic)):
        return Function(value)
    raise ValueError(
        f"{name} must be a function of (t, state), an observable such as midlie_jax.observe.Energy(), or a dict of "
        f"these by name, got {described(value)}."
    )


def as_observe(value: Any) -> Observe | None:
    """The checked argument `observe` of a driver."""
    return value if value is None or isinstance(value, Statistic) else as_observable("observe", value)


def as_observe_of_one(value: Any) -> Observe | None:
    """The checked argument `observe` of a driver of one body."""
    if isinstance(value, Statistic):
        raise ValueError("a statistic combines bodies; give it to midlie_jax.ensemble or midlie_jax.simulate.")
    return as_observe(value)


def observe_state(observe: Observe | None, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
    """What is saved of one body at one time: what is observed, or the state itself if nothing is."""
    if observe is None:
        return state
    observable = observe.observable if isinstance(observe, Statistic) else observe
    acting = on_body(torque, body)
    value = jax.tree.map(jnp.asarray, observable.of(t, state, body, acting))
    if not jax.tree.leaves(value):
        raise ValueError("observe must return an array or a pytree of arrays, but returned none.")
    if not isinstance(observe, Statistic):
        return value
    for path, leaf in jax.tree_util.tree_leaves_with_path(value):
        if jnp.iscomplexobj(leaf):
            raise ValueError(
                f"values of a statistic must be real, but observable{jax.tree_util.keystr(path)} is complex; return "
                "its real and its imaginary part."
            )
    return jax.tree.map(lambda x: _promoted(x, state.momentum.dtype), value)


def _promoted(x: Array, dtype: Any) -> Array:
    """`x` in this floating-point dtype, or in its own if that has more digits."""
    own = jnp.issubdtype(x.dtype, jnp.floating) and x.dtype.itemsize > jnp.dtype(dtype).itemsize
    return x if own else x.astype(dtype)
