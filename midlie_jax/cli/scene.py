"""`Scene`: a test problem with a body, a torque, a start and a duration; and perturbed copies of its start."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import described
from ..model import so3
from ..model.states import AxisState, RigidState, TravellingState
from ..model.torques import TorqueLike


@dataclass(frozen=True, eq=False)
class Scene:
    """A named test problem.

    Attributes:
        name: as in `scenes()`.
        title: description in one line.
        body: the body, about its fixed point or its centre of mass: a `RigidBody`, a `SymmetricRotor`, or a `FreeBody`;
            or several coupled bodies.
        torque: the torque on it, or None for a free body.
        start: its state at time 0: a `RigidState`, an `AxisState`, a `FreeState`, a `FreeAxisState` or a
            `CoupledState`.
        dt: a step small enough that a picture of the motion by LIEMID[EA] shows no error.
        duration: duration of the motion, a multiple of the step.
        source: the source of the numbers.
        units: the units of mass, length and time, and the space frame if it needs a definition.
        axes: (3, 3) for a body given by a full tensor: the principal axes, as columns, in the frame in which the tensor
            was given (see `RigidBody.from_tensor`); None if the body frame is the given frame.
        method: the method of `midlie run`.
    """

    name: str
    title: str
    body: Any
    torque: TorqueLike | None
    start: Any
    dt: float
    duration: float
    source: str
    units: str
    axes: Float[Array, "3 3"] | None = None
    method: str = "JACOBI[EA]"

    @property
    def steps(self) -> int:
        """Number of steps `dt` in `duration`."""
        return round(self.duration / self.dt)

    @property
    def time_unit(self) -> str:
        units = self.units.partition(";")[0].split(",")  # mass, length, time
        return units[-1].strip() if len(units) == 3 else ""


def perturbed(scene: Scene, count: int, size: float, seed: int = 0) -> Any:
    """Perturbed copies of the start of a scene.

    Args:
        scene: from `scene(name)`.
        count: number of copies.
        size: standard deviation of each component of the perturbation: for a momentum relative to its norm, for the
            attitude a rotation vector in the body frame, radian, for an axis one in space, and for a position relative
            to the distance travelled per radian of rotation. Coupled bodies are perturbed separately.
        seed: the same seed gives the same copies in any dtype, and the same first copies for a larger count.

    Returns:
        The states, with leading axis `count`, as for `jax.vmap`; the first is the start itself.

    Raises:
        ValueError: `count` is not a positive int, `size` is negative or not finite, or the state is of a custom kind.
    """
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"count must be a positive Python int, got {count!r}.")
    if not np.isfinite(size) or size < 0:
        raise ValueError(f"size must be finite and not negative, got {size!r}.")
    start = scene.start
    if not type(start).__module__.startswith("midlie_jax."):
        raise ValueError(
            f"the initial state of a scene must be of a kind of midlie_jax, got {described(start)}; call "
            "midlie_jax.integrate for a custom kind."
        )
    parts = 4 if isinstance(start, TravellingState) else 2
    changes = size * np.random.default_rng(seed).standard_normal((count, parts, *start.momentum.shape))
    momentum_change, rotation, *travel = (jnp.asarray(changes[1:, i], start.momentum.dtype) for i in range(parts))
    turning = start.turning if isinstance(start, TravellingState) else start
    others: Any = _turned(turning, momentum_change, rotation)
    if isinstance(start, TravellingState):
        linear, position = travel
        push = _length(start.linear)[None] * linear
        others = start.made(
            others, start.linear[None] + push, start.position[None] + _way_of_a_radian(scene) * position
        )
    # The start is prepended instead of perturbed by zero, so the first state equals it bit for bit.
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), start, others)


def _turned(start: Any, momentum_change: Array, rotation: Array) -> Any:
    momentum = start.momentum[None] + _length(start.momentum)[None] * momentum_change
    turn = so3.exp(rotation)
    if isinstance(start, AxisState):
        axis = so3.rotate(turn, jnp.broadcast_to(start.axis, momentum.shape))
        # A momentum without a component along the axis, as for a pendulum, must keep this property.
        spin = jnp.sum(start.momentum * start.axis)
        along = jnp.sum(momentum * axis, axis=-1, keepdims=True)
        kept = jnp.where(spin == 0, momentum - along * axis, momentum)
        return AxisState(kept, axis)
    return RigidState(momentum, so3.multiply(start.attitude[None], turn))


def _way_of_a_radian(scene: Scene) -> Array:
    """The distance travelled at the start per radian of rotation; 0 without rotation; a mean over several bodies."""
    velocity = scene.start.linear / scene.body.mass[..., None]
    speed, rate = (jnp.sqrt(jnp.sum(v**2)) for v in (velocity, scene.body.velocity(scene.start.momentum)))
    return jnp.where(rate > 0, speed / jnp.where(rate > 0, rate, 1), 0)


def _length(vector: Array) -> Array:
    return jnp.sqrt(jnp.sum(vector**2, axis=-1, keepdims=True))
