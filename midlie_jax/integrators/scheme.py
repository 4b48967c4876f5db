"""`Scheme`: the table of kicks, flights and bath stages of a step, checked on construction; `run` takes the step.

The order of a scheme is measured in extended precision and without JAX, on runs of two pendulums. For a scheme with a
bath it is measured on two oscillators, whose averages need no sample, because they obey closed equations.
"""

from collections.abc import Callable, Iterator
from dataclasses import InitVar, dataclass, replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

Stages = tuple[tuple[str, float], ...]  # kinds and coefficients
KICK, FLIGHT, BATH = "kick", "flight", "bath"
_ROUNDING = 1e-12  # tolerance for sums of coefficients, which are published with 14 digits or more
_names: set[str] = set()  # the names of the package's own schemes


@dataclass(frozen=True)
class Scheme:
    """A splitting scheme.

    Attributes:
        name: the part in brackets of a method's name.
        order: order of accuracy if the flight is of the same order or higher, or if the scheme is `composed`. It is
            measured (`measured_order`, up to half a second) unless there are no kicks; with a bath it is the weak
            order, the order of averages, which is at most 2 (`measured_weak_order`).
        stages: pairs (KICK | FLIGHT | BATH, coefficient), in the order in which they act. The coefficients of each kind
            sum to 1. In a bath stage, friction and noise act on the momenta, and poses are unchanged
            (`midlie_jax.baths.Langevin`).
        source: the publication of the table.
        use: when to use the scheme, for `midlie_jax.schemes.names()`.
        leading: whether the scheme, with an exact flight, needs the least work for some torque and some accuracy.
            `recommend` and charts of error against cost use the leading schemes.
        composed: whether it composes whole symmetric steps, which also raises the order of an inexact flight.
        gradients: one number g for each kick, or empty. The kick then uses the torque of the potential
            V - g h^2 T . I^-1 T, with the step h and the torque T; for particles V - g h^2 f . M^-1 f. Not with a bath.
        displaced: whether such a kick uses the torque at an attitude displaced by the rotation vector 2 g h^2 I^-1 T,
            rotated back, instead of a derivative. The difference is of order h^4, so an order up to 4 is kept; but the
            kick then has no potential, and the method is not symplectic.
        small: an exponent n for weak forces, as on a fast top: for forces of size e, the global error is of order e h^n
            + e^2 h^m, with m at least `order`.

    Args:
        known: whether to accept the name and the order unchecked, for the schemes of this package.

    Raises:
        ValueError: the name belongs to a scheme of this package, or contains brackets; coefficients do not sum to 1;
            the order is not the measured one; a stage is neither a kick nor a flight nor a bath; `gradients` is neither
            empty nor one number for each kick, or there is a bath; `displaced` without `gradients`; or `small` or
            `composed` is not true of the scheme.

    Examples:
        >>> kick, flight, end = ml.schemes.KICK, ml.schemes.FLIGHT, 0.1931833275037836  # McLachlan 1995
        >>> table = ((kick, end), (flight, 0.5), (kick, 1 - 2 * end), (flight, 0.5), (kick, end))
        >>> scheme = ml.schemes.Scheme("ML2", 2, table)  # a ValueError if the order were not 2
        >>> scheme.symmetric, scheme.evaluations, ml.method("JACOBI", scheme).name
        (True, 2, 'JACOBI[ML2]')
    """

    name: str
    order: int
    stages: Stages
    source: str = ""
    composed: bool = False
    gradients: tuple[float, ...] = ()
    small: int | None = None
    use: str = ""
    leading: bool = False
    displaced: bool = False
    known: InitVar[bool] = False

    def __post_init__(self, known: bool) -> None:
        for problem in self._problems(known):
            raise ValueError(f"scheme {self.name!r}{problem}")

    def _problems(self, known: bool) -> Iterator[str]:
        if not isinstance(self.name, str) or not self.name or set("[]") & set(self.name):
            yield ": its name must be text without brackets."
        if not known and self.name in _names:
            yield ": midlie_jax has a scheme of this name; choose another name."
        if not isinstance(self.stages, tuple):
            yield f": stages must be a tuple of (kind, coefficient), got {self.stages!r}."
        for stage in self.stages:
            if not (isinstance(stage, tuple) and len(stage) == 2 and isinstance(stage[1], (int, float))):
                yield f": each stage must be a pair (kind, coefficient), got {stage!r}."
        kinds = [kind for kind, _ in self.stages]
        if FLIGHT not in kinds or not set(kinds) <= {KICK, FLIGHT, BATH}:
            yield f" must be made of {KICK!r}, {FLIGHT!r} and {BATH!r}, got {', '.join(map(repr, kinds))}."
        if self.random and (self.gradients or self.composed or self.small is not None):
            yield " has a bath, so averages are of weak order 2 at most; leave out gradients, composed and small."
        for kind in dict.fromkeys(kinds):
            total = sum(c for k, c in self.stages if k == kind)
            if not abs(total - 1) <= _ROUNDING:
                yield f": the coefficients of its {kind}s must sum to 1, got {total:.15g}."
        if self.gradients and len(self.gradients) != kinds.count(KICK):
            yield f" has {kinds.count(KICK)} kicks and {len(self.gradients)} gradients; give one for each kick."
        if self.displaced and not any(self.gradients):
            yield " has no gradients to replace by a displaced torque; leave out displaced."
        if not isinstance(self.order, int) or self.order < 1:
            yield f": its order must be a positive integer, got {self.order!r}."
        if self.composed and not self._is_composed():
            yield (
                " is declared composed, but its kicks are not half the sum of the adjacent flights; leave out composed."
            )
        if self.small is not None and not self._moments_are_exact(self.small):
            yield (
                f" has small={self.small}, but its kicks do not integrate polynomials of degree {self.small - 1} in "
                "time exactly; check the coefficients, or leave out small."
            )
        if not known and (KICK in kinds or self.random):
            measured = measured_weak_order(self) if self.random else measured_order(self)
            if not abs(measured - self.order) < 0.5:
                yield (
                    f" is declared of order {self.order}, but an order of {measured:.1f} is measured; check the "
                    "coefficients, or declare the measured order."
                )

    def _is_composed(self) -> bool:
        """Whether the step consists of Verlet steps: half kick, flight, half kick, with adjacent kicks merged."""
        if not self.alternates or self.stages[0][0] != KICK:
            return False
        kicks, flights, _ = self.columns()
        halves = zip(kicks, pairwise([0.0, *flights, 0.0]), strict=True)
        return all(abs(kick - (a + b) / 2) <= _ROUNDING for kick, (a, b) in halves)

    def _moments_are_exact(self, count: int) -> bool:
        """Whether the kicks, as a quadrature at their times, integrate the powers of t below `count` exactly."""
        kicks = (coefficient for kind, coefficient in self.stages if kind == KICK)
        rule = list(zip(kicks, self.times_of_kicks, strict=True))
        return all(abs(sum(b * c**k for b, c in rule) - 1 / (k + 1)) <= _ROUNDING for k in range(count))

    @property
    def symmetric(self) -> bool:
        """Whether the table is a palindrome, so that a step of -h undoes a step of h; False with a bath."""
        return self.stages == self.stages[::-1] and self.gradients == self.gradients[::-1] and not self.random

    @property
    def random(self) -> bool:
        """Whether it contains a bath."""
        return any(kind == BATH for kind, _ in self.stages)

    @property
    def begins_with_force(self) -> bool:
        """Whether a step begins with a kick by the force at its start, without a gradient; a bath changes no force."""
        return next(kind for kind, _ in self.stages if kind != BATH) == KICK and not any(self.gradients[:1])

    @property
    def reuses_force(self) -> bool:
        """Whether a step begins and ends with such a kick, so its last force is the first of the next step."""
        last = next(kind for kind, _ in reversed(self.stages) if kind != BATH)
        return self.begins_with_force and last == KICK and not any(self.gradients[-1:])

    def merged(self) -> "Scheme":
        """The scheme with adjacent stages of the same kind merged: the same method if the flight is exact."""
        stages = [self.stages[0]]
        for kind, coefficient in self.stages[1:]:
            if kind == stages[-1][0]:
                stages[-1] = (kind, stages[-1][1] + coefficient)
            else:
                stages.append((kind, coefficient))
        return replace(self, stages=tuple(stages), known=True)

    @property
    def flights(self) -> int:
        """Flights per step."""
        return sum(kind == FLIGHT for kind, _ in self.stages)

    @property
    def alternates(self) -> bool:
        """Whether there are only kicks and flights, alternating, and the first and last stage are of the same kind."""
        kinds = [kind for kind, _ in self.stages]
        return not self.random and kinds[0] == kinds[-1] and all(a != b for a, b in pairwise(kinds))

    def columns(self) -> tuple[list[float], list[float], list[float]]:
        """If the scheme alternates: kicks, flights, and the times before, between and after flights, from 0 to 1."""
        kicks = [c for kind, c in self.stages if kind == KICK]
        flights = [c for kind, c in self.stages if kind == FLIGHT]
        # Rounded coefficients do not sum exactly to 1, but the time after the last flight is 1.
        return kicks, flights, [0.0, *list(accumulate(flights))[:-1], 1.0]

    @property
    def times_of_kicks(self) -> list[float]:
        """The time of each kick, in steps after the start of the step."""
        before = accumulate(c if kind == FLIGHT else 0.0 for kind, c in self.stages)
        return [time for time, (kind, _) in zip(before, self.stages, strict=True) if kind == KICK]

    @property
    def evaluations(self) -> int:
        """Force evaluations per step after the first step; the derivative for a gradient is not counted."""
        at_displaced = sum(g != 0 for g in self.gradients) if self.displaced else 0
        return sum(kind == KICK for kind, _ in self.stages) - self.reuses_force + at_displaced


