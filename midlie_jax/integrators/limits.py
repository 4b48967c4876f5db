"""Theoretical limits of the step, for `midlie_jax.check` and for stability maps, derived in the docstrings.

Frequencies are angular, in radians per unit of time, and steps are positive. Both may be NumPy arrays.
"""

import math
from typing import Any

import numpy as np

from .scheme import BATH, KICK, Scheme
from .system import AnyMotion, Motion

_FINEST, _FURTHEST = 1e-3, 30.0  # the spacing and the end of the search for h omega
_ROUNDING = 1e-9  # the largest excess of a trace over 2 that counts as rounding
_GROWTH = 1e-4  # the allowed relative growth of an oscillation per Runge-Kutta step


def oscillator_limit(scheme: Scheme) -> float:
    """The largest h omega up to which every step of a scheme of kicks and flights is stable on an oscillator.

    In units in which moment and frequency of a libration are 1, and with a step of x, a flight a is the matrix
    ((1, a x), (0, 1)) and a kick b is ((1, 0), (-b x (1 - 2 g x^2), 1)). The weight g of a force gradient enters
    because the potential V - g h^2 T . I^-1 T has the stiffness k (1 - 2 g (h omega)^2). The determinant is 1, so the
    step is stable where the trace is between -2 and 2. The limit is the first x outside, for example 2 for EA, whose
    trace is 2 - x^2. A bath is ignored, because its damping increases the stability.
    """
    x = np.arange(_FINEST, _FURTHEST, _FINEST)
    step = np.broadcast_to(np.eye(2), (len(x), 2, 2))
    weights = iter(scheme.gradients)
    for kind, coefficient in (stage for stage in scheme.stages if stage[0] != BATH):
        stage = np.broadcast_to(np.eye(2), (len(x), 2, 2)).copy()
        if kind == KICK:
            stage[:, 1, 0] = -coefficient * x * (1 - 2 * next(weights, 0.0) * x * x)
        else:
            stage[:, 0, 1] = coefficient * x
        step = stage @ step
    return _first(x, np.abs(np.trace(step, axis1=1, axis2=2)) > 2 + _ROUNDING)


def decay_limit(scheme: Scheme) -> float:
    """The largest h gamma up to which a scheme damps a decay at the rate gamma, p' = -gamma p.

    A kick b is a step of the explicit midpoint rule, a factor 1 - b x + (b x)^2 / 2 with x = h gamma; flights change
    nothing. The limit is the first x at which the product of the factors exceeds 1.
    """
    x = np.arange(_FINEST, _FURTHEST, _FINEST)
    factor = np.ones_like(x)
    for kind, coefficient in scheme.stages:
        if kind == KICK:
            factor *= 1 - coefficient * x + (coefficient * x) ** 2 / 2
    return _first(x, np.abs(factor) > 1 + _ROUNDING)


def runge_kutta_limit(formula: Any, direction: complex) -> float:
    """The largest h |lambda| for which a Runge-Kutta step magnifies y in y' = lambda y by a factor of at most 1 + 1e-4.

    A step multiplies y by the stability polynomial R(h lambda) of the method, which is evaluated by its formula
    (`runge_kutta.py`). If the real part of `direction`, lambda / |lambda|, is positive, y itself grows, and the result
    is infinity.
    """
    if direction.real > _ROUNDING:
        return math.inf
    x = np.arange(_FINEST, _FURTHEST, _FINEST)
    z = x * direction

    def rates(time: float, part: float, motion: AnyMotion) -> AnyMotion:
        return Motion(part * z * motion.momentum, ())

    def pause(fresh: Any, older: Any, evaluations: int) -> tuple[Any, Any, bool]:
        return fresh, older, False

    change = formula.change(rates, pause, Motion(np.ones_like(z), ()))
    return _first(x, np.abs(1 + np.asarray(change.momentum)) > 1 + _GROWTH)


def _first(x: np.ndarray, beyond: np.ndarray) -> float:
    return float(x[np.argmax(beyond)]) - _FINEST if np.any(beyond) else math.inf


def resonance(frequency: Any, k: Any = 1) -> Any:
    """The step at which kicks resonate with a motion of this frequency, h = pi / (k omega), 2 k steps per period.

    Under a weak torque the angle x = omega t of a nutation, a precession or a spin advances evenly, and the torque has
    harmonics T_n cos(n x), which average to zero. Kicks sample it only at the times m h. The harmonic n = 2 k of an
    angle that advances by pi / k per step is then the same at every kick, and the kicks add up. A field that is
    quadratic in the direction of the body, such as a gravity gradient, has n = 2 and resonates at h omega = pi. A field
    that is linear in it resonates at h omega = 2 pi, and at pi / k in higher order.
    """
    return np.pi / (np.asarray(k) * np.asarray(frequency))


def resonance_half_width(field: Any, k: Any = 1) -> Any:
    """The largest difference of omega from pi / (k h) within which the resonance captures it, field / k.

    Near the resonance of the harmonic n = 2 k the angle y = n x - 2 pi t / h changes slowly. The kicks act on it like a
    pendulum, y'' = -f^2 sin y, with the frequency f, `field`, of small oscillations in this harmonic alone. The
    separatrix is at y' = 2 f, so x' = omega is captured within 2 f / n.
    """
    return np.asarray(field) / np.asarray(k)
