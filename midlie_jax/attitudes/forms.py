"""Quaternions, Euler angles and spin: the numbers of a line of data, and their rotation.

The standard describes the rotation from frame A to frame B. The quaternion of a rotation by an angle phi about the unit
vector e is (e sin(phi / 2), cos(phi / 2)), scalar last. In the order of this package, scalar first, it takes components
in B to components in A: for A fixed in space and B in the body it is the attitude.

Euler angles are successive rotations of frame A about its axes as they are after the earlier rotations. For spin, the
axis is z of B, given by right ascension and declination in A. The rotations are ZXZ by 90 deg + alpha, 90 deg - delta,
and the spin angle; the rate is the z component of the angular velocity. Orekit 12 uses the same definition, and it
reproduces the rates in the SPIN example of the standard from its angles, to 3e-4.
"""

from typing import NamedTuple

import numpy as np

_LOCKED = 4  # rounding errors: below this sine or cosine of the second angle, the third angle is set to 0


class Form(NamedTuple):
    """The numbers of a line of data after the epoch.

    Attributes:
        columns: the names of the numbers, in the order of the standard; angles in degrees, rates in degrees/s.
        kind: "quaternion", "euler", "spin", or "" if they do not give an attitude.
        versions: the versions of the standard that have it.
    """

    columns: tuple[str, ...]
    kind: str
    versions: tuple[str, ...] = ("1.0", "2.0")


_Q, _QD = ("Q1", "Q2", "Q3", "QC"), ("Q1_DOT", "Q2_DOT", "Q3_DOT", "QC_DOT")
_A, _AD = ("ANGLE_1", "ANGLE_2", "ANGLE_3"), ("ANGLE_1_DOT", "ANGLE_2_DOT", "ANGLE_3_DOT")
_W = ("ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z")
_S = ("SPIN_ALPHA", "SPIN_DELTA", "SPIN_ANGLE", "SPIN_ANGLE_VEL")
FORMS = {
    "QUATERNION": Form(_Q, "quaternion"),
    "QUATERNION/DERIVATIVE": Form(_Q + _QD, "quaternion"),
    "QUATERNION/RATE": Form(_Q + _AD, "quaternion", ("1.0",)),
    "QUATERNION/ANGVEL": Form(_Q + _W, "quaternion", ("2.0",)),
    "EULER_ANGLE": Form(_A, "euler"),
    "EULER_ANGLE/RATE": Form(_A + _AD, "euler", ("1.0",)),
    "EULER_ANGLE/DERIVATIVE": Form(_A + _AD, "euler", ("2.0",)),
    "EULER_ANGLE/ANGVEL": Form(_A + _W, "euler", ("2.0",)),
    "SPIN": Form(_S, "spin"),
    "SPIN/NUTATION": Form((*_S, "NUTATION", "NUTATION_PER", "NUTATION_PHASE"), ""),
    "SPIN/NUTATION_MOM": Form((*_S, "MOMENTUM_ALPHA", "MOMENTUM_DELTA", "NUTATION_VEL"), "", ("2.0",)),
}


def rotations(kind: str, numbers: np.ndarray, sequence: str) -> np.ndarray:
    """Quaternions (n, 4), scalar first, from components in B to components in A, for lines of data (n, k)."""
    if kind == "quaternion":
        found = numbers[:, [3, 0, 1, 2]]
        return found / np.linalg.norm(found, axis=1, keepdims=True)
    angles = np.deg2rad(numbers[:, :3])
    if kind == "spin":
        angles = np.stack([np.pi / 2 + angles[:, 0], np.pi / 2 - angles[:, 1], angles[:, 2]], axis=1)
        sequence = "ZXZ"
    turns = [_about(axis, angles[:, i]) for i, axis in enumerate(sequence)]
    return _multiply(_multiply(turns[0], turns[1]), turns[2])


