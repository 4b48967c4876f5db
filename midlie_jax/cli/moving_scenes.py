"""The scenes of bodies that translate, of an axis alone, and of coupled bodies; `scenes` gives them their names."""

from itertools import combinations
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..asteroids.mutual_gravity import MutualGravity
from ..model import so3
from ..model.bodies import RigidBody
from ..model.free_body import FreeBody
from ..model.rotor import SymmetricRotor
from ..model.state import Time
from ..model.states import AxisState, CoupledState, FreeState
from ..model.torques import FromPotential, HeavyTop, Oblateness, PointMass, Torque, UniformGravity
from ..model.torques.reads_body import ReadsBody
from ..model.wrench import Wrench
from ..molecules.points import sites
from ..molecules.rods import straight_rod
from .scene import Scene

_BRICK = np.array([0.00189422, 0.006211019, 0.007194665]), 0.155404754  # moments and mass, slug and ft
_EARTH = 3.986004418e14, 6378137.0, 1.08262982e-3  # mu, radius and J2 of WGS-84, m and s
_TURN_OF_EARTH = 7.292115e-5  # rad/s
_FOOT = 0.3048
_COULOMB = 138.935457644  # of two elementary charges at a distance of 1 nm
_CHARGES = np.array([-0.8476, 0.4238, 0.4238])
_SIGMA, _DEPTH = 0.3166, 0.650  # of the Lennard-Jones potential of the oxygens


class JEOD:
    """NASA JEOD's verification case RUN_10A, kg, m and s: a satellite on a nearly circular orbit."""

    mu = 3.986004415e14
    moments = (500.0, 12250.0, 12250.0)
    rates = (-1.97989570839746e-5, -0.001134281491669957, 0.0)  # body frame
    position = (-4292653.41, 955168.47, 5139356.57)  # Earth-centred inertial
    velocity = (109.649663, -7527.72649, 1484.521489)
    to_body = (  # from inertial to body components
        (-0.6443912270931274, 0.05284210190675609, 0.7628680480341864),
        (-0.7615617871470506, -0.1345758407161209, -0.6339660776454052),
        (0.06916350883930189, -0.9894933326514259, 0.1269620166955875),
    )


def _start(momentum: Any, attitude: Any, linear: Any, position: Any, dtype: Any) -> FreeState:
    return FreeState(*(jnp.asarray(x, dtype) for x in (momentum, attitude, linear, position)))


def _coupled(momentum: Any, attitude: Any, linear: Any, position: Any, dtype: Any) -> CoupledState:
    return CoupledState(*(jnp.asarray(x, dtype) for x in (momentum, attitude, linear, position)))


def _body(moments: Any, mass: Any, dtype: Any) -> FreeBody:
    return FreeBody(RigidBody(jnp.asarray(moments, dtype)), jnp.asarray(mass, dtype))


def thrown_brick(dtype: Any) -> Scene:
    moments, mass = _BRICK
    return Scene(
        name="",
        title="a brick in a parabola that turns over again and again about its middle axis",
        body=_body(moments, mass, dtype),
        torque=UniformGravity(jnp.asarray([0.0, 0.0, -32.174], dtype)),
        start=_start(
            moments * np.array([0.1, 12.0, 0.1]), [1.0, 0.0, 0.0, 0.0], mass * np.array([15.0, 0.0, 32.174]),
            [0.0, 0.0, 5.0], dtype,
        ),
        dt=0.005,
        duration=2.0,
        source="the brick of NASA NESC's check-case 2; the throw is chosen here, not published",
        units="slug, ft, s; z up",
    )  # fmt: skip


def dropped_brick(dtype: Any) -> Scene:
    moments, mass = _BRICK
    mu, radius, j2 = _EARTH
    height = radius / _FOOT + 30000
    mu, radius, j2, pole = (jnp.asarray(x, dtype) for x in (mu / _FOOT**3, radius / _FOOT, j2, [1.0, 0.0, 0.0]))
    earth = PointMass(mu, gradient=False) + Oblateness(mu, radius, j2, pole, gradient=False)  # as published
    return Scene(
        name="",
        title="the tumbling brick dropped from 30000 ft over the turning Earth, east of the plumb line",
        body=_body(moments, mass, dtype),
        torque=earth,
        start=_start(
            moments * np.deg2rad([10.0, 20.0, 30.0]),
            [1.0, 0.0, 0.0, 0.0],
            [0.0, mass * _TURN_OF_EARTH * height, 0.0],
            [0.0, 0.0, -height],
            dtype,
        ),
        dt=0.05,
        duration=30.0,
        source="NASA NESC six-degree-of-freedom check-case 2, as carried by nasa/simupy-flight; J2 of WGS-84",
        units="slug, ft, s; space is North-East-Down over the equator at time 0, from the Earth's centre, not turning",
    )


