"""`Scheme`, the table of kicks and flights that make a step, and `run`, the function that takes a step by a scheme.

Neither depends on the kind of body: the same tables drive rigid bodies and particles.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any

KICK, FLIGHT = "kick", "flight"
_ROUNDING = 1e-12  # tolerance for sums of coefficients, which are published with 14 digits or more


@dataclass(frozen=True)
class Scheme:
    """A splitting scheme.

    Attributes:
        name: the part in brackets of a method's name.
        order: order of accuracy if the flight is of the same order or higher, or if the scheme is `composed`. Whether
            the coefficients reach an order of 3 or more is not checked; `measured_order` measures it.
        stages: pairs (KICK | FLIGHT, coefficient), in the order in which they act. The coefficients of the kicks sum to
            1, and so do those of the flights.
        source: the publication of the table.
        use: when to use the scheme, for `midlie_jax.schemes()`.
        leading: whether the scheme, with an exact flight, needs the least work for some torque and some accuracy.
            `recommend` tries the leading schemes, and charts of error against cost show them.
        composed: whether the scheme is a composition of whole symmetric steps, which also raises the order of an
            inexact flight.
        gradients: one number g for each kick, or empty. The kick then uses the torque of the potential
            V - g h^2 T . I^-1 T, with the step h and the torque T; for particles V - g h^2 f . M^-1 f.
        small: an exponent n for weak forces, as on a fast top: where the forces are of size e, the global error is of
            order e h^n + e^2 h^m, with m at least `order`.

    Raises:
        ValueError: coefficients do not sum to 1, or violate the condition of order 2 where `order` is 2 or more; a
            stage is neither a kick nor a flight; `gradients` is neither empty nor one number for each kick.
    """

    name: str
    order: int
    stages: tuple[tuple[str, float], ...]
    source: str = ""
    composed: bool = False
    gradients: tuple[float, ...] = ()
    small: int | None = None
    use: str = ""
    leading: bool = False

    def __post_init__(self) -> None:
        label = f"scheme {self.name!r}"
        if not isinstance(self.stages, tuple):
            raise ValueError(f"{label}: stages must be a tuple of (kind, coefficient), got {self.stages!r}.")
        for stage in self.stages:
            if not (isinstance(stage, tuple) and len(stage) == 2 and isinstance(stage[1], (int, float))):
                raise ValueError(f"{label}: each stage must be a pair (kind, coefficient), got {stage!r}.")
        kinds = [kind for kind, _ in self.stages]
        if FLIGHT not in kinds or not set(kinds) <= {KICK, FLIGHT}:
            raise ValueError(f"{label} must be made of {KICK!r} and {FLIGHT!r}, got {', '.join(map(repr, kinds))}.")
        for kind in dict.fromkeys(kinds):
            total = sum(c for k, c in self.stages if k == kind)
            if not abs(total - 1) <= _ROUNDING:
                raise ValueError(f"{label}: the coefficients of its {kind}s must sum to 1, got {total:.15g}.")
        if self.gradients and len(self.gradients) != kinds.count(KICK):
            raise ValueError(
                f"{label} has {kinds.count(KICK)} kicks and {len(self.gradients)} gradients; give one for each kick."
            )
        if not isinstance(self.order, int) or self.order < 1:
            raise ValueError(f"{label}: its order must be at least 1 and a whole number, got {self.order!r}.")
        if self.order > 1 and KICK in kinds and not abs(self._first_moment() - 0.5) <= _ROUNDING:
            raise ValueError(
                f"{label} is declared of order {self.order}, but its kicks, each times the flights before it, sum to "
                f"{self._first_moment():.15g} where order 2 needs 0.5; check the coefficients or declare order=1."
            )

    def _first_moment(self) -> float:
        """The sum over the kicks of coefficient times elapsed time, in units of the step."""
        elapsed, total = 0.0, 0.0
        for kind, coefficient in self.stages:
            if kind == FLIGHT:
                elapsed += coefficient
            else:
                total += coefficient * elapsed
        return total

    @property
    def symmetric(self) -> bool:
        """Whether the table reads the same backwards, so that a step of -h undoes a step of h."""
        return self.stages == self.stages[::-1] and self.gradients == self.gradients[::-1]

    @property
    def reuses_force(self) -> bool:
        """Whether a step begins and ends with a kick, so that its last force is the first force of the next step."""
        ends = self.stages[0][0] == KICK and self.stages[-1][0] == KICK
        return ends and (not self.gradients or self.gradients[0] == self.gradients[-1] == 0)

    def merged(self) -> "Scheme":
        """The scheme with adjacent stages of the same kind merged: the same method if the flight is exact."""
        stages = [self.stages[0]]
        for kind, coefficient in self.stages[1:]:
            if kind == stages[-1][0]:
                stages[-1] = (kind, stages[-1][1] + coefficient)
            else:
                stages.append((kind, coefficient))
        return replace(self, stages=tuple(stages))

    @property
    def flights(self) -> int:
        """Flights per step."""
        return sum(kind == FLIGHT for kind, _ in self.stages)

    @property
    def alternates(self) -> bool:
        """Whether kicks and flights alternate, and the first and the last stage are of the same kind."""
        return all(a[0] != b[0] for a, b in pairwise(self.stages)) and self.stages[0][0] == self.stages[-1][0]

    def columns(self) -> tuple[list[float], list[float], list[float]]:
        """Of a scheme that alternates: kicks, flights, and the times before, between and after flights, from 0 to 1."""
        kicks = [c for kind, c in self.stages if kind == KICK]
        flights = [c for kind, c in self.stages if kind == FLIGHT]
        # The coefficients are rounded, so their sum is not exactly 1; the time after the last flight is.
        return kicks, flights, [0.0, *list(accumulate(flights))[:-1], 1.0]

    @property
    def evaluations(self) -> int:
        """Force evaluations per step after the first step."""
        return sum(kind == KICK for kind, _ in self.stages) - self.reuses_force


def run(
    scheme: Scheme,
    fly: Callable[[float, Any], Any],
    kick: Callable[[float, float, Any, Any], Any],
    evaluate: Callable[[float, float, Any], Any],
    motion: Any,
    force: Any = None,
) -> tuple[Any, Any]:
    """One step of h by a scheme.

    Args:
        fly: `fly(a, motion)`, the motion after a flight for the time a h.
        kick: `kick(b, c, motion, force)`, the motion after an impulse b h force at the time c h after the start.
        evaluate: `evaluate(c, g, motion)`, the force at the time c h after the start, with the weight g of
            `Scheme.gradients`.
        motion: the motion at the start, of any type.
        force: the force at the start if the caller kept it from the last step (see `reuses_force`), else None.

    Returns:
        The new motion, and the force of the last kick (None where there was no kick).
    """
    elapsed, flights_left = 0.0, scheme.flights
    weights = iter(scheme.gradients)
    for kind, coefficient in scheme.stages:
        if kind == FLIGHT:
            motion = fly(coefficient, motion)
            flights_left -= 1
            # The coefficients are rounded, so their sum is not exactly 1; the time after the last flight is.
            elapsed = elapsed + coefficient if flights_left else 1.0
            force = None
        else:
            weight = next(weights, 0.0)
            force = evaluate(elapsed, weight, motion) if force is None else force
            motion = kick(coefficient, elapsed, motion, force)
    return motion, force
