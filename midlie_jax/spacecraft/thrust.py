"""`Thrust`: an engine fixed in the body."""

from collections.abc import Callable
from typing import Any

from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_function_of_time, vector_at
from .._math import components as cp
from ..model.state import AnyState, Time
from ..model.torques.base import Torque
from ..model.torques.travel import travelling
from ..model.wrench import Wrench


class Thrust(Torque):
    """An engine fixed in the body: its force, and the torque lever x force, both in the body frame.

    Attributes:
        force: the thrust, body frame, (3,), or a function `force(t) -> (3,)`.
        lever: vector from the centre of mass to the engine, body frame, (3,), or a function `lever(t) -> (3,)`.

    Raises:
        ValueError: force or lever of another shape, or not finite. When called: the state does not translate.

    Examples:
        >>> engine = ml.spacecraft.Thrust(force=[0.0, 0.0, 2.0], lever=[0.5, 0.0, 0.0])
        >>> state = ml.FreeState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], position=[0.0, 0.0, 0.0])
        >>> engine(0.0, state).torque[1].item(), engine(0.0, state).force[2].item()  # lever x force; in space
        (-1.0, 2.0)
    """

    force: Float[Array, "*batch 3"] | Callable[[Any], Array]
    lever: Float[Array, "*batch 3"] | Callable[[Any], Array]

    def __init__(self, force: Any, lever: Any):
        self.force, self.lever = as_function_of_time("force", force), as_function_of_time("lever", lever)

    def check(self, state: AnyState) -> None:
        for vector in (self.force, self.lever):
            if not callable(vector):
                state.in_one_frame(cp.vector(vector))

    def __call__(self, t: Time, state: AnyState) -> Any:
        state, _ = travelling(self, state, None)
        vectors = (cp.vector(vector_at(name, getattr(self, name), t)) for name in ("force", "lever"))
        force, lever = (state.in_one_frame(v)[0] for v in vectors)
        return Wrench(cp.pack(cp.cross(lever, force)), cp.pack(state.to_space(force)))