def boomerang(dtype: Any) -> Scene:
    moments, mass, lean = np.array([1.25e-3, 1.25e-3, 2.5e-3]), 0.1, np.deg2rad(33.0)
    # The axis points to the left of the throw, along y, and leans upwards.
    half = (lean - np.pi / 2) / 2
    blades = (jnp.asarray(x, dtype) for x in (0.0145, 0.3, 0.8, 3.0, 0.016))
    return Scene(
        name="",
        title="the lift of its blades turns its axis, and so it flies a circle and comes back",
        body=_body(moments, mass, dtype),
        torque=Blades(*blades) + UniformGravity(jnp.asarray([0.0, 0.0, -9.81], dtype)),
        start=_start(
            moments * np.array([0.0, 0.0, 100.0]), [np.cos(half), np.sin(half), 0.0, 0.0],
            mass * np.array([22.0, 0.0, 8.8]), [0.0, 0.0, 1.8], dtype,
        ),
        dt=0.001,
        duration=2.0,
        source="mean over a turn of the lift and drag of its blades (after Hess, Sci. Am. 219 (1968) 124); numbers "
        "chosen here",
        units="kg, m, s; z up; the throw is along x",
    )  # fmt: skip


def satellite(dtype: Any) -> Scene:
    mass, earth = 1000.0, tuple(jnp.asarray(x, dtype) for x in (JEOD.mu, 6378136.3, 1.0826357e-3))
    return Scene(
        name="",
        title="orbit and attitude as one system: the Earth's oblateness turns the orbit",
        body=_body(JEOD.moments, mass, dtype),
        torque=PointMass(earth[0]) + Oblateness(*earth),
        start=_start(
            np.array(JEOD.moments) * np.array(JEOD.rates), so3.from_matrix(jnp.asarray(JEOD.to_body, dtype).T),
            mass * np.array(JEOD.velocity), JEOD.position, dtype,
        ),
        dt=10.0,
        duration=28800.0,
        source="body and orbit of NASA JEOD's verification case RUN_10A, which has no oblateness; the mass is chosen "
        "here, and J2 is that of JGM-3",
        units="kg, m, s; space is Earth-centred inertial",
    )  # fmt: skip


def spherical_pendulum(dtype: Any) -> Scene:
    mass, length = 1.0, 1.0
    down = np.deg2rad(60.0)  # from the vertical, downwards
    push = 0.7 * np.sqrt(9.81 / length)  # rad/s, about the vertical
    axis = np.array([np.sin(down), 0.0, -np.cos(down)])
    momentum = mass * length**2 * np.cross(axis, np.cross([0.0, 0.0, push], axis))
    return Scene(
        name="",
        title="an axis that hangs: the bob swings between two heights, and the swing turns",
        body=SymmetricRotor(jnp.asarray(mass * length**2, dtype)),
        torque=HeavyTop(jnp.asarray(mass * 9.81 * length, dtype)),
        start=AxisState(jnp.asarray(momentum, dtype), jnp.asarray(axis, dtype)),
        dt=0.01,
        duration=10.0,
        source="chosen here, not published",
        units="kg, m, s; z up; the axis points from the pivot to the bob",
        method="SYMMETRIC[EA]",
    )


def binary_asteroid(dtype: Any) -> Scene:
    masses = np.array([532661512390.31647, 4995532430.186578])
    moments = np.array(
        [
            [3.0787835416160292e16, 3.162944060573699e16, 3.324873160340355e16],
            [10660065963959.85, 15001746242654.273, 16923273395857.004],
        ]
    )
    spins = np.array([7.72269580528e-4, 1.46420239261e-4])[:, None] * np.array([[0.05, 0.0, 1.0], [0.0, 0.05, 1.0]])
    attitudes = [
        [1.0, 0.0, 0.0, 0.0],
        [0.9952465414778341, 0.0870727897926938, 0.0434534024273578, 0.0038016801040236755],
    ]
    share = masses[::-1] / masses.sum() * [-1, 1]  # shares of distance and velocity from first to second
    way, velocity = np.array([1200.0, 0.0, 0.0]), np.array([0.0, 0.175704287113523, 0.0])
    linear = (masses * share)[:, None] * velocity
    return Scene(
        name="",
        title="a binary asteroid: its moon swings about the line to it, and both axes wander",
        body=_body(moments, masses, dtype),
        torque=MutualGravity(jnp.asarray(6.67e-11, dtype)),
        start=_coupled(moments * spins, attitudes, linear, share[:, None] * way, dtype),
        dt=60.0,
        duration=172800.0,
        source="like (65803) Didymos, from the example of GUBAS (Davis & Scheeres, Icarus 341 (2020) 113439), with a "
        "primary that is no sphere; to the second degree, tilted",
        units="kg, m, s; the centre of mass rests at the origin",
        method="JACOBI[SRKN6b]",
    )


