"""Tumbling bodies: conversion between light-curve parameters (periods, pole, phases) and a state; see `Tumble`.

In a rotation period the short axis makes one more circuit than the long axis, in either mode.

L. Landau, E. Lifshitz, Mechanics (1976), section 37; N. Samarasinha, M. A'Hearn, Icarus 93 (1991) 194; M. Kaasalainen,
Astron. Astrophys. 376 (2001) 302; P. Pravec and others, Icarus 173 (2005) 108 and 233 (2014) 48.
"""

from contextlib import suppress
from itertools import product
from math import pi
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from .._checks.arguments import as_finite, as_floats, as_positive, require, shown
from .._math import components as cp
from .._math.elliptic import amplitude, complete, fraction_of
from .._math.powers import unit as power_of_two
from ..drivers.observe.observables import QUANTITIES
from ..model import so3
from ..model.bodies import Body, RigidBody, principal_of
from ..model.compatibility import check_body, check_state
from ..model.state import AnyState
from ..model.states import RigidState

_BISECTIONS = 60
_NEAREST = 80.0  # -log of the smallest distance from the separatrix, as a fraction of the mode's energies
_MODES = ("short", "long")


class Tumble(NamedTuple):
    """How a body tumbles at a state, from `tumble`.

    - The *pole* is the direction of the angular momentum L, fixed in space.
    - *Short-axis mode* (SAM): L circles the axis of the largest moment in the body frame. *Long-axis mode* (LAM): L
      circles the axis of the smallest moment. The time of one circuit is the rotation period, P_psi.
    - The *precession periods*, P_phi, are the mean times in which the short or the long axis circles L in space. In
      both modes 1 / P_short = 1 / P_long + 1 / P_psi. A published pair (P_phi, P_psi) may mean either axis and either
      mode: see `tumblings`.
    - The *phases* (s, phi): s is the share of the rotation period since L had no component along the middle axis and
      positive ones along the other two; phi is the angle about the pole.

    Attributes:
        short_axis: whether the motion is in short-axis mode.
        energy_ratio: 2 E Ic / |L|^2, the energy relative to a rotation about the short axis with the same momentum, at
            least 1.
        short_axis_period, long_axis_period: the precession periods of these axes, time.
        rotation_period: of the momentum in the body, time.
        effective_rate: 2 E / |L|, the mean angular velocity along the momentum, radians/time.
        momentum: |L|.
        pole: the direction of L in space, (3,); None for a state without attitude.
        phases: (s, phi) as for `tumbling`, s in (-1/2, 1/2], phi in (-2 pi, 2 pi]; phi is 0 for a state without
            attitude. If the momentum is on the negative side of the axis that it circles, `tumbling` has no such start;
            s is then the phase of the body with two axes reversed.

    Examples:
        >>> toutatis = ml.RigidBody([3.0836, 3.235, 1.0])  # 8 December 1992 (Astron. J. 146 (2013) 95), days
        >>> rates, angles = jnp.deg2rad(jnp.array([[14.5, 33.7, -98.5], [147.5, 63.9, 241.5]]))
        >>> start = ml.RigidState(toutatis.momentum(rates), ml.so3.from_euler(angles, "ZXZ"))
        >>> ml.asteroids.tumble(toutatis, start).rotation_period.round(4)
        Array(5.3804, dtype=float64)
    """

    short_axis: Bool[Array, "*batch"]
    energy_ratio: Float[Array, "*batch"]
    short_axis_period: Float[Array, "*batch"]
    long_axis_period: Float[Array, "*batch"]
    rotation_period: Float[Array, "*batch"]
    effective_rate: Float[Array, "*batch"]
    momentum: Float[Array, "*batch"]
    pole: Float[Array, "*batch 3"] | None
    phases: tuple[Float[Array, "*batch"], Float[Array, "*batch"]]


