"""`Neighbours`: which molecules of a periodic box are near to each other, found between compiled runs.

The list holds until a site has moved by half the skin. After that it makes forces NaN, so a run with an old list is not
`ok`. A force reads only as many neighbours, nearest first, as the moves of the sites require.
"""

from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from .._checks.arguments import require_finite

_LEVELS = 2**16 - 1  # of distances, kept in the upper half of a number with the neighbour in the lower
_NONE = np.uint32(2**32 - 1)
_SPARE = 1.3  # slots for each neighbour of now, so that later lists fit; empty slots are skipped


class Neighbours(eqx.Module):
    """A neighbour list, a pytree: another list of the same shape needs no new compilation.

    Attributes:
        slots: the neighbours of molecule i are slots[:, i], nearest first, (m, N), m even; i itself fills empty slots.
        nearest: the smallest distance in each slot when the list was built, (m,), ascending.
        places: the sites when the list was built, (N, a, 3).
        reach: the distance up to which sites were found, ().

    Examples:
        >>> places = jnp.array([[[0.0, 0.0, 0.0]], [[0.9, 0.0, 0.0]], [[0.5, 0.0, 0.0]]])  # three atoms
        >>> near = ml.molecules.Neighbours.of(places, box=1.0, reach=0.2)
        >>> near.slots[0]  # the first two are neighbours through the wall; the third has none
        Array([1, 0, 2], dtype=int32)
    """

    slots: Int[Array, "slots molecules"]
    nearest: Float[Array, "slots"]
    places: Float[Array, "molecules points 3"]
    reach: Float[Array, ""]

    @classmethod
    def of(cls, places: Any, box: Any, reach: float, slots: int = 0) -> "Neighbours":
        """The list of molecules with these sites.

        Args:
            places: of the sites, (N, a, 3), inside or outside the box.
            box: the edges, (3,), or one for a cube; each at least twice the reach of the force.
            reach: the distance up to which sites are found, the cut-off of the force plus a skin.
            slots: the least number of slots; lists of one run should have one shape.

        Raises:
            ValueError: more than 65,536 molecules, or places that are not finite.
        """
        dtype = jnp.asarray(places).dtype
        places, edges = np.asarray(places, np.float64), np.broadcast_to(np.asarray(box, np.float64), (3,))
        number = len(places)
        if number > _LEVELS + 1:
            raise ValueError(f"places must hold at most {_LEVELS + 1} molecules, got {number}. Use a cell list.")
        require_finite("places", places)
        whole = np.floor(np.mod(places / edges + 0.5, 1) * 2**32 - 2**31).astype(np.int64).astype(np.int32)
        keys = np.asarray(_keys(whole, np.asarray(edges / reach, np.float32)))
        near = keys != _NONE
        counts = near.sum(axis=1)
        slots = max(slots + slots % 2, 2 * int(max(2, min(number, _SPARE * counts.max() + 3)) // 2))
        found = np.full((number, slots), _NONE)
        found[np.arange(slots) < counts[:, None]] = keys[near]
        found.sort(axis=1)
        others = np.where(found == _NONE, np.arange(number)[:, None], found & _LEVELS).astype(np.int32)
        nearest = reach * np.sqrt((found >> 16).min(axis=0) / _LEVELS)
        return cls(
            *(jnp.asarray(others.T), jnp.asarray(nearest, dtype), jnp.asarray(places, dtype)), jnp.asarray(reach, dtype)
        )

    def moved(self, places: Array) -> Float[Array, ""]:
        """The largest move of a site since the list was built."""
        return jnp.sqrt(jnp.max(jnp.sum((places - self.places) ** 2, axis=-1)))

    def reach_now(self, places: Array, cutoff: float) -> Float[Array, ""]:
        """The distance up to which slots are read now: the cut-off plus the moves of two sites; NaN if too far."""
        needed = cutoff + 2 * self.moved(places)
        return jax.lax.stop_gradient(jnp.where(needed <= self.reach, needed, jnp.nan))


@jax.jit
def _keys(whole: Array, edges: Array) -> Array:
    """For molecules i and j the level of the least distance of two sites and j in one number, (N, N), if in reach.

    The sites are whole numbers in units of the box, whose differences wrap around as the box does; `edges` are in
    reaches.
    """
    number, sites, _ = whole.shape
    least = jnp.full((number, number), jnp.inf, jnp.float32)
    for p, q in product(range(sites), repeat=2):
        ways = [whole[:, p, x][:, None] - whole[:, q, x][None, :] for x in range(3)]
        x, y, z = (way.astype(jnp.float32) * (edges[k] * 2**-32) for k, way in enumerate(ways))
        square = x * x + y * y + z * z
        least = jnp.where(square < least, square, least)
    level = least * jnp.float32(_LEVELS)
    other = jnp.arange(number, dtype=jnp.uint32)[None, :]
    near = (level < _LEVELS) & (other != other.T)
    key = jnp.where(near, level, 0).astype(jnp.uint32) * jnp.uint32(2**16) + other
    return jnp.where(near, key, jnp.uint32(_NONE))
