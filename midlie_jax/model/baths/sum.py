"""`Sum`: several baths of bodies at once."""

from collections.abc import Iterable
from itertools import chain
from typing import Any

from jax import Array

from ..._checks.arguments import described
from ..bodies import Body
from ..exposure import PreparedBath, PreparedSum
from ..state import AnyState
from .base import BathOfBodies


class Sum(BathOfBodies):
    """Several baths at once, `a + b`, each with its own key; for example gases at two temperatures, or gas and laser.

    A bath stage applies each bath but the last for half of its time, the last one for all of it, and the others again
    in reverse order. Each of these stages is exact, and the error of the sum is of second order in the step, as for a
    torque. Baths at one temperature keep the Maxwell distribution at every step. For a number of friction and
    `Langevin(...) + Recoil(...)`, the heat of the recoil is right to a factor x/sinh(x), x = G h/I. The noise does not
    repeat if baths share a key.

    Attributes:
        parts: the baths.

    Raises:
        ValueError: a part that is no bath of bodies.

    Examples:
        >>> keys = jax.random.split(jax.random.key(0))
        >>> both = ml.baths.Langevin(1.0, 0.5, keys[0]) + ml.baths.Recoil(0.2, keys[1])
        >>> body, start = ml.RigidBody([2.0, 2.0, 1.0]), ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> bool(ml.integrate("SYMMETRIC[BAOAB]", body, None, start, dt=0.1, steps=20, bath=both).ok)
        True
    """

    parts: tuple[BathOfBodies, ...]

    def __init__(self, *parts: Any):
        for part in parts:
            if not isinstance(part, BathOfBodies):
                raise ValueError(f"a sum must be of baths of bodies, such as Langevin, got {described(part)}.")
        self.parts = tuple(chain.from_iterable(part.parts if isinstance(part, Sum) else (part,) for part in parts))

    @property
    def keys(self) -> tuple[Any, ...]:
        return tuple(chain.from_iterable(part.keys for part in self.parts))

    def prepared(self, body: Body, coefficients: Iterable[float], t: Array, h: Array, start: AnyState) -> PreparedSum:
        halves, last = {b / 2 for b in coefficients}, len(self.parts) - 1

        def one(i: int, part: BathOfBodies) -> PreparedBath:
            return part.prepared(body, coefficients if i == last else halves, t, h, start)

        return PreparedSum(tuple(one(i, part) for i, part in enumerate(self.parts)))

    def check(self, state: AnyState) -> None:
        for part in self.parts:
            part.check(state)

    def check_kind(self, state: AnyState, body: Any) -> None:
        for part in self.parts:
            part.check_kind(state, body)

    def check_on(self, state: AnyState, body: Any) -> None:
        for part in self.parts:
            part.check_on(state, body)
