"""BROWNIAN: rotation and translation under strong friction, where a body has no inertia.

With the mobility M = G^-1 in the body frame, the temperature kT and the torque T,

    dR = R hat(M T dt + sqrt(2 kT M) o dW),    dx = m F dt + sqrt(2 kT m) dW,    m = R g^-1 R^T.

The torque-free part is a random rotation with a normal rotation vector. Its covariance has a term of second order, so
that all averages agree with rotational diffusion up to h^3. Let L_i generate rotations about the axes, D = kT M with
the eigenvalues d_i, and C the covariance. From [L_1, L_2] = L_3 the mean of exp(x . L) equals exp(h sum_i d_i L_i^2) up
to h^2 if

    C_1 = 2 h d_1 + h^2 (d_2 d_3 - (2/3) d_1 (d_2 + d_3)),    and likewise C_2, C_3;

for equal d, C = 2 h d (1 - h d/6). The step is half of this diffusion, the motion under the torque by the midpoint
rule, and the other half of the diffusion: weak order 2 (Strang splitting).
"""

import operator
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import shown
from .._math import components as cp
from .._math.components import is_traced
from .._math.short_series import WIDEST_SQUARE, cosine_and_sinc_of_square, half_turn
from ..model.baths.base import words_of
from ..model.baths.langevin import Langevin
from ..model.bodies import Body, RigidBody, SymmetricRotor, TensorBody
from ..model.exposure import PreparedBath, in_principal_axes, product, rows
from ..model.free_body import Place
from ..model.state import AnyState
from ..model.states.unit_vector import Swing
from ..model.torques.reads_body import without_bath
from .base import Method
from .system import AnyMotion, Motion, Stepped, System
from .verdict import of_all, verdict

_LARGEST = 0.5  # of h kT tr M: six standard deviations of a random rotation are within the polynomials of `half_turn`


class Mobility(NamedTuple):
    """The inverse M of a friction in principal axes."""

    inverse: Any  # M, as three numbers or three rows
    bend: Any  # the K of the covariance 2 s (M + s K / 2), s = h kT
    trace: Array  # of M

    @classmethod
    def of(cls, friction: Array, frame: Any) -> "Mobility":
        friction = in_principal_axes(friction, frame)
        if friction.shape[-2:] != (3, 3):
            a, b, c = (1 / g for g in (cp.vector(friction) if friction.ndim else (friction,) * 3))
            pairs = (a, b, c), (b, c, a), (c, a, b)
            return cls((a, b, c), tuple(y * z - (2 / 3) * x * (y + z) for x, y, z in pairs), a + b + c)
        inverse = jnp.linalg.inv(friction)
        square, trace = inverse @ inverse, jnp.trace(inverse, axis1=-2, axis2=-1)
        second = (trace**2 - jnp.trace(square, axis1=-2, axis2=-1)) / 2
        bend = (5 / 3) * (square - trace[..., None, None] * inverse)
        bend = bend + second[..., None, None] * jnp.eye(3, dtype=friction.dtype)
        return cls(rows(inverse), rows(bend), trace)

    def rotation(self, s: Array, noise: cp.Vector) -> cp.Vector:
        covariance = [
            cp.tree_add(m, jax.tree.map(partial(operator.mul, s / 2), k))
            for m, k in zip(self.inverse, self.bend, strict=True)
        ]
        return cp.scale(cp.root(2 * s), _root_times(tuple(covariance), noise))

    def shift(self, s: Array, noise: cp.Vector) -> cp.Vector:
        return cp.scale(cp.root(2 * s), _root_times(self.inverse, noise))


def _root_times(matrix: Any, noise: cp.Vector) -> cp.Vector:
    """L noise with L L^T the matrix, by Cholesky's method for three rows."""
    if not isinstance(matrix[0], tuple):
        x, y, z = (cp.root(entry) * number for entry, number in zip(matrix, noise, strict=True))
        return x, y, z
    (a, b, c), (_, d, e), (_, _, f) = matrix
    x, y, z = noise
    first = cp.root(a)
    b, c = b / first, c / first
    second = cp.root(d - b * b)
    e = (e - b * c) / second
    return first * x, b * x + second * y, c * x + e * y + cp.root(f - c * c - e * e) * z


