"""`Turning`: a body at the times of an animation's frames."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count
from ..model import so3
from ..model.states import AxisState, attitude_of
from .curves import as_axis
from .motion import Motion, motion_of
from .shape import Shape, shape_of
from .travel import Room, Travel, travel_of

_RESOLVED = np.pi / 2  # radians: if a body turns by less between saved states, attitudes between them are known


class Turning(NamedTuple):
    """The frames of an animation.

    Attributes:
        times: the times of the frames, (k,).
        shape: how the body is drawn.
        corners: its corners in space at these times, (k, c, 3), from the middle of the body.
        tips: the end of the drawn axis at these times, (k, 3), a unit vector in space.
        inside: the share of the axis that is inside the body, measured from the middle.
        momenta: the angular momentum in space at these times, over its largest length along the path, (k, 3).
        path_times: the saved times whose states are drawn, (n,).
        path_tips, path_momenta: `tips` and `momenta` at the saved times, (n, 3).
        axis: the name of the axis.
        remarks: texts to be written on the picture.
        travel: where the body is; None if it stays where it is.
        per_frame: by how many turns it turns from frame to frame.
        until: the first of the remarks if the path ends before the picture does or begins after it; otherwise "".
    """

    times: np.ndarray
    shape: Shape
    corners: np.ndarray
    tips: np.ndarray
    inside: float
    momenta: np.ndarray
    path_times: np.ndarray
    path_tips: np.ndarray
    path_momenta: np.ndarray
    axis: str
    remarks: tuple[str, ...]
    travel: Travel | None
    per_frame: float
    until: str = ""

    def placed(self, k: int, points: np.ndarray) -> np.ndarray:
        """Points given from the middle of the body, where they are in the picture of frame k."""
        return points if self.travel is None else self.travel.centres[k] + self.travel.size * points


class Moving(NamedTuple):
    """What moves.

    Attributes:
        body: one body.
        path: its path.
        shape: how it is drawn; by default by its moments.
        room: that of bodies with which it is drawn together.
    """

    body: Any
    path: Any
    shape: Shape | None = None
    room: Room | None = None


def picture_file(file: str | Path, ending: str) -> Path:
    """The file to write.

    Raises:
        ValueError: its name has another ending.
    """
    target = Path(file)
    if target.suffix.lower() != ending:
        raise ValueError(
            f"file must end in {ending}, got {str(file)!r}; midlie_jax.plot.animate writes a .gif, view an .html."
        )
    return target


def turning(body: Any, path: Any, axis: Any, frames: Any, most: int) -> Turning:
    """The body at evenly spaced times of its path, the first and the last among them; see `turnings`."""
    return turnings([(body, path)], axis, frames, most)[0]


def turnings(moving: Sequence[Moving | tuple[Any, Any]], axis: Any, frames: Any, most: int) -> list[Turning]:
    """Bodies at the same evenly spaced times, from the first of all their paths to the last.

    Between saved states a body is assumed to turn at a constant rate. If it turns by more than a right angle between
    two saved states, the attitudes between them are unknown, and the frames show the nearest saved states. A body whose
    path ends before the others stands still from then on.

    Args:
        moving: bodies and their paths: `Moving`, or pairs.
        axis: the axis to draw, as for `axis_path`.
        frames: number of frames.
        most: largest number of frames.

    Raises:
        ValueError: a body is not one body that turns; a path is not of one body with attitudes or axes, or its first
            two states are bad; some paths go forward and others backward; the axis is neither a name, nor an index, nor
            a unit vector, or the states do not know it; there are fewer than two frames, or more than `most`.
    """
    count = as_count("frames", frames)
    if count < 2:
        raise ValueError("frames must be at least 2, got 1.")
    if count > most:
        raise ValueError(f"frames must be at most {most}, got {count}; show a part of the path.")
    all_moving = [one if isinstance(one, Moving) else Moving(one[0], one[1]) for one in moving]
    shapes = [one.shape or shape_of(one.body) for one in all_moving]
    as_axis(axis)
    motions = [motion_of(one.path) for one in all_moving]
    signs = {bool(motion.times[-1] > motion.times[0]) for motion in motions}
    if len(signs) > 1:
        raise ValueError("some paths go forward in time and others backward; show them in pictures of their own.")
    first, last = (min, max) if signs.pop() else (max, min)
    times = np.linspace(first(m.times[0] for m in motions), last(m.times[-1] for m in motions), count)
    return [
        _turning(one.body, motion, shape, axis, times, one.room)
        for one, motion, shape in zip(all_moving, motions, shapes, strict=True)
    ]


def _turning(body: Any, motion: Motion, shape: Shape, axis: Any, times: np.ndarray, room: Room | None) -> Turning:
    direction, name = as_axis(axis)
    path_tips = motion.directions(direction)  # raises before the body is compared with the states
    angles = motion.turns_by(body)
    # Sorted by ascending time, because a run may go backwards.
    order = np.argsort(motion.times)
    ascending = motion.times[order]
    within = np.clip(times, ascending[0], ascending[-1])
    place = np.clip(np.searchsorted(ascending, within, side="right") - 1, 0, len(order) - 2)
    share = (within - ascending[place]) / np.diff(ascending)[place]
    remarks = [motion.failed] if motion.failed else []
    if not motion.failed and np.any(within != times):
        remarks.append(f"from t = {motion.times[0]:.6g} to {motion.times[-1]:.6g}")
    until = remarks[0] if remarks else ""
    if np.max(angles) > _RESOLVED:
        share = np.round(share)
        remarks.append("frames are saved states")
    moving_frames = np.ptp(within) / (abs(times[-1] - times[0]) / (len(times) - 1))
    per_frame = float(np.sum(angles)) / moving_frames / (2 * np.pi)
    if per_frame > 0.25:
        remarks.append(f"{per_frame:.2g} turns from frame to frame")
    travel = travel_of(body, motion, shape, order[place], order[place + 1], share, room)
    if travel is not None and travel.in_words:
        remarks.append(travel.in_words)
    rotations = _rotations(motion, order[place], order[place + 1], share)
    momenta = motion.spatial_momenta
    momenta = momenta / max(float(np.max(np.linalg.norm(momenta, axis=1))), np.finfo(float).tiny)
    at_frames = np.stack([np.interp(within, ascending, momenta[order, i]) for i in range(3)], axis=1)
    return Turning(
        times=times,
        shape=shape,
        corners=np.einsum("kij,cj->kci", rotations, shape.corners),
        tips=rotations @ direction,
        inside=shape.inside(direction),
        momenta=at_frames,
        path_times=motion.times,
        path_tips=path_tips,
        path_momenta=momenta,
        axis=name,
        remarks=tuple(remarks),
        travel=travel,
        per_frame=per_frame,
        until=until,
    )


def _rotations(motion: Motion, before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The rotation matrices (k, 3, 3) between saved states, given by their indices; the spin of an axis is chosen."""
    share = np.asarray(share, float)
    states: Any = motion.turning.states
    if motion.has_axis_alone:
        # Interpolated first: the chosen attitudes jump where the axis passes through -z.
        axes = np.asarray(states.axis, float)
        between = axes[before] + share[:, None] * (axes[after] - axes[before])
        between /= np.linalg.norm(between, axis=1, keepdims=True)
        at = AxisState(jnp.zeros_like(between), jnp.asarray(between)).with_attitude().attitude
    else:
        attitudes = jnp.asarray(attitude_of(states))
        at = so3.slerp(attitudes[before], attitudes[after], jnp.asarray(share))
    return np.asarray(so3.to_matrix(at), float)
