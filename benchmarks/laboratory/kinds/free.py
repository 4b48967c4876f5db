"""A body that travels about a point mass, in thirteen numbers: Pi, the quaternion, p and x.

Pi' = Pi x I^-1 Pi + T, q' = q (0, I^-1 Pi)/2, p' = f, x' = p/m. With the position w = R^T x in the body frame, the
force R^T f is -mu (m/r^3 + 3/(2 r^5) tr I - 15/(2 r^7) w . I w + 3/r^5 I) w, and the torque 3 mu/r^5 w x I w. For
heyoka other ways to write them, with powers of r instead of products, or with R in another place, took equally long.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from midlie_jax.cli.scenes import Scene
from midlie_jax.model import torques

from .kind import Kind, no_closed_form
from .vectors import cross, dot, matrices, rows, turning


def rates(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """The equations of motion; a ValueError for another force than a point mass's."""
    if not isinstance(scene.torque, torques.PointMass):
        raise ValueError(f"scene {scene.name!r} travels, for which the rivals have the force PointMass alone.")
    body: Any = scene.body
    moments, mass, mu = np.asarray(body.body.moments).tolist(), float(body.mass), float(scene.torque.mu)
    a, b, c = moments

    def field(state: Any, place: Any = None) -> tuple[Any, ...]:
        del place
        momentum, attitude, linear, position = state[:3], state[3:7], state[7:10], state[10:]
        to_space = rows(attitude)
        w = tuple(dot(column, position) for column in zip(*to_space, strict=True))
        inverse = dot(position, position) ** -0.5
        square = inverse * inverse
        cube = inverse * square
        fifth = cube * square
        shape = dot(w, (a * w[0], b * w[1], c * w[2])) * square
        along = (-mu * mass) * cube + (-mu * fifth) * (1.5 * sum(moments) - 7.5 * shape)
        force = tuple((along + (-3 * mu * moment) * fifth) * x for moment, x in zip(moments, w, strict=True))
        pull = 3 * mu * fifth
        torque = pull * ((c - b) * w[1] * w[2]), pull * ((a - c) * w[2] * w[0]), pull * ((b - a) * w[0] * w[1])
        velocity = momentum[0] / a, momentum[1] / b, momentum[2] / c
        return (
            *(turn + pulled for turn, pulled in zip(cross(momentum, velocity), torque, strict=True)),
            *turning(attitude, velocity),
            *(dot(row, force) for row in to_space),
            *((1 / mass) * p for p in linear),
        )

    return field


def errors(ends: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The angle between the attitudes or the distance of the positions over r, whichever is larger."""
    chord = np.linalg.norm(matrices(ends[:, 3:7]) - matrices(exact[:, 3:7]), axis=(1, 2)) / np.sqrt(8)
    away = np.linalg.norm(ends[:, 10:] - exact[:, 10:], axis=1) / np.linalg.norm(exact[:, 10:], axis=1)
    return np.maximum(2 * np.arcsin(np.minimum(chord, 1.0)), away)


FREE = Kind(rates, errors, "attitude (rad) or position (over r), the larger", no_closed_form)
