"""`Around`: what stands around bodies that travel: a planet at the origin, or the walls of a periodic box."""

from collections.abc import Iterable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from .._checks.arguments import as_floats
from ..model.states import TravellingState
from .shape import CORNERS

_SMOOTH = (12, 24)  # how many steps the surface of a planet has from pole to pole, and around


class Around(NamedTuple):
    """What stands around the bodies of a picture.

    Attributes:
        box: the least and the largest corner of a periodic box, (2, 3).
        planet: the radius of a ball at the origin.
    """

    box: np.ndarray | None = None
    planet: float | None = None

    def hidden(self, points: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Which of the points (..., 3) the planet hides from a viewer in the direction `out` (3,), far away."""
        if self.planet is None:
            return np.zeros(points.shape[:-1], bool)
        depth = points @ out
        return (depth < 0) & (np.sum(points**2, axis=-1) - depth**2 < self.planet**2)

    @property
    def edges(self) -> list[np.ndarray]:
        """The twelve edges of the box, each as two corners (2, 3); none if there is no box."""
        if self.box is None:
            return []
        corners = self.box.mean(axis=0) + CORNERS * np.ptp(self.box, axis=0) / 2
        pairs = [pair for pair in combinations(range(8), 2) if np.sum(CORNERS[pair[0]] != CORNERS[pair[1]]) == 1]
        return [corners[list(pair)] for pair in pairs]


NOTHING = Around()


def around_of(box: Any, planet: Any, paths: Iterable[Any]) -> Around:
    """What stands around the bodies.

    Args:
        box, planet: the arguments of `animate` and `view`.
        paths: those of the bodies.

    Raises:
        ValueError: the box or the radius of the planet is wrong, or a state has no place.
    """
    for name, given in (("box", box), ("planet", planet)):
        still = [path for path in paths if not isinstance(getattr(path, "states", None), TravellingState)]
        if given is not None and still:
            kind = type(getattr(still[0], "states", None)).__name__
            raise ValueError(f"{name} needs bodies with a place, such as a FreeState, got a {kind}.")
    return Around(None if box is None else _box(box), None if planet is None else _radius(planet))


def _box(given: Any) -> np.ndarray:
    corners = np.asarray(as_floats("box", given), float)
    if corners.shape != (2, 3):
        raise ValueError(
            "box must be the least and the largest corner, (2, 3): [[0, 0, 0], [L, L, L]] for a box that begins at the "
            f"origin, [[-L/2] * 3, [L/2] * 3] for one around it; got {corners.shape}."
        )
    if not np.all(np.isfinite(corners)) or np.any(corners[1] <= corners[0]):
        raise ValueError(f"box must have its least corner first and its largest second, got {corners.tolist()}.")
    return corners


def _radius(given: Any) -> float:
    radius = np.asarray(as_floats("planet", given), float)
    if radius.shape != () or not 0 < radius < np.inf:
        raise ValueError(f"planet must be the radius of the planet, a positive number, got {given!r}.")
    return float(radius)


def unwrapped(track: np.ndarray, box: np.ndarray) -> np.ndarray:
    """The track (n, 3) of a body without the jumps to the other side of the box.

    From one saved state to the next the body moves by less than half the box, or this cannot be known.
    """
    size, steps = np.ptp(box, axis=0), np.diff(track, axis=0)
    return np.concatenate([track[:1], track[:1] + np.cumsum(steps - size * np.round(steps / size), axis=0)])


def wrapped(places: np.ndarray, box: np.ndarray) -> np.ndarray:
    """The places (n, 3) in the box."""
    return box[0] + np.mod(places - box[0], np.ptp(box, axis=0))


def ball(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A ball around the origin: its points (p, 3), and its triangles as indices of them, (t, 3)."""
    rows, columns = _SMOOTH
    polar, azimuth = np.linspace(0, np.pi, rows + 1)[:, None], 2 * np.pi * np.arange(columns) / columns
    points = np.stack(np.broadcast_arrays(
        np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    ), axis=-1).reshape(-1, 3)  # fmt: skip
    row, column = (index.ravel() for index in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    first, beside = row * columns + column, row * columns + (column + 1) % columns
    lower, across = first + columns, beside + columns
    return radius * points, np.concatenate([np.stack([first, lower, across], 1), np.stack([first, across, beside], 1)])
