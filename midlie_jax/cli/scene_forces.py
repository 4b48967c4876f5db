"""The torques and forces of some scenes: a well and a ring, a pulse, the blades of a boomerang, waters."""

from itertools import combinations
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..model import so3
from ..model.free_body import Wrench
from ..model.state import Time
from ..model.torques import FromPotential, Torque
from ..model.torques.reads_body import ReadsBody
from ..molecules.points import sites

_WELL = (np.cos(1.25), np.sin(1.25) / np.sqrt(2.0), 0.0, np.sin(1.25) / np.sqrt(2.0))  # exp(2.5 (1, 0, 1) / sqrt(2))
_COULOMB = 138.935457644  # of two elementary charges at a distance of 1 nm
_CHARGES = np.array([-0.8476, 0.4238, 0.4238])
_SIGMA, _DEPTH = 0.3166, 0.650  # of the Lennard-Jones potential of the oxygens


class PairPotential(Torque):
    """The torque of the drift test of Bou-Rabee, Ortolan and Saccon, arXiv 1005.3078, by automatic differentiation.

        V = (d - 1)^2 - 0.3 / dm, d = |R - 1|, dm = |R - Rm|, Rm = exp(2.5 (1, 0, 1) / sqrt(2))

    It has a ring of least energy about one attitude and a well at another; the norms are Frobenius norms. For a body
    that moves between them, the energy drifts if a method is reversible but not symplectic. The norm of R - 1 is the
    norm of the vector part of the attitude quaternion, times the root of 8; in this form nothing cancels near R = 1.
    """

    def __call__(self, t: Time, state: Any) -> Array:
        return FromPotential(self.potential)(t, state)

    def potential(self, t: Time, state: Any) -> Array:
        del t
        attitude = state.attitude
        from_well = so3.multiply(so3.conjugate(jnp.asarray(_WELL, attitude.dtype)), attitude)
        return (_distance(attitude) - 1) ** 2 - 0.3 / _distance(from_well)


def _distance(quaternion: Array) -> Array:
    """|R - 1| of the rotation of a unit quaternion."""
    return jnp.sqrt(8 * jnp.sum(quaternion[1:] ** 2))


class Pulse(eqx.Module):
    """A constant torque switched on and off, for `Prescribed`.

    At a switch the torque is the mean of the values on both sides, so that steps that end there keep second order.
    """

    torque: Float[Array, "3"]  # between the switches, body frame
    on: float = eqx.field(static=True)
    off: float = eqx.field(static=True)

    def __call__(self, t: Any) -> Float[Array, "3"]:
        t = jnp.asarray(t, self.torque.dtype)
        return self.torque * ((_side(t, self.on) - _side(t, self.off)) / 2)


def _side(t: Float[Array, ""], switch: float) -> Float[Array, ""]:
    """-1 before the switch, 0 at it, 1 after it."""
    # The end of a step may differ from the switch by the rounding of n * dt: half a unit for dt, half for the product.
    slack = 4 * float(jnp.finfo(t.dtype).eps) * abs(switch)
    return jnp.where(jnp.abs(t - switch) <= slack, jnp.zeros_like(t), jnp.sign(t - switch))


class Blades(ReadsBody):
    """Lift and drag of thin blades that rotate about the third body axis, in air at rest, averaged over a rotation.

    A piece of a blade moves at U along the plane and at W along the third axis n. Per unit of length, its lift along n
    is strength/radius * U (lift U - slope W), and its drag is strength/radius * drag U^2. U = spin r + v . (n x r^),
    where v is the velocity of the body and r^ points along the blade. The advancing blade therefore has more lift: the
    axis precesses and the path bends. Stall and wake are neglected.
    """

    strength: Float[Array, ""]  # half the density of air times the chord, the number and the length, mass/length
    radius: Float[Array, ""]  # length of a blade
    lift: Float[Array, ""]  # coefficient of lift of a blade that moves in its plane
    slope: Float[Array, ""]  # decrease of this coefficient with W/U, 1/radian
    drag: Float[Array, ""]  # coefficient of drag

    @property
    def velocity_dependent(self) -> bool:
        return True

    def at(self, t: Any, state: Any, body: Any) -> Wrench:
        del t
        a, turn = self.radius, body.velocity(state.momentum)
        v = so3.rotate(so3.conjugate(state.attitude), state.linear / body.mass)  # all vectors are along the body axes
        n = jnp.zeros_like(v).at[2].set(1)
        spin, along = turn[2], v[2]
        across, tilt = v - along * n, turn - spin * n  # the parts in the plane of the blades
        square = jnp.sum(across**2)
        lift = self.lift * ((spin * a) ** 2 / 3 + square / 2) + self.slope * a * (
            jnp.sum(across * tilt) / 4 - spin * along / 2
        )
        bend = (self.slope * a * along / 4 - self.lift * a**2 * spin / 3) * across
        steady = -self.slope * a**3 * spin / 8 * tilt
        slow = -self.drag * a * ((spin * a) ** 2 + square) / 4 * n
        force = lift * n - self.drag * a * spin / 2 * across
        return Wrench(self.strength * (bend + steady + slow), self.strength * so3.rotate(state.attitude, force))


class Molecule(NamedTuple):
    """A rigid molecule."""

    mass: float
    moments: np.ndarray  # principal, (3,)
    points: np.ndarray  # O, H and H in the principal frame, (3, 3)


def _water() -> Molecule:
    """Two hydrogens at 0.1 nm from the oxygen, at the angle of a tetrahedron; flat, with e2 across the plane."""
    oxygen, hydrogen, half = 15.9994, 1.008, np.arccos(-1 / 3) / 2
    mass = oxygen + 2 * hydrogen
    x, z = 0.1 * np.sin(half), 0.1 * np.cos(half)
    low = -2 * hydrogen * z / mass  # the oxygen, from the centre of mass
    points = np.array([[0.0, 0.0, low], [x, 0.0, low + z], [-x, 0.0, low + z]])
    across, along = oxygen * low**2 + 2 * hydrogen * (low + z) ** 2, 2 * hydrogen * x**2
    return Molecule(mass, np.array([across, across + along, along]), points)


WATER = _water()


class Waters(Torque):
    """The electrostatic and Lennard-Jones forces between a few waters, by automatic differentiation."""

    def __call__(self, t: Time, state: Any) -> Any:
        return FromPotential(self.potential)(t, state)

    def potential(self, t: Time, state: Any) -> Array:
        del t
        places = sites(state, jnp.asarray(WATER.points, state.position.dtype))
        charges = jnp.asarray(_COULOMB * np.outer(_CHARGES, _CHARGES), places.dtype)
        energies = list[Array]()
        for i, j in combinations(range(len(places)), 2):
            first, second = places[i], places[j]
            distances = jnp.sqrt(jnp.sum((first[:, None] - second[None]) ** 2, axis=-1))
            sixth = (_SIGMA / distances[0, 0]) ** 6
            energies.append(jnp.sum(charges / distances) + 4 * _DEPTH * (sixth * sixth - sixth))
        return sum(energies[1:], start=energies[0])
