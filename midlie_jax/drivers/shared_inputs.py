"""Inputs that all bodies share, computed once per ensemble, such as an orbit or a field over time.

XLA would recompute them in every chunk of bodies. `find` traces one step of one body and splits it
(`_xla/hoisting.py`): `SharedInputs.rows` computes the expensive values that change from step to step and are the same
for all bodies; `SharedInputs.advance` is the step that reads its row of them.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._xla import budgets
from .._xla.hoisting import Hoisted, depends, hoist
from ..integrators.base import Method, Progress
from ..integrators.system import System
from ..integrators.verdict import FINE
from ..model.torques import on_body
from .clock import ends_of_step

Rows = list[Any]


class SharedInputs(NamedTuple):
    """The split step of a run; `costly`: whether the torque that reads a row has expensive operations."""

    costly: bool
    hoisted: Hoisted
    structure: Any

    def placed(self, system: System) -> System:
        return system._replace(placement=system.placement.if_costly(self.costly))

    def rows(self, system: System, t0: Array, dt: Array, n: Array) -> Rows:
        return self.hoisted.prepare(n, t0, dt, *_arrays(system), *[None] * self.structure.num_leaves)

    def table(self, system: System, t0: Array, dt: Array, n: Array) -> Rows:
        """The rows of steps with these indices (k,), a multiple of PREPARED_ROWS so that their bits depend not on k."""
        return jax.lax.map(lambda n: self.rows(system, t0, dt, n), n, batch_size=budgets.PREPARED_ROWS)

    def advance(self, system: System, t0: Array, dt: Array, progress: Progress, n: Array, row: Any) -> Progress:
        leaves = jax.tree.leaves(progress)
        return self.structure.unflatten(self.hoisted.rest(row, n, t0, dt, *_arrays(system), *leaves))


def find(method: Method, arguments: Any, rows: Any) -> SharedInputs | None:
    """The split step of an ensemble, None if nothing is worth preparing; `rows` marks arrays with a row per body."""
    body, torque, start, dt, t0 = arguments
    if torque is None or any(jax.tree.leaves(rows[3:])) or jax.sharding.get_abstract_mesh().manual_axes:
        return None
    arrays, functions = eqx.partition((body, torque, start), eqx.is_array)
    pairs = zip(jax.tree.leaves((body, torque, start)), jax.tree.leaves(rows[:3]), strict=True)
    marks = [mark for leaf, mark in pairs if eqx.is_array(leaf)]

    def torque_alone(arrays: Any, t: Array) -> Any:
        body, torque, start = eqx.combine(arrays, functions)
        return on_body(torque, body)(t, start)

    _, costly, alone = depends(jax.make_jaxpr(torque_alone)(arrays, t0), [*marks, False])
    if not alone:
        return None

    def system_of(arrays: Any, t: Array) -> System:
        body, torque, start = eqx.combine(arrays, functions)
        system = method.system(body, torque, start, t, dt)
        return system._replace(placement=system.placement.if_costly(costly))

    own, _, _ = depends(jax.make_jaxpr(lambda *a: _arrays(system_of(*a)))(arrays, t0), [*marks, False])
    constants, other = eqx.partition(system_of(arrays, t0), eqx.is_array)
    motion = eqx.combine(constants, other).motion(start)
    force = jax.tree.map(jnp.zeros_like, motion.momentum) if method.keeps_force(eqx.combine(constants, other)) else None
    progress = Progress(motion, force, jnp.asarray(FINE))
    structure = jax.tree.structure(progress)

    def step(n: Array, t0: Array, dt: Array, *leaves: Array) -> list[Array]:
        count = len(leaves) - structure.num_leaves
        system = eqx.combine(jax.tree.unflatten(jax.tree.structure(constants), leaves[:count]), other)
        before = structure.unflatten(leaves[count:])
        after, _ = method.advance(system.at_step(n), (t0, dt), partial(ends_of_step, n), dt, before)
        return jax.tree.leaves(after)

    inputs = [jnp.zeros((), jnp.int32), t0, dt, *jax.tree.leaves(constants), *jax.tree.leaves(progress)]
    known = [True, True, True, *(not o for o in own), *[False] * structure.num_leaves]
    varying = [True, *[False] * (len(inputs) - 1)]
    # Without the mesh of an array, which JAX would write into operations that `jax.shard_map` could not perform.
    types = [jax.ShapeDtypeStruct(x.shape, x.dtype, weak_type=jax.typeof(x).weak_type) for x in inputs]
    split = hoist(jax.make_jaxpr(step)(*types), known, varying)
    return None if split is None else SharedInputs(costly, split, structure)


def _arrays(system: System) -> list[Array]:
    return jax.tree.leaves(eqx.filter(system, eqx.is_array))
