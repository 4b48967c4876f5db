"""`Rod`: the elastic forces of a chain of rigid bodies that form an elastic rod: bending, twist and shear.

The rod follows Simo and Reissner (J. C. Simo, Comput. Methods Appl. Mech. Eng. 49 (1985) 55), whose cross sections stay
flat. Each body is a piece of the rod, with e3 along the rod. A link joins each body to the next. With D its length, R
the attitudes and x the positions of the two bodies, Rm the attitude half-way between them,

    strain     = Rm^T (x' - x) / D - e3        (two shears and the stretch)
    curvature  = log(R^T R') / D               (two bends and the twist)
    V          = sum D/2 (strain . S strain + curvature . B curvature)

Below, h is the rotation by half the angle between the bodies, so that Rm = R h = R' h^T. Small rotations of the bodies
by the vectors a and a' (each in its frame) change their relative rotation by w = h a' - h^T a in the frame Rm, and
rotate Rm by (h^T a + h a')/2 - r x w / 2, with r the Rodrigues vector of h. The rotation vector log(R^T R') changes by
C w, where C stretches w across the axis by c, half the angle over its sine.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_count, as_finite, as_floats, as_positive, is_unit, require
from .._math import components as cp
from .._xla.fusion import begin, fuse
from ..model import so3
from ..model.bodies import RigidBody
from ..model.free_body import FreeBody, Wrench
from ..model.state import AnyState, Time
from ..model.states import CoupledState
from ..model.torques.base import Torque

_MOST = float(np.sin(np.pi / 8) ** 2)  # the largest x of `_excess`, for a relative rotation of the bodies by pi


def _excess_of(x: np.ndarray) -> np.ndarray:
    """(c - 1)/s^2, for half the angle a between two bodies, s = sin a and c = a/s, as a function of x = sin^2(a/4)."""
    square = 16 * x * (1 - x) * (1 - 2 * x) ** 2
    sine = np.sqrt(np.maximum(square, 1e-3))
    angle = 4 * np.arcsin(np.sqrt(x))
    # The first terms of the series of asin(s)/s, used where the quotient would round.
    series = 1 / 6 + square * (3 / 40 + square * (5 / 112 + square * (35 / 1152 + square * 63 / 2816)))
    return np.where(square < 1e-3, series, (angle / sine - 1) / sine**2)


# As a polynomial, exact to rounding, the forces need no division, root or arctangent, which would split XLA's loops.
_EXCESS = tuple(
    np.polynomial.Chebyshev.interpolate(_excess_of, 17, [0, _MOST]).convert(kind=np.polynomial.Polynomial).coef.tolist()
)


class Rod(Torque):
    """The elastic forces of a rod, a chain of coupled bodies with e3 along it, for a `CoupledState`.

    A link joins body i to body i + 1. With a clamp, one more link, the first, joins a frame fixed in space to the first
    body. Energy is conserved; without a clamp, so are linear and angular momentum. `midlie_jax.molecules.straight_rod`
    makes a rod from its length, radius and material.

    Attributes:
        length: of the links at rest, () or (links,), length.
        stretch: stiffness against shear along e1 and e2 and against stretch, (k G A, k G A, E A), (3,) or (links, 3),
            force.
        bend: stiffness against bending about e1 and e2 and against twist, (E I1, E I2, G J), (3,) or (links, 3),
            force length^2.
        strain: shears and stretch without force, (3,) or (links, 3), a number; by default zero.
        curvature: bends and twist without torque, (3,) or (links, 3), 1/length; by default zero, a straight rod.
        clamp: None for a free rod; or the fixed frame: its position in space, (3,), and its attitude, a unit quaternion
            (w, x, y, z), (4,), with e3 along the rod.

    Raises:
        ValueError: a length or stiffness is not positive, a shape is wrong, a number is not finite, or the attitude of
            the clamp is not a unit quaternion. When called: the state is not a `CoupledState`, or its number of links
            differs from the number of values.

    Examples:
        >>> rod = ml.molecules.Rod(length=0.1, stretch=[300.0, 300.0, 800.0], bend=[2.0, 2.0, 1.5])
        >>> still, upright = jnp.zeros((2, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1))
        >>> state = ml.CoupledState(still, upright, linear=still, position=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.11]])
        >>> rod(0.0, state).force[:, 2].round(6)  # the stiffness times the strain, 800 * 0.1
        Array([ 80., -80.], dtype=float64)
    """

    length: Float[Array, "*batch"]
    stretch: Float[Array, "*batch 3"]
    bend: Float[Array, "*batch 3"]
    strain: Float[Array, "*batch 3"] | None
    curvature: Float[Array, "*batch 3"] | None
    clamp: tuple[Float[Array, "*batch 3"], Float[Array, "*batch 4"]] | None

    def __init__(
        self, length: Any, stretch: Any, bend: Any, *, strain: Any = None, curvature: Any = None, clamp: Any = None
    ):
        self.length = as_positive("length", length)
        self.stretch, self.bend = as_positive("stretch", stretch, (3,)), as_positive("bend", bend, (3,))
        self.strain = None if strain is None else as_finite("strain", strain, (3,))
        self.curvature = None if curvature is None else as_finite("curvature", curvature, (3,))
        self.clamp = None if clamp is None else _frame(clamp)

    def __call__(self, t: Time, state: AnyState) -> Wrench:
        links = self._links(state)
        force, first, second = links.load()
        if self.clamp is not None:  # the force on the fixed frame is not needed
            return Wrench(second + _before(first[1:]), _before(force[1:]) - force)
        return Wrench(_after(second) + _before(first), _before(force) - _after(force))

    def potential(self, t: Time, state: AnyState) -> Array:
        return self._links(state).potential()

    def _links(self, state: Any) -> "_Links":
        if not isinstance(state, CoupledState):
            raise ValueError(
                f"Rod acts on a chain of bodies that translate, but the state is a {type(state).__name__}; use a "
                "CoupledState of a FreeBody, for example from midlie_jax.molecules.straight_rod."
            )
        places, attitudes = state.position, state.attitude
        if self.clamp is not None:
            pairs = zip(self.clamp, (places, attitudes), strict=True)
            places, attitudes = (jnp.concatenate([held[None], free]) for held, free in pairs)
        count = len(places) - 1
        if count < 1:
            raise ValueError("Rod needs at least two bodies, or one and a clamp; the state holds one.")
        for name, axes in (("length", 0), ("stretch", 1), ("bend", 1), ("strain", 1), ("curvature", 1)):
            value = getattr(self, name)
            if value is not None and value.shape[: value.ndim - axes] not in ((), (count,)):
                raise ValueError(
                    f"{name} must be one for all links or one for each of {count}, got shape {value.shape} for "
                    f"{state.count} bodies{' and a clamp' if self.clamp is not None else ''}."
                )
        return _Links(self, places, attitudes)


def _frame(clamp: Any) -> tuple[Array, Array]:
    if not isinstance(clamp, tuple | list) or len(clamp) != 2:
        raise ValueError("clamp must be None or (place, attitude), a vector (3,) and a unit quaternion (4,).")
    place, attitude = as_finite("clamp[0]", clamp[0], (3,)), as_floats("clamp[1]", clamp[1], (4,))
    require("clamp[1]", attitude, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")
    return place, attitude


def _before(load: Array) -> Array:
    """The load (links, 3) on the body before each link, as the load on all bodies; no link follows the last body."""
    return jnp.concatenate([load, jnp.zeros_like(load, shape=(1, 3))])


def _after(load: Array) -> Array:
    return jnp.concatenate([jnp.zeros_like(load, shape=(1, 3)), load])


class _Links:
    """The links of a rod: components of arrays (links,).

    `length` is D, `middle` Rm, `half` h, `way` Rm^T (x' - x) / D; strain and curvature are minus the values at rest.
    `u` is the axis of the rotation between two bodies, times the sine s of half its angle; `excess` is (c - 1)/s^2.
    """

    def __init__(self, rod: Rod, places: Array, attitudes: Array):
        self.rod, self.length = rod, rod.length
        way = cp.scale(1 / self.length, cp.vector(places[1:] - places[:-1]))
        # The forces of one link are a loop over all links; its inputs and outputs are fused separately.
        way, first, second = begin((way, cp.quaternion(attitudes[:-1]), cp.quaternion(attitudes[1:])))
        w, *rest = cp.multiply(cp.conjugate(first), second)
        sign = jnp.where(w < 0, -jnp.ones_like(w), jnp.ones_like(w))  # q and -q are one rotation
        self.u = cp.scale(sign, (rest[0], rest[1], rest[2]))
        self.half = cp.normalised((1 + sign * w, *self.u))
        self.middle = cp.multiply(first, self.half)
        self.way = cp.rotate_back(self.middle, way)
        self.excess = cp.polynomial(_EXCESS, (1 - self.half[0]) / 2)
        self.c = 1 + cp.dot(self.u, self.u) * self.excess
        strain = self.way[0], self.way[1], self.way[2] - 1
        curvature = cp.scale(self.c * (2 / self.length), self.u)
        self.strain = strain if rod.strain is None else cp.subtract(strain, cp.vector(rod.strain))
        self.curvature = curvature if rod.curvature is None else cp.subtract(curvature, cp.vector(rod.curvature))

    def potential(self) -> Array:
        parts = (self.rod.stretch, self.strain), (self.rod.bend, self.curvature)
        density = [cp.dot(cp.times(cp.vector(stiffness), v), v) for stiffness, v in parts]
        return jnp.sum(self.length * (density[0] + density[1])) / 2

    def load(self) -> tuple[Array, Array, Array]:
        """The forces on the bodies before the links, in space, and the torques on the bodies before and behind them."""
        tension = cp.times(cp.vector(self.rod.stretch), self.strain)
        moment = cp.times(cp.vector(self.rod.bend), self.curvature)
        lever = cp.scale(self.length, cp.cross(tension, self.way))
        rodrigues = cp.scale(cp.reciprocal(self.half[0]), (self.half[1], self.half[2], self.half[3]))
        # C moment: unchanged along the axis, scaled by c across it.
        stretched = cp.subtract(cp.scale(self.c, moment), cp.scale(self.excess * cp.dot(self.u, moment), self.u))
        between = cp.subtract(stretched, cp.scale(0.5, cp.cross(lever, rodrigues)))
        half_lever = cp.scale(0.5, lever)
        first = cp.rotate(self.half, cp.subtract(between, half_lever))
        second = cp.scale(-1, cp.rotate_back(self.half, cp.add(between, half_lever)))
        force = cp.rotate(self.middle, tension)
        return cp.packed(fuse((force, first, second)))


_SHEAR_FACTOR = 27 / 28  # for a round cross section, as in PyElastica
_POISSON = 0.5  # the default of PyElastica


class StraightRod(NamedTuple):
    """A rod at rest, in the order of the arguments of `integrate`, from its first end to the other.

    Examples:
        >>> size = {"length": 1.0, "radius": 0.05, "density": 1000.0, "youngs_modulus": 1e6}
        >>> rod = ml.molecules.straight_rod(10, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], **size)
        >>> round(float(rod.body.mass.sum()), 4)  # pi 0.05^2 1000
        7.854
    """

    body: FreeBody
    torque: Rod
    start: CoupledState


def straight_rod(
    elements: int,
    start: Any,
    direction: Any,
    normal: Any,
    *,
    length: Any,
    radius: Any,
    density: Any,
    youngs_modulus: Any,
    shear_modulus: Any = None,
    clamped: bool = False,
) -> StraightRod:
    """A straight elastic rod with a round cross section, unstressed and at rest.

    The rod has `elements` links of equal length and a body at each end of them, with e3 along the rod and e1 along the
    normal. A clamp holds the first of the `elements` + 1 bodies, which is then not a body of the state. Each body has
    the mass nearest to it and the moments of a cylinder as long as a link; bodies at free ends have half of both.
    Errors decrease with the square of the number of elements.

    The stiffest motion limits the step: keep dt below half the time in which sound, of speed sqrt(E/density), passes an
    element.

    Args:
        elements: the number of links.
        start: position of the first end in space, (3,).
        direction, normal: unit vectors along the rod and across it, (3,).
        length, radius, density: of the rod, of its cross section, and mass over volume, ().
        youngs_modulus: E, (), force/length^2.
        shear_modulus: G, (), force/length^2; by default E/3, for an incompressible material.
        clamped: whether the first end is held, with its direction.

    Raises:
        ValueError: `elements` is not a positive int; a size or modulus is not positive; direction and normal are not
            orthogonal unit vectors.

    Examples:
        >>> body, torque, start = ml.molecules.straight_rod(  # for integrate
        ...     10, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0],
        ...     length=1.0, radius=0.05, density=1000.0, youngs_modulus=1e6, clamped=True,
        ... )
        >>> start.position.shape
        (10, 3)
    """
    count = as_count("elements", elements)
    modulus = as_positive("youngs_modulus", youngs_modulus)
    shear = modulus / (2 * (1 + _POISSON)) if shear_modulus is None else as_positive("shear_modulus", shear_modulus)
    whole, thick, heavy = as_positive("length", length), as_positive("radius", radius), as_positive("density", density)
    given = {"start": start, "direction": direction, "normal": normal}
    place, along, across = (as_floats(name, value, (3,)) for name, value in given.items())
    for name, value in (("direction", along), ("normal", across)):
        require(name, value, is_unit, "must be a unit vector", "divide it by its norm.")
    right, cure = "must be at right angles to direction", "this is their dot product."
    require("normal", jnp.sum(across * along), lambda x: np.abs(x) < 1e-3, right, cure)
    attitude = so3.from_matrix(jnp.stack([across, jnp.cross(along, across), along], axis=-1))
    piece = whole / count
    area, square = jnp.pi * thick**2, thick**2 / 4  # their product is the second moment of the cross section
    # The bodies at the ends of the elements share them; the clamped body is left out.
    share = np.where((np.arange(count + 1) % count) == 0, 0.5, 1.0)[clamped:]
    mass = heavy * piece * jnp.asarray(share, area.dtype) * area
    across = thick**2 / 4 + piece**2 / 12
    moments = mass[:, None] * jnp.stack([across, across, thick**2 / 2])[None]
    stretch = jnp.stack([_SHEAR_FACTOR * shear * area, _SHEAR_FACTOR * shear * area, modulus * area])
    bend = jnp.stack([modulus * area * square, modulus * area * square, 2 * shear * area * square])
    torque = Rod(piece, stretch, bend, clamp=(place, attitude) if clamped else None)
    nodes = piece * jnp.arange(int(clamped), count + 1, dtype=piece.dtype)
    nothing = jnp.zeros((len(share), 3), piece.dtype)
    position = place[None] + nodes[:, None] * along[None]
    state = CoupledState(nothing, jnp.broadcast_to(attitude, (len(share), 4)), nothing, position)
    return StraightRod(FreeBody(RigidBody(moments), mass), torque, state)