def own_scheme(name: str, order: int, stages: Stages, source: str, **options: Any) -> Scheme:
    _names.add(name)
    return Scheme(name, order, stages, source, known=True, **options)


def run(
    scheme: Scheme,
    fly: Callable[[float, Any], Any],
    kick: Callable[[float, float, Any, Any], Any],
    evaluate: Callable[[float, float, Any], Any],
    motion: Any,
    force: Any = None,
    bathe: Callable[[float, float, int, Any], Any] | None = None,
) -> tuple[Any, Any]:
    """One step of h by a scheme: the new motion, and the force of the last kick (None if there was no kick).

    Args:
        fly: `fly(a, motion)`, the motion after a flight for the time a h.
        kick: `kick(b, c, motion, force)`, the motion after an impulse b h force at the time c h after the start.
        evaluate: `evaluate(c, g, motion)`, the force at the time c h, with the weight g of `Scheme.gradients`.
        motion: the motion at the start, of any type.
        force: the force at the start if the caller kept it from the previous step (see `reuses_force`), else None.
        bathe: `bathe(b, c, i, motion)`, the motion after stage i of the bath, from 0, for the time b h at the time c h.
            If None, such stages change nothing.

    Examples:
        >>> h = 0.1  # a mass on a spring; its motion is (position, momentum)
        >>> fly = lambda a, motion: (motion[0] + a * h * motion[1], motion[1])
        >>> kick = lambda b, c, motion, force: (motion[0], motion[1] + b * h * force)
        >>> pull = lambda c, g, motion: -motion[0]
        >>> motion, force = ml.schemes.run(ml.schemes.EA, fly, kick, pull, (1.0, 0.0))
        >>> [round(x, 6) for x in motion]
        [0.995, -0.09975]
    """
    elapsed, flights_left, baths = 0.0, scheme.flights, 0
    weights = iter(scheme.gradients)
    for kind, coefficient in scheme.stages:
        if kind == FLIGHT:
            motion = fly(coefficient, motion)
            flights_left -= 1
            # Rounded coefficients do not sum exactly to 1, but the time after the last flight is 1.
            elapsed = elapsed + coefficient if flights_left else 1.0
            force = None
        elif kind == BATH:  # changes only momenta, so the force stays
            motion = motion if bathe is None else bathe(coefficient, elapsed, baths, motion)
            baths += 1
        else:
            weight = next(weights, 0.0)
            force = evaluate(elapsed, weight, motion) if force is None else force
            motion = kick(coefficient, elapsed, motion, force)
    return motion, force


