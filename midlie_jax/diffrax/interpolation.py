"""`LieInterpolation`, dense output on the group: states between the ends of a step."""

import math
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.fusion import begin, fuse
from .._kernel.replay import Packed, by_components
from ..model import so3
from ..model.states import DirectionState, RigidState
from .term import ambient_rate, like

_LARGEST = 16  # entries of a vector that is split into its entries


class LieInterpolation(diffrax.AbstractLocalInterpolation):
    """Interpolation between the ends of a step, on the group, with a local error of fourth order if the ends are exact.

    For a `RigidState` the attitude is R0 exp(c(s)), a unit quaternion to rounding, where c is the cubic that matches
    both attitudes and both angular velocities. The spatial momentum is the cubic that matches momentum and spatial
    torque at both ends, and is then rotated to the body frame, so that a free body's spatial momentum is constant
    between steps as well. If a step turns by more than pi, its ends do not determine the direction of the turn, and the
    result inside the step is NaN. For a state without attitude, each array is interpolated by a cubic, and a direction
    is scaled back to unit length.

    Args:
        t0, t1: times of the ends.
        y0, y1: states at t0 and t1.
        velocity0, velocity1, torque0, torque1: velocities and torques at t0 and t1, as in `Rates`.
        h: the signed step, which is t0 - t1 if time runs backwards.
    """

    t0: Any
    t1: Any
    y0: Any
    y1: Any
    velocity0: Array
    velocity1: Array
    torque0: Array
    torque1: Array
    h: Array

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> Any:
        """The state at t0; with t1, the arrays at t1 minus the arrays at t0. `derivative` differentiates the arrays."""
        del left
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        # A number would be a constant of the compiled program, which would then be compiled anew for each time.
        return _state_at(self, t0 if eqx.is_array(t0) else jnp.asarray(t0, jnp.result_type(self.t0)))


@eqx.filter_jit
@eqx.filter_checkpoint
def _state_at(dense: LieInterpolation, t: Any) -> Any:
    """The state at the time t.

    Reverse mode computes it again, so that XLA finds nothing in its derivative that it could compute ahead, entry by
    entry, for all times of a step.
    """
    return _by_scalars(_state_of_arrays, dense.y0, _by_scalars(_cubics, dense), dense.t0, dense.t1, t)


def _cubics(dense: LieInterpolation) -> tuple[Any, Any]:
    """The cubics of the step.

    Returns:
        The cubic of the rotation vector, None for a state without attitude; and the cubics of all other arrays, for a
        `RigidState` of R0^T times the spatial momentum.
    """
    y0, y1, h = dense.y0, dense.y1, dense.h
    velocity0, velocity1, torque0, torque1 = dense.velocity0, dense.velocity1, dense.torque0, dense.torque1
    if isinstance(y0, RigidState):
        turned = so3.multiply(so3.conjugate(y0.attitude), y1.attitude)
        angle = so3.log(turned)
        # h times the mean angular velocity approximates the turn. If the logarithm is far from this value, the true
        # turn is longer than pi: turns that differ by 2 pi have the same logarithm.
        deviation = angle - h / 2 * (velocity0 + velocity1)
        angle = jnp.where(jnp.sum(deviation**2) < jnp.pi**2, angle, jnp.nan)
        turn = _cubic(jnp.zeros_like(angle), angle, h * velocity0, h * so3.dexp_inverse(-angle, velocity1))
        momentum, torque = so3.rotate(turned, y1.momentum), so3.rotate(turned, torque1)
        return turn, _cubic(y0.momentum, momentum, h * torque0, h * torque)
    slope0 = ambient_rate(y0, y0.unpack(velocity0), y0.unpack(torque0))
    slope1 = ambient_rate(y1, y1.unpack(velocity1), y1.unpack(torque1))
    ends = zip(*map(jax.tree.leaves, (y0, y1, slope0, slope1)), strict=True)
    return None, [_cubic(a, b, h * da, h * db) for a, b, da, db in ends]


def _state_of_arrays(y0: Any, cubics: tuple[Any, Any], t0: Any, t1: Any, t: Any) -> Any:
    """The state at the time t; `y0`, at t0, tells the class of the state, and for a `RigidState` the attitude."""
    length = t1 - t0
    no_step = length == 0
    s = jnp.where(no_step, jnp.zeros_like(length), t - t0) / jnp.where(no_step, jnp.ones_like(length), length)
    s = s.astype(y0.momentum.dtype)
    turn, rest = cubics
    if isinstance(y0, RigidState):
        turn = so3.exp(_at(turn, s))
        momentum = so3.rotate(so3.conjugate(turn), _at(rest, s))
        attitude = RigidState.turn(cp.quaternion(y0.attitude), cp.quaternion(turn), jnp.array(False), s)
        return like(y0, momentum, cp.pack(attitude))
    leaves = [_at(cubic, s) for cubic in rest]
    if isinstance(y0, DirectionState):
        leaves[1] = leaves[1] / jnp.sqrt(jnp.sum(leaves[1] ** 2))
    return like(y0, *leaves)


def _by_scalars(function: Callable[..., Any], *arguments: Any) -> Any:
    """The function of pytrees of small vectors, evaluated on their entries in one loop: its derivative compiles faster.

    A function of larger arrays, as particles may have, is evaluated as it is.
    """
    leaves, structure = jax.tree.flatten(begin(arguments))
    leaves = [jnp.asarray(leaf) for leaf in leaves]
    if any(leaf.ndim > 1 or leaf.size > _LARGEST for leaf in leaves):
        return function(*arguments)
    result = jax.eval_shape(function, *arguments)
    shapes, result_structure = jax.tree.flatten(result)

    def joined(leaves: list[Array]) -> Array:
        results = jax.tree.leaves(function(*jax.tree.unflatten(structure, leaves)))
        return jnp.concatenate([jnp.ravel(x) for x in results])

    entries, _ = by_components(joined, [Packed(tuple(x[i] for i in range(len(x)))) if x.ndim else x for x in leaves])
    found = iter(fuse(entries))
    packed = [jnp.stack([next(found) for _ in range(math.prod(x.shape))]).reshape(x.shape) for x in shapes]
    return jax.tree.unflatten(result_structure, packed)


def _cubic(start: Array, end: Array, slope0: Array, slope1: Array) -> tuple[Array, Array, Array, Array]:
    """Coefficients, lowest first, of the cubic on [0, 1] with these values and slopes at its ends."""
    change = end - start
    return start, slope0, 3 * change - 2 * slope0 - slope1, slope0 + slope1 - 2 * change


def _at(cubic: tuple[Array, Array, Array, Array], s: Array) -> Array:
    a, b, c, d = cubic
    return a + s * (b + s * (c + s * d))