class _Shape(NamedTuple):
    """The free motion with the smallest momentum |L| = 1, about the axis of I3: Pi = (A1 cn, sgn A2 sn, A3 dn)."""

    m1: Array  # 1 - m of the elliptic functions
    rate: Array  # of their argument
    amplitudes: tuple[Array, Array, Array]
    precession: Array  # the mean rate of the third axis about L

    @classmethod
    def of(cls, moments: cp.Vector, above: Array, below: Array, near: Array, short: Array) -> "_Shape":
        """The motion about the third axis, from 2 E I3 - 1, 1 - 2 E I1 and 1 - 2 E I2 for |L| = 1."""
        i1, i2, i3 = moments
        m1 = near * (i3 - i1) / (below * (i3 - i2))
        rate = jnp.sqrt(below * (i3 - i2) / (i1 * i2 * i3))
        amplitudes = (
            jnp.sqrt(i1 * above / (i3 - i1)),
            jnp.sqrt(i2 * above / (i3 - i2)),
            jnp.sqrt(i3 * below / (i3 - i1)),
        )
        # The first axis precesses about L by elliptic integrals of the third kind without a pole (E. T. Whittaker,
        # Analytical Dynamics, section 69); the third by one circuit more or less in each period of the momentum.
        quarter = complete(m1, jnp.ones_like(m1))
        third = complete(m1, 1 + i1 * above / (i3 * below))
        first = 1 / i1 + (1 / i3 - 1 / i1) * third / quarter
        return cls(m1, rate, amplitudes, first + jnp.where(short, 1.0, -1.0) * (pi / 2) * rate / quarter)

    @property
    def period(self) -> Array:
        return 4 * complete(self.m1, jnp.ones_like(self.m1)) / self.rate


def _at(moments: cp.Vector, u: Array, short: Array) -> _Shape:
    """The motion whose energy is a fraction 1 - exp(-u) of the way from the steady rotation to the separatrix."""
    i1, i2, i3 = moments
    d, left = -jnp.expm1(-u), jnp.exp(-u)
    above, near = d * (i3 / i2 - 1), left * (1 - i2 / i3)
    return _Shape.of(moments, above, 1 - i1 / i3 - d * (i1 / i2 - i1 / i3), near, short)


def _ratio(moments: cp.Vector, u: Array, short: Array) -> Array:
    shape = _at(moments, u, short)
    return shape.precession * shape.period / (2 * pi)


def tumbling(
    body: Body,
    *,
    precession_period: Any,
    rotation_period: Any,
    axis: str,
    pole: Any,
    phases: Any,
    mode: str | None = None,
) -> RigidState:
    """The initial state of a free body that tumbles with given periods, as known from light curves.

    `Tumble` defines periods and phases. The momentum in the body frame starts where s is zero, and free motion advances
    it by s rotation periods. The attitude is a product of three rotations: the smallest that takes this direction to z,
    a rotation by phi about z, and the smallest that takes z to the pole.

    Differentiable with respect to all numbers, including the body's; `midlie_jax.asteroids.tumble` is the inverse.

    Args:
        body: a `RigidBody`, or a `TensorBody` in a custom frame (the axes above are then the principal ones).
        precession_period: the mean time in which `axis` circles the momentum in space, (), time.
        rotation_period: of the momentum in the body, (), time.
        axis: the axis of this precession: "short", of the largest moment, or "long", of the smallest.
        pole: the direction of the angular momentum in space, (3,), of any nonzero length.
        phases: (s, phi), s as a fraction of the rotation period, phi in radians.
        mode: "short" or "long"; None if only one mode allows these periods. Required for traced numbers.

    Returns:
        The state. Where the numbers are traced and no motion has these periods, it is NaN.

    Raises:
        ValueError: no motion of the body, or none in this mode, has these periods; both modes have one, and `mode` is
            None; axis or mode is another string; or a number is not positive or not finite, or of a wrong shape.

    Examples:
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> start = ml.asteroids.tumbling(
        ...     body, precession_period=3.9, rotation_period=10.0, axis="short", pole=[0.0, 0.0, 1.0], phases=(0.1, 0.0)
        ... )
        >>> ml.asteroids.tumble(body, start).rotation_period.round(4)
        Array(10., dtype=float64)
    """
    principal = principal_of(body)
    if not isinstance(principal, RigidBody):
        raise ValueError(f"body must be a RigidBody or a TensorBody, got {type(body).__name__}.")
    if axis not in _MODES:
        raise ValueError(f'axis must be "short" or "long", got {shown(axis)}.')
    precession = as_positive("precession_period", precession_period, cure="give its magnitude.")
    rotation = as_positive("rotation_period", rotation_period, cure="give its magnitude.")
    pole = as_finite("pole", pole, (3,))
    require("pole", jnp.sum(pole**2, axis=-1), lambda x: x > 0, "must not be zero", "give a direction.")
    if not isinstance(phases, tuple) or len(phases) != 2:
        raise ValueError(f"phases must be a tuple (s, phi), got {shown(phases)}.")
    s, phi = as_floats("phases[0]", phases[0]), as_floats("phases[1]", phases[1])
    turns = rotation / precession
    mode = _mode_of(_sorted(principal)[0], turns, axis, mode)
    turns = turns + _further_turns(axis, mode)
    momentum, attitude = _start_of(principal, body.frame_of_user(), turns, rotation, pole, s, phi, mode == "short")
    return RigidState(momentum, attitude)


