"""`Together`: what one panel of an animation shows: one body, or in one space all bodies that act on each other."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..model.states import Coupled
from .motion import motion_of
from .several import Panel, each_body, path_of_one
from .shape import shape_of
from .style import FEW, ORANGE, SKY, VERMILLION, colours_of
from .travel import room_of
from .turning import Moving, Turning, turnings


class Together(NamedTuple):
    """The bodies of one panel, at the same times.

    Attributes:
        members: the bodies.
        colours: one for each.
    """

    members: tuple[Turning, ...]
    colours: tuple[str, ...]

    @property
    def alone(self) -> bool:
        """Whether there is one body."""
        return len(self.members) == 1

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
        """Texts to be written on the picture: those of the body that turns fastest."""
        return max(self.members, key=lambda member: member.per_frame).remarks

    @property
    def limits(self) -> np.ndarray | None:
        """The least and the largest coordinates of the picture, (2, 3); None if the body stays where it is."""
        own = [member.travel.limits for member in self.members if member.travel is not None]
        return np.stack([np.min(own, axis=0)[0], np.max(own, axis=0)[1]]) if own else None


def togethers(panels: Sequence[Panel], axis: Any, frames: Any, most: int, points: Any = None) -> list[Together]:
    """The bodies of the panels, at the times of the frames; see `turnings`.

    Args:
        panels: those of a coupled path show all bodies of it.
        axis, frames, most: as for `turnings`.
        points: places in the frame of the body, (a, 3), that are drawn in place of a solid.
    """
    groups = [_members(panel, points) for panel in panels]
    flat = iter(turnings([one for group in groups for one in group], axis, frames, most))
    found = list[Together]()
    for group in groups:
        members = tuple(next(flat) for _ in group)
        found.append(Together(members, (ORANGE,) if len(group) == 1 else tuple(colours_of(len(group)))))
    return found


def _members(panel: Panel, points: Any) -> list[Moving]:
    """The bodies of a panel; those of a coupled path share the room that they need."""
    states: Any = getattr(panel.path, "states", None)
    if not isinstance(states, Coupled):
        return [Moving(panel.body, panel.path, None if points is None else shape_of(panel.body, points))]
    drawn: Any = motion_of(panel.path, together=True).states
    bodies = each_body(panel.body, states.count)
    shapes = [shape_of(body, points) for body in bodies]
    room = room_of(bodies, np.asarray(drawn.position, float), shapes)
    return [
        Moving(body, path_of_one(panel.path, i), shape, room)
        for i, (body, shape) in enumerate(zip(bodies, shapes, strict=True))
    ]
