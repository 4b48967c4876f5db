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
from scipy.spatial.transform import Rotation  # SciPy comes with JAX

from ..._math.euler import euler_angles, matrices_of


class Form(NamedTuple):
    """The numbers of a line of data after the epoch."""

    columns: tuple[str, ...]  # their names, in the order of the standard; angles in degrees, rates in degrees/s
    kind: str  # "quaternion", "euler", "spin", or "" if they do not give an attitude
    versions: tuple[str, ...] = ("1.0", "2.0")  # the versions of the standard that have it


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
    return Rotation.from_euler(sequence, angles).as_quat(scalar_first=True)


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
