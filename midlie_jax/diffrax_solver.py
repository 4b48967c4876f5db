"""The methods as solvers of diffrax: one line changes in a pipeline, the rest of it stays.

    term, solver = ml.RigidBodyTerm(body, torque), ml.LieSolver("LIEMID[EA]")
    solution = diffrax.diffeqsolve(term, solver, t0, t1, dt0, ml.RigidState(momentum, attitude))

The only file that imports diffrax, by its public names. The same term runs under diffrax's own solvers, which see
the derivatives of the state's arrays; `LieSolver` sees angular velocity and torque and moves on the group.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from . import _components as cp
from . import so3
from ._fuse import seam, together
from .bodies import DirectionState, Particles, RigidBody, RigidState, State
from .checks import same_dtype
from .methods import method as find_method
from .stepper import Method, Motion, System
from .torques import TorqueLike


class Rates(NamedTuple):
    """What changes a state.

    Attributes:
        ambient: the derivative of the state's arrays, a state of the same class.
        velocity: body-frame angular velocity (3,); for particles the velocity.
        torque: body-frame torque (3,); for particles the force.
    """

    ambient: Any
    velocity: Array
    torque: Array


class RigidBodyTerm(diffrax.AbstractTerm):
    """Pi' = Pi x Om + T, R' = R skew(Om), Om = I^-1 Pi, as a term for `LieSolver` and for every ODE solver of diffrax.

    Attributes:
        body: what moves.
        torque: any callable `torque(t, state) -> (3,)` in the body frame, or None.
        torque_of_args: instead of `torque`: a function from diffrax's `args` to such a callable (or None), such as
            `lambda args: ml.torques.HeavyTop(args["weight"])`.

    Raises:
        ValueError: both torques given, a torque that cannot be called, a body that is none.
    """

    body: RigidBody | Particles
    torque: TorqueLike | None
    torque_of_args: Callable[[Any], TorqueLike | None] | None

    def __init__(self, body: Any, torque: Any = None, *, torque_of_args: Any = None):
        if not isinstance(body, (RigidBody, Particles)):
            raise ValueError(f"body must be a midlie_jax.RigidBody or Particles, got {type(body).__name__}.")
        if torque is not None and torque_of_args is not None:
            raise ValueError("give torque or torque_of_args, not both; add torques with midlie_jax.torques.Sum.")
        for name, value, form in (("torque", torque, "(t, state)"), ("torque_of_args", torque_of_args, "args")):
            if value is not None and not callable(value):
                raise ValueError(f"{name} must be None or a callable of {form}, got {type(value).__name__}.")
        self.body, self.torque, self.torque_of_args = body, torque, torque_of_args

    def torque_at(self, args: Any) -> TorqueLike | None:
        """The torque for these `args`, a callable of (t, state)."""
        return self.torque if self.torque_of_args is None else self.torque_of_args(args)

    def vf(self, t: Any, y: Any, args: Any) -> Rates:
        """The rates of one state at a time ()."""
        torque = self.torque_at(args)
        _check(self.body, torque, y)
        motion, system = Motion(*y.parts()), System.of(self.body, torque, y, _as_time(t, y))
        force = system.force(_as_time(t, y), motion)
        velocity = _velocity(system, motion.momentum)
        return Rates(_ambient(y, velocity, force), _pack(velocity), _pack(force))

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        """The step."""
        del kwargs
        return t1 - t0

    def prod(self, vf: Rates, control: Any) -> Any:
        """The step times the derivative of the state's arrays."""
        return jax.tree.map(lambda x: jnp.asarray(control, x.dtype) * x, vf.ambient)


