"""`Together`: what one panel of an animation shows: one body, or several in one space."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..model.compatibility import check_body
from ..model.states import Coupled
from .around import NOTHING, Around
from .motion import motion_of, path_of_one
from .several import Panel, each_body
from .shape import CORNER, shape_of
from .style import FEW, ORANGE, SKY, VERMILLION, colours_of
from .travel import SEEN, apart_by, room_of
from .turning import Moving, Turning, turnings

_MOST_TRACKS = 36  # thin lines that can be followed


class Together(NamedTuple):
    """The bodies of one panel, at the same times.

    Attributes:
        members: the bodies.
        colours: one for each.
        names: the names of paths drawn in one space, one for each, "" for one that has none; () for coupled bodies.
        around: what stands around them.
    """

    members: tuple[Turning, ...]
    colours: tuple[str, ...]
    names: tuple[str, ...] = ()
    around: Around = NOTHING

    @property
    def alone(self) -> bool:
        """Whether there is one body."""
        return len(self.members) == 1

    @property
    def has_tracks(self) -> bool:
        """Whether tracks are drawn: in the colours of a few bodies, thin and grey those of more that do not meet."""
        return self.around.box is None and (self.few or (bool(self.names) and len(self.members) <= _MOST_TRACKS))

    def named(self, i: int) -> str:
        """What body i is called."""
        return (self.names[i] if self.names else "") or f"body {i}"

    @property
    def few(self) -> bool:
        """Whether each body has a colour that is told from the others, so that its axis and its track are drawn."""
        return len(self.members) <= FEW

    @property
    def solid(self) -> bool:
        """Whether the bodies are drawn as solids; otherwise as points."""
        return bool(self.members[0].shape.faces)

    def sites(self, k: int) -> list[np.ndarray]:
        """The corners or the points of each body at frame k, in space."""
        return [member.placed(k, member.corners[k]) for member in self.members]

    def sticks(self, k: int) -> list[np.ndarray]:
        """The lines (2, 3) from the first point of each body to the others."""
        return [np.stack([own[0], other]) for own in self.sites(k) for other in own[1:]]

    @property
    def colours_of_sites(self) -> list[str]:
        """A colour for each point: that of its body; of many bodies, one for their first points and one for others."""
        pairs = [(colour, k) for colour, own in zip(self.colours, self.sites(0), strict=True) for k in range(len(own))]
        return [colour if self.few else SKY if k else VERMILLION for colour, k in pairs]

    @property
    def times(self) -> np.ndarray:
        """The times of the frames, (k,)."""
        return self.members[0].times

    @property
    def remarks(self) -> tuple[str, ...]:
        """Texts to be written on the picture: those of the body that turns fastest, and whether paths are shorter."""
        fastest = max(self.members, key=lambda member: member.per_frame)
        ends = [member.until for member in self.members if member.until]
        if len(self.members) == 1 or not ends or (set(ends) == {fastest.until} and len(ends) == len(self.members)):
            return fastest.remarks
        failed = [end for end in ends if end.startswith("FAILED")]
        what = f"{len(failed)} of {len(self.members)} FAILED" if failed else f"{len(ends)} are not there all the time"
        return (what, *(remark for remark in fastest.remarks if remark != fastest.until))

    @property
    def limits(self) -> np.ndarray | None:
        """The least and the largest coordinates of the picture, (2, 3); None if the body stays where it is."""
        own = [member.travel.limits for member in self.members if member.travel is not None]
        if own and self.around.planet is not None:
            own.append(1.05 * self.around.planet * np.array([[-1.0] * 3, [1.0] * 3]))
        return np.stack([np.min(own, axis=0)[0], np.max(own, axis=0)[1]]) if own else None


def togethers(
    panels: Sequence[Panel],
    axis: Any,
    frames: Any,
    most: int,
    points: Any = None,
    *,
    around: Around = NOTHING,
    in_one: bool = False,
) -> list[Together]:
    """The bodies of the panels, at the times of the frames; see `turnings`.

    Args:
        panels: those of a coupled path show all bodies of it.
        axis, frames, most: as for `turnings`.
        points: places in the frame of the body, (a, 3), that are drawn in place of a solid.
        around: what stands around the bodies.
        in_one: whether the bodies of all panels are drawn in one space.
    """
    groups = [_all_in_one(panels, points, around)] if in_one else [_members(one, points, around) for one in panels]
    names = tuple(panel.name for panel in panels) if in_one else ()
    flat = iter(turnings([one for group in groups for one in group], axis, frames, most))
    found = list[Together]()
    for group in groups:
        members = tuple(next(flat) for _ in group)
        colours = (ORANGE,) if len(group) == 1 else tuple(colours_of(len(group)))
        found.append(Together(members, colours, names, around))
    return found


def _members(panel: Panel, points: Any, around: Around) -> list[Moving]:
    """The bodies of a panel; those of a coupled path share the room that they need."""
    states: Any = getattr(panel.path, "states", None)
    if not isinstance(states, Coupled):
        if around.box is not None or around.planet is not None:
            return _all_in_one([panel], points, around)
        return [Moving(panel.body, panel.path, None if points is None else shape_of(panel.body, points))]
    drawn: Any = motion_of(panel.path, together=True).states
    check_body(panel.body, states)
    bodies = each_body(panel.body, states.count)
    shapes = [shape_of(body, points) for body in bodies]
    tracks = list(np.moveaxis(np.asarray(drawn.position, float), 1, 0))
    room = room_of(bodies, tracks, shapes, around.box)
    return [
        Moving(body, path_of_one(panel.path, i), shape, room)
        for i, (body, shape) in enumerate(zip(bodies, shapes, strict=True))
    ]


def _all_in_one(panels: Sequence[Panel], points: Any, around: Around) -> list[Moving]:
    """Bodies that do not act on each other, in one room."""
    bodies, paths = [panel.body for panel in panels], [panel.path for panel in panels]
    states: list[Any] = [motion_of(path).states for path in paths]
    for body, one in zip(bodies, states, strict=True):
        check_body(body, one)
    shapes = [shape_of(body, points) for body in bodies]
    tracks = [np.asarray(one.position, float) for one in states]
    room = room_of(bodies, tracks, shapes, around.box)
    # They need no gaps, because they do not meet. All may begin at one place, and then they are not shown apart.
    last = apart_by(np.stack([track[-1] for track in tracks]))
    apart = 2 * max(room.apart, last, SEEN * CORNER * room.extent)
    return [
        Moving(body, path, shape, room._replace(apart=apart))
        for body, path, shape in zip(bodies, paths, shapes, strict=True)
    ]
