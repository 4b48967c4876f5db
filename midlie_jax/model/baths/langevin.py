"""`Langevin`: friction and thermal noise of a heat bath on rigid bodies."""

from typing import Any, ClassVar

import numpy as np
from jax import Array
from jaxtyping import Float

from ..._checks.arguments import as_floats, require, require_finite, shown
from ..._math.components import is_traced
from ..bodies import Body, RigidBody, TensorBody, is_symmetric, read_as_tensor
from ..exposure import PreparedBath, exposures
from ..rotor import SymmetricRotor
from ..state import AnyState
from ..torques.reads_body import knows_axis_alone
from .base import HeatBath

_ROUNDED = 1e-5  # largest magnitude of a negative eigenvalue of a tensor due to rounding, relative to its largest entry


class Langevin(HeatBath):
    """A heat bath: dPi = -G Omega dt + sqrt(2 kT G) dW in the body frame; likewise for p if the body translates.

    The argument `bath` of a run, for methods whose scheme has a bath stage, such as "JACOBI[BAOAB]". The stage solves
    these equations exactly. A free body therefore keeps the Maxwell distribution, `<Pi_i^2> = kT I_i` and
    `<p_i^2> = kT m`, at any step that the flight supports. docs/heat.md describes the effect of a torque.

    With a torque, averages have an error of second order in the step: the weak order of a scheme with a bath is 2. In a
    harmonic well of frequency omega, let s = (h omega)^2/4. BAOAB and ABOBA have the exact variance of the position,
    and 1 - s and 1/(1 - s) times the exact variance of the momentum. OBABO has the exact variance of the momentum, and
    1/(1 - s) times the exact variance of the position (Leimkuhler and Matthews, Appl. Math. Res. Express 2013, 34; for
    rotations Davidchack, Ouldridge and Tretyakov, J. Chem. Phys. 142, 2015, 144114). Derivatives are taken along the
    path, for fixed noise.

    Averages are accurate at any friction, but dynamics need x = G h/I << 1: a free body diffuses (x/2) coth(x/2) times
    too fast, by 2 percent at x = 0.5 and 31 percent at x = 2. For translation x = g h/m.

    The random numbers depend only on the key, on the index of the step and of the stage, and for coupled bodies on the
    index of the body. A run in blocks must therefore pass `first_step`; it then has the noise of the uninterrupted run,
    while otherwise each block repeats the noise of the first one. Two runs with one key have the same noise, in float32
    and float64. An ensemble needs a key for each body, `jax.random.split(key, n)`; coupled bodies share one.

    For an `AxisState` the friction must be symmetric about the axis, and the body needs its moment about the axis,
    `SymmetricRotor(moment, along)`. With `along` zero, a linear molecule, the bath does not rotate the body about its
    axis.

    Attributes:
        kT: the temperature in units of energy, (), or a function of time t -> (). Not negative.
        friction: G, torque per angular velocity: a number (), three numbers (3,) along the principal axes of a
            `RigidBody` or `SymmetricRotor`, or a symmetric tensor (3, 3) in the frame of the body. For coupled bodies,
            numbers and tensors may have an axis for the bodies, (N, 3) and (N, 3, 3); (3, 3) is always a tensor.
        key: a typed key, `jax.random.key(seed)`; (n,) for an ensemble.
        linear_friction: g, force per velocity, likewise; for a body that translates, 0 for none. Three numbers or a
            tensor rotate with the body. None for a body that does not translate.

    Raises:
        ValueError: a negative temperature; a friction that is negative, not symmetric or not positive semi-definite, or
            of another shape; a key that is not typed. When a run begins: several keys for one body; `linear_friction`
            missing or superfluous; a friction that does not fit the state; or a method without the stage.

    Examples:
        >>> bath = ml.baths.Langevin(kT=1.5, friction=0.5, key=jax.random.key(0))
        >>> top, start = ml.RigidBody([2.0, 2.0, 1.0]), ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.integrate("SYMMETRIC[BAOAB]", top, None, start, dt=0.1, steps=100, save_every=10, bath=bath)
        >>> path.states.momentum.shape, bool(path.ok)
        ((11, 3), True)
    """

    methods: ClassVar[str] = "JACOBI[BAOAB], or SYMMETRIC[BAOAB] for two equal moments"
    friction: Float[Array, "..."]
    linear_friction: Float[Array, "..."] | None

    def __init__(self, kT: Any, friction: Any, key: Any, linear_friction: Any = None):
        super().__init__(kT, key)
        self.friction = _friction("friction", friction)
        self.linear_friction = None if linear_friction is None else _friction("linear_friction", linear_friction)

    def prepared(self, body: Body, coefficients: set[float], t: Array, h: Array, start: AnyState) -> PreparedBath:
        """The bath prepared for the steps of a run.

        Args:
            body: the body of the run.
            coefficients: of the bath stages.
            t, h: a time of the run and its step, ().
            start: the initial state.
        """
        principal, frame, friction = body.in_principal_axes(), body.frame_of_user(), self.friction.astype(h.dtype)
        linear = None if self.linear_friction is None else self.linear_friction.astype(h.dtype)
        root = self.root if callable(self.kT) else None
        own = None if root is not None else self.root(t)
        made = {b: exposures(principal, frame, friction, linear, b * h, own) for b in sorted(coefficients)}
        return self.for_run(start, made, root)

    def check(self, state: AnyState) -> None:
        for name in ("friction", "linear_friction") if knows_axis_alone(state) else ():
            friction = getattr(self, name)
            if friction is None or is_traced(friction) or friction.shape[-1:] != (3,) or friction.shape[-2:] == (3, 3):
                continue
            numbers = np.asarray(friction)
            if np.any(numbers[..., 0] != numbers[..., 1]):
                raise _not_symmetric(name, friction, state)

    def check_kind(self, state: AnyState, body: Any) -> None:
        kind = type(state).__name__
        if not isinstance(body.turning, RigidBody | TensorBody | SymmetricRotor):
            raise ValueError(f"Langevin acts on rigid bodies and rotors, not on a {kind}; leave out Langevin.")
        if (state.kind.rotation is None) != (self.linear_friction is None):
            raise ValueError(
                f"a {kind} translates: give Langevin the linear_friction, or 0 for none."
                if state.kind.rotation is not None
                else f"a {kind} does not translate: leave out linear_friction."
            )
        if isinstance(body.turning, SymmetricRotor):
            body.turning.known_along  # noqa: B018 - raises if it is unknown

    def check_on(self, state: AnyState, body: Any) -> None:
        super().check_on(state, body)
        count = state.momentum.shape[-2] if state.several else None
        for name in ("friction", "linear_friction"):
            friction = getattr(self, name)
            if friction is not None:
                _check_one(name, friction, state, count, body)


