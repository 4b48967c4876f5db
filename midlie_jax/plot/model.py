"""`Scene`: one panel of a GIF or an HTML view: bodies at evenly spaced times, in a box, about a planet.

`panels` and `around_of` check the arguments of `animate` and `view`, `turnings` moves single bodies to the times of the
frames, and `scenes` gathers the bodies of each panel.
"""

import pathlib
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from math import ceil
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count, as_floats
from ..drivers.path import Path
from ..model import so3
from ..model.bodies import Body, RigidBody, SymmetricRotor, TensorBody
from ..model.compatibility import check_body
from ..model.free_body import FreeBody
from ..model.state import attitude_of
from ..model.states import AxisState, Coupled, TravellingState
from ..model.surface import Surface
from .curves import as_axis, limits_around
from .motion import Motion, OrientedState, motion_of, path_of_one, to_matrix
from .solids import CORNER, CORNERS, Shape, shape_of
from .style import BLUE, FEW, ORANGE, SKY, VERMILLION, colours_of

_MOST, _MOST_TOGETHER = 12, 500  # panels of a picture, and bodies in one space
_MOST_TRACKS = 36  # thin lines that can be distinguished
_ROW = 4  # the most panels in a row
_RESOLVED = np.pi / 2  # radians: up to this rotation between saved states, attitudes between them are unambiguous
_SEEN = 0.11  # length of the drawn axis over the size of the path, if the body must be drawn larger than it is
_AT_REST = 0.02  # a smaller path, relative to the body, is not shown

Turns = RigidBody | TensorBody | SymmetricRotor | FreeBody
Bodies = Turns | Sequence[Turns]
OnePath = Path[OrientedState]
Paths = OnePath | Mapping[str, OnePath] | Sequence[OnePath]

# Compiled, because a picture calls them for each body.
_slerp = jax.jit(so3.slerp)
_spatial_momentum = jax.jit(lambda states: states.spatial_momentum())


class Panel(NamedTuple):
    """The name, which may be "", the body or the coupled bodies, and the path of one panel; the shape of the body."""

    name: str
    body: Any
    path: Any
    shape: Shape | None = None  # by default a solid
    magnified: float | None = None  # magnification of bodies that share one space
    box: np.ndarray | None = None


def panels(body: Any, path: Any, together: bool = False) -> list[Panel]:
    """The panels of a picture, in order, for the arguments of `animate` and `view`.

    Bodies of an ensemble are named by their index. Coupled bodies that translate share one panel; others have one each.
    """
    most = _MOST_TOGETHER if together else _MOST
    names, paths = _named(path, most)
    states = [getattr(one, "states", None) for one in paths]
    free = [isinstance(one, TravellingState) and not isinstance(one, Coupled) for one in states]
    if not paths:
        raise ValueError("path must hold at least one path, got none. Give a path, or a mapping of names to paths.")
    if len(names) > most:
        cure = ", or set together=True to draw bodies in one space" * all(free)
        raise ValueError(f"path must hold at most {most} paths, got {len(names)}. Choose some of them{cure}.")
    if together and not all(free):
        one = states[free.index(False)]
        why = "whose bodies are drawn together without it" if isinstance(one, Coupled) else "which has no position"
        raise ValueError(f"together must be False for a {type(one).__name__}, {why}.")
    coupled = any(isinstance(one, Coupled) for one in states)
    if isinstance(body, Sequence):
        bodies = list(body)
    elif len(paths) > 1 and isinstance(body, Body) and len(body.batch) == 1 + coupled:
        bodies = _each_body(body, body.batch[0])
    else:
        bodies = [body] * len(paths)
    if len(bodies) != len(paths):
        raise ValueError(f"body must be one body, or one for each of the {len(paths)} paths, got {len(bodies)}.")
    return [Panel(*panel) for panel in zip(names, bodies, paths, strict=True)]


