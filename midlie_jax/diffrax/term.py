"""`RigidBodyTerm`, body and torque as a diffrax term, for `LieSolver` and every ODE solver of diffrax.

The functions below the class are helpers shared by the subpackage, to convert between states, arrays and components.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax import Array

from .._checks.arguments import described, same_dtype
from .._math import components as cp
from ..drivers.arguments import check_bath, check_moves
from ..integrators.base import Method
from ..integrators.system import System
from ..model.bodies import Body
from ..model.compatibility import check_batch, check_body
from ..model.kind import Kind
from ..model.state import State
from ..model.torques import TorqueLike


class Rates(NamedTuple):
    """The rates of change of a state: `ambient` for other solvers, velocity and torque for `LieSolver`.

    Attributes:
        ambient: the derivative of the arrays of the state, as a state of the same class.
        velocity: body-frame angular velocity (3,); for particles the velocity; for a body that translates, both. It
            always has the form of the momentum.
        torque: body-frame torque (3,), in the same form.

    Examples:
        >>> rates = ml.diffrax.RigidBodyTerm(body, torque).vf(0.0, start, None)
        >>> rates.velocity, rates.torque[0].round(4)  # for LieSolver
        (Array([ 0.,  0., 50.], dtype=float64), Array(5.9104, dtype=float64))
    """

    ambient: Any
    velocity: Any
    torque: Any


class RigidBodyTerm(diffrax.AbstractTerm[Any, Any]):
    """Pi' = Pi x Om + T, R' = R skew(Om), Om = I^-1 Pi, as a term for `LieSolver` and for every ODE solver of diffrax.

    Attributes:
        body: a `RigidBody`, `TensorBody`, `FreeBody`, `SymmetricRotor` or `Particles`.
        torque: any callable `torque(t, state) -> (3,)` in the body frame, or None; for a body that translates it can
            return a `Wrench`.
        torque_of_args: instead of `torque`, a function from the `args` of diffrax to the torque (a callable or None),
            for example `lambda args: ml.torques.HeavyTop(args["weight"])`.

    Raises:
        ValueError: both `torque` and `torque_of_args` are given, one of them is not callable, or `body` is not a body.

    Examples:
        >>> term = ml.diffrax.RigidBodyTerm(body, torque)
        >>> term.vf(0.0, start, None).velocity  # the angular velocity
        Array([ 0.,  0., 50.], dtype=float64)
        >>> fitted = ml.diffrax.RigidBodyTerm(body, torque_of_args=lambda args: ml.torques.HeavyTop(args["weight"]))
    """

    body: Body
    torque: TorqueLike | None
    torque_of_args: Callable[[Any], TorqueLike | None] | None

    def __init__(self, body: Any, torque: Any = None, *, torque_of_args: Any = None):
        if not isinstance(body, Body):
            raise ValueError(
                "body must be a midlie_jax.RigidBody, TensorBody, FreeBody, SymmetricRotor or Particles, got "
                f"{described(body)}."
            )
        if torque is not None and torque_of_args is not None:
            raise ValueError("give torque or torque_of_args, not both; add torques with midlie_jax.torques.Sum.")
        for name, value, form in (("torque", torque, "(t, state)"), ("torque_of_args", torque_of_args, "args")):
            if value is not None and not callable(value):
                raise ValueError(f"{name} must be None or a callable of {form}, got {described(value)}.")
        self.body, self.torque, self.torque_of_args = body, torque, torque_of_args

    def torque_at(self, args: Any) -> TorqueLike | None:
        """The torque for these `args`: a callable of (t, state), or None."""
        return self.torque if self.torque_of_args is None else self.torque_of_args(args)

    def vf(self, t: Any, y: Any, args: Any) -> Rates:
        """The `Rates` of the state y at the scalar time t."""
        torque = self.torque_at(args)
        check(self.body, torque, y)
        system = System.of(self.body, torque, y, as_time(t, y), whole=True)
        motion = system.motion(y)
        force = system.vector_in_user_axes(system.force(as_time(t, y), motion))
        velocity = system.vector_in_user_axes(system.velocity(motion.momentum))
        return Rates(ambient_rate(y, velocity, force), cp.packed(velocity), cp.packed(force))

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        return t1 - t0

    def prod(self, vf: Rates, control: Any) -> Any:
        return jax.tree.map(lambda x: jnp.asarray(control, x.dtype) * x, vf.ambient)


def ambient_rate(y: Any, velocity: Any, force: Any) -> Any:
    """The derivative of the arrays of the state y, under this velocity and torque or force."""
    momentum, pose = y.parts()
    kind = y.kind
    return unchecked(kind, kind.momentum_rate(momentum, velocity, force), kind.rate(pose, velocity))


@partial(jax.jit, static_argnums=0, inline=True)
def unchecked(kind: Kind, momentum: Any, pose: Any) -> Any:
    """`kind.join`, traced and thus unchecked: the class would reject derivatives of quaternions for their length."""
    return kind.join(momentum, pose)


def as_time(t: Any, y: Any) -> Array:
    """The time t in the dtype of the state y, used for all computations."""
    return jnp.asarray(t).astype(y.momentum.dtype)


def check(body: Any, torque: Any, y: Any, method: Method | None = None) -> None:
    if not isinstance(y, State):
        raise ValueError(
            f"the state must be one such as midlie_jax.RigidState, got {described(y)}; for "
            "BacksolveAdjoint use a solver of diffrax: BacksolveAdjoint(solver=diffrax.Tsit5())."
        )
    if y.kind.compensated:
        raise ValueError(
            "diffrax would lose the low parts of a CompensatedState; use a RigidState, or midlie_jax.integrate."
        )
    if y.kind.constant_steps:
        raise ValueError(
            f"diffrax does not support {y.kind.constant_steps}; use midlie_jax.integrate, ensemble or simulate."
        )
    check_body(body, y)
    if method is not None:
        check_moves(method, body, y)
        check_bath(method, None, "a heat bath needs midlie_jax.integrate, because diffrax does not count steps")
    check_batch("y0", body, y)
    try:
        same_dtype("the state", y.momentum, body=body, torque=torque)
    except ValueError as error:
        raise ValueError(
            f"{error} diffrax promotes the state to the dtype of time: for float32 with x64 on, give t0, t1 and dt0 as "
            "jnp.float32."
        ) from error
