"""Sites, points fixed in a body: their positions in space, forces on them, and bodies made from point masses."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_floats, as_not_negative, require, same_dtype
from .._math import components as cp
from .._math.powers import unit
from ..model.bodies import RigidBody, SymmetricRotor
from ..model.free_body import FreeBody, Wrench
from ..model.leaf import needs_attitude
from ..model.state import AnyState

# A moment smaller than the largest by this factor, the spacing of the dtype to this power, is rounding: the points are
# on a line. Likewise, the sign of a smaller coordinate is rounding.
_LINE = 2 / 3
_NO_SIGN = 1 / 3


def from_points(masses: Any, places: Any) -> tuple[FreeBody, Float[Array, "points 3"]]:
    """The body made of point masses, and its points in the principal frame about the centre of mass.

    The moments ascend, and the principal axes are right-handed. In the order of the points, the first nonzero value of
    the first and of the second coordinate is positive. The result does not depend on the position and orientation of
    the points as a whole. If two moments are equal, the axes in their plane are arbitrary.

    Args:
        masses: of the points, (a,). A zero gives a site without mass, such as the charge of a TIP4P water.
        places: their positions in any frame, (a, 3).

    Returns:
        The body and the points (a, 3). If all points are on a line, the rotating body is a `SymmetricRotor` without a
        moment along its axis, and its states are `FreeAxisState`s. The points are then on the third axis, and the third
        coordinate of the first point away from the centre of mass is positive.

    Raises:
        ValueError: wrong shapes or dtypes, a negative mass, no mass, masses in one place, or masses on a line with
            another site off it. If jit or grad traces the points, these are not checked, and the body is not a
            `SymmetricRotor`.

    Examples:
        >>> places = [[0.0, 0.0, 0.0], [0.08, 0.06, 0.0], [-0.08, 0.06, 0.0]]
        >>> water, points = ml.molecules.from_points([16.0, 1.0, 1.0], places)
        >>> water.body.moments.round(6)
        Array([0.0064, 0.0128, 0.0192], dtype=float64)
    """
    masses, places = as_not_negative("masses", masses, cure="check their signs and units."), as_finite("places", places)
    _check_points(masses, places)
    total = jnp.sum(masses)
    masses = masses / total
    centred = places - jnp.sum(masses[:, None] * places, axis=0, keepdims=True)
    length, per_length = unit(jnp.max(jnp.abs(centred)))  # a power of two, so squares stay in range
    x, y, z = cp.vector(per_length * centred)
    xx, yy, zz, yz, zx, xy = (jnp.sum(masses * product) for product in (x * x, y * y, z * z, y * z, z * x, x * y))
    tensor = jnp.stack([yy + zz, -xy, -zx, -xy, xx + zz, -yz, -zx, -yz, xx + yy]).reshape(3, 3)
    moments, axes = jnp.linalg.eigh(tensor)
    points, on_a_line = centred @ axes, moments[0] <= cp.epsilon(moments) ** _LINE * moments[2]
    moments = moments * total * length * length
    if not cp.is_traced(on_a_line) and on_a_line:
        return _on_a_line(total, points, moments)
    first, second = (_sign(points[:, k], points) for k in (0, 1))
    third = first * second * jnp.sign(jnp.linalg.det(axes))
    signs = cp.pack((first, second, third))
    return FreeBody(RigidBody(moments), total), points * signs[None, :]


def _check_points(masses: Array, places: Array) -> None:
    if masses.ndim != 1 or places.shape != (*masses.shape, 3):
        raise ValueError(f"masses must be (a,) and places (a, 3), got {masses.shape} and {places.shape}.")
    same_dtype("masses", masses, places=places)
    require("masses", masses, lambda m: np.any(m > 0), "must not all be zero", "give a mass to at least two points.")
    if cp.is_traced(masses, places):
        return
    heavy = np.asarray(places)[np.asarray(masses) > 0]
    if np.all(np.ptp(heavy, axis=0) <= cp.epsilon(places) * np.max(np.abs(heavy))):
        problem = f"places must hold masses at two or more positions, got {len(heavy)}"
        raise ValueError(f"{problem}; use midlie_jax.Particles for point masses.")


def _on_a_line(mass: Array, points: Array, moments: Array) -> tuple[FreeBody, Array]:
    """The rotor; the axis of the least moment, the first, becomes the third."""
    along, size = points[:, 0], jnp.max(jnp.abs(points))
    if jnp.max(jnp.abs(points[:, 1:])) > cp.epsilon(points) ** _NO_SIGN * size:
        raise ValueError("places must be on one line as all masses are; a site is off. Give that site a mass.")
    zeros = jnp.zeros_like(along)
    third = cp.pack((zeros, zeros, _sign(along, points) * along))
    return FreeBody(SymmetricRotor(moments[2], jnp.zeros_like(moments[2])), mass), third


def _sign(coordinates: Array, points: Array) -> Array:
    nonzero = jnp.abs(coordinates) > cp.epsilon(points) ** _NO_SIGN * jnp.max(jnp.abs(points))
    chosen = coordinates[jnp.argmax(nonzero)]
    return jnp.where(chosen < 0, -jnp.ones_like(chosen), jnp.ones_like(chosen))


def sites(state: AnyState, points: Any) -> Float[Array, "*batch points 3"]:
    """The positions in space of points fixed in a body, y = x + R s.

    Args:
        state: any state with an attitude or an axis; without a position, relative to the fixed point.
        points: in the frame of the attitude, (a, 3) for all bodies, or (..., a, 3) with the leading axes of the state.
            If the state holds an axis only, the points must be on the third axis.

    Returns:
        (..., a, 3), space frame.

    Raises:
        ValueError: wrong shapes or dtypes, a state without attitude and axis, or points off the axis of the state.

    Examples:
        >>> turned = ml.RigidState([0.0, 0.0, 1.0], ml.so3.exp(jnp.array([0.0, 0.0, np.pi / 2])))
        >>> ml.molecules.sites(turned, [[1.0, 1.0, 0.5], [2.0, 1.0, 0.5]]).round(6)  # a quarter turn about z
        Array([[-1. ,  1. ,  0.5],
               [-1. ,  2. ,  0.5]], dtype=float64)
    """
    position = getattr(state, "position", None)
    arms, _ = _arms(state, points)
    if position is not None:
        arms = [cp.add(cp.vector(position), arm) for arm in arms]
    return jnp.stack([cp.pack(arm) for arm in arms], axis=-2)


def wrench_on_sites(state: AnyState, points: Any, forces: Any) -> Wrench:
    """The torque and force on a body of forces on its sites: the transpose of the derivative of `sites`.

    Args:
        state, points: as for `sites`.
        forces: on the sites, space frame, (..., a, 3).

    Returns:
        A wrench with the torque in the frame of the momentum: the body frame, or the space frame for a state that holds
        an axis only. For a state that does not translate, use its attribute `torque`.

    Raises:
        ValueError: as for `sites`, or forces of another shape or dtype.

    Examples:
        >>> state = ml.FreeState([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0])
        >>> pull = ml.molecules.wrench_on_sites(state, [[0.0, 0.0, 0.5]], forces=[[2.0, 0.0, 0.0]])
        >>> pull.torque, pull.force
        (Array([0., 1., 0.], dtype=float64), Array([2., 0., 0.], dtype=float64))
    """
    arms, columns = _arms(state, points)
    shape = (*state.momentum.shape[:-1], len(arms), 3)
    forces = as_floats("forces", forces)
    if forces.shape != shape:
        raise ValueError(f"forces must be {shape}, one for each site of each body, got {forces.shape}.")
    same_dtype("the state", state.momentum, forces=forces)
    on_sites = [cp.vector(forces[..., k, :]) for k in range(len(arms))]
    force, torque = on_sites[0], cp.cross(arms[0], on_sites[0])
    for arm, g in zip(arms[1:], on_sites[1:], strict=True):
        force, torque = cp.add(force, g), cp.add(torque, cp.cross(arm, g))
    if columns is not None:
        torque = (cp.dot(columns[0], torque), cp.dot(columns[1], torque), cp.dot(columns[2], torque))
    return Wrench(cp.pack(torque), cp.pack(force))


def _arms(state: AnyState, points: Any) -> tuple[list[cp.Vector], cp.Columns | None]:
    """The vectors R s from the centre to each site, space frame; and the columns of R, or None for an axis."""
    points = as_floats("points", points)
    batch = state.momentum.shape[:-1]
    if points.ndim < 2 or points.shape[-1] != 3 or points.shape[-2] == 0 or points.shape[:-2] not in ((), batch):
        raise ValueError(f"points must be (a, 3) or {(*batch, 'a', 3)} with a > 0, got {points.shape}.")
    same_dtype("the state", state.momentum, points=points)
    each = [cp.vector(points[..., k, :]) for k in range(points.shape[-2])]
    attitude, axis = getattr(state, "attitude", None), getattr(state, "axis", None)
    if attitude is not None:
        columns = cp.columns(cp.quaternion(attitude))
        return [_combined(columns, point) for point in each], columns
    if axis is None:
        raise needs_attitude(state)
    on_axis = "must be on the third axis for a state that holds an axis only"
    require("points", points, lambda p: p[..., :2] == 0, on_axis, "use a state with an attitude.")
    along = [jnp.where((x == 0) & (y == 0), z, jnp.nan) for x, y, z in each]  # points may be traced
    return [cp.scale(z, cp.vector(axis)) for z in along], None


def _combined(columns: cp.Columns, v: cp.Vector) -> cp.Vector:
    return cp.add(cp.add(cp.scale(v[0], columns[0]), cp.scale(v[1], columns[1])), cp.scale(v[2], columns[2]))
