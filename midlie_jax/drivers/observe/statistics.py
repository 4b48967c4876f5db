"""`Statistic`: a quantity of all bodies at one time, such as their mean and covariance, or a histogram."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from ..._checks.arguments import as_finite, described
from .observables import Observable, as_observable


class Statistic(eqx.Module):
    """A quantity of all bodies at one time; parts are computed from groups of bodies and then merged.

    Examples:
        >>> class Largest(ml.observe.Statistic):  # of your own: the largest of a number over the bodies, at each time
        ...     def part(self, values, good):
        ...         return jnp.max(jnp.where(good, values, -jnp.inf))
        ...     def merged(self, parts):
        ...         return jnp.max(parts, axis=0)
        >>> fastest = Largest(lambda t, state: jnp.linalg.norm(state.momentum))  # ml.ensemble(..., observe=fastest)
        >>> fastest.part(jnp.array([1.0, 3.0, 2.0]), jnp.array([True, False, True])).item()
        2.0
    """

    observable: Observable = eqx.field(converter=lambda value: as_observable("observable", value))

    @abstractmethod
    def part(self, values: Any, good: Array) -> Any:
        """The part of a group of bodies, from its values (bodies, ...); only `good` bodies count.

        The values have the dtype of the run or one with more digits, even if integers or booleans are observed.
        """

    @abstractmethod
    def merged(self, parts: Any) -> Any:
        """The part of the union of several groups, from their parts stacked along the first axis."""

    def check(self, saves: int | None) -> None:
        """Raises if the statistic needs more saved values of a body than this; None for the end alone."""

    def parts(self, values: Any, good: Array) -> Any:
        """What `ensemble` keeps of a group of bodies, from values (bodies, k, ...); here one part per time."""
        return jax.vmap(self.part, in_axes=1)(values, good)

    def result(self, merged: Any, interval: Array) -> Any:
        """The result of `ensemble` from the merged parts; `interval` is the time between two saved values."""
        return merged

    def finished(self, merged: Any) -> Any:
        """The content of a file for the merged parts, a pytree of arrays."""
        return merged

    def attributes(self) -> dict[str, Any]:
        """The attributes of the statistic in a file."""
        return {}


class Moments(NamedTuple):
    """Mean and covariance of a quantity with m components over the bodies at one time.

    Attributes:
        number: (), number of bodies counted.
        mean: (m,); NaN if no body was counted.
        scatter: (m, m), the sum of (x - mean) (x - mean)^T over the bodies, from which `covariance` is computed.

    Examples:
        >>> energies = jnp.array([1.0, 2.0, 6.0])  # of three bodies
        >>> found = ml.observe.Mean(ml.observe.energy).part(energies, good=jnp.array([True, True, True]))
        >>> found.mean, found.covariance  # of one number, m = 1
        (Array([3.], dtype=float64), Array([[7.]], dtype=float64))
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

    An array counts as the vector of all its numbers. A value that is not finite makes the mean not finite. Parts are
    merged by the formulas of Chan, Golub and LeVeque (1983).

    Examples:
        >>> starts = ml.RigidState(jnp.tile(start.momentum, (100, 1)), jnp.tile(start.attitude, (100, 1)))
        >>> run = {"dt": 0.01, "steps": 10, "save_every": 5, "observe": ml.observe.Mean(ml.observe.Axis())}
        >>> found = ml.ensemble("JACOBI[EA]", body, torque, starts, **run).states
        >>> found.mean.shape, found.covariance.shape  # of the axis (3,) at 3 times
        ((3, 3), (3, 3, 3))
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
        """Number, mean and covariance; for a single number, mean and variance have no axis (m,)."""

        def of_moments(m: Moments) -> dict[str, Array]:
            single = m.mean.shape[-1] == 1
            mean, covariance = (m.mean[..., 0], m.covariance[..., 0, 0]) if single else (m.mean, m.covariance)
            return {"number": m.number, "mean": mean, "variance" if single else "covariance": covariance}

        return _on_moments(of_moments, merged)


def _on_moments(function: Callable[[Moments], Any], tree: Any) -> Any:
    return jax.tree.map(function, tree, is_leaf=lambda x: isinstance(x, Moments))


class Histogram(Statistic):
    """The number of bodies in each bin: an integer array (bins,) for each number that the observable returns.

    Bins are as in `numpy.histogram`; values outside all bins and NaN are not counted. Values and edges are compared in
    the dtype with more digits.

    Attributes:
        edges: (bins + 1,), increasing, in the unit of the observable.

    Raises:
        ValueError: the edges are not finite, do not increase, or are fewer than two.

    Examples:
        >>> heights = ml.observe.Histogram(lambda t, state: state.axis[2], edges=[-1.0, 0.0, 0.5, 1.0])  # an AxisState
        >>> of_bodies = jnp.array([0.1, 0.4, 0.9, 1.0])  # ml.ensemble(..., observe=heights) computes them
        >>> heights.part(of_bodies, good=jnp.array([True, True, True, True]))
        Array([0, 2, 2], dtype=int32)
    """

    edges: Array

    def __init__(self, observable: Any, edges: Any):
        self.observable = observable
        self.edges = as_finite("edges", edges)
        if self.edges.ndim != 1 or len(self.edges) < 2 or not bool(jnp.all(jnp.diff(self.edges) > 0)):
            raise ValueError(f"edges must be at least two increasing numbers, got {described(edges)}.")

    def part(self, values: Any, good: Array) -> Any:
        bins = len(self.edges) - 1

        def of_numbers(x: Array) -> Array:
            x = promoted(x, self.edges.dtype)
            edges = self.edges.astype(x.dtype)
            # The run time of a search and a count hardly depends on the number of bins.
            place = jnp.searchsorted(edges, x, side="right").astype(jnp.int32) - 1
            place = jnp.where(x == edges[-1], bins - 1, place)
            inside = good & (place >= 0)
            counts = jnp.zeros(bins, jnp.int32)
            return counts.at[jnp.where(inside, place, bins)].add(1, mode="drop")  # a position after the bins is dropped

        def of_array(x: Array) -> Array:
            columns = x.reshape(len(good), -1)
            counts = jax.vmap(of_numbers, in_axes=1)(columns)
            return counts.reshape(*x.shape[1:], bins)

        return jax.tree.map(of_array, values)

    def merged(self, parts: Any) -> Any:
        return jax.tree.map(lambda part: jnp.sum(part, axis=0, dtype=part.dtype), parts)

    def attributes(self) -> dict[str, Any]:
        return {"bin_edges": self.edges.tolist()}


def promoted(x: Array, dtype: Any) -> Array:
    """`x` in this floating-point dtype, or in its own if it has more digits."""
    own = jnp.issubdtype(x.dtype, jnp.floating) and x.dtype.itemsize > jnp.dtype(dtype).itemsize
    return x if own else x.astype(dtype)
