"""Calls for the law of units: every torque, orbit, density, observable and function, with dimensions."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from cases import turn

import midlie_jax as ml
from midlie_jax.model import densities, orbits, torques

# Exponents of length, mass and time.
NUMBER, LENGTH, MASS, TIME, RATE = (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1)
SPEED, ACCELERATION, MU, AREA = (1, 0, -1), (1, 0, -2), (3, 0, -2), (2, 0, 0)
INERTIA, MOMENTUM, PUSH, FORCE, ENERGY = (2, 1, 0), (2, 1, -1), (1, 1, -1), (1, 1, -2), (2, 1, -2)
DENSITY, FRICTION, CURVATURE = (-3, 1, 0), (2, 1, -1), (-1, 0, 0)

ROOM = 10  # powers of two between numbers that are asked for and the ends of the range


class Units:
    """Numbers in the dtype and in units scaled by powers of two; `held` is False if the dtype does not hold one."""

    def __init__(self, dtype: str, powers: tuple[int, int, int] = (0, 0, 0)):
        self.dtype, self.powers, self.held = dtype, powers, True

    def scaled(self, value: Any, dimension: tuple[int, int, int]) -> tuple[np.ndarray, bool]:
        """Numbers in these units, and whether the largest is a normal number of the dtype, with some room."""
        power, value = int(np.dot(dimension, self.powers)), np.asarray(value, np.float64)
        largest, limits = np.max(np.abs(value), initial=0.0), np.finfo(self.dtype)
        held = largest == 0 or limits.minexp + ROOM < np.log2(largest) + power < limits.maxexp - ROOM
        with np.errstate(over="ignore", under="ignore"):
            return np.ldexp(value, power), bool(held)

    def __call__(self, value: Any, dimension: tuple[int, int, int] = NUMBER) -> np.ndarray:
        exact, held = self.scaled(value, dimension)
        self.held = self.held and held
        with np.errstate(over="ignore", under="ignore"):
            return exact.astype(self.dtype)


class Case(NamedTuple):
    """A call: `build(units)` makes the arguments of `call`, and `found` has the dimensions of its results."""

    build: Callable[[Units], tuple[Any, ...]]
    call: Callable[..., Any]
    found: Any


# ---- the numbers of all cases ----

UP = turn(0.5, -0.3, 0.8)
VECTOR, OTHER = [0.3, -0.5, 0.4], [0.7, 0.2, -0.6]
UNIT = [0.48, -0.6, 0.64]
FACETS = [0.5, 0.7], [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]], [[0.1, 0.5, 0.2], [0.3, -0.2, 0.4]]


def rigid(u: Units) -> Any:
    return ml.RigidBody(u([1.0, 2.0, 2.5], INERTIA))


def free(u: Units) -> Any:
    return ml.FreeBody(rigid(u), u(3.0, MASS))


def turning(u: Units) -> Any:
    return ml.RigidState(u([1.0, 0.8, -1.3], MOMENTUM), u(UP))


def travelling(u: Units) -> Any:
    return ml.FreeState(u([1.0, 0.8, -1.3], MOMENTUM), u(UP), u([2.0, -1.0, 0.5], PUSH), u([3.0, -7.0, 2.0], LENGTH))


def pair(u: Units) -> Any:
    body = ml.FreeBody(ml.RigidBody(u([[1.0, 2.0, 2.5], [0.6, 0.7, 0.8]], INERTIA)), u([3.0, 1.0], MASS))
    rows = u([[1.0, 0.8, -1.3], OTHER], MOMENTUM), u([UP, [1.0, 0.0, 0.0, 0.0]]), u([VECTOR, OTHER], PUSH)
    return body, ml.CoupledState(*rows, u([[3.0, -7.0, 2.0], [0.0, 1.0, 0.0]], LENGTH))


def pair_forces(u: Units) -> Any:
    """Lennard-Jones and Coulomb forces on the molecules of `pair`, which are near each other through the walls."""
    forces = ml.molecules.PairForces(
        u([[0.1, 0.0, 0.2]], LENGTH),
        box=u([8.0, 9.0, 10.0], LENGTH),
        cutoff=float(u(4.0, LENGTH)),
        charges=[0.5],
        sigmas=u([2.0], LENGTH),
        epsilons=u([0.2], ENERGY),
        damping=float(u(0.2, CURVATURE)),
        coulomb=float(u(1.5, (3, 1, -2))),
    )
    return forces.listed(pair(u)[1], skin=float(u(0.5, LENGTH)))


def chain(u: Units) -> Any:
    return ml.spins.Spins(), ml.spins.SpinState(u([[0.0, 0.6, 0.8], [0.0, -0.8, 0.6], [1.0, 0.0, 0.0]]))


def surface(u: Units) -> Any:
    areas, normals, centroids = FACETS
    return ml.Surface.of_facets(u(areas, AREA), u(normals), u(centroids, LENGTH))


def round_orbit(u: Units) -> Any:
    return orbits.CircularOrbit(u([3.0, -7.0, 2.0], LENGTH), u(VECTOR, SPEED), u(20.0, MU))


def ellipse(u: Units) -> Any:
    return orbits.KeplerOrbit(u([3.0, -7.0, 2.0], LENGTH), u([1.0, 1.2, 0.3], SPEED), u(20.0, MU), u(0.25, TIME))


def table(u: Units) -> Any:
    times = np.array([-1.0, 0.0, 1.0, 2.5, 3.0, 4.0])
    places = np.stack([3 * np.cos(times / 2), 3 * np.sin(times / 2), 0.1 * times], axis=-1)
    return orbits.TableOrbit(u(times, TIME), u(places, LENGTH))


# ---- torques ----


def alone(u: Units) -> Any:
    return rigid(u), turning(u)


def moving(u: Units) -> Any:
    return free(u), travelling(u)


WRENCH = "wrench"
TORQUE = FIELD = ENERGY  # of spins, which have no dimension here


def on(make: Callable[[Units], Any], scene: Callable[[Units], Any] = alone) -> Case:
    """A torque on the body and the state of a scene, at a time."""
    found = WRENCH if scene in (moving, pair) else TORQUE
    return Case(
        lambda u: (make(u), *scene(u), u(0.75, TIME)),
        lambda torque, body, state, t: torques.on_body(torque, body)(t, state),
        found,
    )


TORQUES = {
    "HeavyTop": on(lambda u: torques.HeavyTop(u(2.0, TORQUE), (0.48, -0.6, 0.64))),
    "DipoleInField": on(lambda u: torques.DipoleInField(u(VECTOR, TORQUE), u(OTHER))),
    "GravityGradient": on(lambda u: ml.spacecraft.GravityGradient(None, round_orbit(u), u(20.0, MU))),
    "GravityGradient on an ellipse": on(lambda u: ml.spacecraft.GravityGradient(None, ellipse(u), u(20.0, MU))),
    "EddyCurrents": on(lambda u: ml.spacecraft.EddyCurrents(u([0.5, 0.3, 0.2], FRICTION), u(VECTOR))),
    "Held": on(lambda u: torques.Held(u([VECTOR, (0.4, 0.1, -0.7)], TORQUE), u(8.0, TIME), u(-8.0, TIME))),
    "Pulses": on(lambda u: torques.Pulses(u([-4.0], TIME), u(8.0, TIME), u(VECTOR, TORQUE))),
    "Damping": on(lambda u: torques.Damping(u(0.5, FRICTION))),
    "PDControl": on(lambda u: ml.spacecraft.PDControl(u([1.0, 0, 0, 0]), u(2.0, TORQUE), u(0.5, FRICTION))),
    "MomentumWheels": on(lambda u: ml.spacecraft.MomentumWheels(u(VECTOR, MOMENTUM))),
    "ReactionWheels": on(
        lambda u: ml.spacecraft.ReactionWheels(jax.tree_util.Partial(_wheels, u(VECTOR, MOMENTUM), u(2.0, TIME)))
    ),
    "Drag": on(lambda u: torques.Drag(u(VECTOR, LENGTH), u(2.0, AREA), u(0.1, DENSITY), u(OTHER, SPEED))),
    "Drag of a free body": on(lambda u: torques.Drag(u(VECTOR, LENGTH), u(2.0, AREA), u(0.1, DENSITY)), moving),
    "Sunlight": on(
        lambda u: ml.asteroids.Sunlight(
            surface(u), u(UNIT), u(5.0, (0, 1, -3)), 0.3, 0.2, 0.5, speed_of_light=u(2.0, SPEED)
        ),
        moving,
    ),
    "FreeMolecularDrag": on(
        lambda u: ml.spacecraft.FreeMolecularDrag(
            surface(u), u(0.1, DENSITY), u(OTHER, SPEED), wall_speed=u(0.2, SPEED), thermal_speed=u(0.6, SPEED)
        )
    ),
    "UniformGravity": on(lambda u: torques.UniformGravity(u(VECTOR, ACCELERATION)), moving),
    "PointMass": on(lambda u: torques.PointMass(u(20.0, MU)), moving),
    "Oblateness": on(lambda u: torques.Oblateness(u(20.0, MU), u(2.0, LENGTH), 0.1, u(UNIT)), moving),
    "Magnus": on(lambda u: torques.Magnus(u(0.2, MASS), u(VECTOR, SPEED)), moving),
    "Thrust": on(lambda u: ml.spacecraft.Thrust(u(VECTOR, FORCE), u(OTHER, LENGTH)), moving),
    "MutualGravity": on(lambda u: ml.asteroids.MutualGravity(u(2.0, (3, -1, -2)), degree=4), pair),
    "SolarTide": on(lambda u: ml.asteroids.SolarTide(round_orbit(u), u(20.0, MU)), moving),
    "TidalDissipation": on(
        lambda u: ml.asteroids.TidalDissipation(u(2.0, (3, -1, -2)), u(0.3, TIME), u(1.0, LENGTH)), pair
    ),
    "OnEach": on(lambda u: torques.OnEach(torques.PointMass(u(20.0, MU))), pair),
    "PairForces": on(pair_forces, pair),
    "Rod": on(
        lambda u: ml.molecules.Rod(u(6.0, LENGTH), u([2.0, 2.0, 5.0], FORCE), u([1.0, 1.0, 0.7], (3, 1, -2))), pair
    ),
    "AppliedField": on(lambda u: ml.spins.AppliedField(u(VECTOR, FIELD)), chain),
    "Exchange": on(lambda u: ml.spins.Exchange(u(1.5, FIELD)), chain),
    "DzyaloshinskiiMoriya": on(lambda u: ml.spins.DzyaloshinskiiMoriya(u([VECTOR], FIELD)), chain),
    "Anisotropy": on(lambda u: ml.spins.Anisotropy(u(0.7, FIELD), u(UNIT)), chain),
    "CubicAnisotropy": on(lambda u: ml.spins.CubicAnisotropy(u(0.7, FIELD)), chain),
    "Sum": on(lambda u: torques.HeavyTop(u(2.0, TORQUE)) + torques.Damping(u(0.5, FRICTION))),
}


def _wheels(momentum: Any, time: Any, t: Any) -> Any:
    return momentum * (1 + t / time)


def dimensions(case: Case, count: int) -> list[Any]:
    if case.found == WRENCH:
        return [TORQUE, FORCE]

    def one(x: Any) -> bool:
        return x is None or (isinstance(x, tuple) and len(x) == 3 and all(isinstance(power, int) for power in x))

    leaves = jax.tree.leaves(case.found, is_leaf=one)
    return leaves * count if len(leaves) == 1 else leaves


# ---- orbits, densities, functions of bodies and states ----


def at(make: Callable[[Units], Any], found: Any = NUMBER) -> Case:
    return Case(lambda u: (make(u), u(0.75, TIME)), lambda orbit, t: orbit(t), found)


def seen(make: Callable[[Units], Any], found: Any = NUMBER) -> Case:
    return Case(lambda u: (make(u), turning(u), u(0.75, TIME)), lambda f, state, t: f(t, state), found)


def of(call: Callable[..., Any], found: Any, *numbers: Any, after: Callable[[Units], tuple[Any, ...]] | None = None):
    """A function of what a scene makes, and of numbers, each with its dimension."""
    return Case(lambda u: (*(after(u) if after else ()), *(u(*x) for x in numbers)), call, found)


def elements(u: Units, eccentricity: float, **size_and_place: Any) -> Any:
    angles = {"inclination": 0.9, "ascending_node": 0.4, "argument_of_periapsis": 1.3}
    return orbits.KeplerOrbit.from_elements(mu=u(20.0, MU), eccentricity=u(eccentricity), **angles, **size_and_place)


ORBITS = {
    "CircularOrbit": at(round_orbit, LENGTH),
    "KeplerOrbit": at(ellipse, LENGTH),
    "KeplerOrbit of a hyperbola": at(
        lambda u: elements(u, 2.0, periapsis=u(3.0, LENGTH), time_of_periapsis=u(0.1, TIME)), LENGTH
    ),
    "KeplerOrbit of a mean anomaly": at(
        lambda u: elements(u, 0.3, semi_major_axis=u(3.0, LENGTH), mean_anomaly=u(0.3), epoch=u(0.5, TIME)), LENGTH
    ),
    "TableOrbit": at(table, LENGTH),
    "TableField": at(lambda u: orbits.TableField(table(u).times, u(np.cos(np.arange(18.0).reshape(6, 3))))),
    "DipoleField": at(lambda u: orbits.DipoleField(ellipse(u), u(VECTOR, LENGTH), u(2.0, AREA), u(0.5, RATE))),
}
DENSITIES = {
    "OrbitalDistance": seen(lambda u: densities.OrbitalDistance(ellipse(u), u(5.0, LENGTH))),
    "TorqueSize": seen(
        lambda u: densities.TorqueSize(torques.HeavyTop(u(2.0, TORQUE)), u(2.0, TORQUE), u(0.5, TORQUE))
    ),
    "Spin": seen(lambda u: densities.Spin(u([1.0, 2.0, 2.5], INERTIA), u(2.0, RATE), u(0.1, RATE))),
}


def box_light(u: Units) -> Any:
    law = ml.asteroids.LommelSeeliger(0.1)
    return ml.asteroids.Brightness(surface(u), u([0.8, 0, 0.6]), u([0.0, 0.6, 0.8]), law)


def observed(observable: Any) -> Callable[..., Any]:
    return lambda torque, body, state, t: ml.observe.as_observable("observe", observable).of(t, state, body, torque)


def scene(u: Units) -> tuple[Any, ...]:
    return torques.PointMass(u(20.0, MU)), free(u), travelling(u), u(0.75, TIME)


def flying(u: Units) -> tuple[Any, ...]:
    return (travelling(u),)


def solid(vertices: Any, density: Any) -> Any:
    made = ml.Surface(vertices, FACES).centred()
    body = made.body(density)
    return made.areas, made.normals, made.volume, made.centre_of_mass, made.mass(density), body.principal.moments


def tumbling(moments: Any, slow: Any, fast: Any) -> Any:
    how = {"precession_period": slow, "rotation_period": fast, "axis": "short", "phases": (0.1, 0.2), "mode": "short"}
    return ml.asteroids.tumbling(ml.RigidBody(moments), pole=jnp.array([0, 0.6, 0.8], slow.dtype), **how)


def joined(moments: Any, mass: Any, place: Any) -> Any:
    body, centre = ml.FreeBody.joined([(ml.RigidBody(moments), mass, place), (None, 2 * mass, -place)])
    assert isinstance(body.body, ml.TensorBody)
    return body.body.tensor, body.mass, centre


def driven(body: Any, state: Any, dt: Any, momenta: Any, motor: Any, friction: Any, inertia: Any) -> Any:
    axes = jnp.asarray([[0, 0, 1], [1, 0, 0]], dt.dtype)
    wheels = ml.spacecraft.DrivenWheels(axes, motor, 1.2 * momenta[0], friction, inertia)
    free = ml.stepper("JACOBI[EA]", body, None, state, dt=dt)
    carry, momenta = wheels.advance(free, free.init(), momenta, jnp.stack([2 * motor, -motor]), 4)
    return free.state(carry), momenta


def rod(length: Any, radius: Any, density: Any, modulus: Any) -> Any:
    axes = (jnp.zeros(3, length.dtype), jnp.array([0, 0, 1], length.dtype), jnp.array([1, 0, 0], length.dtype))
    made = ml.molecules.straight_rod(3, *axes, length=length, radius=radius, density=density, youngs_modulus=modulus)
    return tuple(made)


TUMBLE = (None, NUMBER, TIME, TIME, TIME, RATE, MOMENTUM, NUMBER, (NUMBER, NUMBER))
VERTICES = [[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 2.0]]
FACES = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
SIDES, FULL = ([3.0, 2.0, 1.0], LENGTH), [[3.0, 0.5, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 4.0]]
POINTS = VERTICES, LENGTH
ROD = (INERTIA, MASS), (LENGTH, FORCE, (3, 1, -2)), (MOMENTUM, NUMBER, PUSH, LENGTH)
WHEELS = (0.25, TIME), ([0.4, -0.2], MOMENTUM), (0.5, TORQUE), (0.1, FRICTION), (0.2, INERTIA)
OF_SOLID = AREA, NUMBER, (3, 0, 0), LENGTH, MASS, INERTIA
THREE = ([2.0, 1.0, 1.5], INERTIA)
FUNCTIONS = {
    "kinetic_energy": of(ml.observe.kinetic_energy, ENERGY, after=moving),
    "energy": of(lambda torque, body, state, t: ml.observe.energy(body, torque, state, t), ENERGY, after=scene),
    "angular_velocity": of(ml.observe.angular_velocity, RATE, after=alone),
    "spatial_angular_velocity": of(ml.observe.spatial_angular_velocity, RATE, after=alone),
    "spatial_momentum": of(ml.observe.spatial_momentum, MOMENTUM, after=flying),
    "linear_momentum": of(ml.observe.linear_momentum, PUSH, after=flying),
    "velocity": of(ml.observe.linear_velocity, SPEED, after=moving),
    "tumble": of(lambda body, state: tuple(ml.asteroids.tumble(body, state)), TUMBLE, after=alone),
    "tumbling": of(tumbling, (MOMENTUM, NUMBER), ([1.0, 2.0, 2.5], INERTIA), (3.9, TIME), (12.0, TIME)),
    "free_motion": of(
        lambda *given: ml.free_motion(*given).states, (MOMENTUM, NUMBER), ([0.0, 0.5, -2.0], TIME), after=alone
    ),
    "TensorBody": of(lambda tensor: ml.TensorBody(tensor), (INERTIA, None), (FULL, INERTIA)),
    "Particles": of(lambda m, p: ml.Particles(m).velocity(p), SPEED, (FULL, MASS), (VECTOR, PUSH)),
    "SymmetricRotor": of(lambda i, p: ml.SymmetricRotor(i).velocity(p), RATE, (2.0, INERTIA), (VECTOR, MOMENTUM)),
    "Surface": of(solid, OF_SOLID, POINTS, (0.5, DENSITY)),
    "Surface.ellipsoid": of(lambda axes: ml.Surface.ellipsoid(axes, 20).areas, AREA, SIDES),
    "Surface.box": of(lambda sides: ml.Surface.box(sides).areas, AREA, SIDES),
    "from_points": of(ml.molecules.from_points, ((INERTIA, MASS), LENGTH), ([2.0, 1.0, 1.5, 0.5], MASS), POINTS),
    "joined": of(joined, (INERTIA, MASS, LENGTH), THREE, (2.0, MASS), ([1.0, -0.5, 2.0], LENGTH)),
    "sites": of(ml.molecules.sites, LENGTH, POINTS, after=flying),
    "wrench_on_sites": of(ml.molecules.wrench_on_sites, (TORQUE, FORCE), POINTS, (VERTICES, FORCE), after=flying),
    "straight_rod": of(rod, ROD, (6.0, LENGTH), (0.5, LENGTH), (3.0, DENSITY), (2.0, (-1, 1, -2))),
    "DrivenWheels": of(driven, ((MOMENTUM, NUMBER), MOMENTUM), *WHEELS, after=alone),
    "EllipsoidBrightness": seen(
        lambda u: ml.asteroids.EllipsoidBrightness(u(*SIDES), u([1.0, 0, 0]), u([0.0, 1, 0])), AREA
    ),
    "Brightness": seen(box_light, AREA),
    "Pressure": of(
        observed(ml.molecules.Pressure()), (-1, 1, -2), after=lambda u: (pair_forces(u), *pair(u), u(0.75, TIME))
    ),
    "EulerAngles in a run": of(observed(ml.observe.EulerAngles("ZXZ")), NUMBER, after=scene),
    "position in a run": of(observed(ml.observe.position), LENGTH, after=scene),
    "linear_velocity in a run": of(observed(ml.observe.linear_velocity), SPEED, after=scene),
}
CASES = ORBITS | TORQUES | DENSITIES | FUNCTIONS