def tumblings(
    body: Body, *, precession_period: Any, rotation_period: Any, pole: Any, phases: Any, axis: str | None = None
) -> dict[tuple[str, str], RigidState]:
    """All starts with a published pair of periods, if it does not say which mode and which axis it means.

    Args:
        body, precession_period, rotation_period, pole, phases: as for `tumbling`, not traced.
        axis: the axis of the precession, if it is known; None for both.

    Returns:
        The start for each (mode, axis) that allows these periods, such as ("long", "long"): at most four, and none for
        a body that cannot have them.

    Raises:
        ValueError: as for `tumbling`, unless no motion has these periods.

    Examples:
        >>> body = ml.RigidBody([1.0, 3.0836, 3.235])  # Toutatis; periods in days
        >>> starts = ml.asteroids.tumblings(
        ...     body, precession_period=7.3996, rotation_period=5.3804, pole=[0.0, 0.0, 1.0], phases=(0.0, 0.0)
        ... )
        >>> list(starts)
        [('long', 'long')]
    """
    found: dict[tuple[str, str], RigidState] = {}
    given = {"precession_period": precession_period, "rotation_period": rotation_period}
    for mode, about in product(_MODES, _MODES if axis is None else (axis,)):
        with suppress(_ImpossibleError):
            found[mode, about] = tumbling(body, **given, axis=about, pole=pole, phases=phases, mode=mode)
    return found


class _ImpossibleError(ValueError):
    pass


@eqx.filter_jit
def _start_of(
    principal: RigidBody, frame: Any, wanted: Array, rotation: Array, pole: Array, s: Array, phi: Array, short: bool
) -> tuple[Array, Array]:
    moments, order, sign, largest = _sorted(principal)
    i1, i2, i3 = moments if short else moments[::-1]
    shape = _shape_with((i1, i2, i3), wanted, jnp.asarray(short))
    size = shape.period / rotation * largest[0]
    angle = amplitude(shape.m1, s - jnp.round(s))
    c, n = jnp.cos(angle), jnp.sin(angle)
    first, second, third = shape.amplitudes
    third = third * jnp.sqrt(shape.m1 * n * n + c * c)
    along, across = (first * c, third) if short else (third, first * c)
    by_size = jnp.stack(jnp.broadcast_arrays(size * along, size * sign * second * n, size * across), axis=-1)
    momentum = jnp.take_along_axis(by_size, jnp.broadcast_to(jnp.argsort(order, axis=-1), by_size.shape), axis=-1)
    up = jnp.zeros_like(momentum).at[..., 2].set(1)
    about = jnp.stack(jnp.broadcast_arrays(jnp.cos(phi / 2), 0 * phi, 0 * phi, jnp.sin(phi / 2)), axis=-1)
    to_pole = _smallest_turn(jnp.broadcast_to(up, (*pole.shape[:-1], 3)), pole)
    attitude = so3.multiply(so3.multiply(to_pole, about), _smallest_turn(momentum, up))
    if frame is not None:
        momentum = cp.pack(cp.rotate(frame, cp.vector(momentum)))
        attitude = cp.pack(cp.multiply(cp.quaternion(attitude), cp.conjugate(frame)))
    return momentum, attitude


