"""The function that a fit minimises: the residuals of all measurements for one vector, and their Jacobian.

With one segment the vector holds the parameters. With several (multiple shooting) the initial states of the second and
later segments are further unknowns, appended to the vector. The differences between the end of a segment and the
beginning of the next are further residuals.

H. G. Bock, Recent advances in parameter identification techniques for O.D.E., in Numerical Treatment of Inverse
Problems in Differential and Integral Equations (Birkhäuser 1983) 95.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from .._xla.compiler import exact_jit
from ..integrators.base import Method
from ..model.state import AnyState
from ..model.states import TravellingState
from .instruments import Attitudes, Rates
from .loss import Loss
from .measurements import Measurement
from .parameters import Layout
from .sampling import Closed, Grid

Model = Callable[[Any], tuple[Any, Any, AnyState]]


class Data(eqx.Module):
    """The inputs of the residuals besides the unknowns; every array may be mapped over."""

    layout: Layout
    measurements: tuple[Measurement, ...]
    # With multiple shooting, reference states (segments - 1, ...): the unknowns are increments from them to the initial
    # states of the second and later segments.
    anchors: AnyState | None = None


class Problem(eqx.Module):
    """The fixed part of a fit, made and checked once, and the same for all data sets."""

    model: Model = eqx.field(static=True)  # from values of the parameters to (body, torque, start)
    method: Method = eqx.field(static=True)
    grid: Grid | Closed
    continuity: float = eqx.field(static=True)  # the weight of the jumps of multiple shooting, see `fit`
    loss: Loss | None = None
    differences: bool = eqx.field(static=True, default=False)  # Jacobians by differences, which compile faster

    def single(self) -> "Problem":
        """The problem without multiple shooting."""
        return replace(self, grid=self.grid.whole())

    def run(self, vector: Float[Array, " u"], data: Data) -> tuple[Any, Any, Any, AnyState]:
        """The values of the parameters, the body, the torque with the paths of the segments, and the initial states."""
        count = data.layout.size
        values = data.layout.values(vector[:count])
        body, torque, start = self.model(values)
        starts = jax.tree.map(lambda x: x[None], start)
        if data.anchors is not None:
            # Increments, in which the change of the momentum is in units of its length.
            moves = vector[count:].reshape(self.grid.segments - 1, -1)
            later = data.anchors.plus(moves * _units(data.anchors, moves))
            starts = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), starts, later)
        return values, body, (torque, self.grid.run(self.method, body, torque, starts)), starts

    def residuals(self, vector: Float[Array, " u"], data: Data) -> tuple[Array, Bool[Array, ""], list[Array]]:
        """All residuals over sigma (r,), as the loss counts them, whether every step was good, and linear unknowns."""
        values, body, (torque, paths), starts = self.run(vector, data)
        times = jnp.concatenate([m.times_of_model(values).astype(vector.dtype) for m in data.measurements])
        states, ok = self.grid.sample(self.method, body, torque, paths, times)
        found: list[Array] = []
        linear: list[Array] = []
        begin = 0
        for measurement in data.measurements:
            end = begin + measurement.times.shape[0]
            here = jax.tree.map(lambda x, a=begin, b=end: x[a:b], states)
            raw = measurement.of_run(torque).residuals(values, body, here)
            left, best = measurement.eliminated(raw, self.loss)
            found.append(left if self.loss is None else self.loss.counted(left))
            linear.append(best)
            begin = end
        if data.anchors is not None:
            ends, later = jax.tree.map(lambda x: x[:-1, -1], paths.states), jax.tree.map(lambda x: x[1:], starts)
            increments = later.minus(ends)
            found.append(self.continuity * (increments / _units(later, increments)).reshape(-1))
        return jnp.concatenate(found), jnp.all(ok) & jnp.all(paths.ok), linear

    def anchored(self, data: Data, vector: Float[Array, " p"]) -> Data:
        """The data with anchors: from the nearest rows of `Rates` and `Attitudes`, else from the run of the guess."""
        assert isinstance(self.grid, Grid)
        values, body, (_, path), _ = self.single().run(vector, data)
        places = self.grid.steps * jnp.arange(1, self.grid.segments) // self.grid.every
        states = jax.tree.map(lambda x: x[0, places], path.states)
        times = path.times[0, places]
        for m in data.measurements:
            if isinstance(m, Rates):
                rates = m.unbiased(values)[_nearest(m, times)]
                states = eqx.tree_at(lambda s: s.momentum, states, jax.vmap(body.momentum)(rates))
            if isinstance(m, Attitudes):  # it is compared only with states that have an attitude
                states = eqx.tree_at(lambda s: s.attitude, states, m.values[_nearest(m, times)])
        return Data(data.layout, data.measurements, states)


def _nearest(measurement: Measurement, times: Float[Array, " s"]) -> Int[Array, " s"]:
    """For each time, the nearest complete row of the measurement."""
    missing = ~jnp.all(measurement.present, axis=-1)
    distances = jnp.abs(measurement.times[None] - times[:, None])
    return jnp.argmin(jnp.where(missing[None], jnp.full_like(distances, jnp.inf), distances), axis=-1)


def _units(states: AnyState, increments: Float[Array, "s k"]) -> Float[Array, "s k"]:
    """The units of increments: the lengths of momenta and position, 1 if zero, and 1 radian for the rotation."""

    def unit(vectors: Array) -> Array:
        size = jnp.linalg.norm(vectors, axis=-1, keepdims=True)
        return jnp.where(size == 0, jnp.ones_like(size), size)

    units = jnp.ones_like(increments).at[..., :3].set(unit(states.momentum))
    if isinstance(states, TravellingState):
        units = units.at[..., -6:-3].set(unit(states.linear)).at[..., -3:].set(unit(states.position))
    return units


def jacobian_of(vector: Float[Array, " u"], data: Data, problem: Problem) -> tuple[Array, Array, Float[Array, "r u"]]:
    """The residuals (r,), whether every step was good, and the Jacobian (r, u), in forward mode or by differences."""
    if problem.differences:
        width = math.sqrt(jnp.finfo(vector.dtype).eps) * data.layout.typical()
        moved = jnp.concatenate([vector[None], vector[None] + jnp.diag(width)])
        every, good, _ = jax.vmap(lambda v: problem.residuals(v, data))(moved)
        return every[0], good[0], (every[1:] - every[:1]).T / width[None]

    def twice(v: Array) -> tuple[Array, tuple[Array, Array]]:
        found, ok, _ = problem.residuals(v, data)
        return found, (found, ok)

    jacobian, (found, ok) = jax.jacfwd(twice, has_aux=True)(vector)
    return found, ok, jacobian


@exact_jit
def linear_unknowns(problem: Problem, data: Data, vector: Float[Array, " p"]) -> list[Array]:
    """The linear unknowns of each measurement for a vector of the parameters."""
    return problem.single().residuals(vector, data)[2]


@eqx.filter_custom_jvp
def residuals(vector: Float[Array, " u"], data: Data, problem: Problem) -> Array:
    """`Problem.residuals`, with a derivative in forward mode: a custom solver stores the Jacobian, not the run."""
    return problem.residuals(vector, data)[0]


@residuals.def_jvp
def _(primals: Sequence[Any], tangents: Sequence[Any]) -> Any:
    vector, data, problem = primals
    along, along_data, _ = tangents
    found, _, jacobian = jacobian_of(vector, data, problem)
    change = jnp.zeros_like(found) if along is None else jacobian @ along
    if any(leaf is not None for leaf in jax.tree.leaves(along_data)):
        _, more = eqx.filter_jvp(lambda d: problem.residuals(vector, d)[0], (data,), (along_data,))
        change = change + more
    return found, change