def _friction(name: str, value: Any) -> Array:
    friction = as_floats(name, value)
    require_finite(name, friction)
    if friction.shape[-2:] != (3, 3) or is_traced(friction):
        require(name, friction, lambda g: g >= 0, "must not be negative", "check its sign.")
        return friction
    tensor = np.asarray(friction, np.float64)
    largest = np.abs(tensor).max(initial=0.0)
    if not is_symmetric(tensor):
        raise ValueError(
            f"{name} must be symmetric if it is a tensor, got {shown(tensor)}; pass (G + G.T) / 2; or, "
            f"{read_as_tensor(name)}."
        )
    least = float(np.linalg.eigvalsh(tensor).min(initial=0.0))
    if least < -_ROUNDED * largest:
        raise ValueError(
            f"{name} must be positive semi-definite, but {shown(tensor)} has the eigenvalue {least:.3g}; check its "
            f"signs; or, {read_as_tensor(name)}."
        )
    return friction


def _check_one(name: str, friction: Array, state: AnyState, count: int | None, body: Body) -> None:
    shape, tensor = friction.shape, friction.shape[-2:] == (3, 3)
    leading = shape[:-2] if tensor else shape[:-1]
    if not (shape == () or (shape[-1] == 3 and leading in ((), (count,)))):
        wanted = "(), (3,) or (3, 3)" + ("" if count is None else f", or ({count}, 3) or ({count}, 3, 3)")
        raise ValueError(f"{name} of one run must be of shape {wanted}, got {shape}; more are for midlie_jax.ensemble.")
    turning: Any = body.turning
    if shape and not tensor and not isinstance(turning, RigidBody | SymmetricRotor):
        raise ValueError(
            f"{name} must be a number or a tensor (3, 3) for a {type(turning).__name__}, got three numbers. Give the "
            "tensor in the frame of the body."
        )
    if isinstance(turning, SymmetricRotor) and tensor:
        raise _not_symmetric(name, friction, state)


def _not_symmetric(name: str, friction: Array, state: AnyState) -> ValueError:
    got = f"shape {friction.shape}" if is_traced(friction) else shown(friction)
    return ValueError(
        f"{name} on a {type(state).__name__} must be a number, or three numbers with the first "
        f"two equal, got {got}; use a state with an attitude for another friction."
    )
