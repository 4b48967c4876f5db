"""Schemes: which kicks and flights make a step, with which coefficients.

A scheme is a table of numbers, and `run` is the one function that runs a table. It does not know what flies:
the same tables drive rigid bodies and particles.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

KICK, FLIGHT = "kick", "flight"


class Scheme(NamedTuple):
    """A splitting scheme.

    Attributes:
        name: its name in method names.
        order: order of accuracy when the flight's own order is no less.
        symmetric: whether the table reads the same backwards, so that a step of -h undoes a step of h.
        stages: (KICK | FLIGHT, coefficient) in the order in which they act; coefficients of each sum to 1.
        source: where the table is from.
    """

    name: str
    order: int
    symmetric: bool
    stages: tuple[tuple[str, float], ...]
    source: str

    @property
    def reuses_force(self) -> bool:
        """Whether a step begins and ends with a kick, so that the last force is the next step's first."""
        return self.stages[0][0] == KICK and self.stages[-1][0] == KICK

    @property
    def flights(self) -> int:
        """Flights a step."""
        return sum(kind == FLIGHT for kind, _ in self.stages)

    @property
    def evaluations(self) -> int:
        """Force evaluations a step, once under way."""
        return sum(kind == KICK for kind, _ in self.stages) - self.reuses_force


def run(
    scheme: Scheme,
    fly: Callable[[float, Any], Any],
    kick: Callable[[float, float, Any, Any], Any],
    evaluate: Callable[[float, Any], Any],
    motion: Any,
    force: Any = None,
) -> tuple[Any, Any]:
    """One step.

    Args:
        fly: `fly(a, motion)`, the flight for a times the step.
        kick: `kick(b, c, motion, force)`, the impulse of b times the step, c steps after its start.
        evaluate: `evaluate(c, motion)`, the force there.
        motion: anything.
        force: the force at the start, where the caller keeps it from the last step (see `reuses_force`).

    Returns:
        The new motion, and the force of the last kick (None where there was no kick).
    """
    elapsed, flights_left = 0.0, scheme.flights
    for kind, coefficient in scheme.stages:
        if kind == FLIGHT:
            motion = fly(coefficient, motion)
            flights_left -= 1
            # Coefficients are rounded; the last flight ends at the end of the step all the same.
            elapsed = elapsed + coefficient if flights_left else 1.0
            force = None
        else:
            force = evaluate(elapsed, motion) if force is None else force
            motion = kick(coefficient, elapsed, motion, force)
    return motion, force


def _splitting(name: str, order: int, stages: tuple[tuple[str, float], ...], source: str) -> Scheme:
    return Scheme(name, order, stages == stages[::-1], stages, source)


_KRYSL = "Krysl, Explicit time integrators for nonlinear dynamics derived from the midpoint rule, 2004"
E1 = _splitting("E1", 1, ((FLIGHT, 1.0), (KICK, 1.0)), _KRYSL)
E2 = _splitting("E2", 1, ((KICK, 1.0), (FLIGHT, 1.0)), _KRYSL)
EA = _splitting("EA", 2, ((KICK, 0.5), (FLIGHT, 0.5), (FLIGHT, 0.5), (KICK, 0.5)), _KRYSL)
EA_STAR = _splitting("EA*", 2, ((FLIGHT, 0.5), (KICK, 1.0), (FLIGHT, 0.5)), _KRYSL)
