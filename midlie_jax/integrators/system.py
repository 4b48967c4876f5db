"""The equations of motion on components: momentum and pose (`Motion`), and the constants of a run (`System`)."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._xla import budgets
from .._xla.apart import Placement
from .._xla.fusion import split
from .._xla.per_row import in_rows, with_tangents_of
from .._xla.replay import Traced
from ..model.bodies import Body
from ..model.exposure import PreparedBath
from ..model.free_body import Momenta, Place, Wrench
from ..model.inertia import Inertia
from ..model.kind import Inertias, Kind
from ..model.state import AnyState, P, Q
from ..model.torques import Torque, TorqueLike, on_body, velocity_dependent
from ..model.torques.by_step import OfValues, parts_by_step, values_in_step, with_values

C = TypeVar("C")
_CONCRETE_VALUE_ERRORS = (jax.errors.TracerArrayConversionError, jax.errors.TracerIntegerConversionError)


class Motion(eqx.Module, Generic[P, Q]):
    """Momentum and pose as components, as returned by `State.parts`."""

    momentum: P
    pose: Q


AnyMotion = Motion[Any, Any]
Stepped = tuple[AnyMotion, Any, Array | bool]  # motion, force if it is kept, and a verdict or whether a step succeeded


class System(NamedTuple):
    """The constants of a body, the torque on the body, and the class of the states.

    Momenta and poses are in principal components; states and torques are in the user's components, which differ for a
    `TensorBody`.
    """

    inertia: Any  # the constants of the body, `Body.inertia()`
    torque: TorqueLike | None
    kind: Kind
    reads_momentum: bool
    placement: Placement
    frame: Any = None  # the quaternion from principal components to the user's; None if both agree
    bath: tuple[PreparedBath, ...] | None = None
    by_step: bool = False  # whether a part of the torque has a constant value in each step; see `in_step`
    traced: Traced | None = None  # the torque from its trace; None without a torque

    @classmethod
    def of(cls, body: Body, torque: TorqueLike | None, start: AnyState, t: Array, *, whole: bool = False) -> "System":
        """The system of a body and a torque. The torque is traced once, at the time t and the state `start`.

        With `whole`, momenta and poses have the form of `start.parts` even for a few coupled bodies. Raises a
        ValueError if the torque needs concrete numbers where JAX has tracers.
        """
        traced, found, values, reads = None, None, (), False
        if torque is not None:
            torque = on_body(torque, body)
            values = values_in_step(torque, t, t, t)
            try:
                traced, found = Traced.of(OfValues(torque), values, t, start)
            except (jax.errors.ConcretizationTypeError, *_CONCRETE_VALUE_ERRORS) as error:
                raise ValueError(
                    "the torque needs numbers where JAX has only tracers; use jnp.where(condition, a, b) for "
                    f"`if`, and jnp.cross for np.cross. JAX reports: {str(error).splitlines()[0]}"
                ) from error
            reads = velocity_dependent(torque) or any(getattr(found.reads[1], name) for name in start.kind.momenta)
        kind = start.kind if whole else start.kind.of_run(start, found)
        frame, inertia = body.frame_of_user(), body.in_principal_axes().inertia()
        costly = found is not None and (found.costly or kind.several)
        long = found is not None and (found.operations if kind == start.kind else found.scalars) > budgets.LONG_TORQUE
        inertia, frame = kind.constants(inertia, frame)
        placement = Placement.of(costly=costly, long=long, apart=kind.apart)
        return cls(inertia, torque, kind, reads, placement, frame, by_step=bool(values), traced=traced)

    def by_entries(self) -> "System":
        """The system with the parameters of the torque as the scalars that a step reads."""
        return self if self.traced is None else self._replace(traced=self.traced.by_entries())

    def begun(self, begin: Callable[[Any], Any], carry: C, *, shared: bool = False) -> "tuple[System, C]":
        """The system and the carry at the start of a loop of a step, by `begin` of `_xla/fusion.py`.

        The cotangents of the constants of body and bath leave the derivative of the loop in the loop of the motion, not
        each in a separate loop. If the bodies of a batch share the constants, each has a copy for the derivative; the
        cotangents would otherwise be summed over the bodies at every use.
        """
        # The rows of a copy lack the axes of a mesh that are part of the array types.
        if not shared or jax.sharding.get_abstract_mesh().explicit_axes:
            system, carry = begin((self, carry))
            return system._tied(), carry
        numbers, structure = jax.tree.flatten((self.inertia, self.bath))
        own = [x for x in numbers if _is_scalar(x)]
        rows = in_rows(own, list(filter(eqx.is_inexact_array, jax.tree.leaves(carry))))
        system, rows, carry = begin((self, rows, carry))
        known = iter(with_tangents_of(rows, jax.lax.stop_gradient(own)))
        values = [next(known) if _is_scalar(x) else x for x in numbers]
        inertia, bath = structure.unflatten(values)
        return system._replace(inertia=inertia, bath=bath)._tied(), carry

    def _tied(self) -> "System":
        def is_inertia(value: Any) -> bool:
            return isinstance(value, Inertia)

        parts = jax.tree.map(lambda x: x.tied() if is_inertia(x) else x, self.inertia, is_leaf=is_inertia)
        return self._replace(inertia=parts)

    def at_step(self, n: Array) -> "System":
        """The system in the step of this index, which determines the random numbers of a bath."""
        return self if self.bath is None else self._replace(bath=tuple(bath._replace(step=n) for bath in self.bath))

    def in_step(self, t0: Array, t1: Array, h: Array) -> "System":
        """The system in the step from t0 to t1 of length h, with the values of the `ByStep` parts of the torque."""
        values = values_in_step((self.inertia, self.torque), t0, t1, h)
        if not values:  # there are none, or they are replaced already
            return self
        inertia, torque = with_values((self.inertia, self.torque), split(values))
        given = values[len(parts_by_step(self.inertia)) :]
        traced = None if self.traced is None else self.traced.with_given(given)
        return self._replace(inertia=inertia, torque=torque, traced=traced)

    @property
    def keeps_torque(self) -> bool:
        """Whether the torque at the end of a step equals the torque at the start of the next, at another momentum."""
        return self.torque is not None and not self.reads_momentum and not self.by_step

    def bathed(self, b: float, t: Array, stage: int, motion: AnyMotion) -> AnyMotion:
        """The motion after a bath stage: halves of each bath but the last, around the whole last one."""
        assert self.bath is not None
        *outer, last = self.bath
        parts = [*((bath, b / 2) for bath in outer), (last, b), *((bath, b / 2) for bath in outer[::-1])]
        for i, (bath, own) in enumerate(parts):
            root = None if bath.root is None else bath.root(t)
            noise = bath.noise(len(parts) * stage + i, motion.momentum)
            change = self.kind.bathed(bath.at(t)[own], root, motion.momentum, motion.pose, noise)
            motion = self.pushed(motion, change)
        return motion

    def motion(self, state: AnyState) -> AnyMotion:
        motion: AnyMotion = Motion(*self.kind.parts(state))
        if self.frame is None:
            return motion
        return Motion(self.kind.vector_in(self.frame, motion.momentum), self.kind.pose_in(self.frame, motion.pose))

    def state(self, motion: AnyMotion) -> AnyState:
        user_motion = self.in_user_axes(motion)
        return self.kind.join(user_motion.momentum, user_motion.pose)

    def in_user_axes(self, motion: Motion[P, Q]) -> Motion[P, Q]:
        if self.frame is None:
            return motion
        pose = self.kind.pose_in(_opposite(self.frame), motion.pose)
        return Motion(self.vector_in_user_axes(motion.momentum), pose)

    def vector_in_user_axes(self, vector: Any) -> Any:
        return vector if self.frame is None else self.kind.vector_in(_opposite(self.frame), vector)

    def velocity(self, momentum: P) -> P:
        """The angular velocity I^-1 Pi in principal components; for particles their velocity."""
        return self.inertia.velocity(momentum)

    def members(self, motion: AnyMotion) -> "list[tuple[System, AnyMotion]]":
        """The system and the motion of each body that is moved separately; for a few coupled bodies, of each body."""
        if not isinstance(self.inertia, Inertias):
            return [(self, motion)]
        kind: Any = self.kind
        parts = enumerate(zip(self.inertia.members, motion.momentum, motion.pose, strict=True))

        def system(i: int, inertia: Any) -> System:
            own = None if self.bath is None else tuple(bath._replace(member=i) for bath in self.bath)
            return self._replace(inertia=inertia, kind=kind.member, bath=own)

        return [(system(i, inertia), Motion(p, q)) for i, (inertia, p, q) in parts]

    def of_members(self, motions: "list[AnyMotion]") -> AnyMotion:
        if not isinstance(self.inertia, Inertias):
            return motions[0]
        return Motion(tuple(m.momentum for m in motions), tuple(m.pose for m in motions))

    def rotating(self, motion: AnyMotion) -> "tuple[System, AnyMotion]":
        """The rotation of a body that also translates; otherwise the system and the motion unchanged."""
        if self.kind.rotation is None:
            return self, motion
        system = self._replace(inertia=self.inertia.rotation, kind=self.kind.rotation)
        return system, Motion(motion.momentum.angular, motion.pose.orientation)

    def rotations(self, motion: AnyMotion) -> "list[tuple[System, AnyMotion]]":
        return [own.rotating(one) for own, one in self.members(motion)]

    def travelled(self, h: Array, motion: AnyMotion, rotated: AnyMotion) -> AnyMotion:
        """The motion after a flight that rotates it to `rotated`; a body that translates moves by h p / m."""
        if self.kind.rotation is None:
            return rotated
        linear = motion.momentum.linear
        position = cp.add(motion.pose.position, cp.scale(h * self.inertia.per_mass, linear))
        return Motion(Momenta(rotated.momentum, linear), Place(rotated.pose, position))

    def rates(self, motion: Motion[P, Q], h: Array, force: P | None) -> Motion[P, Q]:
        """h times the right-hand side of the equations of motion."""
        return Motion(*self.kind.rates(self.inertia, h, motion.momentum, motion.pose, force))

    def pushed(self, motion: Motion[P, Q], change: P) -> Motion[P, Q]:
        return Motion(*self.kind.push(motion.momentum, motion.pose, change))

    def turned(self, pose: Q, increment: Any, h: Array) -> Q:
        """The pose after a flight with this increment, in a step of h."""
        return self.kind.act(pose, increment, h == 0)

    def force(self, t: Array, motion: Motion[P, Any]) -> P:
        """The torque in principal components, or the force on particles; zero if the system has no torque."""
        if self.torque is None:
            return jax.tree.map(jnp.zeros_like, motion.momentum)
        return self.placement.around_torque(self._evaluate(t, self.placement.around_torque(motion)))

    def displaced_force(self, t: Array, weight: Array, motion: Motion[P, Any]) -> P:
        """`gradient_force` up to weight^2, from a second torque in place of a derivative.

        It is the torque at the pose displaced by d = 2 weight w, w = I^-1 T, in the frame before the displacement. A
        body without translation is rotated by the Rodrigues vector d/2, and the torque is rotated back, so the kick
        conserves momenta about space-fixed directions. For a body that also translates, both are to first order.
        """
        motion = self.placement.around_torque(motion)

        def at(pose: Any) -> P:
            return self.placement.around_torque(self._evaluate(t, Motion(motion.momentum, pose)))

        force = at(motion.pose)
        displacement = jax.tree.map(lambda x: 2 * weight * x, self.velocity(force))
        if self.kind.turns:
            turn = cp.cayley(cast(cp.Vector, displacement))
            return cast(Any, cp.rotate(turn, cast(Any, at(self.kind.act(motion.pose, turn)))))
        moved = self.kind.shift(motion.pose, self.kind.rate(motion.pose, displacement), jnp.asarray(False))
        return added(at(moved), 2 * weight, self.inertia.commutator(force))

    def gradient_force(self, t: Array, weight: Array, motion: Motion[P, Any]) -> P:
        """The torque of the potential V - weight T . I^-1 T.

        The torque is T + 2 weight (dT + w x T), with w = I^-1 T and dT the rate of change of T while the body rotates
        with the angular velocity w. The cross product arises because derivatives of a potential along the body axes do
        not commute; for particles it is absent.
        """
        motion = self.placement.around_torque(motion)

        def at(pose: Any) -> P:
            return self._evaluate(t, Motion(motion.momentum, pose))

        force = at(motion.pose)
        velocity = self.velocity(force)
        _, change = jax.jvp(at, (motion.pose,), (self.kind.rate(motion.pose, velocity),))
        change = jax.tree.map(jnp.add, change, self.inertia.commutator(force))
        return self.placement.around_torque(added(force, 2 * weight, change))

    def _evaluate(self, t: Array, motion: AnyMotion) -> Any:
        value, returned = self.evaluate(lambda t, state: self.kind.force_of(self._torque_at(t, state)), t, motion)
        _check_force(self.kind, returned, cp.packed(motion.momentum))
        return self._vector(jax.tree.map(jnp.asarray, value))  # a torque may return constants

    def _torque_at(self, t: Array, state: AnyState) -> Any:
        assert self.torque is not None
        if self.traced is None or not self.traced.takes(t, state):
            return self.torque(t, state)
        return self.traced(t, state)

    def _vector(self, vector: Any) -> Any:
        return vector if self.frame is None else self.kind.vector_in(self.frame, vector)

    def number(self, function: Callable[[Any, Any], Any], t: Array, motion: AnyMotion) -> Array:
        motion = self.placement.around_torque(motion)
        value, _ = self.evaluate(lambda t, state: jnp.reshape(function(t, state), 1), t, motion)
        return self.placement.around_torque(value[0])

    def fixed_axis(self, t: Array, motion: AnyMotion) -> Any:
        """A space-fixed direction about which the torque has no component, in principal components; None if unknown.

        Whether it is None does not depend on the motion.
        """
        torque = self.torque
        if not isinstance(torque, Torque) or torque.fixed_axis(self.state(motion)) is None:
            return None
        axis, _ = self.evaluate(lambda t, state: cp.pack(cast(Any, torque.fixed_axis(state))), t, motion)
        return self._vector(axis)

    def evaluate(self, function: Callable[[Any, Any], Any], t: Array, motion: AnyMotion) -> tuple[Any, Any]:
        """The value `function(t, state)` on components, and the shapes and dtypes of its arrays; see `State`."""
        user_motion = self.in_user_axes(motion)
        return self.kind.evaluate(function, t, user_motion.momentum, user_motion.pose)


def _is_scalar(value: Any) -> bool:
    return eqx.is_inexact_array(value) and not value.ndim


def added(momentum: P, h: Array, force: P) -> P:
    return jax.tree.map(lambda p, f: p + h * f, momentum, force)


def _opposite(frame: Any) -> Any:
    return tuple(map(cp.conjugate, frame)) if isinstance(frame[0], tuple) else cp.conjugate(frame)


def _check_force(kind: Kind, returned: Any, momentum: Any) -> None:
    if jax.tree.structure(returned) != jax.tree.structure(momentum):
        if kind.several:
            shapes = sorted({str(tuple(leaf.shape)) for leaf in jax.tree.leaves(returned)})
            rows = f"{len(returned)} rows for {len(momentum)} bodies" if type(returned) is tuple else ", ".join(shapes)
            raise ValueError(
                "the function of coupled bodies must return one row per body, a torque (N, 3) or a "
                f"midlie_jax.torques.Wrench of two arrays (N, 3), got {rows}."
            )
        wanted, cure = f"a {type(momentum).__name__}", "of arrays like the momentum in `State.parts`"
        if isinstance(momentum, Array):
            wanted, cure = "one array", "use jnp.stack([...])"
            if isinstance(returned, Wrench):
                cure = "a force moves a FreeState of a FreeBody"
        elif isinstance(momentum, Momenta):
            wanted, cure = "a midlie_jax.torques.Wrench, or one array for a torque alone", "use jnp.stack([...])"
        raise ValueError(f"the torque must return {wanted}, got {type(returned).__name__}; {cure}.")
    for found, like in zip(jax.tree.leaves(returned), jax.tree.leaves(momentum), strict=True):
        shape, wanted_shape, dtype = tuple(found.shape), tuple(like.shape), found.dtype
        if shape == wanted_shape and dtype == like.dtype:
            continue
        cure = "use jnp.stack([...]) and cast its parameters."
        if len(shape) > len(wanted_shape) and shape[len(shape) - len(wanted_shape) :] == wanted_shape:
            cure = "a parameter with one row per body needs midlie_jax.ensemble (with torque_axes=0), or jax.vmap."
        raise ValueError(
            f"the torque must return {like.dtype}{list(like.shape)} like the momentum, got {dtype}{list(shape)}; {cure}"
        )
