"""What a step does, counted in its trace: evaluations of the torque, and whether it evaluates the torque in a solve.

The torque that is traced leaves a mark, the cube root, which nothing else in the package uses. The mark's derivative is
a mark again, so that a directional derivative of the torque, as Newton's method needs three, counts as an evaluation.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from midlie_jax.integrators.base import Method
from midlie_jax.integrators.system import System
from midlie_jax.model.bodies import RigidBody
from midlie_jax.model.states import RigidState
from midlie_jax.model.torques import Torque

_MARK = "cbrt"


class Work(NamedTuple):
    """Attributes:
    evaluations: torque evaluations of a step after the first, with directional derivatives.
    explicit: whether no evaluation is part of the iteration of a solve.
    """

    evaluations: int
    explicit: bool


@jax.custom_jvp
def _mark(x: Array) -> Array:
    return jax.lax.cbrt(x)


@_mark.defjvp
def _mark_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return _mark(*primals), jax.lax.cbrt(tangents[0])


class _MarkedTorque(Torque):
    """A torque that depends on the attitude. Its potential is there for methods that keep the energy."""

    def __call__(self, t: Any, state: RigidState) -> Array:
        del t
        return _mark(state.attitude[1:])

    def potential(self, t: Any, state: RigidState) -> Array:
        del t
        return state.attitude[0]


def work(method: Method) -> Work:
    """The work of a step of a rigid body with two equal moments, under a torque that depends on the attitude."""
    body = RigidBody(jnp.array([2.0, 2.0, 3.0]))
    start = RigidState(jnp.ones(3), jnp.full(4, 0.5))
    fitted = method.fitted(body)

    def step(start: RigidState, h: Array) -> Any:
        system = System.of(body, _MarkedTorque(), start, jnp.zeros_like(h))
        motion = system.motion(start)
        force = motion.momentum if fitted.keeps_force(system) else None
        return fitted.step(system, jnp.zeros_like(h), h, h, motion, force)

    outside, inside = _marks(jax.make_jaxpr(step)(start, jnp.asarray(0.1)).jaxpr, solving=False)
    return Work(outside + inside, inside == 0)


def _marks(jaxpr: Any, solving: bool) -> tuple[int, int]:
    """The marks outside and inside of solves, which are `custom_root` calls; a mark in a loop counts for each turn.

    In jax 0.10 such a call is a function with a derivative of its own; in 0.12 it is a primitive that keeps its
    parts in `_prim`.
    """
    outside = inside = 0
    for equation in jaxpr.eqns:
        name = equation.primitive.name
        if name == _MARK:
            outside, inside = outside + (not solving), inside + solving
        root = equation.params.get("_prim")
        for value in (*equation.params.values(), *getattr(root, "params", {}).values()):
            body = getattr(value, "jaxpr", value)
            if not hasattr(body, "eqns"):
                continue
            # The mark is a function with a derivative of its own, as a solve is, but does nothing else.
            own = name == "custom_jvp_call" and [e.primitive.name for e in body.eqns] != [_MARK]
            within = solving or own or root is not None
            found = _marks(body, within)
            turns = equation.params.get("length", 1)
            if name == "while" and sum(found):
                raise ValueError("a loop of unknown length evaluates the torque; its evaluations cannot be counted.")
            outside, inside = outside + turns * found[0], inside + turns * found[1]
    return outside, inside
