"""`Travel`: where a body is at the frames of an animation, and how much larger than it is it must be drawn to be seen.

An orbit is millions of times as large as a satellite. So the body is drawn larger than it is, by a round number that
the picture tells, while path and axes keep one scale.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..model.free_body import FreeBody
from ..model.states import TravellingState
from .around import unwrapped, wrapped
from .curves import limits_around
from .motion import Motion
from .shape import CORNER, Shape

SEEN = 0.11  # the length of the drawn axis over the size of the path, where the body must be drawn larger than it is
_AT_REST = 0.02  # a path that is smaller than this, relative to the body, is not shown


class Room(NamedTuple):
    """What bodies share that are drawn together.

    Attributes:
        extent: the size of all their tracks.
        largest: the distance of the outermost corner of the largest of them from its middle.
        apart: how far they are from each other, at first; drawn larger they leave half of it between them.
        box: the periodic box in which they are shown, (2, 3).
    """

    extent: float
    largest: float
    apart: float
    box: np.ndarray | None = None

    @property
    def magnification(self) -> float:
        """How many times as large as they are the bodies are drawn."""
        return _round_number(min(SEEN * CORNER * self.extent, self.apart / 4) / self.largest)


class Travel(NamedTuple):
    """The place of a body.

    Attributes:
        track: the positions of the centre of mass at the saved times, (n, 3); without jumps from wall to wall.
        centres: those at the frames, (k, 3).
        size: the length of the drawn axis of the body, in the units of the positions.
        magnified: how many times as large as the body it is drawn.
        box: the periodic box in which it is shown, (2, 3).
    """

    track: np.ndarray
    centres: np.ndarray
    size: float
    magnified: float
    box: np.ndarray | None = None

    @property
    def in_words(self) -> str:
        """What the picture says about the size of the body; "" if it is drawn as large as it is."""
        if self.magnified == 1:
            return ""
        return f"body x {self.magnified:,.0f}" if self.magnified < 1e9 else f"body x {self.magnified:.0e}"

    @property
    def limits(self) -> np.ndarray:
        """The least and the largest coordinates of the picture, (2, 3)."""
        return limits_around(self.track if self.box is None else self.box, 1.05 * self.size)


def room_of(
    bodies: Sequence[FreeBody], tracks: Sequence[np.ndarray], shapes: Sequence[Shape], box: np.ndarray | None = None
) -> Room:
    """The room of bodies, each with a track (n, 3)."""
    if box is not None:
        tracks = [np.concatenate([wrapped(track, box), box]) for track in tracks]
    extent = float(np.max(np.ptp(np.concatenate(tracks), axis=0)))
    return Room(extent, max(map(_size, bodies, shapes)), apart_by(np.stack([track[0] for track in tracks])), box)


def apart_by(places: np.ndarray) -> float:
    """The median distance of a place (n, 3) to the nearest other one."""
    if len(places) < 2:
        return np.inf
    squares = np.sum(places**2, axis=1)
    squared = squares[:, None] + squares - 2 * places @ places.T
    np.fill_diagonal(squared, np.inf)
    return float(np.sqrt(np.median(np.maximum(squared.min(axis=1), 0.0))))


def _size(body: FreeBody, shape: Shape) -> float:
    """The distance of the outermost corner of a body from its middle."""
    return shape.reach / float(body.mass) ** 0.5


def travel_of(
    body: Any,
    motion: Motion,
    shape: Shape,
    before: np.ndarray,
    after: np.ndarray,
    share: np.ndarray,
    room: Room | None = None,
) -> Travel | None:
    """Where the body is at the frames; None if it does not travel, or by less than can be seen.

    Args:
        body: one body.
        motion: its motion.
        shape: its shape.
        before, after: for each frame the indices of the saved states on either side of it, (k,).
        share: how far each frame is on the way from one to the other, (k,).
        room: that of bodies drawn together, which all have a place.
    """
    states = motion.states
    if not isinstance(states, TravellingState) or not isinstance(body, FreeBody):
        return None
    track = np.asarray(states.position, float)
    own = _size(body, shape)
    if room is None:
        room = room_of([body], [track], [shape])
        if room.extent < _AT_REST * own:
            return None
    track = track if room.box is None else unwrapped(track, room.box)
    centres = track[before] + share[:, None] * (track[after] - track[before])
    centres = centres if room.box is None else wrapped(centres, room.box)
    return Travel(track, centres, room.magnification * own / CORNER, room.magnification, room.box)


def _round_number(wanted: float) -> float:
    """The largest of 1, 2, 5, 10, 20, 50, ... that is not above the number; 1 for smaller ones."""
    if wanted <= 1:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)))
