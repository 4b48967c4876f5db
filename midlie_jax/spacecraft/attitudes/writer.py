"""`write`: attitudes of one body as an Attitude Ephemeris Message in KVN, version 2.0 or 1.0."""

import re
from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from fractions import Fraction
from itertools import pairwise
from pathlib import Path as File
from typing import Any

import jax
import numpy as np

from ..._checks.arguments import described, unknown
from ..._math.euler import as_sequence
from ...drivers.path import Path
from ...simulation.saved import saved_path
from .epochs import Epoch, check_system
from .message import check_frame, is_of_body, numbers_of

UNITS = {"ns": Fraction(1, 10**9), "us": Fraction(1, 10**6), "ms": Fraction(1, 1000), "s": Fraction(1),
         "min": Fraction(60), "h": Fraction(3600), "d": Fraction(86400)}  # fmt: skip
_TYPES = {"quaternion": "QUATERNION", "euler": "EULER_ANGLE", "spin": "SPIN"}
_NUMBERS = str.maketrans("XYZ", "123")  # of axes in version 1.0
_UNIT = 1e-3


def write(
    run: Any,
    file: str | File,
    *,
    epoch: str | datetime,
    time_system: str,
    time_unit: str | float,
    object_name: str,
    object_id: str,
    originator: str,
    ref_frame_a: str,
    ref_frame_b: str,
    center_name: str | None = None,
    form: str = "quaternion",
    sequence: str | None = None,
    body: Any = None,
    index: int = 0,
    times: Any = None,
    version: str = "2.0",
    comments: Sequence[str] = (),
    creation_date: str | datetime | None = None,
    frames: Collection[str] = (),
) -> int:
    """Writes the attitudes of one body as an Attitude Ephemeris Message (CCSDS 504.0-B-2 or B-1); returns their number.

    The file describes the rotation from frame A, the space frame, to frame B, the body frame. Their names are labels;
    nothing is computed from them. Quaternions keep their sign, so that they can be interpolated.

    Args:
        run: a `Path`, whose states have an `attitude`; a store .zarr or a file .npz of `simulate` or `midlie run`; or a
            state with arrays (n, 4), with `times`.
        file: the file; an existing one is replaced.
        epoch: the epoch of time 0 of the run: an ISO date and time, or a `datetime`, which without a time zone is in
            `time_system`.
        time_system: UTC, TAI, GPS, TT, TDB, TCB, TCG or UT1. In UTC leap seconds are counted.
        time_unit: the unit of time of the run: ns, us, ms, s, min, h, d, or a number of seconds.
        object_name, object_id: of the spacecraft; the id is its international designator, such as 2006-224A.
        originator: who made the file.
        ref_frame_a, ref_frame_b: the space frame, such as EME2000, and the body frame, such as SC_BODY_1.
        center_name: the body at the origin of frame A, such as EARTH; optional.
        form: "quaternion"; "euler", with `sequence`; or "spin": the direction of the body z axis, the angle about it,
            and the rate about it, the z component of the angular velocity.
        sequence: of Euler angles: the successive body axes, such as "ZYX" or "321".
        body: for "spin" of a `Path` or a state: the body of the run, for its angular velocity.
        index: which body of a store.
        times: (n,), for a state.
        version: "2.0", or "1.0" for older programs.
        comments: texts to put before the data.
        creation_date: in UTC; None for now.
        frames: names of frames that are not in the registries of CCSDS and that both sides agreed upon.

    Raises:
        ValueError: an argument is invalid or missing; the run failed, or holds no attitudes of one body; or different
            times have the same epoch, which is written to nanoseconds.
        OSError: the file cannot be written.

    Examples:
        >>> body, start = ml.RigidBody([2.0, 2.0, 1.0]), ml.RigidState([0.1, 0.0, 0.2], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.integrate("SYMMETRIC[EA]", body, None, start, dt=1.0, steps=60, save_every=10)
        >>> ml.spacecraft.attitudes.write(
        ...     path, "satellite.aem", epoch="2026-04-13T21:45:00", time_system="UTC", time_unit="s", originator="LAB",
        ...     object_name="SATELLITE", object_id="2026-001A", ref_frame_a="EME2000", ref_frame_b="SC_BODY_1",
        ... )  # seven lines of data
        7
    """
    if form not in _TYPES:
        raise unknown("form", form, _TYPES)
    if version not in ("1.0", "2.0"):
        raise unknown("version", version, ("1.0", "2.0"))
    if (form == "euler") != (sequence is not None):
        raise ValueError("sequence is the order of Euler angles, such as 'ZYX'; give it only with form='euler'.")
    letters = "" if sequence is None else as_sequence("sequence", sequence)
    words = [("object_name", object_name), ("object_id", object_id), ("originator", originator)]
    words += [("comments", comment) for comment in comments]
    for name, word in words if center_name is None else [*words, ("center_name", center_name)]:
        if not isinstance(word, str) or not word.strip() or not re.fullmatch(r"[\x20-\x7e]+", word):
            raise ValueError(f"{name} must be one line of ASCII text, got {word!r}.")
    check_frame("ref_frame_a", ref_frame_a, frames)
    check_frame("ref_frame_b", ref_frame_b, frames)
    if is_of_body(ref_frame_a) and not is_of_body(ref_frame_b):
        raise ValueError(
            f"ref_frame_a must be the space frame and ref_frame_b the body frame, got {ref_frame_a} "
            f"and {ref_frame_b}; exchange them."
        )
    system, unit = check_system(time_system), _unit(time_unit)
    try:
        zero = Epoch.of(system, epoch)
    except ValueError as error:
        raise ValueError(f"epoch {error}") from None
    times, attitudes, rates = _read(run, times, body, index, form == "spin")
    stamps = [Epoch(system, zero.seconds + Fraction(float(t)) * unit).text() for t in times]
    same = next((a for a, b in pairwise(stamps) if a >= b), None)
    if same is not None:
        raise ValueError(f"times must ascend by more than a nanosecond; two of them are {same}; check time_unit.")
    numbers = numbers_of(form, attitudes, letters, None if rates is None else np.rad2deg(rates) / float(unit))
    kept = Epoch.of("UTC", creation_date or datetime.now(UTC)).text(0)
    metadata = {
        "OBJECT_NAME": object_name,
        "OBJECT_ID": object_id,
        "CENTER_NAME": center_name,
        "REF_FRAME_A": ref_frame_a,
        "REF_FRAME_B": ref_frame_b,
        "ATTITUDE_DIR": "A2B" if version == "1.0" else None,
        "TIME_SYSTEM": system,
        "START_TIME": stamps[0],
        "STOP_TIME": stamps[-1],
        "ATTITUDE_TYPE": _TYPES[form],
        "QUATERNION_TYPE": "LAST" if version == "1.0" and form == "quaternion" else None,
        "EULER_ROT_SEQ": (letters if version == "2.0" else letters.translate(_NUMBERS)) or None,
    }
    lines = [f"CCSDS_AEM_VERS = {version}", f"CREATION_DATE = {kept}", f"ORIGINATOR = {originator}", "", "META_START"]
    lines += [f"COMMENT {comment}" for comment in comments]
    lines += [f"{name} = {value}" for name, value in metadata.items() if value is not None]
    lines += ["META_STOP", "", "DATA_START"]
    # Sixteen digits, the maximum of the standard.
    lines += [" ".join([stamp, *(f"{x:.16g}" for x in row)]) for stamp, row in zip(stamps, numbers, strict=True)]
    File(file).write_text("\n".join([*lines, "DATA_STOP", ""]), encoding="utf-8")
    return len(stamps)