class Brownian(Method):
    """Overdamped motion in a heat bath: half a diffusion, the midpoint rule under the torque, half a diffusion.

    For bodies whose momentum relaxes much faster than their pose changes: colloids, molecules in a solvent. The bath is
    a `midlie_jax.baths.Langevin` with positive frictions. The momentum of the state has no meaning and stays. Averages
    and correlations have weak order 2 in the step. A step with h kT tr(G^-1) above 0.5, or with a rotation by the
    torque above 4.4 radians, reports False in `ok`. Two torque evaluations per step.
    """

    name: str = eqx.field(static=True, default="BROWNIAN")
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=False)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=False)
    bodies: type[Any] = eqx.field(static=True, default=RigidBody)
    evaluations: int = eqx.field(static=True, default=2)

    @property
    def random(self) -> bool:
        return True

    @property
    def several(self) -> bool:
        return True

    def moves(self, body: Body) -> bool:
        return isinstance(body.turning, RigidBody | TensorBody | SymmetricRotor)

    def check(self, body: Any, torque: Any, start: Any, batch: int) -> None:
        _, bath = without_bath(torque)
        for name in ("friction", "linear_friction"):
            friction = getattr(bath, name, None)
            if callable(friction) or friction is None or is_traced(friction):
                continue
            numbers = np.asarray(friction)
            least = np.linalg.eigvalsh(numbers) if numbers.shape[-2:] == (3, 3) else numbers
            if not np.all(least > 0):
                raise ValueError(
                    f"{name} must be positive in every direction for {self.name}, got {shown(numbers)}; for a body "
                    "with inertia use JACOBI[BAOAB]."
                )

    def system(self, body: Body, torque: Any, start: AnyState, t: Array, h: Array) -> System:
        torque, bath = without_bath(torque)
        if not isinstance(bath, Langevin):
            raise ValueError(
                f"bath must be one midlie_jax.baths.Langevin for {self.name}, got a {type(bath).__name__}; for other "
                "noise use JACOBI[BAOAB]."
            )
        bath.check_on(start, body)
        system = System.of(body, torque, start, t)
        if system.reads_momentum:
            raise ValueError(f"torque must not read the momentum under {self.name}, where a body has none.")
        mobilities = eqx.Partial(_mobilities, bath, body)
        varies = callable(bath.friction) or callable(bath.linear_friction)
        made = mobilities if varies else mobilities(t)
        return system._replace(bath=(PreparedBath.of(words_of(bath.key), made, bath.root, start),))

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:
        motion, first = _diffused(system, t0, h, motion, 0)
        middle, _ = _driven(system, t0, h / 2, h, motion, motion)
        motion, turn = _driven(system, t0 + h / 2, h, h, middle, motion)
        motion, last = _diffused(system, t1, h, motion, 1)
        return motion, None, of_all(verdict(True, (jnp.maximum(first, last), _LARGEST), (turn, WIDEST_SQUARE)))


def _mobilities(bath: Langevin, body: Body, t: Array) -> list[Mobility]:
    frictions = [friction for friction in bath.frictions(body, t) if friction is not None]
    return [Mobility.of(friction, body.frame_of_user()) for friction in frictions]


def _bath(system: System) -> PreparedBath:
    assert system.bath is not None
    return system.bath[0]


def _diffused(system: System, t: Array, h: Array, motion: AnyMotion, half: int) -> tuple[AnyMotion, Array]:
    """The motion after half of the diffusion in a step of h, and the largest h kT tr M."""
    root = _bath(system).root
    assert root is not None
    s = h / 2 * root(t) ** 2
    moved, sizes = [], []
    for own, one in system.members(motion):
        turning, *travel = _bath(own).at(t)
        rotating, rotation = own.rotating(one)
        like = one.momentum.linear if travel else rotation.momentum
        orientation: Any = rotation.pose
        position: Any = one.pose.position if travel else None
        for stage in (2, 0) if half == 0 else (1, 3):  # in the second half in the reverse order
            noise = _bath(own).noise(stage, like)
            if stage < 2:
                orientation = _turned(rotating, orientation, turning.rotation(s, noise), h)
            elif travel:
                # The rotated noise has the same distribution.
                shift = _by_mobility(rotating, orientation, travel[0], lambda m, own: m.shift(s, own), noise)
                position = cp.add(position, shift)
        moved.append(_at(one, orientation, position))
        sizes.append(2 * s * turning.trace)
    return system.of_members(moved), reduce(jnp.maximum, sizes)


def _driven(
    system: System, t: Array, time: Array, h: Array, at: AnyMotion, motion: AnyMotion
) -> tuple[AnyMotion, Array]:
    """The motion after a time under the torque at the motion `at`, and the largest square of half its rotation."""
    if system.torque is None:
        return motion, jnp.zeros_like(h)
    force, moved, sizes = system.force(t, at), [], []
    forces = [force] if len(system.members(motion)) == 1 else force
    for (own, one), (_, there), pull in zip(system.members(motion), system.members(at), forces, strict=True):
        turning, *travel = _bath(own).at(t)
        rotating, rotation = own.rotating(one)
        _, rotation_there = own.rotating(there)
        turn = cp.scale(time, product(turning.inverse, pull.angular if travel else pull))
        position = None
        if travel:
            shift = _by_mobility(
                rotating, rotation_there.pose, travel[0], lambda m, own: product(m.inverse, own), pull.linear
            )
            position = cp.add(one.pose.position, cp.scale(time, shift))
        moved.append(_at(one, _turned(rotating, rotation.pose, turn, h), position))
        sizes.append(cp.dot(turn, turn) / 4)
    return system.of_members(moved), reduce(jnp.maximum, sizes)


def _turned(system: System, orientation: Any, turn: cp.Vector, h: Array) -> Any:
    w = cp.scale(0.5, turn)
    if not system.kind.leaves[0].in_space:
        return system.turned(orientation, cp.square(half_turn(w)), h)
    square = cp.dot(w, w)
    return system.turned(orientation, Swing.of(w, square, *cosine_and_sinc_of_square(square)), h)


def _by_mobility(system: System, orientation: Any, mobility: Mobility, product: Any, vector: cp.Vector) -> cp.Vector:
    """A product of the mobility in the body frame with a vector in the space frame."""
    leaf = system.kind.leaves[0]
    if not leaf.in_space:
        return cp.rotate(orientation, product(mobility, cp.rotate_back(orientation, vector)))
    across, _, along = product(mobility, (jnp.ones_like(vector[0]),) * 3)
    return cp.add(cp.scale(across, vector), cp.scale((along - across) * cp.dot(orientation, vector), orientation))


def _at(motion: AnyMotion, orientation: Any, position: cp.Vector | None) -> AnyMotion:
    return Motion(motion.momentum, orientation if position is None else Place(orientation, position))
