"""`Rounding`: the error that the rounding of its sums leaves in a run, estimated before it.

A step adds a change to the momentum, and the sum is rounded to nearest, by up to half a unit in its last place. Errors
that fall either way grow as the square root of the number of steps. But from one step to the next the change itself
varies little, and as long as it varies by less than that unit it is rounded the same way: m such steps in a row count
as one error of m times the size. A flight that turns the body by a changes the momentum by a, and this change by a^2,
in units of the momentum; so m = eps / a^2, and steps below sqrt(eps) (3e-4 radians in float32) lose more than longer
ones. A torque that is constant in the body is rounded the same way in all steps, and one whose impulse is less than
half the last place is lost as a whole.

A `CompensatedState` keeps what the sums lose, so the unit is the last place of the change.
"""

from typing import Any, NamedTuple

import numpy as np

FEW = 3.0  # a state needs compensation where its rounding is so many times that of errors that fall either way


class Rounding(NamedTuple):
    """What decides the rounding of a run; the error is right within a factor of ten.

    Attributes:
        eps: the spacing of the dtype at 1.
        compensated: whether the run has a `CompensatedState`.
        changes: the changes of the momentum in a step by flight and torque, over its size, (2, bodies).
        variations: how much these vary from step to step, likewise.
    """

    eps: float
    compensated: bool
    changes: Any
    variations: Any

    def error(self, steps: int, compensated: bool | None = None) -> float:
        """The error of the momentum over its size that rounding leaves after a number of steps, of the worst body.

        Args:
            steps: the number of steps.
            compensated: whether with a `CompensatedState`; by default as in the run.
        """
        unit = (
            self.changes if (self.compensated if compensated is None else compensated) else np.ones_like(self.changes)
        )
        least = np.finfo(float).tiny
        alike = np.clip(self.eps * unit / np.maximum(self.variations, least), 1, steps)
        errors = np.minimum(self.changes, self.eps / 2 * unit) * np.sqrt(steps * alike)
        return float(np.max(np.sqrt(np.sum(np.square(errors), axis=0))))

    def loses(self, steps: int) -> bool:
        """Whether rounding errors add up in one direction, which a `CompensatedState` would keep from happening."""
        usual = self.eps / 2 * steps**0.5
        return self.error(steps) > FEW * usual and self.error(steps, compensated=True) < self.error(steps) / FEW

    def text(self, steps: int) -> str:
        """The estimate in words."""
        found = f"about {self.error(steps):.1g} of the momentum in {steps} steps"
        if not self.loses(steps):
            return found
        return (
            f"{found}: so small changes are rounded the same way in many steps; a CompensatedState loses about "
            f"{self.error(steps, compensated=True):.1g}, a longer step less, too"
        )
