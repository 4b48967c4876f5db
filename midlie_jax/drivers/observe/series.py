"""`Series`: the base class of statistics over consecutive values of bodies.

The values of a body are processed in blocks, in the order of time, and the necessary results of earlier blocks are
carried along. A run in several time spans therefore has the same statistic as a run in one.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from .spread import Sums, merged_sums
from .statistics import Statistic


class Series(Statistic):
    """A statistic over times and bodies; only the values before the first bad state of a body count."""

    fields: ClassVar[tuple[str, ...]]  # the names of the results of `of_sums`, beginning with its rows

    def _begun(self, bodies: int, x: Any) -> Any:
        """The initial carry of these bodies for one array, a NamedTuple with the field `counted`."""
        raise NotImplementedError

    def _taken(self, before: Any, x: Array, good: Array) -> Any:
        """The carry after the values (bodies, k, m) at the next k times; none counts after one that is not `good`."""
        raise NotImplementedError

    def _sums(self, carried: Any, counted: Array) -> Sums:
        """`Sums` of the bodies that are `counted`, for one array."""
        raise NotImplementedError

    def begun(self, bodies: int, values: Any) -> Any:
        """The initial carry of these bodies, a pytree of arrays (bodies, ...); `values` are of one body at one time."""
        return jax.tree.map(lambda x: self._begun(bodies, x), values)

    def taken(self, carried: Any, values: Any, good: Array) -> Any:
        return jax.tree.map(lambda x, before: self._taken(before, x.reshape(*good.shape, -1), good), values, carried)

    def sums(self, carried: Any, counted: Array) -> Any:
        return jax.tree.map(lambda one: self._sums(one, counted), carried, is_leaf=lambda x: hasattr(x, "counted"))

    @abstractmethod
    def of_sums(self, sums: Sums, interval: Array) -> Any:
        """The statistic of one observed array; `interval` is the time between two values, ()."""

    def part(self, values: Any, good: Array) -> Any:
        """The part of a group of bodies, from all their values (bodies, k, ...); only `good` values count."""
        one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[2:], x.dtype), values)
        carried = self.taken(self.begun(len(good), one), values, good)
        return self.sums(carried, jnp.ones(len(good), bool))

    def parts(self, values: Any, good: Array) -> Any:
        return self.part(values, good)

    def merged(self, parts: Any) -> Any:
        return jax.tree.map(merged_sums, parts, is_leaf=lambda x: isinstance(x, Sums))

    def result(self, merged: Any, interval: Array) -> Any:
        return jax.tree.map(
            lambda sums: self.of_sums(sums, jnp.abs(interval)), merged, is_leaf=lambda x: isinstance(x, Sums)
        )

    def finished(self, merged: Any) -> Any:
        return jax.tree.map(lambda found: found._asdict(), merged, is_leaf=lambda x: hasattr(x, "_asdict"))

    def row_of(self, name: str) -> str:
        """The name of the rows of a variable of the file: `observed_lag` for `observed_error`."""
        field = next(field for field in self.fields if name.endswith(field))
        return name.removesuffix(field) + self.fields[0]

    def of_bodies(self, values: Any, good: Array, interval: Array) -> Any:
        alone = jax.tree.map(lambda x: x[None], self.part(values, good))
        return self.result(self.merged(alone), interval)
