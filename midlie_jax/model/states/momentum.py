"""`MomentumState`, and the description of a body-frame momentum for files."""

from typing import Any, ClassVar

from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, require_finite
from ..bodies import RigidBody
from ..kind import Leaves
from ..leaf import BodyLeaf, Described, NoPose
from ..state import State

BODY_MOMENTUM = {
    "long_name": "angular momentum in the body frame, about the fixed point or the centre of mass",
    "units": "mass length2 time-1",
    "frame": "body",
}


class BodyMomentum(NoPose, BodyLeaf):
    """A momentum in the body frame alone."""

    about: ClassVar[tuple[Described, ...]] = ((("axis",), BODY_MOMENTUM),)


class MomentumState(State):
    """The state of a rigid body without its attitude: three numbers.

    Attributes:
        momentum: body-frame angular momentum Pi, (..., 3).

    Examples:
        >>> body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.MomentumState([0.01, 2.0, 0.01])
        >>> path = ml.free_motion(body, start, [0.0, 5.0, 10.0])
        >>> jnp.linalg.norm(path.states.momentum, axis=-1).round(4)
        Array([2., 2., 2.], dtype=float64)
    """

    momentum: Float[Array, "*batch 3"]
    body: ClassVar[type] = RigidBody
    leaves: ClassVar[Leaves] = (BodyMomentum,)

    def __init__(self, momentum: Any):
        self.momentum = as_floats("momentum", momentum, (3,))
        require_finite("momentum", self.momentum)
