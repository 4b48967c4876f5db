"""`Formula`: the change of momentum and pose in a Runge-Kutta step, for any equations of motion."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from .system import AnyMotion

# `rates(time, part, motion)` is `part` times h times the right-hand side of the equations of motion, at the time t0 +
# `time` h of a step from t0.
Rates = Callable[[float, float, AnyMotion], AnyMotion]
# `pause(fresh, older, evaluations)` returns `fresh` and `older` unchanged, and whether a loop ends there. It marks a
# point of a step where few numbers are alive, before a part with this many evaluations. A loop that would become too
# long for the compiler ends there: in a step for `fresh`, the numbers computed since the last end; in its derivative
# for both.
Pause = Callable[[Any, Any, int], tuple[Any, Any, bool]]


@runtime_checkable
class Formula(Protocol):
    """An explicit formula for the change in a step."""

    @property
    def order(self) -> int:
        """Order of accuracy."""
        ...

    @property
    def evaluations(self) -> int:
        """Evaluations of the rates per step."""
        ...

    @property
    def reach(self) -> float:
        """The largest rotation h |Omega| of a step, in radians, above which the error can be 0.01."""
        ...

    def change(self, rates: Rates, pause: Pause, motion: AnyMotion) -> AnyMotion:
        """The change of the motion in the step that starts from it."""
        ...