def grid(count: int) -> tuple[int, int]:
    """The numbers of rows and columns of a picture with `count` panels."""
    rows = ceil(count / _ROW)
    return rows, ceil(count / rows)


def _named(path: Any, most: int) -> tuple[list[str], list[Any]]:
    if isinstance(path, Mapping):
        return [str(name) for name in path], list(path.values())
    if isinstance(path, Sequence) and not hasattr(path, "states"):  # a path is a tuple as well
        return [""] * len(path), list(path)
    states: Any = getattr(path, "states", None)
    momentum: Any = getattr(states, "momentum", 0.0)
    shape, coupled = np.shape(momentum), isinstance(states, Coupled)
    if len(shape) == 3 + coupled:
        word, count, one = "replica" if coupled else "body", shape[0], _row
    elif coupled and not isinstance(states, TravellingState):
        word, count, one = "body", states.count, path_of_one
    else:
        return [""], [path]
    return [f"{word} {k}" for k in range(count)], [one(path, k) for k in range(min(count, most + 1))]


def _row(path: Any, k: int) -> Any:
    """The path of body k of an ensemble, whose bodies may share their times."""
    times = path.times[k] if np.ndim(path.times) == 2 else path.times
    rest = jax.tree.map(lambda x: x[k] if np.ndim(x) else x, path._replace(times=()))
    return rest._replace(times=times)


def _each_body(body: Any, count: int) -> list[Any]:
    return [jax.tree.map(lambda x, i=i: x[i], body) if body.batch else body for i in range(count)]


def picture_file(file: str | pathlib.Path, ending: str) -> pathlib.Path:
    """The file to write; raises a ValueError if its name has another ending."""
    target = pathlib.Path(file)
    if target.suffix.lower() != ending:
        raise ValueError(
            f"file must end in {ending}, got {str(file)!r}. midlie_jax.plot.animate writes a .gif, view an .html."
        )
    return target


