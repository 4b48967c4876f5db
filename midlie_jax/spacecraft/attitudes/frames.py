"""Names of reference frames in the CCSDS registries (sanaregistry.org)."""

import re
from collections.abc import Collection
from typing import Any

from ..._checks.arguments import shown, unknown

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
