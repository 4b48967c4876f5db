"""The order of a scheme, measured in extended precision and without JAX.

`measured_order` compares runs of two pendulums. For a scheme with a bath, `measured_weak_order` compares the averages
of two oscillators; they need no sample, because mean and covariance of a linear system obey closed equations.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from .stages import BATH, FLIGHT, KICK, Table, run

# Two pendulums of different mass joined by a spring; the potential is far from quadratic.
_MASSES = np.array([1.0, 1.7], np.longdouble)
_START = np.array([0.3, 0.8], np.longdouble), np.array([0.7, -0.4], np.longdouble)
_DURATION, _FEWEST_STEPS, _MOST_STEPS = 3, 12, 1536


def pendulums(
    scheme: Table, count: int, before: tuple[tuple[str, float], ...] = (), after: tuple[tuple[str, float], ...] = ()
) -> np.ndarray:
    """Momenta and angles of two pendulums after `count` steps, in extended precision, (4,).

    Args:
        before, after: stages of a processor, applied once before and once after all steps.
    """
    h = np.longdouble(_DURATION) / count

    def fly(a: float, motion: Any) -> Any:
        return motion[0], motion[1] + a * h * motion[0] / _MASSES

    def kick(b: float, c: float, motion: Any, force: Any) -> Any:
        del c
        return motion[0] + b * h * force, motion[1]

    def force_at(u: Any) -> Any:
        pull = np.cos(u[0] - u[1]) / 2
        return -np.sin(u) - np.array([pull, -pull])

    def evaluate(c: float, g: float, motion: Any) -> Any:
        del c
        u = motion[1]
        force = force_at(u)
        if not g:
            return force
        w = force / _MASSES
        if scheme.displaced:
            return force_at(u + 2 * g * h * h * w)
        pull_rate = np.sin(u[0] - u[1]) / 2 * (w[0] - w[1])
        return force + 2 * g * h * h * (-np.cos(u) * w + np.array([pull_rate, -pull_rate]))

    def apply(stages: tuple[tuple[str, float], ...], motion: Any) -> Any:
        for kind, x in stages:
            motion = fly(x, motion) if kind == FLIGHT else kick(x, 0.0, motion, evaluate(0.0, 0.0, motion))
        return motion

    motion, force = apply(before, _START), None
    for _ in range(count):
        motion, force = run(scheme, fly, kick, evaluate, motion, force if scheme.reuses_force else None)
    return np.concatenate(apply(after, motion))


def measured_order(
    scheme: Table, before: tuple[tuple[str, float], ...] = (), after: tuple[tuple[str, float], ...] = ()
) -> float:
    """The order of a scheme on two pendulums: the slope of the error at the smallest steps not dominated by rounding.

    A `Scheme` is measured on construction. The error is estimated from differences of runs with steps h, h/2 and h/4,
    in NumPy's longdouble and without JAX. The result is within about 0.1 of an integer. If rounding hides the error
    (order 8 and more if longdouble is plain double), it is the slope at the largest steps.

    Args:
        scheme: the scheme.
        before, after: stages of a processor, applied once before and once after a run.

    Examples:
        >>> round(ml.schemes.measured_order(ml.schemes.EA))
        2
    """
    slope, count = np.nan, _FEWEST_STEPS
    ends = [pendulums(scheme, count * factor, before, after) for factor in (1, 2)]
    while 4 * count <= _MOST_STEPS:
        ends.append(pendulums(scheme, 4 * count, before, after))
        error, half_step_error = (np.linalg.norm(a - b) for a, b in pairwise(ends[-3:]))
        if np.isfinite(slope) and half_step_error < 1e4 * np.finfo(np.longdouble).eps:
            break
        slope = float(np.log2(error / half_step_error))
        count *= 2
    return slope


# Two oscillators joined by a spring, each with its own friction, at the temperature 1.
_STIFFNESS = np.array([[2.0, -0.7], [-0.7, 1.2]], np.longdouble)
_FRICTIONS = np.array([0.4, 1.5], np.longdouble)


def measured_weak_order(scheme: Table) -> float:
    """The weak order of a scheme with a bath, from the mean and the covariance of two oscillators.

    The pendulums of `measured_order` test the combination of kicks and flights; the lower of both orders is returned.

    Examples:
        >>> round(ml.schemes.measured_weak_order(ml.schemes.BAOAB))
        2
    """
    counts = 16, 32, 64
    coarse, middle, fine = (_averages(scheme, count) for count in counts)
    order = float(np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine)))
    return min(order, measured_order(scheme)) if any(kind == KICK for kind, _ in scheme.stages) else order


def _averages(scheme: Table, count: int) -> np.ndarray:
    """Mean (4,) and covariance (16,) of momenta and positions after `count` steps."""
    h, same, none = np.longdouble(_DURATION) / count, np.eye(2, dtype=np.longdouble), np.zeros((2, 2), np.longdouble)
    mean, covariance = np.array([0.7, -0.4, 0.3, 0.8], np.longdouble), np.zeros((4, 4), np.longdouble)
    for _ in range(count):
        for kind, x in scheme.stages:
            noise = np.zeros(4, np.longdouble)
            if kind == BATH:
                kept = np.exp(-_FRICTIONS * x * h / _MASSES)
                stage = np.block([[np.diag(kept), none], [none, same]])
                noise[:2] = _MASSES * (1 - kept**2)
            elif kind == FLIGHT:
                stage = np.block([[same, none], [np.diag(x * h / _MASSES), same]])
            else:
                stage = np.block([[same, -x * h * _STIFFNESS], [none, same]])
            mean, covariance = stage @ mean, stage @ covariance @ stage.T + np.diag(noise)
    return np.concatenate([mean, covariance.ravel()])