def tumble(body: Body, state: AnyState) -> Tumble:
    """How a body would tumble without torque.

    Differentiable. `short_axis` changes at the separatrix, the energy of a rotation about the axis of the middle moment
    I2. There the rotation period is infinite, and both precession periods are 2 pi I2 / |L|. For a body with two equal
    moments, and for a steady rotation, the periods are the limits. For a ball they are NaN.

    Args:
        body: a `RigidBody`, `TensorBody`, or `FreeBody` of one; or n bodies, whose states have a leading axis n.
        state: one with a momentum (..., 3) in the body frame; for a path its `states`.

    Returns:
        A `Tumble`, with the leading axes of the state.

    Raises:
        ValueError: the state does not belong to the body, or the body is a `SymmetricRotor`.

    Examples:
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> ml.asteroids.tumble(body, ml.RigidState([0.2, 0.1, 2.5], [1.0, 0.0, 0.0, 0.0])).rotation_period.round(3)
        Array(10.341, dtype=float64)
    """
    check_state("state", state)
    check_body(body, state)
    principal = principal_of(body).turning
    if not isinstance(principal, RigidBody):
        raise ValueError(f"body must be a RigidBody, a TensorBody or a FreeBody of one, got {type(body).__name__}.")
    return _tumble_of(principal, body.frame_of_user(), state.momentum, getattr(state, "attitude", None))


@eqx.filter_jit
def _tumble_of(principal: RigidBody, frame: Any, momentum: Array, attitude: Any) -> Tumble:
    if frame is not None:
        momentum = cp.pack(cp.rotate_back(frame, cp.vector(momentum)))
        attitude = None if attitude is None else cp.pack(cp.multiply(cp.quaternion(attitude), frame))
    moments, order, sign, largest = _sorted(principal)
    unit, size = _unit(momentum)
    rate = size * largest[1]
    a, b, c = cp.vector(jnp.take_along_axis(unit, jnp.broadcast_to(order, unit.shape), axis=-1))
    ia, ib, ic = moments
    near = a * a * (1 - ib / ia) + c * c * (1 - ib / ic)  # 1 - 2 E Ib
    # On the separatrix the momentum approaches the middle axis and never returns: the rotation period is infinite, and
    # on average both axes precess at the rate of a rotation about the middle axis.
    separating = near == 0
    short = (near > 0) | (separating & (ia + ic > 2 * ib))  # with two equal moments, the mode that exists
    i1, i3 = jnp.where(short, ia, ic), jnp.where(short, ic, ia)
    p1, p3 = jnp.where(short, a, c), jnp.where(short, c, a)
    above = p1 * p1 * (i3 / i1 - 1) + b * b * (i3 / ib - 1)
    below = b * b * (1 - i1 / ib) + p3 * p3 * (1 - i1 / i3)
    some = below * (i3 - ib) / (i3 - i1)  # any number with finite periods, as derivatives need
    shape = _Shape.of((i1, ib, i3), above, below, jnp.where(separating, some, near), short)
    energy = a * a / ia + b * b / ib + c * c / ic  # 2 E / |L|^2
    # If the momentum is on the negative side of the third axis, reverse the first and third axes.
    side = jnp.where(p3 < 0, -1.0, 1.0).astype(p3.dtype)
    angle = jnp.arctan2(sign * b * jnp.sqrt(jnp.abs(i3 - ib) / ib), side * p1 * jnp.sqrt(jnp.abs(i3 - i1) / i1))
    pole, phi = None, jnp.zeros_like(size)
    if attitude is not None:
        pole = so3.rotate(attitude, unit)
        up = jnp.zeros_like(unit).at[..., 2].set(1)
        about = so3.multiply(
            so3.multiply(so3.conjugate(_smallest_turn(up, pole)), attitude), so3.conjugate(_smallest_turn(unit, up))
        )
        phi = 2 * jnp.arctan2(about[..., 3], about[..., 0])
    by_turn = 2 * pi / shape.period  # the difference between the precession rates of short and long axis
    slower = jnp.where(short, shape.precession - by_turn, shape.precession)
    fast, slow, rotation = (x / rate for x in (2 * pi / (slower + by_turn), 2 * pi / slower, shape.period))
    separating = separating & (ia < ic)  # a ball has no separatrix
    middle = 2 * pi * ib / rate
    return Tumble(
        short,
        energy * ic,
        jnp.where(separating, middle, fast),
        jnp.where(separating, middle, slow),
        jnp.where(separating, jnp.inf, rotation),
        energy * rate,
        size,
        pole,
        (fraction_of(shape.m1, angle), phi),
    )


