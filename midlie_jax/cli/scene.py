"""`Scene`: a test problem with a body, a torque, a start and a duration; and perturbed copies of its start."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..model import so3
from ..model.bodies import RigidBody
from ..model.states import RigidState
from ..model.torques import TorqueLike


@dataclass(frozen=True, eq=False)
class Scene:
    """A named test problem.

    Attributes:
        name: as in `scenes()`.
        title: description in one line.
        body: the body, about its fixed point or its centre of mass.
        torque: body-frame torque, or None for a free body.
        start: body-frame angular momentum (3,) and attitude (4,), at time 0.
        dt: a step small enough that a picture of the motion by LIEMID[EA] shows no error.
        duration: duration of the motion, a whole number of steps.
        source: where the numbers are from.
        units: the units of mass, length and time, and the space frame if it needs a definition.
        axes: (3, 3) for a body given by a full tensor: the principal axes, as columns, in the frame in which the
            tensor was given (see `RigidBody.from_tensor`); None where the body frame is the given frame.
    """

    name: str
    title: str
    body: RigidBody
    torque: TorqueLike | None
    start: RigidState
    dt: float
    duration: float
    source: str
    units: str
    axes: Float[Array, "3 3"] | None = None

    @property
    def steps(self) -> int:
        """Number of steps `dt` in `duration`."""
        return round(self.duration / self.dt)

    @property
    def time_unit(self) -> str:
        """The unit of time, such as "s"; "" if any consistent units may be used."""
        units = self.units.partition(";")[0].split(",")  # mass, length, time
        return units[-1].strip() if len(units) == 3 else ""


def perturbed(scene: Scene, count: int, size: float, seed: int = 0) -> RigidState:
    """Perturbed copies of the start of a scene.

    Args:
        scene: from `scene(name)`.
        count: number of copies.
        size: standard deviation of each component of the perturbation: for the momentum relative to its norm, for the
            attitude a rotation vector in the body frame, radian.
        seed: the same seed gives the same copies in any dtype, and the same first copies for a larger count.

    Returns:
        The states, with leading axis `count`, as for `jax.vmap`; the first is the start itself.

    Raises:
        ValueError: `count` is not a positive int, or `size` is negative or not finite.
    """
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"count must be a positive Python int, got {count!r}.")
    if not np.isfinite(size) or size < 0:
        raise ValueError(f"size must be finite and not negative, got {size!r}.")
    changes = size * np.random.default_rng(seed).standard_normal((count, 2, 3))
    momentum, attitude = scene.start.momentum, scene.start.attitude
    momentum_change, rotation = (jnp.asarray(changes[1:, i], momentum.dtype) for i in (0, 1))
    norm = jnp.sqrt(jnp.sum(momentum**2))
    others = (momentum[None] + norm * momentum_change, so3.multiply(attitude[None], so3.exp(rotation)))
    # The start is prepended instead of perturbed by zero, so that the first state equals it bit for bit.
    return RigidState(
        momentum=jnp.concatenate([momentum[None], others[0]]),
        attitude=jnp.concatenate([attitude[None], others[1]]),
    )