# Two pendulums of different mass joined by a spring; the potential is far from quadratic.
_MASSES = np.array([1.0, 1.7], np.longdouble)
_START = np.array([0.3, 0.8], np.longdouble), np.array([0.7, -0.4], np.longdouble)
_DURATION, _FEWEST_STEPS, _MOST_STEPS = 3, 12, 1536


def pendulums(scheme: Scheme, count: int, before: Stages = (), after: Stages = ()) -> np.ndarray:
    """Momenta and angles of two pendulums after `count` steps, in extended precision, (4,)."""
    h = np.longdouble(_DURATION) / count

    def fly(a: float, motion: Any) -> Any:
        return motion[0], motion[1] + a * h * motion[0] / _MASSES

    def kick(b: float, c: float, motion: Any, force: Any) -> Any:
        return motion[0] + b * h * force, motion[1]

    def force_at(u: Any) -> Any:
        pull = np.cos(u[0] - u[1]) / 2
        return -np.sin(u) - np.array([pull, -pull])

    def evaluate(c: float, g: float, motion: Any) -> Any:
        u = motion[1]
        force = force_at(u)
        if not g:
            return force
        w = force / _MASSES
        if scheme.displaced:
            return force_at(u + 2 * g * h * h * w)
        pull_rate = np.sin(u[0] - u[1]) / 2 * (w[0] - w[1])
        return force + 2 * g * h * h * (-np.cos(u) * w + np.array([pull_rate, -pull_rate]))

    def apply(stages: Stages, motion: Any) -> Any:
        for kind, x in stages:
            motion = fly(x, motion) if kind == FLIGHT else kick(x, 0.0, motion, evaluate(0.0, 0.0, motion))
        return motion

    motion, force = apply(before, _START), None
    for _ in range(count):
        motion, force = run(scheme, fly, kick, evaluate, motion, force if scheme.reuses_force else None)
    return np.concatenate(apply(after, motion))


def measured_order(scheme: Scheme, before: Stages = (), after: Stages = ()) -> float:
    """The order of a scheme on two pendulums: the slope of the error at the smallest steps not dominated by rounding.

    The error is estimated from differences of runs with steps h, h/2 and h/4, in NumPy's longdouble. The result is
    within about 0.1 of an integer. If rounding hides the error (order 8 and more if longdouble is plain double), it is
    the slope at the largest steps.

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


def measured_weak_order(scheme: Scheme) -> float:
    """The weak order of a scheme with a bath, from the mean and the covariance of two oscillators.

    The pendulums of `measured_order` test the combination of kicks and flights; the lower of both orders is returned.

    Examples:
        >>> round(ml.schemes.measured_weak_order(ml.schemes.BAOAB))
        2
    """
    coarse, middle, fine = (_averages(scheme, count) for count in (16, 32, 64))
    order = float(np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine)))
    return min(order, measured_order(scheme)) if any(kind == KICK for kind, _ in scheme.stages) else order


def _averages(scheme: Scheme, count: int) -> np.ndarray:
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
