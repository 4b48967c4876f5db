"""Whether the rows are so far apart that other values of the parameters may fit as well: aliases."""

import math
from typing import Any

import jax
import numpy as np

from ..model.bodies import principal_of
from .measurements import Measurement, Observed, Rates
from .of_body import OfBody
from .residuals import Model

_MOST_TURNS = 0.5  # between two rows


def aliases_of(model: Model, measurements: tuple[Measurement, ...], values: Any) -> str:
    """What to say if a body turns by more than half a revolution between rows; "" otherwise.

    Rates alone, of a free body, need no more rows than the change of the rates: a body that spins fast about an axis of
    symmetry may turn many times between them.
    """
    body, torque, start = model(values)
    if not np.all(np.isfinite(start.momentum)):
        return ""
    for own in _by_body(measurements).values():
        (_, one, state) = own[0].subject(body, start)
        inner = [m.measurement if isinstance(m, OfBody) else m for m in own]
        if start.several and any(isinstance(m, Observed) for m in own):
            continue  # a quantity of all bodies, with no rotation of its own
        times = np.unique(np.concatenate([_times(m) for m in inner]))
        gap = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        speed = _speed(inner, one, state, values)
        free_rates = torque is None and all(isinstance(m, Rates) for m in inner)
        frequency = min(speed, _nutation(one, state)) if free_rates else speed
        if frequency * gap > 2 * math.pi * _MOST_TURNS:
            return (
                f"the body turns {speed * gap / (2 * math.pi):.3g} times between rows, so other values may fit as well "
                "(aliases); check the units of time and of the rates, or give rows closer together"
            )
    return ""


def _by_body(measurements: tuple[Measurement, ...]) -> dict[int | None, list[Measurement]]:
    found: dict[int | None, list[Measurement]] = {}
    for m in measurements:
        found.setdefault(m.body if isinstance(m, OfBody) else None, []).append(m)
    return found


def _times(m: Measurement) -> np.ndarray:
    present = np.asarray(m.present)
    return np.asarray(m.times, np.float64)[present.reshape(len(present), -1).any(axis=1)]


def _speed(measurements: list[Measurement], body: Any, state: Any, values: Any) -> float:
    """The usual measured speed; the speed at the start where no rates are measured."""
    for m in measurements:
        if isinstance(m, Rates):
            bias = 0.0 if m.bias is None else np.asarray(m.bias(values))
            complete = np.all(np.asarray(m.present), axis=1)
            if complete.any():
                return float(np.median(np.linalg.norm(np.asarray(m.values)[complete] - bias, axis=1)))
    return float(np.linalg.norm(jax.tree.leaves(body.velocity(state.momentum))[0]))


def _nutation(body: Any, state: Any) -> float:
    """The largest frequency at which the rates of a free body can change."""
    moments = np.asarray(principal_of(body).turning.moments)
    return float(np.linalg.norm(state.momentum) * (1 / moments.min() - 1 / moments.max()))