class LieInterpolation(diffrax.AbstractLocalInterpolation):
    """Between the ends of a step, on the group: local error of fourth order where the ends are exact.

    For a `RigidState` the attitude is R0 exp(c(s)), c the cubic that meets both attitudes and both angular
    velocities, a unit quaternion to rounding; the spatial momentum is the cubic that meets momentum and spatial
    torque at both ends, turned into the body. So a free body's spatial momentum is constant between steps too. The
    step must turn by less than pi. Of a state without attitude the arrays are interpolated by cubics, a direction
    being brought back to unit length.

    Args:
        t0, t1: times of the ends.
        y0, y1: the states there.
        velocity0, velocity1, torque0, torque1: as in `Rates`.
        h: the signed step, which is t0 - t1 when time runs backwards.
    """

    t0: Any
    t1: Any
    y0: Any
    turn: Any  # the cubic of the rotation vector, where there is an attitude
    rest: Any  # the cubics of what else there is: of a RigidState, R0^T times the spatial momentum

    def __init__(
        self,
        *,
        t0: Any,
        t1: Any,
        y0: Any,
        y1: Any,
        velocity0: Array,
        velocity1: Array,
        torque0: Array,
        torque1: Array,
        h: Array,
    ):
        self.t0, self.t1, self.y0 = t0, t1, y0
        if isinstance(y0, RigidState):
            turned = so3.multiply(so3.conjugate(y0.attitude), y1.attitude)
            angle = so3.log(turned)
            self.turn = _cubic(jnp.zeros_like(angle), angle, h * velocity0, h * so3.dexp_inverse(-angle, velocity1))
            momentum, torque = so3.rotate(turned, y1.momentum), so3.rotate(turned, torque1)
            self.rest = _cubic(y0.momentum, momentum, h * torque0, h * torque)
        else:
            slope0 = _ambient(y0, _parts(velocity0, y0), _parts(torque0, y0))
            slope1 = _ambient(y1, _parts(velocity1, y1), _parts(torque1, y1))
            self.turn = None
            ends = zip(*map(jax.tree.leaves, (y0, y1, slope0, slope1)), strict=True)
            self.rest = [_cubic(a, b, h * da, h * db) for a, b, da, db in ends]

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> Any:
        """The state at t0, or with t1 the difference of the arrays between the two; `derivative` is that of arrays."""
        del left
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        y0 = self.y0
        length = self.t1 - self.t0
        still = length == 0
        s = jnp.where(still, jnp.zeros_like(length), t0 - self.t0) / jnp.where(still, jnp.ones_like(length), length)
        s = s.astype(y0.momentum.dtype)
        if isinstance(y0, RigidState):
            turn = so3.exp(_at(self.turn, s))
            momentum = so3.rotate(so3.conjugate(turn), _at(self.rest, s))
            attitude = cp.unpack(so3.multiply(y0.attitude, turn))
            return _like(y0, momentum, cp.pack(RigidState.unit(attitude, jnp.array(False))))
        leaves = [_at(cubic, s) for cubic in self.rest]
        if isinstance(y0, DirectionState):
            leaves[1] = leaves[1] / jnp.sqrt(jnp.sum(leaves[1] ** 2))
        return _like(y0, *leaves)


class RotationNorm(eqx.Module):
    """A norm for `diffrax.PIDController(norm=...)` that takes momentum and attitude each for what it is.

    The larger of the momentum's error, by its length, in units of `momentum`, and of the attitude's, the angle of the
    rotation between the two, in units of `angle`. PIDController divides errors entry by entry by atol + rtol |y|
    before it asks for the norm, and entries of a quaternion pass through zero. So with rtol=0 the angle is exact, and
    `atol` is the error allowed a step, in those units; with an rtol of up to atol it is right within a factor of 2.

    Attributes:
        momentum: the size of momentum that counts as one.
        angle: the angle that counts as one, in radians.
    """

    momentum: float | Array = 1.0
    angle: float | Array = 1.0

    def __call__(self, error: Any) -> Array:
        first, *rest = [jnp.sqrt(jnp.sum(leaf**2)) for leaf in jax.tree.leaves(error)]
        # Half the angle is in a unit quaternion's difference, the whole in that of a direction.
        factor = 2.0 if isinstance(error, RigidState) else 1.0
        return jnp.maximum(first / self.momentum, factor * rest[0] / self.angle) if rest else first / self.momentum


