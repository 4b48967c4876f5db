"""`EllipsoidBrightness`: the brightness of an ellipsoid in closed form."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_positive
from .._math import components as cp
from .._math.powers import unit
from .brightness import Light

_NONE = 1e-30  # the square of a sine below this counts as zero


class EllipsoidBrightness(Light):
    """The brightness of a sunlit ellipsoid for the Lommel-Seeliger law, in closed form.

    `Brightness(Surface.ellipsoid(semi_axes), sun, observer, LommelSeeliger())` converges to it with the number of
    facets; it needs the run time of a few facets. It is smooth. For a sum over facets the derivative jumps where a
    facet rotates into the dark. A fit then takes more steps, and its intervals are too narrow if there are few facets.

    With s and o, the directions of Sun and observer divided by the semi-axes, component by component, and v = s + o,
    the brightness is pi/2 a b c |s| |o| / |v| (cos l + cos m + sin l sin m ln(tan(l/2) tan(m/2))), where l and m are
    the angles from v to s and to o (K. Muinonen, K. Lumme, Astron. Astrophys. 584 (2015) A23). Relative to the
    brightness seen from the Sun it is accurate to rounding; opposite to the Sun, to the power 2/3 of rounding.

    Attributes:
        semi_axes: along the axes of the body frame, (3,), length, positive.
        sun, observer, phase, magnitude: as for `Brightness`.

    Raises:
        ValueError: the semi-axes are not positive or have another shape, or a direction is no unit vector.

    Examples:
        >>> light = ml.asteroids.EllipsoidBrightness([3.0, 2.0, 1.0], sun=[1.0, 0.0, 0.0], observer=[0.0, 1.0, 0.0])
        >>> state = ml.RigidState([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0])
        >>> round(float(light(0.0, state)), 4)  # in a run: as observe
        1.4293
    """

    semi_axes: Float[Array, "*batch 3"]

    def __init__(self, semi_axes: Any, sun: Any, observer: Any, *, phase: Any = None, magnitude: bool = False):
        self.semi_axes = as_positive("semi_axes", semi_axes, (3,), cure="check their units.")
        self._view(sun, observer, phase, magnitude)

    def intensity(self, sun: cp.Vector, observer: cp.Vector) -> Array:
        return _intensity(cp.vector(self.semi_axes), sun, observer)


def _intensity(axes: cp.Vector, sun: cp.Vector, observer: cp.Vector) -> Array:
    """The formula of `EllipsoidBrightness` without angles: |s x v| = |o x v| = |s x o|."""
    length, per_length = unit(cp.largest(axes))  # powers of two: squares of inverse axes stay within the dtype
    a, b, c = cp.scale(per_length, axes)
    s, o = ((x / a, y / b, z / c) for x, y, z in (sun, observer))
    v, across = cp.add(s, o), cp.cross(s, o)
    s2, o2, v2, square = (cp.dot(u, u) for u in (s, o, v, across))
    # Opposite to the Sun the bright edge is thinner than the rounding error of v; there it counts as dark.
    apart = v2 > s2 * float(jnp.finfo(v2.dtype).eps) ** (2 / 3)
    v2 = jnp.where(apart, v2, jnp.ones_like(v2))
    sizes, dots = (jnp.sqrt(s2 * v2), jnp.sqrt(o2 * v2)), (cp.dot(s, v), cp.dot(o, v))
    # On the line through both directions the logarithm is infinite, but not its product with |s x o|^2.
    bent = apart & (square > _NONE * s2 * o2)
    product = jnp.where((dots[0] < 0) | (dots[1] < 0), jnp.ones_like(square), square)
    for size, dot in zip(sizes, dots, strict=True):
        # tan(l/2) without cancellation, up to the factor |s x o| or its inverse. Only one angle can be obtuse.
        product = product * jnp.where(dot < 0, size - dot, 1 / jnp.where(bent, size + jnp.abs(dot), jnp.ones_like(dot)))
    logarithm = jnp.log(jnp.where(bent, product, jnp.ones_like(product)))
    cosines = jnp.sqrt(o2) * dots[0] + jnp.sqrt(s2) * dots[1]
    return length * (np.pi / 2 * a * b * c / v2 * (cosines + square / jnp.sqrt(v2) * logarithm)) * length
