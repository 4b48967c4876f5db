"""A list of the neighbours of rigid molecules in a periodic cube, built between runs, not in them.

Molecules are neighbours if two of their sites are within the cut-off and a skin. The list is good until a site has
moved by half the skin; after that it makes forces NaN, so that a run with too old a list is not `ok`. The neighbours of
a molecule are in the order of their distance, and a force takes only as many as the sites' moves since demand.

All pairs are looked at, in one compiled loop: 15 ms for 1,728 waters. From some ten thousand molecules on, a list by
cells, such as vesin's, is faster.
"""

from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

_LEVELS = 2**16 - 1  # of distances, kept in the upper half of a number with the neighbour in the lower
_NONE = np.uint32(2**32 - 1)


class Neighbours(eqx.Module):
    """A list; a pytree, of which a new one with the same shapes needs no new compilation.

    Attributes:
        slots: of molecule i the neighbours are slots[:, i], nearest first, (m, N); i itself fills empty slots.
        nearest: no distance in a slot was less when the list was built, (m,), ascending.
        places: of the sites when it was built, (N, a, 3).
        reach: cut-off and skin, ().
    """

    slots: Array
    nearest: Array
    places: Array
    reach: Array

    def cutoff_now(self, places: Array, cutoff: float) -> Array:
        """The distance up to which slots are needed now: moves of two sites more than the cut-off; NaN if too far."""
        moved = jnp.sqrt(jnp.max(jnp.sum((places - self.places) ** 2, axis=-1)))
        needed = cutoff + 2 * moved
        return jax.lax.stop_gradient(jnp.where(needed <= self.reach, needed, jnp.nan))


def neighbour_list(places: Any, box: float, cutoff: float, skin: float, slots: int | None = None) -> Neighbours:
    """The list for these places.

    Args:
        places: of the sites, (N, a, 3), in or out of the box.
        box: the edge of the cube.
        cutoff: the largest distance of sites that act on each other.
        skin: how much further the list reaches.
        slots: how many slots the list has, an even number, so that lists of one run have one shape; by default some
            more than now needed.
    """
    places = np.asarray(places, np.float64)
    number, reach = len(places), cutoff + skin
    if box < 2 * cutoff:
        raise ValueError(
            f"box must be at least twice the cut-off, got {box:g} and {cutoff:g}: a site would see two images of "
            "another; take more molecules or a shorter cut-off."
        )
    if number > 2**16:
        raise ValueError(f"places must be of at most 65536 molecules, got {number}; take a list by cells.")
    # In units of the box as whole numbers, whose differences wrap around as the box does: that of the nearest images.
    whole = np.floor((places / box % 1) * 2**32).astype(np.int64).astype(np.int32)
    keys = np.asarray(_keys(whole, (reach / box) ** 2))
    near = keys != _NONE
    counts = near.sum(axis=1)
    slots = 2 * int(max(1, min(number, 1.06 * counts.max() + 2) // 2)) if slots is None else slots
    if counts.max() > slots or slots % 2:
        raise ValueError(
            f"slots must be even and at least {counts.max()}, the most neighbours of a molecule, got {slots}; give "
            "some more."
        )
    found = np.full((number, slots), _NONE)
    found[np.arange(slots) < counts[:, None]] = keys[near]
    found.sort(axis=1)
    others = np.where(found == _NONE, np.arange(number)[:, None], found & _LEVELS).astype(np.int32)
    nearest = reach * np.sqrt((found >> 16).min(axis=0) / _LEVELS)
    return Neighbours(jnp.asarray(others.T), jnp.asarray(nearest), jnp.asarray(places), jnp.asarray(reach))


@jax.jit
def _keys(whole: Array, square_of_reach: Any) -> Array:
    """For molecules i and j the level of the least distance of two sites and j in one number, (N, N), if in reach."""
    number, sites, _ = whole.shape
    least = jnp.full((number, number), jnp.inf, jnp.float32)
    for p, q in product(range(sites), repeat=2):
        columns = (whole[:, p, x][:, None] - whole[:, q, x][None, :] for x in range(3))
        x, y, z = (column.astype(jnp.float32) * jnp.float32(2**-32) for column in columns)
        square = x * x + y * y + z * z
        least = jnp.where(square < least, square, least)
    level = least * jnp.asarray(_LEVELS / square_of_reach, jnp.float32)
    other = jnp.arange(number, dtype=jnp.uint32)[None, :]
    near = (level < _LEVELS) & (other != other.T)
    key = jnp.where(near, level, 0).astype(jnp.uint32) * jnp.uint32(2**16) + other
    return jnp.where(near, key, jnp.uint32(_NONE))
