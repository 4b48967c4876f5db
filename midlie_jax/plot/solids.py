"""Shapes of bodies: a solid with the moments of inertia of the body, or its points, and a ball for a planet.

A box of mass m and half sides a, b, c has the moments m (b^2 + c^2) / 3, m (c^2 + a^2) / 3, m (a^2 + b^2) / 3.
Therefore a^2 is proportional to I2 + I3 - I1. A cylinder of radius r and half length c has I3 = m r^2 / 2 and I1 = m
r^2 / 4 + m c^2 / 3.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_finite
from ..model import so3
from ..model.bodies import RigidBody, SymmetricRotor, TensorBody, principal_of
from ..model.compatibility import body_named
from ..model.free_body import FreeBody
from ..model.surface import Surface

CORNER = 0.8  # distance of the outermost corner from the middle; the drawn axis has length 1
_THINNEST = 0.03  # thickness of a flat or thin body in the picture, relative to its longest side
_SIDES = 24  # of the prism that represents a cylinder
_SMOOTH = (12, 24)  # steps of the surface of a ball from pole to pole, and around
# The corners of a cube, and its six faces as loops of corners, counter-clockwise from outside.
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
FACES = ((4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4))  # +x -x +y -y +z -z


class Shape(NamedTuple):
    """A solid, scaled to the size of a picture."""

    corners: np.ndarray  # in the frame of the body, (c, 3), the outermost at the distance CORNER from the middle
    faces: tuple[tuple[int, ...], ...]  # loops of corners, counter-clockwise from outside; () for points
    round: bool  # whether the faces represent a curved surface, so that edges between them are not drawn
    reach: float  # the true distance of the outermost corner times the root of the mass, from the moments of inertia
    one_colour: bool = False

    def inside(self, direction: np.ndarray) -> float:
        """The distance that a ray from the middle stays inside, in the units of the corners."""
        if not self.faces:
            return 0.0
        loops = [self.corners[list(face[:3])] for face in self.faces]
        normals = np.array([np.cross(b - a, c - b) for a, b, c in loops])
        heights = np.sum(normals * np.array([loop[0] for loop in loops]), axis=1)
        ahead = heights > 0  # of a surface that is not convex, some are not
        rate = float(np.max(normals[ahead] @ direction / heights[ahead], initial=0))
        return 1 / rate if rate else 0.0


def shape_of(body: Any, points: Any = None) -> Shape:
    """A box with the moments of a rigid body; for a `SymmetricRotor` a cylinder, or a rod if only one moment is known.

    Flat and thin bodies are drawn with some thickness. Points (a, 3) in the frame of a body with a mass, which gives
    them their scale, or a `Surface` of triangles replace the solid.
    """
    turning = body.turning if isinstance(body, FreeBody) else body
    if not isinstance(turning, RigidBody | TensorBody | SymmetricRotor):
        raise ValueError(
            f"body must be a RigidBody, a TensorBody or a SymmetricRotor, or a FreeBody, got {body_named(body)}."
        )
    if turning.batch:
        known = "a moment ()" if isinstance(turning, SymmetricRotor) else "moments (3,)"
        shape = turning.batch if isinstance(turning, SymmetricRotor) else (*turning.batch, 3)
        raise ValueError(f"body must be one body with {known}, got {shape}. Take the row of the body.")
    solid = _cylinder(turning) if isinstance(turning, SymmetricRotor) else _box(turning)
    if points is None:
        return solid
    if isinstance(points, Surface):
        return _surface(body, points)
    sites = np.asarray(as_finite("points", points), float)
    if sites.ndim != 2 or sites.shape[1] != 3 or not len(sites):
        raise ValueError(f"points must be (a, 3), positions in the frame of the body, got {sites.shape}.")
    if not isinstance(body, FreeBody):
        raise ValueError(f"body must be a FreeBody, whose mass gives points their scale, got {body_named(body)}.")
    return Shape(sites * (CORNER * float(body.mass) ** 0.5 / solid.reach), (), False, solid.reach)


def _surface(body: Any, surface: Surface) -> Shape:
    if surface.corners is None:
        raise ValueError("a surface is drawn by its triangles; make every part of vertices and faces.")
    corners, loops = np.unique(np.asarray(surface.corners, float).reshape(-1, 3), axis=0, return_inverse=True)
    reach = float(np.linalg.norm(corners, axis=1).max())
    mass = float(body.mass) if isinstance(body, FreeBody) else 1.0
    faces = tuple(map(tuple, loops.reshape(-1, 3).tolist()))
    return Shape(corners * (CORNER / reach), faces, True, reach * mass**0.5, one_colour=True)


def _box(body: RigidBody | TensorBody) -> Shape:
    moments = np.asarray(principal_of(body).moments, float)
    half_sides = np.sqrt(np.maximum(moments.sum() - 2 * moments, 0.0) * 1.5)
    half_sides = np.maximum(half_sides, _THINNEST * half_sides.max())
    reach = float(np.linalg.norm(half_sides))
    corners = CORNERS * half_sides * (CORNER / reach)
    if isinstance(body, TensorBody):
        corners = corners @ np.asarray(so3.to_matrix(jnp.asarray(body.frame)), float).T
    return Shape(corners, FACES, False, reach)


def _cylinder(body: SymmetricRotor) -> Shape:
    across, along = float(body.moment), 0.0 if body.along is None else float(body.along)
    radius, half = np.sqrt(2 * along), np.sqrt(max(3 * across - 1.5 * along, 0.0))
    radius, half = max(radius, _THINNEST * half), max(half, _THINNEST * radius)
    reach = float(np.hypot(radius, half))
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    top = np.array([0.0, 0.0, half])
    corners = np.concatenate([ring + top, ring - top]) * (CORNER / reach)
    n = _SIDES
    sides = tuple((k, n + k, n + (k + 1) % n, (k + 1) % n) for k in range(n))
    return Shape(corners, (tuple(range(n)), tuple(range(2 * n - 1, n - 1, -1)), *sides), True, reach)


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