class LieSolver(diffrax.AbstractAdaptiveSolver):
    """A method of this package as a solver for diffrax; terms must be a `RigidBodyTerm`, the state one of ours.

    Order: that of the method. Interpolation: `LieInterpolation`. Torque evaluations: those of the method; where
    dense output (or `SaveAt(ts=...)`, or an event) or an adaptive controller asks for the torques at both ends and
    the method does not keep them (all but LIEMID[EA], AKW, NMB and Verlet), two more.

    Error estimate: the difference to the first-order step, h/2 times the change of angular velocity for the attitude
    and h/2 times the change of spatial torque for the momentum; of second order in h, which is `error_order`. It is
    the step's own error for methods of order 1, and larger than that for order 2, as in `diffrax.Heun`. No
    derivative passes through it. Prefer constant steps for long runs: a varying step loses the long-time
    behaviour of energy for which these methods are chosen.

    A step whose solve failed, or that is not finite, has an infinite error, so that a controller tries a shorter
    one; where none does, the solution's result is `diffrax.RESULTS.nonlinear_divergence`.

    Attributes:
        method: from `midlie_jax.method`, or its name.

    Raises:
        ValueError: unknown method; from `diffeqsolve`, a term, state, batch or dtype that does not fit.
    """

    method: Method
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = LieInterpolation

    def __init__(self, method: Any = "LIEMID[EA]"):
        found = find_method(method) if isinstance(method, str) else method
        if not isinstance(found, Method):
            raise ValueError(f"method must come from midlie_jax.method(name), got {type(method).__name__}.")
        self.method = found

    def order(self, terms: Any) -> int:
        del terms
        return self.method.order

    def error_order(self, terms: Any) -> int:
        del terms
        return 2

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        """The torque at t0 as components where the method keeps it, else None."""
        del t1
        system, clock = self._system(terms, t0, y0, args)
        return system.force(clock(t0), Motion(*y0.parts())) if self.method.keeps_force(system) else None

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, Any, dict[str, Any], Any, diffrax.RESULTS]:
        system, clock = self._system(terms, t0, y0, args)
        here, there, h = clock(t0), clock(t1), _as_time(terms.contr(t0, t1), y0)
        motion = Motion(*y0.parts())
        keeps = self.method.keeps_force(system)
        if keeps and made_jump is not False:
            solver_state = jax.lax.cond(made_jump, lambda: system.force(here, motion), lambda: solver_state)
        # The seams and the joint exit of `integrate`: the step is one loop here as there.
        constants, functions = eqx.partition((system, here, there, h), eqx.is_array)
        (motion, force), constants = seam(((motion, solver_state), constants))
        system, here, there, h = eqx.combine(constants, functions)
        end, last, fine = self.method.step(system, here, there, h, motion, force)
        end, last, fine = together((end, last, jnp.asarray(fine)))
        y1 = type(y0).join(*end)

        # What follows is computed where something asks for it, and else removed by the compiler.
        torques = (force, last) if keeps else (system.force(here, motion), system.force(there, end))
        velocities = (_velocity(system, motion.momentum), _velocity(system, end.momentum))
        dense = {"y0": y0, "y1": y1, "h": h}
        for i in (0, 1):
            dense |= {f"velocity{i}": _pack(velocities[i]), f"torque{i}": _pack(torques[i])}
        for leaf in jax.tree.leaves(y1):
            fine = fine & jnp.all(jnp.isfinite(leaf))
        error = jax.lax.stop_gradient(_error(y0, y1, h, velocities, torques))
        error = jax.tree.map(lambda e: jnp.where(fine, e, jnp.full_like(e, jnp.inf)), error)
        good, bad = cast(Any, (diffrax.RESULTS.successful, diffrax.RESULTS.nonlinear_divergence))
        result = diffrax.RESULTS.where(fine, good, bad)
        return y1, error, dense, last, result

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """The derivative of the state's arrays, a state of the same class."""
        self._system(terms, t0, y0, args)
        return terms.vf(t0, y0, args).ambient

    def _system(self, terms: Any, t: Any, y: Any, args: Any) -> tuple[System, Callable[[Any], Array]]:
        """The system, and the clock that turns diffrax's time, which always grows, into the term's."""
        # diffrax hands over its own wrapper, which turns time round; what it wraps is inside.
        found = jax.tree.leaves(terms, is_leaf=lambda x: isinstance(x, RigidBodyTerm))
        found = [x for x in found if isinstance(x, RigidBodyTerm)]
        if len(found) != 1:
            raise ValueError(
                f"LieSolver needs one midlie_jax.RigidBodyTerm(body, torque) as its terms, got {type(terms).__name__} "
                f"with {len(found)} of them; diffrax's own solvers take the same term."
            )
        (term,) = found
        torque = term.torque_at(args)
        _check(term.body, torque, y)
        if not isinstance(term.body, self.method.bodies):
            raise ValueError(
                f"method {self.method.name!r} moves {self.method.bodies.__name__}, but body is "
                f"{type(term.body).__name__}; midlie_jax.methods() lists all."
            )

        def clock(t: Any) -> Array:
            return _as_time(terms.contr(jnp.zeros_like(t), jnp.asarray(t)), y)

        return System.of(term.body, torque, y, clock(t)), clock