def dimer(dtype: Any) -> Scene:
    momentum = np.array([[-0.05, -0.1, -0.15], [0.05, 0.1, 0.15]])
    return Scene(
        name="",
        title="two waters that hang on each other by a hydrogen bond",
        body=_body(np.tile(WATER.moments, (2, 1)), [WATER.mass] * 2, dtype),
        torque=Waters(),
        start=_coupled(
            momentum, [[0.8, 0.0, 0.6, 0.0], [0.6, 0.48, 0.0, 0.64]],
            [[0.0, 2.0, 0.0], [0.0, -2.0, 0.0]], [[0.0, 0.0, 0.0], [0.28, 0.0, 0.02]], dtype,
        ),
        dt=0.001,
        duration=1.0,
        source="the rigid water SPC/E (Berendsen, Grigera & Straatsma, J. Phys. Chem. 91 (1987) 6269); the start is "
        "chosen here",
        units="amu, nm, ps; energies in kJ/mol",
    )  # fmt: skip


def rod(dtype: Any) -> Scene:
    elements, size = 20, 0.5
    body, torque, straight = straight_rod(
        elements, *(jnp.asarray(x, dtype) for x in ([0.0, 0.0, 0.0], [0.0, 0.6, 0.8], [1.0, 0.0, 0.0])),
        length=jnp.asarray(2.0, dtype), radius=jnp.asarray(0.1, dtype), density=jnp.asarray(5.0, dtype),
        youngs_modulus=jnp.asarray(10.0, dtype), shear_modulus=jnp.asarray(4.0, dtype),
    )  # fmt: skip
    along = np.linspace(-1.0, 1.0, elements + 1)[:, None]
    spins = size * np.array([0.4, -0.3, 2.0]) * (along + 0.2)
    velocity = size * np.array([0.5, 0.1, -0.2]) * (1 + along**2)
    momentum = body.momentum(jnp.asarray(spins, dtype))
    linear = body.mass[:, None] * jnp.asarray(velocity, dtype)
    return Scene(
        name="",
        title="an elastic rod that flies, bends and twists",
        body=body,
        torque=torque,
        start=CoupledState(momentum, straight.attitude, linear, straight.position),
        dt=0.01,
        duration=10.0,
        source="chosen here, not published",
        units="any consistent units",
    )


class Blades(ReadsBody):
    """Lift and drag of thin blades that rotate about the third body axis, in air at rest, averaged over a rotation.

    A piece of a blade moves at U along the plane and at W along the third axis n. Per unit of length, its lift along n
    is strength/radius * U (lift U - slope W), and its drag is strength/radius * drag U^2. U = spin r + v . (n x r^),
    where v is the velocity of the body and r^ points along the blade. The advancing blade therefore has more lift: the
    axis precesses and the path bends. Stall and wake are neglected.

    Attributes:
        strength: half the density of air times the chord, the number and the length of the blades, (), mass/length.
        radius: length of a blade, ().
        lift: coefficient of lift of a blade that moves in its plane, ().
        slope: decrease of this coefficient with W/U, (), 1/radian.
        drag: coefficient of drag, ().
    """

    strength: Float[Array, ""]
    radius: Float[Array, ""]
    lift: Float[Array, ""]
    slope: Float[Array, ""]
    drag: Float[Array, ""]

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
    """A rigid molecule.

    Attributes:
        mass: ().
        moments: principal, (3,).
        points: O, H and H in the principal frame, (3, 3).
    """

    mass: float
    moments: np.ndarray
    points: np.ndarray


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
        energies = [_of_pair(places[i], places[j], charges) for i, j in combinations(range(len(places)), 2)]
        return sum(energies[1:], start=energies[0])


def _of_pair(first: Array, second: Array, charges: Array) -> Array:
    distances = jnp.sqrt(jnp.sum((first[:, None] - second[None]) ** 2, axis=-1))
    sixth = (_SIGMA / distances[0, 0]) ** 6
    return jnp.sum(charges / distances) + 4 * _DEPTH * (sixth * sixth - sixth)
