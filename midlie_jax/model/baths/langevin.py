"""`Langevin`, friction and thermal noise of a heat bath on rigid bodies; `Recoil`, noise in the space frame."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import shown
from ..._math.components import is_traced
from ..bodies import Body, RigidBody, SymmetricRotor
from ..exposure import exposures, kicks
from ..state import AnyState
from ..torques.reads_body import knows_axis_alone
from .base import BathOfBodies, Warm, as_coefficient, as_key, at


class Langevin(Warm, BathOfBodies):
    """A heat bath: dPi = -G Omega dt + sqrt(2 kT G) dW in the body frame; likewise for p if the body translates.

    The argument `bath` of a run, for methods whose scheme has a bath stage, such as "JACOBI[BAOAB]". The stage solves
    these equations exactly. A free body therefore keeps the Maxwell distribution, `<Pi_i^2> = kT I_i` and
    `<p_i^2> = kT m`, at any step that the flight supports. docs/heat.md describes the effect of a torque.

    With a torque, averages have an error of second order in the step (Leimkuhler and Matthews, Appl. Math. Res. Express
    2013, 34; for rotations Davidchack, Ouldridge and Tretyakov, J. Chem. Phys. 142, 2015, 144114). Dynamics need x = G
    h/I << 1, and g h/m << 1: a free body diffuses (x/2) coth(x/2) times too fast, by 2 percent at x = 0.5. Derivatives
    are taken along the path, for fixed noise.

    The random numbers depend only on the key, on the index of the step and of the stage, and for coupled bodies on the
    index of the body. A run in blocks must therefore pass `first_step`; otherwise each block repeats the noise of the
    first one. Two runs with one key have the same noise, in float32 and float64.

    For an `AxisState` the friction must be symmetric about the axis, and the body is a `SymmetricRotor(moment, along)`.
    With `along` zero, a linear molecule, the bath does not rotate the body about its axis.

    Attributes:
        kT: the temperature in units of energy, (), or a function of time t -> (). Not negative.
        friction: G, torque per angular velocity: a number (), three numbers (3,) along the principal axes of a
            `RigidBody` or `SymmetricRotor`, or a symmetric tensor (3, 3), positive semi-definite, in the frame of the
            body; for coupled bodies also (N, 3) and (N, 3, 3). Or a function of time t that returns one of these.
        key: a typed key, `jax.random.key(seed)`; for an ensemble one for each body, `jax.random.split(key, n)`.
        linear_friction: g, force per velocity, likewise, also in the frame of the body; for a body that translates, 0
            for none. None for a body that does not translate.

    Raises:
        ValueError: arguments of other forms. When a run begins: several keys for one body; `linear_friction` missing or
            superfluous; a friction that does not fit the state; or a method without the stage.

    Examples:
        >>> bath = ml.baths.Langevin(kT=1.5, friction=0.5, key=jax.random.key(0))
        >>> bool(ml.integrate("SYMMETRIC[BAOAB]", body, None, start, dt=0.001, steps=100, bath=bath).ok)
        True
    """

    numbers: ClassVar[tuple[str, ...]] = ("friction", "linear_friction")
    friction: Any
    linear_friction: Any

    def __init__(self, kT: Any, friction: Any, key: Any, linear_friction: Any = None):
        super().__init__(kT, key)
        self.friction = as_coefficient("friction", friction)
        self.linear_friction = None if linear_friction is None else as_coefficient("linear_friction", linear_friction)

    def effects(self, body: Body, times: dict[float, Array], t: Array, with_root: bool = True) -> Any:
        principal, frame = body.in_principal_axes(), body.frame_of_user()
        friction, linear = self.frictions(body, t)
        root = self.root(t) if with_root else None
        return {b: exposures(principal, frame, friction, linear, time, root) for b, time in times.items()}

    def frictions(self, body: Body, t: Array) -> tuple[Array, Array | None]:
        """The frictions at a time; NaN if a function returns one that is not symmetric about the axis of a rotor."""

        def one(value: Any) -> Any:
            numbers = at(value, t)
            if not callable(value) or not isinstance(body.turning, SymmetricRotor) or not numbers.ndim:
                return numbers
            return jnp.where(numbers[..., :1] == numbers[..., 1:2], numbers, jnp.nan)

        return one(self.friction), None if self.linear_friction is None else one(self.linear_friction)

    def check(self, state: AnyState) -> None:
        for name in self.numbers if knows_axis_alone(state) else ():
            friction = getattr(self, name)
            if callable(friction) or friction is None or is_traced(friction):
                continue
            if friction.shape[-1:] != (3,) or friction.shape[-2:] == (3, 3):
                continue
            numbers = np.asarray(friction)
            if np.any(numbers[..., 0] != numbers[..., 1]):
                raise _not_symmetric(name, friction, state)

    def check_numbers(self, name: str, shape: tuple[int, ...], state: AnyState, body: Any) -> None:
        turning, tensor = body.turning, shape[-2:] == (3, 3)
        if shape and not tensor and not isinstance(turning, RigidBody | SymmetricRotor):
            raise ValueError(
                f"{name} must be a number or a tensor (3, 3) for a {type(turning).__name__}, got three numbers. Give "
                "the tensor in the frame of the body."
            )
        if isinstance(turning, SymmetricRotor) and tensor:
            raise _not_symmetric(name, getattr(self, name), state)


def _not_symmetric(name: str, friction: Any, state: AnyState) -> ValueError:
    got = "a tensor" if callable(friction) else f"shape {friction.shape}" if is_traced(friction) else shown(friction)
    return ValueError(
        f"{name} on a {type(state).__name__} must be a number, or three numbers with the first "
        f"two equal, got {got}; use a state with an attitude for another friction."
    )


class Recoil(BathOfBodies):
    """Noise without friction, such as the recoil of photons: dL = sqrt(2 D) dW in the space frame; likewise for p.

    The mean kinetic energy of a free body grows at a constant rate: tr(D)/m for the translation with the linear
    diffusion D, and tr(D)/I for the rotation of a sphere. Add a gas as `Langevin(...) + Recoil(...)`.

    Attributes:
        diffusion: D, the diffusion of the angular momentum, `<dL_i dL_j> = 2 D_ij dt`, in the forms of the friction of
            `Langevin` but in the space frame; a state without an attitude or an axis supports only a number.
        key: as for `Langevin`.
        linear_diffusion: of the linear momentum, likewise; for a body that translates, 0 for none. None for a body that
            does not translate.

    Examples:
        >>> photons = ml.baths.Recoil([0.1, 0.1, 0.4], jax.random.key(0))
        >>> bool(ml.integrate("JACOBI[BAOAB]", body, None, start, dt=0.001, steps=10, bath=photons).ok)
        True
    """

    numbers: ClassVar[tuple[str, ...]] = ("diffusion", "linear_diffusion")
    diffusion: Any
    key: Array
    linear_diffusion: Any

    def __init__(self, diffusion: Any, key: Any, linear_diffusion: Any = None):
        self.diffusion, self.key = as_coefficient("diffusion", diffusion), as_key(key)
        self.linear_diffusion = (
            None if linear_diffusion is None else as_coefficient("linear_diffusion", linear_diffusion)
        )

    def effects(self, body: Body, times: dict[float, Array], t: Array, with_root: bool = True) -> Any:
        linear = None if self.linear_diffusion is None else at(self.linear_diffusion, t)
        return {b: kicks(body.in_principal_axes(), at(self.diffusion, t), linear, time) for b, time in times.items()}

    def check_numbers(self, name: str, shape: tuple[int, ...], state: AnyState, body: Any) -> None:
        known = hasattr(state, "attitude") or isinstance(body.turning, SymmetricRotor)
        if name == "diffusion" and shape and not known:
            raise ValueError(f"diffusion must be a number for a {type(state).__name__}, got {shape}; use a RigidState.")
