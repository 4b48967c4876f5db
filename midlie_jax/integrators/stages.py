"""Kicks, flights and bath stages: the table of a step, and `run`, the function that takes the step.

This module does not depend on the kind of body: the same tables drive rigid bodies and particles.
"""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

KICK, FLIGHT, BATH = "kick", "flight", "bath"


@runtime_checkable
class Table(Protocol):
    """The part of a `Scheme` that `run` needs; `Scheme` documents its attributes."""

    @property
    def stages(self) -> tuple[tuple[str, float], ...]: ...

    @property
    def gradients(self) -> tuple[float, ...]: ...

    @property
    def displaced(self) -> bool: ...

    @property
    def flights(self) -> int: ...

    @property
    def reuses_force(self) -> bool: ...


def run(
    scheme: Table,
    fly: Callable[[float, Any], Any],
    kick: Callable[[float, float, Any, Any], Any],
    evaluate: Callable[[float, float, Any], Any],
    motion: Any,
    force: Any = None,
    bathe: Callable[[float, float, int, Any], Any] | None = None,
) -> tuple[Any, Any]:
    """One step of h by a scheme.

    Args:
        fly: `fly(a, motion)`, the motion after a flight for the time a h.
        kick: `kick(b, c, motion, force)`, the motion after an impulse b h force at the time c h after the start.
        evaluate: `evaluate(c, g, motion)`, the force at the time c h after the start, with the weight g of
            `Scheme.gradients`.
        motion: the motion at the start, of any type.
        force: the force at the start if the caller kept it from the previous step (see `reuses_force`), else None.
        bathe: `bathe(b, c, i, motion)`, the motion after stage i of the bath, counted from 0, which acts for the time b
            h at the time c h after the start. If None, such stages change nothing.

    Returns:
        The new motion, and the force of the last kick (None if there was no kick).

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
