"""Messages of `recommend`: the limit of a step, a cheaper state, and the reason if there is no recommendation."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from ..integrators.registry import exact_flight
from ..integrators.registry import method as find_method
from ..model.bodies import Body
from ..model.state import AnyState
from .facts import Facts
from .ladder import Candidate, Trial

_WORTH = 0.9  # share of the run time below which another state is mentioned
_STIFF = 5  # a rate of the linearised equations is stiff if it exceeds the rate of the motion by this factor


def limit_of_step(body: Any, torque: Any, start: AnyState, t0: Array, trials: Sequence[Trial], best: Trial) -> str:
    """The limit of the step, if a larger step made a run fail rather than inaccurate; "" otherwise."""
    failed = [t for t in trials if t.steps < best.steps and not t.ok]
    if not failed or failed[-1].steps < best.steps / 4:
        return ""
    largest_rate, motion_rate = _rates(body, torque, start, t0)
    if largest_rate * abs(failed[-1].dt) > 1 and largest_rate > _STIFF * motion_rate:
        return f"the torque is stiff: larger steps are unstable. {_stiffness(largest_rate, motion_rate)}"
    return "larger steps rotate the body beyond the reach of the flight's series."


def of_a_direction(seconds: float, whole: float) -> str:
    """Message if a `DirectionState` is faster than a `RigidState`, given both run times; "" otherwise."""
    if not 0 < seconds < _WORTH * whole:  # zero if the run is below the noise of the clock
        return ""
    return (
        "the torque reads one space direction only; without the attitude, on a "
        f"midlie_jax.DirectionState, the same run is {whole / seconds:.1f} times faster."
    )


def why_none(
    body: Any,
    torque: Any,
    start: AnyState,
    t0: Array,
    span: float,
    tolerance: float,
    candidates: Iterable[Candidate],
    change: float,
) -> str:
    """Why there is no recommendation; `change` is the least change of the end by halving a step."""
    runs = [(steps, run.ok) for candidate in candidates for steps, run in candidate.runs.items()]
    most, failed = max(steps for steps, _ in runs), not all(ok for _, ok in runs)
    tried = f"with up to {most} steps of {span / most:.1e}"
    largest_rate, motion_rate = _rates(body, torque, start, t0)
    if not math.isfinite(largest_rate):
        return "the torque or its derivative is not finite at the start; check it for a division by zero."
    if largest_rate > _STIFF * motion_rate and failed:
        return (
            f"the torque is stiff: no method reached {tolerance:.1e} {tried}. {_stiffness(largest_rate, motion_rate)}"
        )
    if math.isinf(change):
        return f"every run failed, {tried}; check the torque for NaN during the motion."
    return (
        f"no recommendation for a tolerance of {tolerance:.1e}: {tried}, halving the step still "
        f"changes the end by {change:.1e}. Use a larger tolerance, a shorter duration (if "
        "the motion is chaotic), or float64."
    )


def _stiffness(largest_rate: float, motion_rate: float) -> str:
    return (
        f"Its largest rate at the start is {largest_rate:.1e} per unit of time, while the rate of the motion is "
        f"{motion_rate:.1e}. Use an implicit solver of diffrax: Kvaerno5() with "
        "midlie_jax.diffrax.RigidBodyTerm(body, torque)."
    )


def speed_of(body: Any, start: Any) -> float:
    """|Omega| at the start; for a `SymmetricRotor`, the angular speed of its axis."""
    return float(np.linalg.norm(np.asarray(body.turning.velocity(start.momentum), np.float64)))


def _rates(body: Any, torque: Any, start: AnyState, t0: Array) -> tuple[float, float]:
    """The largest rate of the torque linearised at the start, and the rate of the motion itself.

    The rate of the motion is the larger of |Omega| and the square root of |d Omega/dt|.
    """
    method = find_method(exact_method(body))
    facts = jax.tree.map(np.asarray, jax.jit(lambda: Facts.of(method, body, torque, start, t0))())
    largest = float(np.max(np.abs(facts.rates)))
    return largest, max(speed_of(body, start), float(facts.acceleration) ** 0.5) if math.isfinite(largest) else math.inf


def exact_method(body: Body) -> str:
    return f"{exact_flight(body).name}[EA]"
