"""`Rounding`: estimates, before a run, the error from the rounding of sums.

A step adds a change to the momentum, and the sum is rounded to nearest, by up to half a unit in its last place. Errors
of random sign grow as the square root of the number of steps. The change varies little from one step to the next. As
long as it varies by less than that unit, its rounding errors are equal: m such steps in sequence make one error of m
times the size. A flight with the rotation angle a changes the momentum by a, and that change varies by a^2 per step, in
units of the momentum. Therefore m = eps / a^2, and steps below sqrt(eps) (3e-4 radians in float32) lose more than
longer ones. A torque that is constant in the body frame is rounded the same way in all steps. If its impulse per step
is less than half a unit in the last place, it is lost completely.

A `CompensatedState` stores the errors of the sums, so the unit is then the last place of the change.
"""

from typing import Any, NamedTuple

import numpy as np

FEW = 3.0  # a state needs compensation if its rounding error exceeds errors of random sign by this factor


class Rounding(NamedTuple):
    """The quantities that determine the rounding errors of a run; the estimate is accurate within a factor of ten.

    Attributes:
        eps: the spacing of the dtype at 1.
        compensated: whether the run has a `CompensatedState`.
        rigid: whether the run has a `RigidState`, the kind that a `CompensatedState` can replace.
        changes: the changes of the momentum per step by flight and torque, relative to its size, (2, bodies).
        variations: the variation of these changes from step to step, likewise.

    Examples:
        >>> found = ml.check("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> found.rounding.error(10**6) < 1e-9, found.rounding.loses(10**6)
        (True, False)
    """

    eps: float
    compensated: bool
    rigid: bool
    changes: Any
    variations: Any

    def error(self, steps: int, compensated: bool | None = None) -> float:
        """The relative error of the momentum by rounding after a number of steps, for the worst body.

        Args:
            steps: the number of steps.
            compensated: whether the state is a `CompensatedState`; by default as in the run.
        """
        compensated = self.compensated if compensated is None else compensated
        unit = self.changes if compensated else np.ones_like(self.changes)
        least = np.finfo(float).tiny
        alike = np.clip(self.eps * unit / np.maximum(self.variations, least), 1, steps)
        errors = np.minimum(self.changes, self.eps / 2 * unit) * np.sqrt(steps * alike)
        return float(np.max(np.sqrt(np.sum(np.square(errors), axis=0))))

    def loses(self, steps: int) -> bool:
        """Whether rounding errors accumulate in one direction, which a `CompensatedState` would prevent."""
        usual = self.eps / 2 * steps**0.5
        return self.error(steps) > FEW * usual and self.error(steps, compensated=True) < self.error(steps) / FEW

    def text(self, steps: int) -> str:
        """The estimate as text."""
        found = f"about {self.error(steps):.1g} of the momentum in {steps} steps"
        if not self.loses(steps):
            return found
        found += ": so small changes are rounded the same way in many steps; "
        if not self.rigid:
            return found + "a longer step loses less, and so does float64"
        return (
            f"{found}a CompensatedState loses about {self.error(steps, compensated=True):.1g}, and a "
            "longer step loses less"
        )
