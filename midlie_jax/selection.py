"""Which method and step for this body, this torque and this error: tried out on the very motion, not looked up.

The candidates run over a ladder of steps, beside each other, and the quickest that stays within the tolerance wins.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from .bodies import RigidBody
from .convergence import Reference, Row, by_halving, measure
from .scenes import Scene
from .states import RigidState
from .torques import TorqueLike, velocity_dependent

_TURNS = 10  # that a motion is watched for, unless told
_LEVELS = 9
_SAFETY = 0.8  # of the step that the errors on both sides of the tolerance would allow
_JUDGE = "DOP853"  # of high order under any torque, and none of the candidates that keep the motion's structure
_FIRST_TURN = 1.0  # radians, by the coarsest step tried


class Recommendation(NamedTuple):
    """What to use.

    Attributes:
        method: its name, for `integrate` and `ensemble`.
        dt: the step.
        error: of the attitude at the end of the motion watched, Frobenius norm, as the steps tried around `dt` tell.
        seconds: wall time for one body in a batch, for the whole motion, at that step.
        duration: how long the motion was watched.
        tried: all runs, as `midlie_jax.convergence.Row`.
    """

    method: str
    dt: float
    error: float
    seconds: float
    duration: float
    tried: tuple[Row, ...]


def recommend(
    body: RigidBody,
    torque: TorqueLike | None,
    state: RigidState,
    tolerance: float,
    *,
    duration: float | None = None,
    symplectic: bool = True,
) -> Recommendation:
    """The quickest of our methods, and its step, for an error of attitude at the end of a motion.

    Runs each candidate on the motion, half a minute in all: compiling is most of it, and counts for nothing in the
    choice. The time a method takes is that of this machine.

    Args:
        body, torque, state: as for `integrate`.
        tolerance: of the attitude at the end, Frobenius norm of the difference of rotation matrices.
        duration: how long; without it, the time of ten turns at the speed of the start.
        symplectic: only methods that are, and so also keep the energy over long runs; False admits Runge and Kutta's.

    Raises:
        ValueError: arguments as for `integrate`; a body at rest without a duration; a tolerance that is not positive,
            or too small to be told from rounding; no candidate reached it (the message gives the best).
    """
    if not isinstance(state, RigidState):
        raise ValueError(
            f"state must be a midlie_jax.RigidState, whose attitude is judged, got {type(state).__name__}."
        )
    if not tolerance > 0:
        raise ValueError(f"tolerance must be positive, got {tolerance!r}.")
    speed = float(np.linalg.norm(np.asarray(state.momentum) / np.asarray(body.moments)))
    if duration is None:
        if not speed > 0:
            raise ValueError("the body is at rest at the start: give a duration.")
        duration = _TURNS * 2 * math.pi / speed
    scene = Scene("", "", body, torque, state, duration, duration, "", "")
    coarsest = max(1, math.ceil(duration * speed / _FIRST_TURN))
    names = candidates(body, torque, symplectic)
    reference = by_halving(scene, _JUDGE, coarsest << (_LEVELS - 2))
    if reference.uncertainty > tolerance / 3:
        raise ValueError(
            f"tolerance {tolerance:.1e} is too small to be judged: the finest runs differ by "
            f"{reference.uncertainty:.1e}; use a larger one, a shorter duration, or float64."
        )
    tried, found = [], []
    for name in names:
        rows = list(_until(scene, name, coarsest, reference, tolerance))
        tried += rows
        found += _fit(rows, tolerance, duration)
    if not found:
        best = min((row.attitude_error for row in tried if row.ok), default=math.nan)
        raise ValueError(
            f"no method tried reached {tolerance:.1e}; the best error was {best:.1e}. Use a larger tolerance or a "
            "shorter duration."
        )
    seconds, name, dt, error = min(found)
    return Recommendation(name, dt, error, seconds, duration, tuple(tried))


def candidates(body: RigidBody, torque: TorqueLike | None, symplectic: bool = True) -> list[str]:
    """The methods that `recommend` tries: on the exact flight of the body, and three rotations about its axes."""
    a, b, _ = np.asarray(body.moments, np.float64)
    exact = "SYMMETRIC" if a == b else "JACOBI"
    if torque is None:
        return [f"{exact}[EA]"]
    tables = ["EA"]
    if not velocity_dependent(torque):  # which lowers every scheme to order 2
        tables += ["CHIN4A", "SRKN6b", "ABA1064", "SRKN11b", "SRKN14a"]
    names = [*(f"{exact}[{table}]" for table in tables), "DLM[EA]"]
    return names if symplectic else [*names, "RK4", "DOP853"]


def _until(scene: Scene, name: str, coarsest: int, reference: Reference, tolerance: float) -> Iterator[Row]:
    """Rows from the coarsest step to the first well within the tolerance."""
    for row in measure(scene, [name], [coarsest << level for level in range(_LEVELS)], reference):
        yield row
        if row.failure or (row.ok and row.attitude_error < tolerance / 2):
            return


def _fit(rows: Sequence[Row], tolerance: float, duration: float) -> list[tuple[float, str, float, float]]:
    """(seconds, method, step, error) from the two rows about the tolerance; nothing if it was not reached."""
    good = [row for row in rows if row.ok]
    if not good or not good[-1].attitude_error <= tolerance:
        return []
    fine = good[-1]
    coarse = next((row for row in reversed(good) if row.attitude_error > tolerance), None)
    dt, slope = fine.dt, 0.0
    if coarse is not None:
        slope = math.log(coarse.attitude_error / max(fine.attitude_error, 1e-300)) / math.log(coarse.dt / fine.dt)
        dt = max(fine.dt, _SAFETY * coarse.dt * (tolerance / coarse.attitude_error) ** (1 / slope))
    dt = duration / math.ceil(duration / dt * (1 - 1e-12))
    return [(fine.seconds * fine.dt / dt, fine.method, dt, fine.attitude_error * (dt / fine.dt) ** slope)]