class Around(NamedTuple):
    """The lowest and the highest corner of a periodic box, (2, 3), and the radius of a planet at the origin."""

    box: np.ndarray | None = None
    planet: float | None = None

    def hidden(self, points: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Whether the planet hides each of the points (..., 3) from a distant viewer in the direction `out` (3,)."""
        if self.planet is None:
            return np.zeros(points.shape[:-1], bool)
        depth = points @ out
        return (depth < 0) & (np.sum(points**2, axis=-1) - depth**2 < self.planet**2)

    @property
    def edges(self) -> list[np.ndarray]:
        """The twelve edges of the box, each as two corners (2, 3); none without a box."""
        if self.box is None:
            return []
        corners = self.box.mean(axis=0) + CORNERS * np.ptp(self.box, axis=0) / 2
        pairs = [pair for pair in combinations(range(8), 2) if np.sum(CORNERS[pair[0]] != CORNERS[pair[1]]) == 1]
        return [corners[list(pair)] for pair in pairs]


NOTHING = Around()


def around_of(box: Any, planet: Any, paths: Iterable[Any]) -> Around:
    """`Around`, for the arguments of `animate` and `view`; a ValueError if one is wrong, or a state has no position."""
    kinds = [type(getattr(path, "states", None)) for path in paths]
    still = [kind.__name__ for kind in kinds if not issubclass(kind, TravellingState)]
    for name, given in (("box", box), ("planet", planet)):
        if given is not None and still:
            raise ValueError(f"{name} must be left out without positions, got a {still[0]}. Use a FreeState.")
    if box is not None:
        box = np.asarray(as_floats("box", box), float)
        if box.shape != (2, 3):
            raise ValueError(
                f"box must be the least and the largest corner, (2, 3), got {box.shape}. "
                "Give [[0, 0, 0], [L, L, L]], for example."
            )
        if not np.all(np.isfinite(box)) or np.any(box[1] <= box[0]):
            raise ValueError(f"box must have its least corner first and its largest second, got {box.tolist()}.")
    if planet is not None:
        radius = as_floats("planet", planet)
        if radius.shape != () or not 0 < radius < np.inf:
            raise ValueError(f"planet must be the radius of the planet, a positive number, got {planet!r}.")
        planet = float(radius)
    return Around(box, planet)


class Travel(NamedTuple):
    """The position of a body, which may be drawn larger than it is, because an orbit is long."""

    track: np.ndarray  # the positions at the saved times, (n, 3); without jumps between walls
    centres: np.ndarray  # the positions at the frames, (k, 3)
    size: float  # the length of the drawn axis of the body, in the units of the positions
    magnified: float
    limits: np.ndarray  # the lowest and the highest coordinates of the picture, (2, 3)


class Turning(NamedTuple):
    """A body at the times of the k frames; its vectors are in space, relative to its middle."""

    times: np.ndarray  # of the frames, (k,)
    shape: Shape
    corners: np.ndarray  # (k, c, 3)
    tips: np.ndarray  # the end of the drawn axis, a unit vector, (k, 3)
    inside: float  # the share of the axis that is inside the body
    momenta: np.ndarray  # the angular momentum over its largest length along the path, (k, 3)
    path_times: np.ndarray  # the saved times of the drawn states, (n,)
    path_tips: np.ndarray  # `tips` at the saved times, (n, 3)
    path_momenta: np.ndarray  # `momenta` at the saved times, (n, 3)
    axis: str  # the name of the axis
    remarks: tuple[str, ...]  # texts on the picture
    travel: Travel | None  # None if the body does not translate
    per_frame: float  # rotations from frame to frame
    until: str  # the first of the remarks if the path does not span the picture; otherwise ""

    def placed(self, k: int, points: np.ndarray) -> np.ndarray:
        """Points relative to the middle of the body, at their positions in the picture of frame k."""
        return points if self.travel is None else self.travel.centres[k] + self.travel.size * points


def turnings(moving: Sequence[Panel], axis: Any, frames: Any, most: int) -> list[Turning]:
    """Single bodies at the same evenly spaced times, from the first of all their paths to the last.

    Between saved states a body is assumed to rotate at a constant rate. If it rotates by more than a right angle
    between two saved states, the attitudes between them are unknown, and the frames show the nearest saved states. A
    body whose path ends before the others does not move after its end.
    """
    count = as_count("frames", frames)
    if count < 2:
        raise ValueError("frames must be at least 2, got 1.")
    if count > most:
        raise ValueError(f"frames must be at most {most}, got {count}. Show a part of the path.")
    moved = [one._replace(shape=one.shape or shape_of(one.body)) for one in moving]
    axis = as_axis(axis)
    motions = [motion_of(one.path) for one in moved]
    signs = {bool(motion.times[-1] > motion.times[0]) for motion in motions}
    if len(signs) > 1:
        raise ValueError(
            "path must hold paths that all go forward in time, or all backward. Show others in a picture of their own."
        )
    first, last = (min, max) if signs.pop() else (max, min)
    times = np.linspace(first(m.times[0] for m in motions), last(m.times[-1] for m in motions), count)
    return [_turning(one, motion, axis, times) for one, motion in zip(moved, motions, strict=True)]


def _turning(moving: Panel, motion: Motion, axis: tuple[np.ndarray, str], times: np.ndarray) -> Turning:
    direction, name = axis
    path_tips = motion.directions(direction)  # raises before the body is compared with the states
    check_body(moving.body, motion.states)
    speeds = np.linalg.norm(np.asarray(jax.vmap(moving.body.turning.velocity)(motion.turning.momentum)), axis=1)
    angles = (speeds[:-1] + speeds[1:]) / 2 * np.abs(np.diff(motion.times))  # approximate, of the body or of its axis
    # Sorted by ascending time, because a run may be backward.
    order = np.argsort(motion.times)
    ascending = motion.times[order]
    within = np.clip(times, ascending[0], ascending[-1])
    place = np.clip(np.searchsorted(ascending, within, side="right") - 1, 0, len(order) - 2)
    share = (within - ascending[place]) / np.diff(ascending)[place]
    until = motion.failed
    if not until and np.any(within != times):
        until = f"from t = {motion.times[0]:.6g} to {motion.times[-1]:.6g}"
    remarks = [until] if until else []
    if np.max(angles) > _RESOLVED:
        share = np.round(share)
        remarks.append("frames are saved states")
    moving_frames = np.ptp(within) / (abs(times[-1] - times[0]) / (len(times) - 1))
    per_frame = float(np.sum(angles)) / moving_frames / (2 * np.pi)
    if per_frame > 0.25:
        remarks.append(f"{per_frame:.2g} turns from frame to frame")
    between = order[place], order[place + 1], share
    shape: Any = moving.shape
    travel = _travel(moving, motion, *between)
    if travel is not None and (factor := travel.magnified) != 1:
        remarks.append(f"body x {factor:,.0f}" if factor < 1e9 else f"body x {factor:.0e}")
    rotations = _rotations(motion.turning, *between)
    momenta = np.asarray(_spatial_momentum(motion.turning), float)
    momenta = momenta / max(float(np.max(np.linalg.norm(momenta, axis=1))), np.finfo(float).tiny)
    at_frames = np.stack([np.interp(within, ascending, momenta[order, i]) for i in range(3)], axis=1)
    corners, tips = np.einsum("kij,cj->kci", rotations, shape.corners), rotations @ direction
    frames = times, shape, corners, tips, shape.inside(direction), at_frames
    return Turning(*frames, motion.times, path_tips, momenta, name, tuple(remarks), travel, per_frame, until)


def _rotations(states: Any, before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The rotation matrices (k, 3, 3) between saved states, given by their indices; the spin of an axis is chosen."""
    if isinstance(states, AxisState):
        # Interpolated first: the chosen attitudes jump where the axis passes through -z.
        axes = np.asarray(states.axis, float)
        between = axes[before] + share[:, None] * (axes[after] - axes[before])
        between /= np.linalg.norm(between, axis=1, keepdims=True)
        at = AxisState(jnp.zeros_like(between), jnp.asarray(between)).with_attitude().attitude
    else:
        attitudes = np.asarray(attitude_of(states))
        at = _slerp(attitudes[before], attitudes[after], share)
    return np.asarray(to_matrix(at), float)


def _travel(moving: Panel, motion: Motion, before: np.ndarray, after: np.ndarray, share: np.ndarray) -> Travel | None:
    """The position; None if the body does not translate, or too little to be visible."""
    states, magnified, box = motion.states, moving.magnified, moving.box
    if not isinstance(states, TravellingState):
        return None
    track, own = np.asarray(states.position, float), _size(moving.body, moving.shape)
    if magnified is None:
        if np.max(np.ptp(track, axis=0)) < _AT_REST * own:
            return None
        magnified = _magnified([own], [track])
    if box is not None:  # from one saved state to the next the body must move by less than half the box
        sides, steps = np.ptp(box, axis=0), np.diff(track, axis=0)
        track = np.concatenate([track[:1], track[:1] + np.cumsum(steps - sides * np.round(steps / sides), axis=0)])
    centres = track[before] + share[:, None] * (track[after] - track[before])
    centres = centres if box is None else _wrapped(centres, box)
    size = magnified * own / CORNER
    return Travel(track, centres, size, magnified, limits_around(track if box is None else box, 1.05 * size))


def _wrapped(positions: np.ndarray, box: np.ndarray) -> np.ndarray:
    return box[0] + np.mod(positions - box[0], np.ptp(box, axis=0))


def _size(body: Any, shape: Any) -> float:
    """The distance of the outermost corner of a body from its middle."""
    return shape.reach / float(body.mass) ** 0.5


def _magnified(sizes: list[float], tracks: list[np.ndarray], box: np.ndarray | None = None, meet: bool = True) -> float:
    """The factor 1, 2, 5, 10, 20, 50, ... by which to enlarge bodies with tracks (n, 3) that can `meet`."""
    inside = tracks if box is None else [np.concatenate([_wrapped(track, box), box]) for track in tracks]
    seen = _SEEN * CORNER * float(np.max(np.ptp(np.concatenate(inside), axis=0)))
    first, last = (_apart_by(np.stack([track[end] for track in tracks])) for end in (0, -1))
    # Bodies that meet leave half of the gaps between them. Others may begin at one position.
    gap = first / 4 if meet else max(first, last, seen) / 2
    wanted = min(seen, gap) / max(sizes)
    if wanted <= 1:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)))


