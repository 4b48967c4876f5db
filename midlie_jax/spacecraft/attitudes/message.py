"""`AttitudeFile` and its `Segment`s, the content of an attitude file; the names of frames, and forms of attitudes.

The standard describes the rotation from frame A to frame B. The quaternion of a rotation by an angle phi about the unit
vector e is (e sin(phi / 2), cos(phi / 2)), scalar last. In the order of this package, scalar first, it takes components
in B to components in A: for A fixed in space and B in the body it is the attitude.

Euler angles are successive rotations of frame A about its axes as they are after the earlier rotations. For spin, the
axis is z of B, given by right ascension and declination in A. The rotations are ZXZ by 90 deg + alpha, 90 deg - delta,
and the spin angle; the rate is the z component of the angular velocity, as in Orekit 12.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation  # SciPy comes with JAX

from ..._checks.arguments import shown, unknown
from ..._math.euler import euler_angles, matrices_of
from .epochs import Epoch

# Names in the registries of CCSDS (sanaregistry.org).
_CELESTIAL = (
    "ALIGN_CB", "ALIGN_EARTH", "B1950", "CIRS", "EFG", "EME2000", "FIXED_CB", "FIXED_EARTH", "GCRF", "GRC", "GTOD",
    "ICRF", "INERTIAL_CB", "ITRF", "ITRF-93", "ITRF-97", "J2000", "J2000A", "J2000_ECLIPTIC", "MCI", "MOD_CB",
    "MOD_EARTH", "MOD_MOON", "MOE_CB", "MOE_EARTH", "MOON_ME", "MOON_MEIAUE", "MOON_PA", "TDR", "TEME",
    "TEMEOFDATE", "TEMEOFEPOCH", "TIRS", "TOD", "TOD_CB", "TOD_EARTH", "TOD_MOON", "TOE_CB", "TOE_EARTH",
    "TOE_MOON", "TRUE_ECLIPTIC", "UVW_GO_INERTIAL", "WGS84",
)  # fmt: skip
_LOCAL = ("LVLH", "NSW", "NTW", "RSW", "SEZ", "TNW", "VNC")
_ORBITAL = (
    *("EQW_INERTIAL", "PQW_INERTIAL", "QSW", "RIC", "RTN"),
    *(f"{name}{kind}" for name in _LOCAL for kind in ("", "_ROTATING", "_INERTIAL")),
)
_NUMBERED = re.compile(r"(ITRF|DTRF|ICRF|GCRF|MOON_PA)_?\d+")  # of a year or an edition
_OF_BODY = re.compile(
    r"(ACC|ACTUATOR|AST|CSS|DSS|ESA|GYRO|GYRO_FRAME|IMU_FRAME|INSTRUMENT|MTA|RW|SA|SC_BODY|SENSOR|STARTRACKER|TAM)"
    r"(_\w+)?"
)


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


@dataclass(frozen=True)
class Segment:
    """A continuous piece of the motion: one block of metadata and its data.

    Attributes:
        metadata: the keywords as in the file, such as "OBJECT_NAME", "REF_FRAME_A" or "INTERPOLATION_METHOD", which is
            stored but not used.
        comments: the texts of the comments among metadata and data.
        epochs: the times of the lines.
        columns: the numbers of the lines by their names in the standard, such as "Q1", each (n,); angles in degrees,
            rates in degrees per second.
        body_is: "A" or "B", the frame that rotates with the body; "" if the frame names do not determine it.

    Examples:
        >>> (segment,) = ml.spacecraft.attitudes.read("satellite.aem").segments  # the file from the example of `write`
        >>> segment.metadata["OBJECT_NAME"], segment.body_is
        ('SATELLITE', 'B')
    """

    metadata: Mapping[str, str]
    comments: tuple[str, ...]
    epochs: tuple[Epoch, ...]
    columns: Mapping[str, np.ndarray]
    body_is: str

    @property
    def attitudes(self) -> np.ndarray:
        """(n, 4), unit quaternions (w, x, y, z) from the frame of the body to the other one.

        Raises:
            ValueError: the data hold a spin axis and a nutation, and no attitude; or the frame of the body is unknown.
        """
        name = self.metadata["ATTITUDE_TYPE"]
        kind = FORMS[name].kind
        if not kind:
            raise ValueError(f"a segment of ATTITUDE_TYPE {name} gives no attitudes; its numbers are in `columns`.")
        if not self.body_is:
            a, b = self.metadata["REF_FRAME_A"], self.metadata["REF_FRAME_B"]
            raise ValueError(
                f"the frame that rotates with the body is unknown, REF_FRAME_A ({a}) or REF_FRAME_B "
                f"({b}); pass read(..., body='A') or body='B'."
            )
        numbers = np.stack([self.columns[column] for column in FORMS[name].columns], axis=1)
        found = rotations(kind, numbers, self.metadata.get("EULER_ROT_SEQ", ""))
        turned = (self.body_is == "A") != (self.metadata.get("ATTITUDE_DIR") == "B2A")
        return found * np.array([1.0, -1.0, -1.0, -1.0]) if turned else found

    def seconds_after(self, epoch: Epoch) -> np.ndarray:
        """(n,), the seconds of the lines after an epoch."""
        return np.array([float(one.seconds - epoch.seconds) for one in self.epochs])


@dataclass(frozen=True)
class AttitudeFile:
    """An Attitude Ephemeris Message.

    Attributes:
        version: "1.0" or "2.0".
        header: its keywords, such as "ORIGINATOR".
        comments: the texts of the comments in the header.
        segments: the pieces of the motion, one after the other.

    Examples:
        >>> message = ml.spacecraft.attitudes.read("satellite.aem")  # the file from the example of `write`
        >>> message.epoch, message.attitudes.shape
        ('2026-04-13T21:45:00.000000000', (7, 4))
    """

    version: str
    header: Mapping[str, str]
    comments: tuple[str, ...]
    segments: tuple[Segment, ...]

    @property
    def epoch(self) -> str:
        """The epoch of the first line, the origin of `times`."""
        return self.segments[0].epochs[0].text()

    @property
    def times(self) -> np.ndarray:
        """(n,), the seconds of all lines after the first; in UTC with leap seconds."""
        return np.concatenate([segment.seconds_after(self.segments[0].epochs[0]) for segment in self._of_one()])

    @property
    def attitudes(self) -> np.ndarray:
        """(n, 4), unit quaternions (w, x, y, z) of all lines, from the frame of the body to the other one."""
        return np.concatenate([segment.attitudes for segment in self._of_one()])

    def _of_one(self) -> tuple[Segment, ...]:
        for keyword in ("OBJECT_ID", "REF_FRAME_A", "REF_FRAME_B"):
            names = {segment.metadata[keyword].upper() for segment in self.segments}
            if len(names) > 1:
                several = ", ".join(sorted(names))
                raise ValueError(f"the segments have several {keyword}: {several}; use each of `segments` separately.")
        return self.segments


def is_of_body(name: str) -> bool:
    """Whether a frame of the registry rotates with a spacecraft: the spacecraft itself or its equipment."""
    return bool(_OF_BODY.fullmatch(name.upper()))


def check_frame(keyword: str, name: Any, agreed: Collection[str] = ()) -> str:
    """The name of a frame; a ValueError if it is neither in the registries nor agreed upon."""
    if not isinstance(name, str) or not name.strip():
        raise ValueError(f"{keyword} must be the name of a frame, got {shown(name)}.")
    known = name.upper() in (*_CELESTIAL, *_ORBITAL) or _NUMBERED.fullmatch(name.upper()) or is_of_body(name)
    if not known and name not in agreed:
        listed = ("EME2000", "ICRF", "GCRF", "ITRF2014", "TEME", "LVLH", "RTN", "SC_BODY_1", "STARTRACKER_1")
        note = f"If both sides agreed on this name, pass frames=({name!r},)."
        raise unknown(f"frame of {keyword}", name, listed, more=(*_CELESTIAL, *_ORBITAL), note=note)
    return name
