"""A list of the neighbours of rigid molecules in a periodic cube, built between runs, not in them.

Molecules are neighbours if two of their sites are within the cut-off and a skin. The list is good until a site has
moved by half the skin. All pairs are looked at, in one compiled loop: 12 ms for 1,728 waters. From some ten thousand
molecules on, a list by cells, such as vesin's, is faster.
"""

from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def neighbour_list(places: Any, box: float, cutoff: float, skin: float, slots: int | None = None) -> np.ndarray:
    """For molecule i its neighbours in [:, i], and i itself in the slots that are left.

    Args:
        places: of the sites, (N, a, 3), in or out of the box.
        box: the edge of the cube.
        cutoff: the largest distance of sites that act on each other.
        skin: how much further the list reaches.
        slots: how many slots the list has, so that lists of one run have one shape; by default some more than now
            needed, as every slot takes its time.

    Returns:
        (slots, N), int32.

    Raises:
        ValueError: the box is smaller than twice the cut-off, or there are too few slots.
    """
    places = np.asarray(places, np.float64)
    if box < 2 * cutoff:
        raise ValueError(
            f"box must be at least twice the cut-off, got {box:g} and {cutoff:g}: a site would see two images of "
            "another; take more molecules or a shorter cut-off."
        )
    # In units of the box as whole numbers, whose differences wrap around as the box does: that of the nearest images.
    whole = np.floor((places / box % 1) * 2**32).astype(np.int64).astype(np.int32)
    near = np.asarray(_near(whole, ((cutoff + skin) / box) ** 2))
    counts = near.sum(axis=1)
    slots = max(1, min(len(places) - 1, int(1.04 * counts.max()))) if slots is None else slots
    if counts.max() > slots:
        raise ValueError(
            f"slots must be at least {counts.max()}, the most neighbours of a molecule, got {slots}; give some more."
        )
    found = np.tile(np.arange(len(places), dtype=np.int32)[:, None], (1, slots))
    found[np.arange(slots) < counts[:, None]] = np.flatnonzero(near) % len(places)
    return np.ascontiguousarray(found.T)


def farthest_move(before: Any, after: Any) -> float:
    """The longest way of a site, (N, a, 3), since its list was built; the list was good if it is below skin / 2."""
    return float(np.sqrt(np.max(np.sum((np.asarray(after) - np.asarray(before)) ** 2, axis=-1))))


@jax.jit
def _near(whole: Array, square_of_reach: float) -> Array:
    """Whether molecules i and j, (N, N), i != j, have two sites within reach."""
    number, sites, _ = whole.shape
    near = jnp.zeros((number, number), bool)
    for p, q in product(range(sites), repeat=2):
        columns = (whole[:, p, x][:, None] - whole[:, q, x][None, :] for x in range(3))
        x, y, z = (column.astype(jnp.float32) * jnp.float32(2**-32) for column in columns)
        near = near | (x * x + y * y + z * z < jnp.asarray(square_of_reach, jnp.float32))
    return near & ~jnp.eye(number, dtype=bool)