def _apart_by(positions: np.ndarray) -> float:
    """The median distance of a position (n, 3) to the nearest other one."""
    if len(positions) < 2:
        return np.inf
    squares = np.sum(positions**2, axis=1)
    squared = squares[:, None] + squares - 2 * positions @ positions.T
    np.fill_diagonal(squared, np.inf)
    return float(np.sqrt(np.median(np.maximum(squared.min(axis=1), 0.0))))


class Scene(NamedTuple):
    """The bodies of one panel at the same times, each with a colour."""

    members: tuple[Turning, ...]
    colours: tuple[str, ...]
    names: tuple[str, ...] = ()  # of paths drawn in one space, "" for a path without name; () for coupled bodies
    around: Around = NOTHING
    title: str = ""  # the name of the path, if it has a panel of its own

    @property
    def alone(self) -> bool:
        return len(self.members) == 1

    @property
    def few(self) -> bool:
        """Whether the colours of the bodies can be distinguished, so that their axes and tracks are drawn."""
        return len(self.members) <= FEW

    @property
    def solid(self) -> bool:
        """Whether the bodies are drawn as solids; otherwise as points."""
        return bool(self.members[0].shape.faces)

    def named(self, i: int) -> str:
        return (self.names[i] if self.names else "") or f"body {i}"

    @property
    def tracks(self) -> list[tuple[Turning, Travel, str, str]]:
        """The bodies whose tracks are drawn, with names and colours; many bodies have thin grey tracks if none meet."""
        drawn = self.few or (bool(self.names) and len(self.members) <= _MOST_TRACKS)
        if self.around.box is not None or not drawn:
            return []
        names = ["the centre of mass"] if self.alone else [self.named(i) for i in range(len(self.members))]
        colours = [VERMILLION] if self.alone else self.colours
        each = zip(self.members, names, colours, strict=True)
        return [(member, member.travel, f"path of {n}", c) for member, n, c in each if member.travel is not None]

    @property
    def axes(self) -> list[tuple[Turning, str, str]]:
        """The bodies whose axes are drawn, with names and colours."""
        if self.alone:
            return [(self.members[0], f"{self.members[0].axis} of the body", BLUE)]
        drawn = list(zip(self.members, self.colours, strict=True)) if self.few and self.solid else []
        return [(member, f"{member.axis} of {self.named(i)}", colour) for i, (member, colour) in enumerate(drawn)]

    def sites(self, k: int) -> list[np.ndarray]:
        """The corners or the points of each body at frame k, in space."""
        return [member.placed(k, member.corners[k]) for member in self.members]

    def sticks(self, k: int) -> list[np.ndarray]:
        """The lines (2, 3) from the first point of each body to the others."""
        return [np.stack([own[0], other]) for own in self.sites(k) for other in own[1:]]

    def styles_of_sites(self, first: Any, other: Any) -> tuple[list[str], list[Any]]:
        """Colours and sizes of all points: `first` and `other` are the sizes in one body; many bodies look the same."""
        each = [(c, k) for c, m in zip(self.colours, self.members, strict=True) for k in range(len(m.shape.corners))]
        colours = [colour if self.few else SKY if k else VERMILLION for colour, k in each]
        return colours, [other if k else first for _, k in each]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Texts on the picture: the remarks of the fastest body, and whether paths are shorter."""
        fastest = max(self.members, key=lambda member: member.per_frame)
        ends = [member.until for member in self.members if member.until]
        if self.alone or not ends or (set(ends) == {fastest.until} and len(ends) == len(self.members)):
            return fastest.remarks
        failed = [end for end in ends if end.startswith("FAILED")]
        what = f"{len(failed)} of {len(self.members)} FAILED" if failed else f"{len(ends)} are not there all the time"
        return (what, *(remark for remark in fastest.remarks if remark != fastest.until))

    @property
    def limits(self) -> np.ndarray | None:
        """The lowest and the highest coordinates of the picture, (2, 3); None if the body does not translate."""
        own = [member.travel.limits for member in self.members if member.travel is not None]
        if own and self.around.planet is not None:
            own.append(1.05 * self.around.planet * np.array([[-1.0] * 3, [1.0] * 3]))
        return np.stack([np.min(own, axis=0)[0], np.max(own, axis=0)[1]]) if own else None


def scenes(
    panels: Sequence[Panel],
    axis: Any,
    frames: Any,
    most: int,
    points: Any = None,
    *,
    around: Around = NOTHING,
    in_one: bool = False,
) -> list[Scene]:
    """The scenes of the panels, or with `in_one` one scene of all, at the times of the frames; see `turnings`.

    `points`, (a, 3) in the frame of the body, replace the solid. A coupled path shows all its bodies in one panel.
    """
    names = tuple(panel.name for panel in panels)
    if in_one:
        groups, titles = [_in_one_space(panels, points, around)], ("",)
    else:
        groups, titles, names = [_bodies_of(one, points, around) for one in panels], names, ()
    flat = iter(turnings([one for group in groups for one in group], axis, frames, most))
    found = list[Scene]()
    for group, title in zip(groups, titles, strict=True):
        colours = (ORANGE,) if len(group) == 1 else tuple(colours_of(len(group)))
        found.append(Scene(tuple(next(flat) for _ in group), colours, names, around, title))
    return found


def _bodies_of(panel: Panel, points: Any, around: Around) -> list[Panel]:
    body, states = panel.body, getattr(panel.path, "states", None)
    if isinstance(states, Coupled):
        if not isinstance(states, TravellingState):
            raise ValueError(
                f"path must be one path, got several of {type(states).__name__}s. Draw each path alone, or take "
                "body i by path._replace(states=path.states.of_body(i))."
            )
        check_body(body, states)
        bodies = enumerate(_each_body(body, states.count))
        return _in_one_space([Panel("", own, path_of_one(panel.path, i)) for i, own in bodies], points, around, True)
    if around.box is not None or around.planet is not None:
        return _in_one_space([panel], points, around)
    return [panel._replace(shape=shape_of(body, points))]


def _in_one_space(panels: Sequence[Panel], points: Any, around: Around, meet: bool = False) -> list[Panel]:
    """Single bodies, all enlarged by one factor."""
    states: list[Any] = [motion_of(panel.path).states for panel in panels]
    for panel, own in zip(panels, states, strict=True):
        check_body(panel.body, own)
    surfaces = isinstance(points, list | tuple) and all(isinstance(one, Surface) for one in points)
    each = zip(panels, points if surfaces else [points] * len(panels), strict=True)
    placed = [panel._replace(shape=shape_of(panel.body, one), box=around.box) for panel, one in each]
    sizes, tracks = [_size(one.body, one.shape) for one in placed], [np.asarray(own.position, float) for own in states]
    magnified = _magnified(sizes, tracks, around.box, meet)
    return [one._replace(magnified=magnified) for one in placed]