def _unit(unit: Any) -> Fraction:
    if isinstance(unit, str):
        if unit not in UNITS:
            raise unknown("time_unit", unit, UNITS, note="Or give a number of seconds.")
        return UNITS[unit]
    if isinstance(unit, bool) or not isinstance(unit, (int, float)) or not 0 < unit < float("inf"):
        raise ValueError(f"time_unit must be one of {', '.join(UNITS)} or a positive number of seconds, got {unit!r}.")
    return Fraction(unit)


def _read(run: Any, times: Any, body: Any, index: int, spin: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Times (n,), attitudes (n, 4), and for spin the rates (n,) about the z axis of the body."""
    if isinstance(run, (str, File)):
        if times is not None or body is not None:
            raise ValueError(f"{run} holds its times and its body; leave times and body out.")
        saved = saved_path(run, index)
        run, body = saved.path, saved.body
    if isinstance(run, Path):
        if times is not None:
            raise ValueError("a path has its times; leave times out.")
        if not bool(np.all(np.asarray(run.ok))):
            raise ValueError(
                f"run must be without failures, got {np.min(np.asarray(run.first_bad))} good states of "
                f"{np.shape(run.times)[-1]}. Pass these as a state with times."
            )
        run, times = run.states, run.times
    elif times is None:
        raise ValueError(f"run must be a path, a file of a run, or a state with times=, got {described(run)}.")
    if not hasattr(run, "attitude") or np.ndim(run.attitude) != 2:
        what = f"attitudes of shape {np.shape(run.attitude)}" if hasattr(run, "attitude") else "none"
        raise ValueError(
            f"run must hold the attitudes of one body, (n, 4), got a {type(run).__name__} with "
            f"{what}; select one body of a batch."
        )
    moments, attitudes = np.asarray(times, np.float64), np.asarray(run.attitude, np.float64)
    if moments.shape != attitudes.shape[:1] or not moments.size:
        raise ValueError(f"times must have shape ({len(attitudes)},), one for each attitude, got {moments.shape}.")
    sizes = np.linalg.norm(attitudes, axis=1)
    good = np.isfinite(moments) & np.isfinite(sizes) & (np.abs(sizes - 1) < _UNIT)
    if not good.all():
        raise ValueError(f"attitudes must be unit quaternions at finite times; row {np.argmin(good)} is not.")
    rates = None
    if spin:
        if body is None:
            raise ValueError("form='spin' needs the body of the run for its angular velocity; give body=.")
        rates = np.asarray(jax.vmap(body.velocity)(run.momentum), np.float64)[:, 2]
    return moments, attitudes / sizes[:, None], rates
