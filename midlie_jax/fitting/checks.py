"""Whether a model and measurements match in kind, units and conventions, checked before anything is traced.

Measured speeds are compared with the possible speeds of a free body of the guess. Attitudes follow another convention
if the angular velocity between neighbours agrees with the measured one only after they are conjugated or exchanged.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation  # SciPy is a dependency of JAX

from ..drivers.arguments import check_system
from ..integrators.base import Method
from ..model.bodies import RigidBody, principal_of
from ..model.state import AnyState
from ..model.torques import without_gravity
from .instruments import Accelerations, Attitudes, Directions, Positions, Rates, of_which
from .measurements import Measurement, Observed
from .parameters import Layout

_FACTOR = 20.0  # a larger ratio of measured and guessed speeds means different units, such as degrees
_ANGLE = 1.5  # radians: below it, the rotation between two rows is unambiguous
_FEWEST = 4  # rows
_AGREES, _DIFFERS, _BETTER = 0.4, 0.6, 3.0
_MINUS = "np.array([1.0, -1.0, -1.0, -1.0])"
_READINGS = {  # conversion of each to (w, x, y, z) from body to space, and how to write it
    "conjugated, from space to body": (lambda q: q * [1, -1, -1, -1], f"values * {_MINUS}"),
    "scalar-last, (x, y, z, w)": (lambda q: np.roll(q, 1, axis=1), "np.roll(values, 1, axis=-1)"),
    "conjugated and scalar-last, (x, y, z, w) from space to body": (
        lambda q: np.roll(q, 1, axis=1) * [1, -1, -1, -1],
        f"np.roll(values, 1, axis=-1) * {_MINUS}",
    ),
}


def checked_model(
    model: Any, layout: Layout, measurements: Sequence[Measurement], method: Method, free: bool = False
) -> tuple[Method, bool]:
    """The fitted method, and whether the model holds several bodies; raises a ValueError if the data do not fit."""
    values = layout.values(layout.start())
    try:
        body, torque, start = model(values)
    except TypeError as error:
        raise ValueError(
            f"model must take the values of the guess and return (body, torque, start): {error}"
        ) from error
    if free and (torque is not None or start.several):
        raise ValueError('torque must be None for "free_motion", of one body; name another method, and give dt.')
    refused = "fit compares one motion with the measurements, and in a heat bath there are many"
    method = check_system(method, body, torque, start, bath=refused)
    if not start.own_axes:
        raise ValueError("model must return rigid bodies, got Particles.")
    if start.momentum.dtype != layout.start().dtype:
        raise ValueError(
            f"the start of the model must be {layout.start().dtype}, as the guess is, got {start.momentum.dtype}."
        )
    for measurement in measurements:
        subject = measurement.subject(body, start)
        _check_measurement(*subject, torque)
        if isinstance(subject[0], Observed):
            subject[0].check(values, *subject[1:])
    check_conventions(measurements, values)
    if torque is None and not start.several:
        for measurement in measurements:
            if isinstance(measurement, Rates):
                _check_speeds(body, start, measurement)
    return method, start.several


def _check_measurement(m: Measurement, body: Any, start: Any, torque: Any) -> None:
    kind, state = type(m).__name__, type(start).__name__
    if isinstance(m, Rates) and not isinstance(principal_of(body).turning, RigidBody):
        raise ValueError(f"Rates must be of a rigid body, got a {type(body).__name__} from the model.")
    suits = hasattr(start, "attitude") or (isinstance(m, Directions) and hasattr(start, "direction"))
    if isinstance(m, Attitudes | Positions | Directions | Accelerations) and not suits:
        raise ValueError(
            f"{kind} must be of a state with an attitude, got a {state} from the model; return a RigidState."
        )
    if isinstance(m, Positions) and m.origin is not None and start.kind.rotation is not None:
        raise ValueError(f"origin must be None for a body that translates, got one with a {state}; leave origin out.")
    if isinstance(m, Accelerations):
        in_model = torque is not None and without_gravity(torque) is not torque
        if m.gravity is None and (start.kind.rotation is None or not in_model):
            raise ValueError(
                "Accelerations must have gravity=, got None. Give it, such as (0, 0, -9.81) or zeros, or "
                "UniformGravity in the torque of a body that translates."
            )
        if in_model and m.gravity is not None:
            raise ValueError(
                "gravity must be given once, got it from Accelerations and from the torque of the model; leave "
                "gravity out of Accelerations."
            )
    if m.values.dtype != start.momentum.dtype:
        raise ValueError(f"{kind} must be {start.momentum.dtype}, as the start of the model is, got {m.values.dtype}.")


def _check_speeds(body: Any, start: AnyState, measured: Rates) -> None:
    """Raises if a free body cannot reach the measured speeds, which means that the units differ."""
    # Its speed changes by at most the ratio of the largest moment to the smallest.
    guessed = float(jnp.linalg.norm(body.velocity(start.momentum)))
    moments = principal_of(body).turning.moments
    allowed = max(_FACTOR, 2 * float(jnp.max(moments) / jnp.min(moments)))
    rates = np.asarray(measured.values)[np.all(np.asarray(measured.present), axis=1)]
    unknown = measured.bias is not None
    # An unknown bias may have any size, so only the changes of the rates are used, and these may be small.
    speeds = np.linalg.norm(rates - np.median(rates, axis=0) if unknown and len(rates) else rates, axis=1)
    usual = float(np.median(speeds)) if speeds.size else 0.0
    slow = 0 < usual <= guessed / allowed and not unknown
    if not slow and not usual >= guessed * (allowed / 2 if unknown else allowed) > 0:
        return
    if not unknown and speeds.min() <= guessed <= speeds.max():
        raise ValueError(
            f"Rates must be of one free motion, got speeds from {speeds.min():.3g} to {speeds.max():.3g}. Fit only "
            "the rows without torque, or give the torque."
        )
    seen = f"changes of {usual:.3g}" if unknown else f"{usual:.3g}"
    raise ValueError(
        f"Rates must be in the units of the guess, {guessed:.3g} radians per unit of time, got {seen}. Convert "
        "them, for example by np.deg2rad(values)."
    )


def check_conventions(measurements: Sequence[Measurement], values: Any) -> None:
    """Raises a ValueError if attitudes contradict the rates of the same body, but agree in another convention."""
    listed = [of_which(m) for m in measurements]
    for body, attitudes in listed:
        for other, rates in listed:
            if body == other and isinstance(attitudes, Attitudes) and isinstance(rates, Rates):
                _check_convention(attitudes, rates, values)


def _check_convention(attitudes: Attitudes, rates: Rates, values: Any) -> None:
    if any(m.clock is not None and m.clock.rule is not None for m in (attitudes, rates)):  # it is fitted
        return
    rows, gaps, measured = _pairs(attitudes, rates, values)
    if len(rows) < _FEWEST:
        return
    fitted = rates.bias is not None and rates.bias.rule is not None

    def typical(vectors: np.ndarray) -> float:
        """The median length, which ignores outliers; without a bias, if it is fitted."""
        return float(np.median(np.linalg.norm(vectors - np.median(vectors, axis=0) * fitted, axis=1)))

    size = typical(measured)

    def disagreement(quaternions: np.ndarray) -> float:
        turned = Rotation.from_quat(quaternions, scalar_first=True)
        off = (turned[rows].inv() * turned[rows + 1]).as_rotvec() / gaps[:, None] - measured
        return typical(off) / size if size > 0 else 0.0

    quaternions = np.asarray(attitudes.values, np.float64)
    given = disagreement(quaternions)
    others = {name: disagreement(read(quaternions)) for name, (read, _) in _READINGS.items()}
    best = min(others, key=lambda name: others[name])
    if others[best] < _AGREES and given > max(_DIFFERS, _BETTER * others[best]):
        raise ValueError(
            f"Attitudes must be quaternions (w, x, y, z) from body to space; by the Rates, these are {best}, off by "
            f"{others[best]:.0%} instead of {given:.0%}. Pass {_READINGS[best][1]}."
        )


def _pairs(attitudes: Attitudes, rates: Rates, values: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of neighbouring rows of attitudes: the first row, the time between, and the rate in the middle of it.

    The body rotates little within each pair, and between the two rows of rates around it.
    """
    times = np.asarray(attitudes.times_of_model(values), np.float64)
    rows = np.flatnonzero(np.asarray(attitudes.present[:, 0]))
    rows = rows[:-1][np.diff(rows) == 1]
    complete = np.all(np.asarray(rates.present), axis=1)
    seen, first = np.unique(np.asarray(rates.times_of_model(values), np.float64)[complete], return_index=True)
    measured = np.asarray(rates.values, np.float64)[complete][first]
    if rates.bias is not None and rates.bias.rule is None:
        measured = measured - np.asarray(rates.bias(values))
    gaps, middles = times[rows + 1] - times[rows], (times[rows + 1] + times[rows]) / 2
    after = np.searchsorted(seen, middles)
    inside = (gaps > 0) & (after > 0) & (after < len(seen))
    rows, gaps, middles, after = rows[inside], gaps[inside], middles[inside], after[inside]
    speeds = np.linalg.norm(measured, axis=1)
    fastest = np.maximum(speeds[after], speeds[after - 1])
    slow = fastest * np.maximum(gaps, seen[after] - seen[after - 1]) < _ANGLE
    between = np.stack([np.interp(middles, seen, x) for x in measured.T], axis=1)
    return rows[slow], gaps[slow], between[slow]