def _error(y0: Any, y1: Any, h: Array, velocities: Any, torques: Any) -> Any:
    """Half of h times what angular velocity and spatial torque have changed by, as differences of the arrays of y1."""
    half, (start, end) = h / 2, torques
    if not isinstance(start, tuple):
        return _like(y1, half * (end - start), half * (velocities[1] - velocities[0]))
    angle = cp.scale(half, cp.subtract(velocities[1], velocities[0]))
    if isinstance(y0, RigidState):
        turned = cp.multiply(cp.conjugate(cp.unpack(y0.attitude)), cp.unpack(y1.attitude))
        start = cp.rotate_back(turned, start)
    momentum, pose = y1.parts()
    # A momentum fixed in space moves against the body's own error; without it a free body would show none.
    change = cp.add(cp.scale(half, cp.subtract(end, start)), cp.cross(momentum, angle))
    return _like(y1, cp.pack(change), _pack(type(y1).rate(pose, angle)))


def _ambient(y: Any, velocity: Any, force: Any) -> Any:
    """The derivative of the state's arrays."""
    momentum, pose = y.parts()
    rate = type(y).rate(pose, velocity)
    if not isinstance(momentum, tuple):
        return _like(y, force, rate)
    return _like(y, cp.pack(cp.add(cp.cross(momentum, velocity), force)), _pack(rate))


def _like(y: Any, *arrays: Any) -> Any:
    """A state of y's class of any numbers: the class itself would refuse a derivative as no unit quaternion."""
    structure = jax.tree.structure(y)
    return jax.tree.unflatten(structure, arrays[: structure.num_leaves])


def _velocity(system: System, momentum: Any) -> Any:
    return (
        cp.times(system.inertia.inverses, momentum)
        if isinstance(momentum, tuple)
        else system.inertia.velocity(momentum)
    )


def _pack(parts: Any) -> Any:
    return cp.pack(parts) if isinstance(parts, tuple) and parts else parts


def _parts(array: Array, y: Any) -> Any:
    return cp.unpack(array) if y.body is RigidBody else array


def _cubic(start: Array, end: Array, slope0: Array, slope1: Array) -> tuple[Array, Array, Array, Array]:
    """Coefficients, lowest first, of the cubic on [0, 1] with these values and slopes at its ends."""
    change = end - start
    return start, slope0, 3 * change - 2 * slope0 - slope1, slope0 + slope1 - 2 * change


def _at(cubic: tuple[Array, Array, Array, Array], s: Array) -> Array:
    a, b, c, d = cubic
    return a + s * (b + s * (c + s * d))


def _as_time(t: Any, y: Any) -> Array:
    return jnp.asarray(t).astype(y.momentum.dtype)


def _check(body: Any, torque: Any, y: Any) -> None:
    if not isinstance(y, State):
        raise ValueError(
            f"the state must be one such as midlie_jax.RigidState, got {type(y).__name__}; for the way back of "
            "BacksolveAdjoint name a solver of diffrax: BacksolveAdjoint(solver=diffrax.Tsit5())."
        )
    if not isinstance(body, y.body):
        raise ValueError(f"a {type(y).__name__} belongs to {y.body.__name__}, but body is {type(body).__name__}.")
    if isinstance(body, RigidBody):
        for name, array in (("body.moments", body.moments), ("y0.momentum", y.momentum)):
            if array.ndim != 1:
                raise ValueError(f"{name} must be (3,), got {array.shape}; map diffeqsolve over a batch with jax.vmap.")
    try:
        same_dtype("the state", y.momentum, body=body, torque=torque)
    except ValueError as error:
        raise ValueError(
            f"{error} diffrax promotes the state to the dtype of time: for float32 with x64 on, give t0, t1 and dt0 as "
            "jnp.float32."
        ) from error
