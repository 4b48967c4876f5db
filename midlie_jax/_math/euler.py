"""Euler angles of R = R_i(a) R_j(b) R_k(c), each about axes of the body, for JAX and for NumPy in float64."""

from typing import Any

import numpy as np

_LOCKED = 4  # rounding errors: below this sine or cosine of the second angle, the third angle is set to 0


def sequence_of(value: object) -> str:
    """A sequence of axes as three letters, from letters or digits; a ValueError that begins with "must"."""
    letters = str(value).upper().translate(str.maketrans("123", "XYZ"))
    if len(letters) != 3 or not set(letters) <= set("XYZ") or not letters[0] != letters[1] != letters[2]:
        raise ValueError(f"must be three axes without equal neighbours, such as ZXZ or 321, got {value!r}.")
    return letters


def as_sequence(name: str, value: object) -> str:
    """`sequence_of` an argument, which the message names."""
    try:
        return sequence_of(value)
    except ValueError as error:
        raise ValueError(f"{name} {error}") from None


def angles_of(r: Any, sequence: str, xp: Any) -> tuple[Any, Any, Any, Any]:
    """The angles a, b and c, and whether the first and the last axis of rotation are parallel, so that c is 0; from the
    entries of the matrices, (3, 3, ...), by `numpy` or `jax.numpy`.
    """
    i, j, last = map("XYZ".index, sequence)
    k, sign = 3 - i - j, 1 if (j - i) % 3 == 1 else -1
    y, x = (r[j, i], -sign * r[k, i]) if last == i else (-sign * r[j, k], r[k, k])
    locked = xp.hypot(y, x) < _LOCKED * xp.finfo(r.dtype).eps
    a = xp.arctan2(xp.where(locked, sign * r[k, j], y), xp.where(locked, r[j, j], x))
    # If both are small, rounding changes the first angle strongly. The others come from the rotation that remains after
    # the first, so the three angles together reproduce the rotation.
    cosine, sine = xp.cos(a), sign * xp.sin(a)
    rest = {m: (cosine * r[j, m] + sine * r[k, m], cosine * r[k, m] - sine * r[j, m]) for m in (i, j, k)}
    if last == i:
        b, c = xp.arctan2(-sign * rest[i][1], r[i, i]), xp.arctan2(-sign * rest[k][0], rest[j][0])
    else:
        b, c = xp.arctan2(sign * r[i, k], rest[k][1]), xp.arctan2(sign * rest[i][0], rest[j][0])
    return a, b, xp.where(locked, xp.zeros_like(c), c), locked


def euler_angles(matrices: np.ndarray, sequence: str) -> tuple[np.ndarray, np.ndarray]:
    """The angles (n, 3) in radians of matrices (n, 3, 3), and where c is set to 0, (n,)."""
    *angles, locked = angles_of(np.moveaxis(matrices, 0, -1), sequence_of(sequence), np)
    return np.stack(angles, axis=-1), locked


def matrices_of(quaternions: np.ndarray) -> np.ndarray:
    """The matrices (n, 3, 3) of quaternions (n, 4), scalar first, in float64; their length is divided out."""
    quaternions = np.asarray(quaternions, np.float64)
    quaternions = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
