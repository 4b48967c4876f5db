"""`ShorterStep`, dense output of the order of the method: a state inside a step is the end of a shorter step.

A shorter step from the same start is a step of the same method. For a method of order p, its error is therefore of
order p + 1 in the length, whereas the cubic of `LieInterpolation` has an error of fourth order.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from .._xla.fusion import is_stored
from ..integrators.base import Method, Progress
from ..integrators.system import System
from ..integrators.verdict import FINE, is_fine
from ..model.bodies import Body
from ..model.torques import TorqueLike
from .dense import Dense, part_of_step


class Start(eqx.Module):
    """The start of a step as arrays only, because diffrax stacks it over many steps and cannot stack functions.

    The last of the arrays holds the times of both ends and the signed step; `rest` the structure, and other leaves.
    """

    arrays: list[Any]
    rest: Any = eqx.field(static=True)

    @classmethod
    def of(
        cls, method: Method, body: Body, torque: TorqueLike | None, y0: Any, force: Array | None, times: list[Array]
    ) -> "Start":
        leaves, structure = jax.tree.flatten((method, body, torque, y0, force, jnp.stack(times)))
        marks = [isinstance(leaf, (Array, np.ndarray, np.generic)) for leaf in leaves]
        arrays = [leaf for leaf, mark in zip(leaves, marks, strict=True) if mark]
        others = tuple(None if mark else leaf for leaf, mark in zip(leaves, marks, strict=True))
        return cls([jnp.asarray(leaf) for leaf in arrays], (structure, tuple(marks), others))

    def parts(self) -> Any:
        structure, marks, others = self.rest
        arrays = iter(self.arrays)
        return structure.unflatten([next(arrays) if m else x for m, x in zip(marks, others, strict=True)])


class ShorterStep(Dense):
    """States inside a step, each computed by a shorter step of the method; NaN if its solve failed."""

    t0: Any
    t1: Any
    start: Start

    def state_at(self, t: Array) -> Any:
        return _state_at(self, t)


@eqx.filter_jit
@eqx.filter_checkpoint(policy=is_stored)
def _state_at(dense: ShorterStep, t: Any) -> Any:
    method, body, torque, y0, force, times = dense.start.parts()
    start_time, end_time, h = times
    s = part_of_step(dense.t0, dense.t1, t, h.dtype)
    system = System.of(body, torque, y0, start_time, whole=True)
    ends = start_time, jnp.where(s == 1, end_time, start_time + s * h)
    motion = system.motion(y0)
    stored = None if force is None else cp.of_flat(force, motion.momentum)
    progress = Progress(motion, stored, jnp.asarray(FINE))
    (end, _, judged), _ = method.advance(system, ends, lambda clock: (*clock, None), s * h, progress)
    return jax.tree.map(lambda x: jnp.where(is_fine(judged), x, jnp.nan), system.state(end))
