"""What a scheme is: which kicks and flights make a step, with which coefficients; and the one function that runs one.

It does not know what flies: the same tables drive rigid bodies and particles.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any

KICK, FLIGHT = "kick", "flight"
_ROUNDING = 1e-12  # of the sums of coefficients, which are published with 14 digits or more


@dataclass(frozen=True)
class Scheme:
    """A splitting scheme.

    Attributes:
        name: its name in method names.
        order: order of accuracy when the flight's own order is no less, or the scheme is `composed`; taken at its word
            from 3 on (`measured_order` tells).
        stages: (KICK | FLIGHT, coefficient) in the order in which they act; coefficients of each sum to 1.
        source: where the table is from.
        use: when to take it, for `midlie_jax.schemes()`.
        leading: whether it needs the least work on an exact flight, for some torque and some accuracy. `recommend`
            tries these, and charts of error against cost show them.
        composed: whether it is a composition of whole symmetric steps, which raises the flight's own order as well.
        gradients: for each kick g, if any: the kick is that of the potential V - g h^2 T . I^-1 T, h the step and T
            the torque (for forces f . M^-1 f).
        small: for forces of a small size e, as on a fast top: the global error is e h^small + e^2 h^(order at least).

    Raises:
        ValueError: coefficients that do not sum to 1, or that miss the condition of order 2 where that is declared; a
            stage of another kind; gradients that are not one for each kick.
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
        place = f"scheme {self.name!r}"
        if not isinstance(self.stages, tuple):
            raise ValueError(f"{place}: stages must be a tuple of (kind, coefficient), got {self.stages!r}.")
        for stage in self.stages:
            if not (isinstance(stage, tuple) and len(stage) == 2 and isinstance(stage[1], (int, float))):
                raise ValueError(f"{place}: each stage must be a pair (kind, coefficient), got {stage!r}.")
        kinds = [kind for kind, _ in self.stages]
        if FLIGHT not in kinds or not set(kinds) <= {KICK, FLIGHT}:
            raise ValueError(f"{place} must be made of {KICK!r} and {FLIGHT!r}, got {', '.join(map(repr, kinds))}.")
        for kind in dict.fromkeys(kinds):
            total = sum(c for k, c in self.stages if k == kind)
            if not abs(total - 1) <= _ROUNDING:
                raise ValueError(f"{place}: the coefficients of its {kind}s must sum to 1, got {total:.15g}.")
        if self.gradients and len(self.gradients) != kinds.count(KICK):
            raise ValueError(
                f"{place} has {kinds.count(KICK)} kicks and {len(self.gradients)} gradients; give one each."
            )
        if not isinstance(self.order, int) or self.order < 1:
            raise ValueError(f"{place}: its order must be at least 1, and whole, got {self.order!r}.")
        if self.order > 1 and KICK in kinds and not abs(self._first_moment() - 0.5) <= _ROUNDING:
            raise ValueError(
                f"{place} is declared of order {self.order}, but the kicks, each times the flights before it, sum to "
                f"{self._first_moment():.15g} where order 2 needs 0.5."
            )

    def _first_moment(self) -> float:
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
        """Whether a step begins and ends with a kick, so that the last force is the next step's first."""
        ends = self.stages[0][0] == KICK and self.stages[-1][0] == KICK
        return ends and (not self.gradients or self.gradients[0] == self.gradients[-1] == 0)

    def merged(self) -> "Scheme":
        """The scheme with neighbouring stages of one kind made one: the same method where the flight is exact."""
        stages = [self.stages[0]]
        for kind, coefficient in self.stages[1:]:
            if kind == stages[-1][0]:
                stages[-1] = (kind, stages[-1][1] + coefficient)
            else:
                stages.append((kind, coefficient))
        return replace(self, stages=tuple(stages))

    @property
    def flights(self) -> int:
        """Flights a step."""
        return sum(kind == FLIGHT for kind, _ in self.stages)

    @property
    def alternates(self) -> bool:
        """Whether kicks and flights take turns, and it begins and ends with the same."""
        return all(a[0] != b[0] for a, b in pairwise(self.stages)) and self.stages[0][0] == self.stages[-1][0]

    def columns(self) -> tuple[list[float], list[float], list[float]]:
        """Kicks, flights, and the times between flights from 0 to 1, of a scheme that alternates."""
        kicks = [c for kind, c in self.stages if kind == KICK]
        flights = [c for kind, c in self.stages if kind == FLIGHT]
        # Coefficients are rounded; the last flight ends at the end of the step all the same.
        return kicks, flights, [0.0, *list(accumulate(flights))[:-1], 1.0]

    @property
    def evaluations(self) -> int:
        """Force evaluations a step, once under way."""
        return sum(kind == KICK for kind, _ in self.stages) - self.reuses_force


def run(
    scheme: Scheme,
    fly: Callable[[float, Any], Any],
    kick: Callable[[float, float, Any, Any], Any],
    evaluate: Callable[[float, float, Any], Any],
    motion: Any,
    force: Any = None,
) -> tuple[Any, Any]:
    """One step.

    Args:
        fly: `fly(a, motion)`, the flight for a times the step.
        kick: `kick(b, c, motion, force)`, the impulse of b times the step, c steps after its start.
        evaluate: `evaluate(c, g, motion)`, the force there, of the potential with gradient weight g (see `gradients`).
        motion: anything.
        force: the force at the start, where the caller keeps it from the last step (see `reuses_force`).

    Returns:
        The new motion, and the force of the last kick (None where there was no kick).
    """
    elapsed, flights_left = 0.0, scheme.flights
    weights = iter(scheme.gradients)
    for kind, coefficient in scheme.stages:
        if kind == FLIGHT:
            motion = fly(coefficient, motion)
            flights_left -= 1
            # Coefficients are rounded; the last flight ends at the end of the step all the same.
            elapsed = elapsed + coefficient if flights_left else 1.0
            force = None
        else:
            weight = next(weights, 0.0)
            force = evaluate(elapsed, weight, motion) if force is None else force
            motion = kick(coefficient, elapsed, motion, force)
    return motion, force
