"""`Labels`: the axes of a free body, relabelled for `free_orbit`.

The axes are right-handed. The second is the axis of the middle moment, and the third is the axis that the momentum
circles, pointing to the side of the momentum. They are chosen by comparisons of scalars, because sorting and indexing
would end the loop over the bodies.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from ..._math import components as cp


class Labels(NamedTuple):
    """The permutation from body axes to labelled axes.

    Attributes:
        forward, backward: whether the axes of the body are counted from the next or from the previous axis.
        exchanged: whether the first and the third axis are then exchanged.
        side: the sign of the third axis; the momentum is on its positive side.
    """

    forward: Array
    backward: Array
    exchanged: Array
    side: Array

    @classmethod
    def of(cls, middle: cp.Vector, weights: cp.Vector, momentum: cp.Vector) -> "Labels":
        """Labels from the unit vector along the middle axis, the weights w of `free_orbit`, and the momentum."""
        one = jnp.ones_like(momentum[0])
        labels = cls(middle[2] > 0, middle[0] > 0, one < 0, one)
        (w1, _, w3), (p1, _, p3) = labels.placed(weights), labels.placed(momentum)
        before, after = p1 * p1 * w3, p3 * p3 * w1
        # On the separatrix the momentum circles neither axis; the choice with the smaller n magnifies rounding less.
        exchanged = (before > after) | ((before == after) & (w1 > w3))
        side = jnp.where(jnp.where(exchanged, p1, p3) < 0, -one, one)
        return labels._replace(exchanged=exchanged, side=side)

    def placed(self, v: cp.Vector) -> cp.Vector:
        """Numbers given for each axis of the body, rearranged for the labelled axes."""
        return self._exchange(_rolled(self.forward, self.backward, v))

    def seen(self, v: cp.Vector) -> cp.Vector:
        """Components along the labelled axes, from components along the body axes."""
        return self._signed(self.placed(v))

    def back(self, v: cp.Vector) -> cp.Vector:
        """Components along the body axes, from components along the labelled axes."""
        return _rolled(self.backward, self.forward, self._exchange(self._signed(v)))

    def _exchange(self, v: cp.Vector) -> cp.Vector:
        return jnp.where(self.exchanged, v[2], v[0]), v[1], jnp.where(self.exchanged, v[0], v[2])

    def _signed(self, v: cp.Vector) -> cp.Vector:
        return v[0], jnp.where(self.exchanged, -self.side, self.side) * v[1], self.side * v[2]


def _rolled(forward: Array, backward: Array, v: cp.Vector) -> cp.Vector:
    x, y, z = v
    return (
        jnp.where(forward, y, jnp.where(backward, z, x)),
        jnp.where(forward, z, jnp.where(backward, x, y)),
        jnp.where(forward, x, jnp.where(backward, y, z)),
    )