def numbers_of(kind: str, quaternions: np.ndarray, sequence: str, rates: np.ndarray | None = None) -> np.ndarray:
    """The inverse of `rotations`: lines of data (n, k); for spin also the rates about the axis, (n,), degrees/s."""
    if kind == "quaternion":
        return quaternions[:, [1, 2, 3, 0]]
    angles, _ = euler_angles(matrices_of(quaternions), "ZXZ" if kind == "spin" else sequence)
    degrees = np.rad2deg(angles)
    if kind == "euler":
        return degrees
    assert rates is not None
    return np.stack([(degrees[:, 0] - 90) % 360, 90 - degrees[:, 1], degrees[:, 2] % 360, rates], axis=1)


def euler_angles(matrices: np.ndarray, sequence: str) -> tuple[np.ndarray, np.ndarray]:
    """The angles a, b, c with R = R_i(a) R_j(b) R_k(c): rotations about body axes after the earlier rotations.

    Args:
        matrices: (n, 3, 3), each takes body components to space components.
        sequence: three letters X, Y, Z without equal neighbours: the axes i, j and k.

    Returns:
        The angles (n, 3) in radians, a and c from -pi to pi, b between -pi/2 and pi/2, or between 0 and pi if the first
        and third letter are equal. And (n,), whether the first and third axis are parallel, in which case c is set to
        0.
    """
    i, j, last = ("XYZ".index(letter) for letter in sequence)
    k = 3 - i - j
    r, sign = np.moveaxis(matrices, 0, -1), 1 if (j - i) % 3 == 1 else -1
    if last == i:
        a, small = np.arctan2(r[j, i], -sign * r[k, i]), np.hypot(r[j, i], r[k, i])
    else:
        a, small = np.arctan2(-sign * r[j, k], r[k, k]), np.hypot(r[j, k], r[k, k])
    locked = small < _LOCKED * np.finfo(r.dtype).eps
    a = np.where(locked, np.arctan2(sign * r[k, j], r[j, j]), a)
    # If both are small, rounding changes the first angle strongly. The others come from the rotation that remains after
    # the first, R_i(a)^T R, so the three angles together reproduce the rotation.
    cosine, sine = np.cos(a), sign * np.sin(a)
    row_i, row_j, row_k = r[i], cosine * r[j] + sine * r[k], cosine * r[k] - sine * r[j]
    if last == i:
        b, c = np.arctan2(-sign * row_k[i], row_i[i]), np.arctan2(-sign * row_j[k], row_j[j])
    else:
        b, c = np.arctan2(sign * row_i[k], row_k[k]), np.arctan2(sign * row_j[i], row_j[j])
    return np.stack([a, b, np.where(locked, 0, c)], axis=-1), locked


def matrices_of(quaternions: np.ndarray) -> np.ndarray:
    """The matrices (n, 3, 3) of unit quaternions (n, 4), scalar first, in float64.

    Quaternions in float32 are unit quaternions only to rounding; their length is divided out.
    """
    quaternions = np.asarray(quaternions, np.float64)
    quaternions = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def sequence_of(value: object) -> str:
    """A sequence of axes as three letters, from letters or digits; a ValueError that begins with "must"."""
    letters = str(value).upper().translate(str.maketrans("123", "XYZ"))
    proper = len(letters) == 3 and set(letters) <= set("XYZ") and letters[0] != letters[1] != letters[2]
    if not proper:
        raise ValueError(f"must be three axes without equal neighbours, such as ZXZ or 321, got {value!r}.")
    return letters


def _about(axis: str, angles: np.ndarray) -> np.ndarray:
    found = np.zeros((len(angles), 4))
    found[:, 0], found[:, 1 + "XYZ".index(axis)] = np.cos(angles / 2), np.sin(angles / 2)
    return found


def _multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    a, u, b, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    scalar = a * b - np.sum(u * v, axis=1, keepdims=True)
    return np.concatenate([scalar, a * v + b * u + np.cross(u, v)], axis=1)
