"""`Turning`: a body at the times of an animation's frames, drawn as a box with its moments of inertia."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count, described
from ..model import so3
from ..model.bodies import RigidBody, TensorBody, principal_of
from .axis_path import as_axis, directions
from .motion import Motion, motion_of

_CORNER = 0.8  # distance of the corners from the middle; the drawn axis has length 1
_THINNEST = 0.03  # the thickness with which a flat body is drawn, relative to its longest side
_RESOLVED = np.pi / 2  # radians: if a body turns by less between saved states, attitudes between them are known
# The corners of a cube, and its six faces as loops of corners, seen from outside counter-clockwise.
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
FACES = ((4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4))  # +x -x +y -y +z -z


class Turning(NamedTuple):
    """The frames of an animation.

    Attributes:
        times: the times of the frames, (k,).
        corners: the corners of the box in space at these times, (k, 8, 3), in the sequence of `CORNERS`.
        tips: the end of the drawn axis at these times, (k, 3), a unit vector in space.
        inside: the share of the axis that is inside the box, measured from the middle.
        momenta: the angular momentum in space at these times, over its largest length along the path, (k, 3).
        path_times: the saved times whose states are drawn, (n,).
        path_tips, path_momenta: `tips` and `momenta` at the saved times, (n, 3).
        axis: the name of the axis.
        remarks: texts to be written on the picture.
    """

    times: np.ndarray
    corners: np.ndarray
    tips: np.ndarray
    inside: float
    momenta: np.ndarray
    path_times: np.ndarray
    path_tips: np.ndarray
    path_momenta: np.ndarray
    axis: str
    remarks: tuple[str, ...]


def picture_file(file: str | Path, ending: str) -> Path:
    """The file to write.

    Raises:
        ValueError: its name has another ending.
    """
    target = Path(file)
    if target.suffix.lower() != ending:
        raise ValueError(f"file must end in {ending}, got {str(file)!r}.")
    return target


def turning(body: Any, path: Any, axis: Any, frames: Any, most: int) -> Turning:
    """The body at evenly spaced times of its path, the first and the last among them; see `turnings`."""
    return turnings([(body, path)], axis, frames, most)[0]


def turnings(moving: Sequence[tuple[Any, Any]], axis: Any, frames: Any, most: int) -> list[Turning]:
    """Bodies at the same evenly spaced times, from the first of all their paths to the last.

    Between saved states a body is assumed to turn at a constant rate. If it turns by more than a right angle between
    two saved states, the attitudes between them are unknown, and the frames show the nearest saved states. A body whose
    path ends before the others stands still from then on.

    Args:
        moving: pairs of a body and its path.
        axis: the axis to draw, as for `axis_path`.
        frames: number of frames.
        most: largest number of frames.

    Raises:
        ValueError: a body is not one rigid body; a path is not of one body with attitudes, or its first two states are
            bad; some paths go forward and others backward; the axis is neither a name, nor an index, nor a unit vector;
            there are fewer than two frames, or more than `most`.
    """
    count = as_count("frames", frames)
    if count < 2:
        raise ValueError("frames must be at least 2, got 1.")
    if count > most:
        raise ValueError(f"frames must be at most {most}, got {count}; show a part of the path.")
    boxes = [box(body) for body, _ in moving]
    as_axis(axis)
    motions = [motion_of(path) for _, path in moving]
    signs = {bool(motion.times[-1] > motion.times[0]) for motion in motions}
    if len(signs) > 1:
        raise ValueError("some paths go forward in time and others backward; show them in pictures of their own.")
    first, last = (min, max) if signs.pop() else (max, min)
    times = np.linspace(first(m.times[0] for m in motions), last(m.times[-1] for m in motions), count)
    return [
        _turning(body, motion, corners, axis, times)
        for (body, _), motion, corners in zip(moving, motions, boxes, strict=True)
    ]


def _turning(body: Any, motion: Motion, corners: np.ndarray, axis: Any, times: np.ndarray) -> Turning:
    direction, name = as_axis(axis)
    attitudes = motion.attitudes  # raises before the body is compared with the states
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
    if np.max(angles) > _RESOLVED:
        share = np.round(share)
        remarks.append("frames are saved states")
    moving_frames = np.ptp(within) / (abs(times[-1] - times[0]) / (len(times) - 1))
    per_frame = float(np.sum(angles)) / moving_frames / (2 * np.pi)
    if per_frame > 0.25:
        remarks.append(f"{per_frame:.2g} turns from frame to frame")
    before, after = (jnp.asarray(attitudes[order[i]]) for i in (place, place + 1))
    at = so3.slerp(before, after, jnp.asarray(share))
    rotations = np.asarray(so3.to_matrix(at), float)
    whole = np.asarray(so3.to_matrix(jnp.asarray(attitudes)), float)
    momenta = np.einsum("nij,nj->ni", whole, motion.momenta.astype(float))
    momenta /= max(float(np.max(np.linalg.norm(momenta, axis=1))), np.finfo(float).tiny)
    at_frames = np.stack([np.interp(within, ascending, momenta[order, i]) for i in range(3)], axis=1)
    return Turning(
        times=times,
        corners=np.einsum("kij,cj->kci", rotations, corners),
        tips=rotations @ direction,
        inside=_inside(corners, direction),
        momenta=at_frames,
        path_times=motion.times,
        path_tips=directions(motion, direction),
        path_momenta=momenta,
        axis=name,
        remarks=tuple(remarks),
    )


def _inside(corners: np.ndarray, direction: np.ndarray) -> float:
    """How far a ray from the middle of a box stays inside it."""
    sides = corners[[4, 2, 1]] - corners[0]  # the whole sides, (3, 3)
    share = np.abs(sides @ direction) / (np.sum(sides**2, axis=1) / 2)
    return 1 / float(np.max(share))


def box(body: Any) -> np.ndarray:
    """The corners (8, 3), in the frame of the body, of the box with its moments of inertia, in the order of `CORNERS`.

    A box of mass m and half sides a, b, c has the moments m (b^2 + c^2) / 3, m (c^2 + a^2) / 3, m (a^2 + b^2) / 3. So
    a^2 is proportional to I2 + I3 - I1. The box is scaled to the size of the picture, and a flat body is drawn with
    some thickness.

    Raises:
        ValueError: the body is not one rigid body.
    """
    if not isinstance(body, RigidBody | TensorBody):
        raise ValueError(f"body must be a RigidBody or a TensorBody, got {described(body)}.")
    moments = np.asarray(principal_of(body).moments, float)
    if moments.shape != (3,):
        raise ValueError(f"body must be one body with moments (3,), got {moments.shape}; take the row of the body.")
    half_sides = np.sqrt(np.maximum(moments.sum() - 2 * moments, 0.0))
    half_sides = np.maximum(half_sides, _THINNEST * half_sides.max())
    corners = CORNERS * half_sides * (_CORNER / np.linalg.norm(half_sides))
    if isinstance(body, TensorBody):
        corners = corners @ np.asarray(so3.to_matrix(body.frame), float).T
    return corners
