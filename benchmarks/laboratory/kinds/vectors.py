"""Vectors and quaternions on scalars of any type."""

from typing import Any

import numpy as np

Vector = tuple[Any, Any, Any]


def cross(a: Any, b: Any) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rows(quaternion: Any) -> tuple[Vector, Vector, Vector]:
    """The rows of the rotation matrix of a unit quaternion."""
    w, x, y, z = quaternion
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def turning(quaternion: Any, velocity: Any) -> tuple[Any, Any, Any, Any]:
    """d/dt of the quaternion of a body, q (0, velocity)/2, with the angular velocity in the body frame."""
    w, x, y, z = quaternion
    a, b, c = velocity
    spin = (-x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a)
    return 0.5 * spin[0], 0.5 * spin[1], 0.5 * spin[2], 0.5 * spin[3]


def matrix(quaternion: Any) -> np.ndarray:
    """The rotation matrix of a unit quaternion, computed in the number type of its entries."""
    return np.array(rows(quaternion))


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """The rotation matrices (n, 3, 3) of quaternions (n, 4) of any norm."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.stack([matrix(q) for q in unit])
