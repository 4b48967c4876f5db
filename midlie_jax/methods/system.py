"""The equations of motion on components: what moves (`Motion`), and what stays the same in a run (`System`)."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.fusion import fuse, fuse_derivative
from .._kernel.replay import traits
from ..model.bodies import Body, RigidBody, TensorBody, principal_of
from ..model.states import AnyState, P, Q
from ..model.torques import TorqueLike, on_body, velocity_dependent
from .inertia import Inertia

T = TypeVar("T")
_NEEDS_NUMBERS = (jax.errors.TracerArrayConversionError, jax.errors.TracerIntegerConversionError)


class Motion(eqx.Module, Generic[P, Q]):
    """Momentum and pose, as `State.parts` gives them."""

    momentum: P
    pose: Q


AnyMotion = Motion[Any, Any]


class System(NamedTuple):
    """A body made ready, the torque on it, and the kind of state that is followed.

    Attributes:
        inertia: `Inertia` for a rigid body, `Particles` themselves; both turn a momentum into a velocity.
        torque: a function of (t, state), or None.
        kind: the class of the state.
        reads_momentum: whether the torque does: damping, control.
        costly: whether the torque holds an operation that XLA counts as expensive, such as a division.
        axes: quaternion from principal components to those of states and torques; None where these are the same.
    """

    inertia: Any
    torque: TorqueLike | None
    kind: type[AnyState]
    reads_momentum: bool
    costly: bool
    axes: cp.Quaternion | None = None

    @classmethod
    def of(cls, body: Body, torque: TorqueLike | None, start: AnyState, t: Array) -> "System":
        """Ready to step from the state `start`."""
        axes = cp.quaternion(body.axes) if isinstance(body, TensorBody) else None
        principal = principal_of(body)
        inertia = Inertia.of(principal) if isinstance(principal, RigidBody) else principal
        if torque is None:
            return cls(inertia, None, type(start), reads_momentum=False, costly=False, axes=axes)
        torque = on_body(torque, body)
        try:
            found = traits(torque, t, start)
        except (jax.errors.ConcretizationTypeError, *_NEEDS_NUMBERS) as error:
            raise ValueError(
                "the torque needs numbers where JAX has none yet: write jnp.where(condition, a, b) for an `if`, and "
                f"jax.numpy for numpy (jnp.cross for np.cross). JAX says: {str(error).splitlines()[0]}"
            ) from error
        reads = velocity_dependent(torque) or found.reads[1].momentum
        return cls(inertia, torque, type(start), reads, found.costly, axes)

    def cut(self, tree: T) -> T:
        """The tree unchanged, passed from one part of a step to the next.

        XLA counts a division, root or exponential as too expensive to repeat, and would cut the loop around such a
        torque at every value used twice. So a costly torque is cut out into loops of its own. Without one, the step
        is a single loop, and only its derivative is cut.
        """
        return fuse(tree) if self.costly else fuse_derivative(tree)

    def _apart(self, tree: T) -> T:
        """The tree unchanged, at the two ends of a costly torque."""
        return fuse(tree) if self.costly else tree

    def motion(self, state: AnyState) -> AnyMotion:
        """The motion of a state, in principal components."""
        motion: AnyMotion = Motion(*state.parts())
        if self.axes is None:
            return motion
        return Motion(cp.rotate_back(self.axes, motion.momentum), self.kind.rotate(motion.pose, self.axes))

    def state(self, motion: AnyMotion) -> AnyState:
        """The inverse of `motion`."""
        seen = self.in_user_axes(motion)
        return self.kind.join(seen.momentum, seen.pose)

    def in_user_axes(self, motion: Motion[P, Q]) -> Motion[P, Q]:
        """The motion in the components of states and torques."""
        if self.axes is None:
            return motion
        pose = self.kind.rotate(motion.pose, cp.conjugate(self.axes))
        return Motion(self.vector_in_user_axes(motion.momentum), pose)

    def vector_in_user_axes(self, vector: Any) -> Any:
        """A vector of principal components in those of states and torques."""
        return vector if self.axes is None else cp.rotate(self.axes, vector)

    def velocity(self, momentum: P) -> P:
        """Angular velocity as components, I^-1 times a vector; of particles their velocity."""
        return self.inertia.velocity(momentum)

    def rates(self, motion: Motion[P, Q], h: Array, force: P | None) -> Motion[P, Q]:
        """h times the right-hand side of the equations of motion, Pi' = Pi x I^-1 Pi + T and the pose's rate."""
        turn = jax.tree.map(lambda v: h * v, self.velocity(motion.momentum))
        push = _filled(motion.momentum, 0.0) if force is None else jax.tree.map(lambda f: h * f, force)
        return Motion(self.kind.momentum_rate(motion.momentum, turn, push), self.kind.rate(motion.pose, turn))

    def turned(self, pose: Q, increment: Any, t: Array, h: Array) -> Q:
        """The pose after a flight in a step of h from time t."""
        return self.kind.turn(pose, increment, h == 0, t)

    def force(self, t: Array, motion: Motion[P, Any]) -> P:
        """The torque's components, or the force on particles; zero where there is none."""
        if self.torque is None:
            return _filled(motion.momentum, 0.0)
        return self._apart(self._evaluate(self.torque, t, self._apart(motion)))

    def gradient_force(self, t: Array, weight: Array, motion: Motion[P, Any]) -> P:
        """The torque of the potential V - weight T . I^-1 T.

        That is T + 2 weight (dT + w x T) with w = I^-1 T and dT the change of T as the body turns with w: the
        derivatives of a potential along the body's axes do not commute. For particles the cross product is absent.
        """
        if self.torque is None:
            return _filled(motion.momentum, 0.0)
        if self.reads_momentum:
            raise ValueError("a scheme with force gradients needs a torque from a potential, not one of the momentum.")
        torque = self.torque
        motion = self._apart(motion)

        def at(pose: Any) -> P:
            return self._evaluate(torque, t, Motion(motion.momentum, pose))

        force = at(motion.pose)
        velocity = self.velocity(force)
        _, change = jax.jvp(at, (motion.pose,), (self.kind.rate(motion.pose, velocity),))
        change = jax.tree.map(jnp.add, change, self.kind.commutator(velocity, force))
        return self._apart(added(force, 2 * weight, change))

    def _evaluate(self, torque: TorqueLike, t: Array, motion: AnyMotion) -> Any:
        entries, found = self.evaluate(torque, t, motion)
        _check_force(found, self.kind.pack(motion.momentum))
        force: Any = self.kind.from_entries(entries)
        return force if self.axes is None else cp.rotate_back(self.axes, force)

    def evaluate(self, function: Callable[[Any, Any], Any], t: Array, motion: AnyMotion) -> Any:
        """The entries of the array `function(t, state)`, and its shape and dtype."""
        seen = self.in_user_axes(motion)
        return self.kind.evaluate(function, t, seen.momentum, seen.pose)


def added(momentum: P, h: Array, force: P) -> P:
    """momentum + h force."""
    return jax.tree.map(lambda p, f: p + h * f, momentum, force)


def _filled(momentum: P, value: float) -> P:
    return jax.tree.map(lambda p: jnp.full_like(p, value), momentum)


def _check_force(found: jax.ShapeDtypeStruct, like: Array) -> None:
    shape, dtype = tuple(found.shape), found.dtype
    if shape == tuple(like.shape) and dtype == like.dtype:
        return
    cure = "use jnp.stack([...]) and cast its parameters."
    if len(shape) > len(like.shape) and shape[len(shape) - len(like.shape) :] == tuple(like.shape):
        cure = "a parameter with one row a body needs midlie_jax.ensemble (and there torque_axes=0), or jax.vmap."
    raise ValueError(
        f"the torque must return {like.dtype}{list(like.shape)} like the momentum, got {dtype}{list(shape)}; {cure}"
    )