def _sorted(body: RigidBody) -> tuple[cp.Vector, Array, Array, tuple[Array, Array]]:
    """The ascending moments in units of a power of two, the indices of their axes, their hand, the unit and 1/unit."""
    order = jnp.argsort(body.moments, axis=-1)
    moments = cp.vector(jnp.take_along_axis(body.moments, order, axis=-1))
    largest = power_of_two(moments[2])
    a, b, c = cp.vector(order)
    sign = jnp.sign((b - a) * (c - a) * (c - b)).astype(body.moments.dtype)
    return cp.scale(largest[1], moments), order, sign, largest


def _further_turns(axis: str, mode: str) -> int:
    """The circuits per rotation period of the axis that the momentum circles, minus the circuits of the other axis."""
    return (mode == "short") - (axis == "short")


def _mode_of(moments: cp.Vector, turns: Array, axis: str, mode: str | None) -> str:
    if mode is not None and mode not in _MODES:
        raise ValueError(f'mode must be "short", "long" or None, got {shown(mode)}.')
    if cp.is_traced(moments, turns):
        if mode is None:
            raise ValueError('mode must be "short" or "long" where body or periods are traced.')
        return mode
    ratio = np.asarray(turns, np.float64)
    least: dict[str, Any] = {}  # near the steady rotation; infinite if there is no such mode
    for name, further in (("short", 1), ("long", -1)):
        a, b, c = (np.asarray(x, np.float64) for x in (moments if name == "short" else moments[::-1]))
        with np.errstate(divide="ignore"):
            least[name] = 1 / np.sqrt((c - a) * (c - b) / (a * b)) + further - _further_turns(axis, name)
    can = {name: bool(np.all(ratio >= least[name])) for name in _MODES}
    able = [name for name in _MODES if can[name]]
    if mode is None and len(able) == 2:
        raise ValueError(
            'mode must be "short" or "long", because both modes have these periods. Give "short" if the momentum '
            "circles the axis of the largest moment."
        )
    if not able or (mode is not None and not can[mode]):
        limits = " and ".join(f"{np.max(least[name]):.6g} in the {name}-axis mode" for name in _MODES)
        raise _ImpossibleError(
            f"rotation_period must be at least {limits} times the precession_period of the {axis} "
            f"axis for this body, got {shown(turns)} times; check the moments and the axis."
        )
    return mode or able[0]


def _shape_with(moments: cp.Vector, wanted: Array, short: Array) -> _Shape:
    """The motion with this ratio of rotation period to precession period; NaN if there is none."""
    constants = jax.lax.stop_gradient((moments, wanted))
    zero = jnp.zeros_like(sum(jax.tree.leaves(constants)))

    def halve(_: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        above = _ratio(constants[0], middle, short) > constants[1]
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (zero, zero + _NEAREST))
    u = jax.lax.stop_gradient((low + high) / 2)
    # Two differentiated Newton steps from the root have its first three derivatives.
    for _ in range(2):
        ratio, slope = jax.jvp(lambda u: _ratio(moments, u, short), (u,), (jnp.ones_like(u),))
        u = u - (ratio - wanted) / slope
    possible = _ratio(constants[0], zero, short) <= constants[1] * (1 + 1e-6)
    return _at(moments, jnp.where(possible, u, jnp.full_like(u, jnp.nan)), short)


def _unit(vector: Array) -> tuple[Array, Array]:
    unit, per_unit = power_of_two(jnp.max(jnp.abs(vector), axis=-1))
    vector = vector * per_unit[..., None]
    length = jnp.linalg.norm(vector, axis=-1)
    return vector / length[..., None], length * unit


def _smallest_turn(a: Array, b: Array) -> Array:
    """The quaternion of the smallest rotation from one direction to another; a rotation by pi for opposite ones."""
    (a, _), (b, _) = _unit(a), _unit(b)
    ca, cb = cp.vector(a), cp.vector(b)
    w = 1 + cp.dot(ca, cb)
    opposite = w < 4 * cp.epsilon(w)
    zero, one = jnp.zeros_like(w), jnp.ones_like(w)
    along_x = jnp.abs(ca[0]) > 0.7
    other = (zero, jnp.where(along_x, zero, one), jnp.where(along_x, one, zero), zero)
    parts = (w, *cp.cross(ca, cb))
    w, x, y, z = (jnp.where(opposite, b, a) for a, b in zip(parts, other, strict=True))
    return cp.pack(cp.normalised((w, x, y, z)))


QUANTITIES[tumble] = lambda t, state, body, torque: tumble(body, state)
