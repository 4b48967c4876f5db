"""Dense output, the states between the ends of a step: `LieInterpolation` on the group, or by a `ShorterStep`.

A shorter step from the same start is a step of the same method. For a method of order p, its error is therefore of
order p + 1 in the length, whereas the cubic of `LieInterpolation` has an error of fourth order.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from .._math.short_series import WIDEST_SQUARE, half_angle
from .._xla.fusion import begin, fuse, is_stored, split
from ..integrators.base import Progress
from ..integrators.system import System
from ..integrators.verdict import FINE, is_fine
from ..model.states import RigidState, TravellingState
from ..model.states.rigid import Rotation
from .term import ambient_rate, unchecked

_HALVINGS = 2  # number of halvings of an angle, so that the polynomials for sine and cosine are exact
LARGEST_TURN = 2**_HALVINGS * WIDEST_SQUARE**0.5  # radians, within a step
_LEAST_COSINE = 0.5**0.5  # the least cosine of half the angle between the rotation of the step and W


class _Dense(diffrax.AbstractLocalInterpolation):
    """States between the times t0 and t1 of the ends of a step."""

    t0: eqx.AbstractVar[Any]
    t1: eqx.AbstractVar[Any]

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> Any:
        """The state at t0; with t1, the arrays at t1 minus the arrays at t0. `derivative` differentiates the arrays."""
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        # A Python number would be a constant of the compiled program, which would then be recompiled for each time.
        return self.state_at(t0 if eqx.is_array(t0) else jnp.asarray(t0, jnp.result_type(self.t0)))

    @abstractmethod
    def state_at(self, t: Array) -> Any:
        pass


def _part_of_step(t0: Any, t1: Any, t: Any, dtype: Any) -> Array:
    """(t - t0) / (t1 - t0); zero in a step of no length."""
    length = t1 - t0
    no_step = length == 0
    s = jnp.where(no_step, jnp.zeros_like(length), t - t0) / jnp.where(no_step, jnp.ones_like(length), length)
    return s.astype(dtype)


class LieInterpolation(_Dense):
    """Interpolation between the ends of a step, on the group, with a local error of fourth order if the ends are exact.

    For a `RigidState` the attitude is R0 exp(s W) P(s), normalised. W is h times the mean of both angular velocities,
    and P the cubic quaternion, near one, that matches both attitudes and both angular velocities. The attitude is exact
    for a steady spin. The spatial momentum, which is the cubic that matches momentum and spatial torque at both ends,
    is rotated to the body frame; for a free body it is constant. The result is NaN if |W| exceeds 8.8 radians, or if
    the rotation of the step differs from W by more than pi/2. All other arrays are interpolated by cubics, and a
    direction is rescaled to unit length.

    Args:
        t0, t1: times of the ends.
        y0, y1: states at t0 and t1.
        velocity0, velocity1, torque0, torque1: velocities and torques at t0 and t1, as in `Rates`.
        h: the signed step, which is t0 - t1 if time runs backwards.

    Examples:
        >>> import diffrax
        >>> saved = diffrax.SaveAt(ts=jnp.array([0.123, 0.456]))  # between steps of 0.01
        >>> term, solver = ml.diffrax.RigidBodyTerm(body, torque), ml.diffrax.LieSolver("JACOBI[EA]")
        >>> solution = diffrax.diffeqsolve(term, solver, 0.0, 1.0, 0.01, start, saveat=saved)
        >>> jnp.linalg.norm(solution.ys.attitude, axis=-1).round(12)  # unit quaternions
        Array([1., 1.], dtype=float64)
    """

    t0: Any
    t1: Any
    y0: Any
    y1: Any
    velocity0: Any
    velocity1: Any
    torque0: Any
    torque1: Any
    h: Array

    def state_at(self, t: Array) -> Any:
        return _interpolated_at(self, t)


@eqx.filter_jit
@eqx.filter_checkpoint
def _interpolated_at(dense: LieInterpolation, t: Any) -> Any:
    """The state at the time t, which reverse mode recomputes: diffrax would copy each stored array entry by entry."""
    s = _part_of_step(dense.t0, dense.t1, t, dense.y0.momentum.dtype)
    moved = None
    if isinstance(dense.y0, TravellingState):
        moved, rates = _arrays_at(dense, s), ("velocity0", "velocity1", "torque0", "torque1")
        turning = {name: getattr(dense, name).angular for name in rates}
        dense = replace(dense, y0=dense.y0.turning, y1=dense.y1.turning, **turning)
    turned = _rigid_state_at(dense, s) if dense.y0.leaves == (Rotation,) else _arrays_at(dense, s)
    return turned if moved is None else moved.made(turned, moved.linear, moved.position)


def _rigid_state_at(dense: LieInterpolation, s: Array) -> RigidState:
    """The state of a rigid body at the fraction s of the step.

    It uses components, without division or root, so it compiles to two loops, and its derivative compiles quickly.
    """
    vectors = dense.y0.momentum, dense.y1.momentum, dense.velocity0, dense.velocity1, dense.torque0, dense.torque1
    poses = dense.y0.attitude, dense.y1.attitude
    # Without the barrier, XLA would precompute all values that do not depend on s, entry by entry, for all times in a
    # step.
    vectors, poses, h, s = jax.lax.optimization_barrier((vectors, poses, dense.h, s))
    vectors, poses, h, s = begin((tuple(map(cp.vector, vectors)), tuple(map(cp.quaternion, poses)), h, s))
    momentum0, momentum1, velocity0, velocity1, torque0, torque1 = vectors
    end, slope0, slope1 = _weights(s)
    turned = cp.multiply(cp.conjugate(poses[0]), poses[1])
    mean, difference = cp.scale(h / 2, cp.add(velocity0, velocity1)), cp.scale(h / 4, cp.subtract(velocity1, velocity0))
    square = cp.dot(mean, mean)
    rest = cp.multiply(cp.conjugate(_exponential(mean, square)), turned)
    sign = jnp.where(rest[0] < 0, -1.0, 1.0).astype(h.dtype)  # q and -q are the same rotation
    rest = sign * rest[0], *cp.scale(sign, rest[1:])
    valid = (square <= LARGEST_TURN**2) & (rest[0] >= _LEAST_COSINE)
    # The spatial momentum, in the body frame at the start. The cubic is linear in the values at the end.
    spatial = _rotated(turned, cp.add(cp.scale(end, momentum1), cp.scale(slope1 * h, torque1)))
    spatial = cp.add(spatial, cp.add(cp.scale(1 - end, momentum0), cp.scale(slope0 * h, torque0)))
    invalid = jnp.where(valid, 0.0, jnp.nan).astype(h.dtype)
    mean, difference, square, rest, spatial, invalid = split((mean, difference, square, rest, spatial, invalid))

    # With q = q0 exp(s W) p, the rate of p is (p h Omega - W p) / 2.
    vector = rest[1:]
    change = cp.add(cp.scale(rest[0], difference), cp.cross(vector, cp.add(mean, difference)))
    cubic = cp.add(cp.scale(end, vector), cp.subtract(cp.scale(slope1, change), cp.scale(slope0, difference)))
    p = 1 - end + end * rest[0] - slope1 * cp.dot(vector, difference), *cubic
    turn = cp.normalised(cp.multiply(_exponential(cp.scale(s, mean), s * s * square), p))
    attitude = Rotation.act(poses[0], turn, jnp.array(False))
    momentum = _rotated(cp.conjugate(turn), spatial)
    momentum, attitude = fuse(jax.tree.map(lambda x: x + invalid, (momentum, attitude)))
    return unchecked(dense.y0.kind, momentum, attitude)


def _rotated(q: cp.Quaternion, v: cp.Vector) -> cp.Vector:
    """`cp.rotate` without the correction of the length of q, because errors do not accumulate here."""
    return cp.add(v, cp.unit_rotation_change(q, v))


def _exponential(turn: cp.Vector, square: Array) -> cp.Quaternion:
    """The quaternion of a rotation vector of at most `LARGEST_TURN`, and of this squared length."""
    square = square * 0.25**_HALVINGS
    cosine, sine = half_angle(square)
    # cos(a/2) and sin(a/2)/a for a fraction a of the angle. For 2 a, the second is the product of both.
    for n in range(_HALVINGS):
        cosine, sine = cosine * cosine - 4.0**n * square * sine * sine, cosine * sine
    return cosine, *cp.scale(sine, turn)


def _arrays_at(dense: LieInterpolation, s: Array) -> Any:
    """The state at the fraction s of the step; each array is interpolated by a cubic."""
    y0, y1, h = dense.y0, dense.y1, dense.h
    rate0 = ambient_rate(y0, *y0.kind.components((dense.velocity0, dense.torque0)))
    rate1 = ambient_rate(y1, *y1.kind.components((dense.velocity1, dense.torque1)))
    scaled = (jax.tree.map(lambda x: h * x, rate) for rate in (rate0, rate1))
    start, end, slope0, slope1 = map(jax.tree.leaves, (y0, y1, *scaled))
    weights = _weights(s)
    leaves = [
        a + weights[0] * (b - a) + weights[1] * c + weights[2] * d
        for a, b, c, d in zip(start, end, slope0, slope1, strict=True)
    ]
    return y0.kind.normalised(jax.tree.unflatten(jax.tree.structure(y0), leaves))


def _weights(s: Array) -> tuple[Array, Array, Array]:
    """The weights of a cubic at s in [0, 1]: its value at 1 and its slopes at 0 and 1; its value at 0 has the rest."""
    rest = 1 - s
    return s * s * (3 - 2 * s), s * rest * rest, -s * s * rest


class Start(eqx.Module):
    """The start of a step: method, body, torque, state, torque there, and the times of both ends and the signed step.

    The functions are apart, because diffrax stacks the arrays over many steps.
    """

    arrays: Any
    functions: Any = eqx.field(static=True)

    @classmethod
    def of(cls, *parts: Any) -> "Start":
        arrays, functions = eqx.partition(parts, lambda leaf: isinstance(leaf, (Array, np.ndarray, np.generic)))
        return cls(jax.tree.map(jnp.asarray, arrays), functions)


class ShorterStep(_Dense):
    """States inside a step, each computed by a shorter step of the method; NaN if its solve failed."""

    t0: Any
    t1: Any
    start: Start

    def state_at(self, t: Array) -> Any:
        return _end_at(self, t)


@eqx.filter_jit
@eqx.filter_checkpoint(policy=is_stored)
def _end_at(dense: ShorterStep, t: Any) -> Any:
    method, body, torque, y0, force, times = eqx.combine(dense.start.arrays, dense.start.functions)
    start_time, end_time, h = times
    s = _part_of_step(dense.t0, dense.t1, t, h.dtype)
    system = System.of(body, torque, y0, start_time, whole=True)
    ends = start_time, jnp.where(s == 1, end_time, start_time + s * h)
    motion = system.motion(y0)
    stored = None if force is None else cp.of_flat(force, motion.momentum)
    progress = Progress(motion, stored, jnp.asarray(FINE))
    (end, _, judged), _ = method.advance(system, ends, lambda clock: (*clock, None), s * h, progress)
    return jax.tree.map(lambda x: jnp.where(is_fine(judged), x, jnp.nan), system.state(end))
