"""`straight_rod`: bodies, forces and initial state of a straight elastic rod, from its size and material."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count, as_floats, as_positive, is_unit, require
from ..model import so3
from ..model.bodies import RigidBody
from ..model.free_body import FreeBody
from ..model.states import CoupledState
from .rod_torque import Rod

_SHEAR_FACTOR = 27 / 28  # for a round cross section, as in PyElastica
_POISSON = 0.5  # the default of PyElastica


class StraightRod(NamedTuple):
    """A rod at rest, in the order of the arguments of `integrate`.

    Attributes:
        body: the bodies, from the first end to the other.
        torque: the elastic forces between them.
        start: all at rest.

    Examples:
        >>> rod = ml.molecules.straight_rod(
        ...     10, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0],
        ...     length=1.0, radius=0.05, density=1000.0, youngs_modulus=1e6,
        ... )
        >>> rod.start.position.shape  # eleven bodies, also of rod.body and rod.torque
        (11, 3)
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
    normal: `elements` + 1 bodies, the first and the last at the ends of the rod. A clamp holds the first of them, which
    is then not a body of the state. Each body has the mass nearest to it and the moments of a cylinder as long as a
    link; bodies at free ends have half of both. Errors decrease with the square of the number of elements.

    The stiffest motion limits the step: keep dt below half the time in which sound, of speed sqrt(E/density), passes an
    element. The moments along the rod exclude much faster motions of slender rods.

    Args:
        elements: the number of links.
        start: position of the first end in space, (3,).
        direction: unit vector along the rod, (3,).
        normal: unit vector across it, (3,).
        length: of the rod, ().
        radius: of its cross section, ().
        density: mass over volume, ().
        youngs_modulus: E, (), force/length^2.
        shear_modulus: G, (), force/length^2; by default E/3, for an incompressible material.
        clamped: whether the first end is held, with its direction. By default both ends are free.

    Returns:
        The body, the torque and the start: `body, torque, start = straight_rod(...)`.

    Raises:
        ValueError: `elements` is not a positive int; a size or modulus is not positive; direction and normal are not
            orthogonal unit vectors.

    Examples:
        >>> rod = ml.molecules.straight_rod(
        ...     10, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0],
        ...     length=1.0, radius=0.05, density=1000.0, youngs_modulus=1e6, clamped=True,
        ... )
        >>> body, torque, start = rod  # for integrate
        >>> start.position.shape, start.position[-1]
        ((10, 3), Array([0., 0., 1.], dtype=float64))
    """
    count = as_count("elements", elements)
    modulus = as_positive("youngs_modulus", youngs_modulus)
    shear = modulus / (2 * (1 + _POISSON)) if shear_modulus is None else as_positive("shear_modulus", shear_modulus)
    whole, thick, heavy = as_positive("length", length), as_positive("radius", radius), as_positive("density", density)
    place, along, across = (
        as_floats(name, value, (3,)) for name, value in (("start", start), ("direction", direction), ("normal", normal))
    )
    for name, value in (("direction", along), ("normal", across)):
        require(name, value, is_unit, "must be a unit vector", "divide it by its norm.")
    require(
        "normal", jnp.sum(across * along), lambda x: np.abs(x) < 1e-3, "must be at right angles to direction",
        "this is their dot product.",
    )  # fmt: skip
    attitude = so3.from_matrix(jnp.stack([across, jnp.cross(along, across), along], axis=-1))
    piece = whole / count
    area, square = jnp.pi * thick**2, thick**2 / 4  # their product is the second moment of the cross section
    # The bodies at the ends of the elements share them; the clamped body is left out.
    share = np.where((np.arange(count + 1) % count) == 0, 0.5, 1.0)[clamped:]
    mass = heavy * piece * jnp.asarray(share, area.dtype) * area
    across = thick**2 / 4 + piece**2 / 12
    moments = mass[:, None] * jnp.stack([across, across, thick**2 / 2])[None]
    torque = Rod(
        piece,
        jnp.stack([_SHEAR_FACTOR * shear * area, _SHEAR_FACTOR * shear * area, modulus * area]),
        jnp.stack([modulus * area * square, modulus * area * square, 2 * shear * area * square]),
        clamp=(place, attitude) if clamped else None,
    )
    nodes = piece * jnp.arange(int(clamped), count + 1, dtype=piece.dtype)
    nothing = jnp.zeros((len(share), 3), piece.dtype)
    position = place[None] + nodes[:, None] * along[None]
    state = CoupledState(nothing, jnp.broadcast_to(attitude, (len(share), 4)), nothing, position)
    return StraightRod(FreeBody(RigidBody(moments), mass), torque, state)
