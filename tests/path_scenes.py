"""Scenes for the laws of execution paths: one for each registered method, state, torque and heat bath."""

import inspect
from functools import partial
from typing import Any, NamedTuple

import cases
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from cases import turn
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.integrators.registry import entries
from midlie_jax.integrators.schemes import BATH, SCHEMES
from midlie_jax.model.torques.reads_body import WithBath

torques, orbits = ml.torques, ml.orbits
DT, T0, BODIES = 1 / 64, 0.3, 3


class Scene(NamedTuple):
    """One run, of one body or one set of coupled bodies, in float64."""

    method: str
    body: Any
    torque: Any  # or, if the method is random, a function of the random key
    start: Any

    @property
    def random(self) -> bool:
        return ml.method(self.method).random


def cast(tree: Any, dtype: str) -> Any:
    """The tree with its floating-point arrays in a dtype."""

    def one(x: Any) -> Any:
        is_array = isinstance(x, np.ndarray | jax.Array)
        return jnp.asarray(x, dtype) if is_array and jnp.issubdtype(x.dtype, jnp.floating) else x

    return jax.tree.map(one, tree)


def starts_of(start: Any, count: int) -> Any:
    """`count` different initial states: row 0 is `start`. Spins are rotated, other momenta are scaled."""
    turn = np.arange(count) % 7
    many = jax.tree.map(lambda x: jnp.asarray(np.broadcast_to(x, (count, *np.shape(x)))), start)
    if isinstance(start, ml.spins.SpinState):
        rotation = Rotation.from_rotvec(np.outer(0.05 * turn, [0, 1, 0])).as_matrix()
        return ml.spins.SpinState(jnp.einsum("nij,n...j->n...i", rotation, many.spin))
    factors = (1 - 0.03 * turn).reshape(count, *[1] * np.ndim(start.momentum))
    return eqx.tree_at(lambda s: s.momentum, many, many.momentum * factors)


# ---- bodies and states ----


def third_axis(attitude: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(attitude, scalar_first=True).as_matrix()[..., 2]


TURN = turn(0.5, -0.3, 0.8)
MOMENTUM = np.array([0.5, 0.4, -0.6])
AXIS = third_axis(TURN)
RIGID = ml.RigidBody([1.0, 2.0, 2.5])
TOP = ml.RigidBody([1.6, 1.6, 1.0])
LINEAR, POSITION = np.array([0.3, 0.7, -0.2]), np.array([2.1, 0.4, -0.6])
TENSOR = ml.TensorBody([[1.8, 0.2, 0.1], [0.2, 2.0, -0.1], [0.1, -0.1, 2.4]])


def _rows(count: int, of_axes: bool = False) -> tuple[Any, ...]:
    """Momenta, attitudes (or axes), linear momenta and positions of `count` bodies."""
    rng = np.random.default_rng(count)
    momentum, linear = 0.4 * rng.normal(size=(2, count, 3))
    attitude = rng.normal(size=(count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    position = rng.normal(size=(count, 3)) * 0.2 + 1.5 * np.arange(count)[:, None]
    if of_axes:
        attitude = third_axis(attitude)
        momentum = momentum + 0.5 * attitude
    return momentum, attitude, linear, position


def _coupled(count: int, of_axes: bool, travels: bool) -> tuple[Any, Any]:
    moments = np.array([1.0, 1.3, 1.5]) * np.linspace(1, 1.4, count)[:, None]
    body: Any = ml.SymmetricRotor(moments[:, 1], moments[:, 0]) if of_axes else ml.RigidBody(moments)
    kinds = {
        (False, False): ml.CoupledRigidState,
        (True, False): ml.CoupledAxisState,
        (False, True): ml.CoupledState,
        (True, True): ml.CoupledFreeAxisState,
    }
    numbers = _rows(count, of_axes)
    start = kinds[of_axes, travels](*(numbers if travels else numbers[:2]))
    return (ml.FreeBody(body, np.linspace(1.0, 1.5, count)) if travels else body), start


def spins_on(*lattice: int) -> ml.spins.SpinState:
    spin = np.random.default_rng(3).normal(size=(*lattice, 3))
    return ml.spins.SpinState(spin / np.linalg.norm(spin, axis=-1, keepdims=True))


# Name: body and start.
STATES: dict[str, tuple[Any, Any]] = {
    "rigid": (RIGID, ml.RigidState(MOMENTUM, TURN)),
    "top": (TOP, ml.RigidState(MOMENTUM, TURN)),
    "tensor": (TENSOR, ml.RigidState(MOMENTUM, TURN)),
    "momentum": (RIGID, ml.MomentumState(MOMENTUM)),
    "direction": (RIGID, ml.DirectionState(MOMENTUM, AXIS)),
    "compensated": (RIGID, ml.CompensatedState(MOMENTUM, TURN)),
    "axis": (ml.SymmetricRotor(1.6, 1.0), ml.AxisState(MOMENTUM, AXIS)),
    "free": (ml.FreeBody(RIGID, 1.5), ml.FreeState(MOMENTUM, TURN, LINEAR, POSITION)),
    "free tensor": (ml.FreeBody(TENSOR, 1.5), ml.FreeState(MOMENTUM, TURN, LINEAR, POSITION)),
    "free axis": (ml.FreeBody(ml.SymmetricRotor(1.6, 1.0), 1.5), ml.FreeAxisState(MOMENTUM, AXIS, LINEAR, POSITION)),
    "free top": (ml.FreeBody(TOP, 1.5), ml.FreeState(MOMENTUM, TURN, LINEAR, POSITION)),
    "two": _coupled(2, False, True),
    "five": _coupled(5, False, True),
    "two rigid": _coupled(2, False, False),
    "five rigid": _coupled(5, False, False),
    "two axes": _coupled(2, True, False),
    "five axes": _coupled(5, True, False),
    "two free axes": _coupled(2, True, True),
    "five free axes": _coupled(5, True, True),
    "particles": (ml.Particles([[1.0], [2.0]]), ml.ParticleState(0.3 * np.ones((2, 3)), np.eye(3)[:2])),
    "spins": (ml.spins.Spins(), spins_on(4)),
    "lattice": (ml.spins.Spins(damping=0.2, sublattices=ml.spins.checkerboard((2, 4))), spins_on(2, 4)),
}

swing = partial(cases.swing, 1.0)


def pull(t: Any, state: Any) -> Any:
    """The potential of a field that changes with time on each third axis, springs, and neighbours."""
    axes = getattr(state, "direction", getattr(state, "axis", None))
    axes = ml.so3.to_matrix(state.attitude)[..., 2] if axes is None else axes
    value = 0.4 * jnp.sum(jnp.atleast_2d(axes)[:, 2]) * jnp.cos(2 * t)
    if axes.ndim == 2:
        value = value + 0.3 * jnp.sum(jnp.sum(axes, 0) ** 2)
    return value + 0.2 * jnp.sum(state.position**2) if hasattr(state, "position") else value


def torque_for(state: str) -> Any:
    if state in ("spins", "lattice"):
        return ml.spins.Exchange(0.4) + ml.spins.AppliedField([0.1, 0.2, 0.7])
    if state == "momentum":
        return torques.Prescribed(lambda t: jnp.stack([jnp.cos(t), t, 0.3 * jnp.ones_like(t)]))
    if state == "particles":
        return lambda t, state: -(2 + jnp.sin(t)) * state.position
    if state in ("rigid", "tensor", "top", "compensated"):  # torques on arrays, in a sum
        return torques.HeavyTop(0.9, [0.48, 0.6, 0.64]) + swing
    return torques.FromPotential(pull)


# ---- torques ----

SURFACE = ml.Surface.of_facets(
    [1.0, 0.7, 0.5],
    [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, -1.0, 0.0]],
    [[0.3, 0.5, 0.0], [0.1, 0.2, 0.4], [0.2, -0.4, 0.1]],
)
KEPLER = orbits.KeplerOrbit([1.0, 0.0, 0.0], [0.0, 1.1, 0.2], 1.0)
CIRCULAR = orbits.CircularOrbit([1.0, 0.0, 0.0], [0.0, 0.6, 0.8], 1.0)
_TIMES = np.linspace(-2.0, 6.0, 81)
TABLE = orbits.TableOrbit(_TIMES, np.stack([np.cos(_TIMES), np.sin(_TIMES), 0.1 * np.sin(2 * _TIMES)], axis=-1))
PRESCRIBED = torques.Prescribed(lambda t: jnp.stack([jnp.cos(t), 0.3 * t, jnp.sin(2 * t)]))


class Quartic(ml.spins.OwnField):
    strength: jax.Array

    def axes(self):
        return (ml.flights.components.vector(jnp.array([0.0, 0.0, 1.0], self.strength.dtype)),)

    def along(self, component):
        return 4 * self.strength * component**3

    def energy(self, t, spin):
        return -self.strength * spin[2] ** 4


class Spiral(ml.spins.SpinField):
    strength: jax.Array

    def field(self, t, spin):
        return (self.strength * jnp.cos(t) + 0 * spin[0], 0 * spin[1], self.strength + 0 * spin[2])

    def energy(self, t, spin):
        return -self.strength * (jnp.cos(t) * spin[0] + spin[2])

    def is_uniform(self, t):
        return True


class Back(torques.Torque):
    stiffness: jax.Array

    def __call__(self, t, state):
        return -self.stiffness * ml.so3.log(state.attitude)


FORCES = {"box": [9.0, 9.0, 10.0], "cutoff": 4.0, "charges": [0.5, -0.3], "sigmas": [0.3, 0.4], "epsilons": [0.2, 0.1]}
PAIRS, PAIRS_ON_AXES = (
    ml.molecules.PairForces(points, **FORCES, damping=0.2)
    for points in ([[0.1, 0.0, 0.2], [0.0, -0.2, 0.1]], [[0.0, 0.0, 0.2], [0.0, 0.0, -0.1]])
)

# Name: the kind of state and the torque. The class of the torque, and those in a sum, count as covered.
TORQUES: dict[str, tuple[str, Any]] = {
    "none": ("top", None),
    "function": ("top", swing),
    "Torque": ("top", Back(jnp.array(0.8))),
    "Sum": ("top", torques.HeavyTop(0.7) + swing + PRESCRIBED),
    "HeavyTop": ("top", torques.HeavyTop(0.9)),
    "DipoleInField": ("top", torques.DipoleInField([0.4, 0.1, 0.8], lambda t: jnp.stack([jnp.cos(t), 0.3 * t, t]))),
    "FromPotential": ("top", torques.FromPotential(pull)),
    "Prescribed": ("top", PRESCRIBED),
    "Held": ("top", torques.Held(np.linspace(-0.6, 0.9, 96).reshape(32, 3), 4 * DT, t0=T0)),
    "Pulses": ("top", torques.Pulses([0.31, 0.52, 1.1], 0.05, [0.3, -0.5, 0.9])),
    "VelocityDependent": ("top", torques.VelocityDependent(lambda t, s: -0.4 * jnp.abs(s.momentum) * s.momentum)),
    "BodyTorque": ("tensor", torques.BodyTorque(lambda t, s, body: -0.4 * body.velocity(s.momentum))),
    "Damping": ("top", torques.Damping([0.2, 0.3, 0.4])),
    "PDControl, moving": (
        "top",
        ml.spacecraft.PDControl(lambda t: ml.so3.exp(jnp.array([0.3, 0.1, 0.0], t.dtype) * t), 0.9, 0.4, limit=0.3),
    ),
    "PDControl": ("top", ml.spacecraft.PDControl([0.8, 0.6, 0.0, 0.0], 0.9, 0.4)),
    "ReactionWheels": ("top", ml.spacecraft.ReactionWheels(lambda t: jnp.stack([jnp.sin(t), 0.2 * t, 0.4 * t]))),
    "MomentumWheels": ("top", ml.spacecraft.MomentumWheels([0.2, -0.4, 0.6])),
    "EddyCurrents": ("top", ml.spacecraft.EddyCurrents(0.4, [0.2, 0.5, 0.9])),
    "GravityGradient": ("top", ml.spacecraft.GravityGradient(None, CIRCULAR, 1.0)),
    "GravityGradient, Kepler": ("top", ml.spacecraft.GravityGradient(None, KEPLER, 1.0)),
    "GravityGradient, table": ("top", ml.spacecraft.GravityGradient(None, TABLE, 1.0)),
    "DipoleField": ("top", torques.DipoleInField([0.4, 0.1, 0.8], orbits.DipoleField(KEPLER, [0.1, 0.2, 0.9], 1.0))),
    "Drag": ("top", torques.Drag([0.1, 0.0, 0.4], 0.8, 1.0, [0.9, 0.3, 0.0])),
    "FreeMolecularDrag": ("top", ml.spacecraft.FreeMolecularDrag(SURFACE, 0.4, [0.9, 0.3, 0.2], wall_speed=0.3)),
    "Sunlight": ("top", ml.asteroids.Sunlight(SURFACE, [0.6, 0.0, 0.8], 2e8)),
    "UniformGravity": ("free top", torques.UniformGravity([0.1, 0.0, -0.9])),
    "PointMass": ("free top", torques.PointMass(1.2)),
    "Oblateness": ("free top", torques.PointMass(1.2) + torques.Oblateness(1.2, 0.4, 0.2)),
    "Magnus": ("free top", torques.Magnus(0.3)),
    "Thrust": ("free top", ml.spacecraft.Thrust([0.1, 0.2, 0.4], [0.3, 0.0, -0.2])),
    "Wrench": (
        "free axis",
        lambda t, s: ml.torques.Wrench(jnp.cross(s.axis, jnp.stack([t, t, 1 + t])), -0.5 * s.position),
    ),
    "MutualGravity": ("two", ml.asteroids.MutualGravity(0.5, degree=4)),
    "MutualGravity, many": ("five", ml.asteroids.MutualGravity(0.3)),
    "SolarTide": (
        "free top",
        ml.asteroids.SolarTide(ml.orbits.CircularOrbit([3.0, 0.0, 0.0], [0.0, 0.6, 0.8], 1.2), 1.2),
    ),
    "TidalDissipation": ("two", ml.asteroids.TidalDissipation(0.5, 0.05, 0.3) + ml.asteroids.MutualGravity(0.5)),
    "OnEach": ("two", torques.OnEach(torques.UniformGravity([0.1, 0.0, -0.9])) + ml.asteroids.MutualGravity(0.3)),
    "PairForces": ("five", PAIRS.listed(STATES["five"][1], skin=6.0)),
    "PairForces, axes": ("five free axes", PAIRS_ON_AXES.listed(STATES["five free axes"][1], skin=6.0)),
    "Rod": ("five", ml.molecules.Rod(1.5, [2.0, 2.0, 3.0], [0.5, 0.5, 0.4])),
    "AppliedField": ("spins", ml.spins.AppliedField([0.1, 0.2, 0.7])),
    "Exchange": ("spins", ml.spins.Exchange(0.4)),
    "DzyaloshinskiiMoriya": ("spins", ml.spins.DzyaloshinskiiMoriya([[0.1, 0.2, 0.3]])),
    "Anisotropy": ("spins", ml.spins.Anisotropy(0.4)),
    "CubicAnisotropy": ("spins", ml.spins.CubicAnisotropy(0.4)),
    "OwnField": ("spins", Quartic(jnp.array(0.3))),
    "SpinField": ("spins", Spiral(jnp.array(0.3))),
}

# ---- baths ----


def langevin(state: str, kT: Any = 0.7, friction: Any = 0.8) -> Any:
    """No torque with a heat bath on a kind of state, as a function of the random key."""
    linear = 0.5 if STATES[state][1].kind.rotation is not None else None
    return lambda key: WithBath(None, ml.baths.Langevin(kT, friction, key, linear_friction=linear))


def recoil(state: str) -> Any:
    """No torque with noise that is fixed in space."""
    linear = (lambda t: 0.3 + 0.1 * t) if STATES[state][1].kind.rotation is not None else None
    diffusion = np.diag([0.4, 0.0, 0.2]) + np.outer([0.3, 0.5, 0.2], [0.3, 0.5, 0.2])
    return lambda key: WithBath(None, ml.baths.Recoil(diffusion, key, linear))


def summed(*baths: Any) -> Any:
    """All with the same key, which do not have the same noise."""
    return lambda key: WithBath(None, ml.baths.Sum(*(bath(key).bath for bath in baths)))


def thermal(key: Any) -> Any:
    return WithBath(torque_for("lattice"), ml.spins.ThermalField(0.3, key))


def with_field(bath: Any, torque: Any) -> Any:
    return lambda key: WithBath(torque, bath(key).bath)


BATHS: dict[str, tuple[str, Any]] = {
    "free": ("rigid", langevin("rigid")),
    "field": ("rigid", with_field(langevin("rigid"), torques.HeavyTop(0.9, [0.48, 0.6, 0.64]))),
    "kT(t)": ("top", with_field(langevin("top", lambda t: 0.5 + 0.1 * t), torques.HeavyTop(0.9))),
    "friction(t)": ("top", with_field(langevin("top", friction=lambda t: 0.5 + 0.1 * t), torques.HeavyTop(0.9))),
    "tensor(t)": (
        "two",
        langevin("two", lambda t: 0.5 + 0.1 * t, lambda t: (1 + t) * jnp.diag(jnp.array([0.4, 0.6, 0.9], t.dtype))),
    ),
    "recoil": ("free", with_field(recoil("free"), torques.FromPotential(pull))),
    "recoil, axis": ("free axis", recoil("free axis")),
    "sum": ("free", summed(langevin("free"), recoil("free"))),
    "tensor": ("tensor", langevin("tensor", friction=np.diag([0.4, 0.6, 0.9]) + 0.1)),
    "compensated": ("compensated", langevin("compensated")),
    "axis": ("axis", with_field(langevin("axis"), torques.FromPotential(pull))),
    "travelling": ("free", with_field(langevin("free"), torques.FromPotential(pull))),
    "travelling axis": ("free axis", langevin("free axis")),
    "two": ("two", with_field(langevin("two"), torques.FromPotential(pull))),
    "five": ("five", with_field(langevin("five"), torques.FromPotential(pull))),
    "spins": ("lattice", thermal),
}
NOISES = ("kT(t)", "axis", "five", "spins", "recoil")
HEATED = [name for name, scheme in SCHEMES.items() if any(kind == BATH for kind, _ in scheme.stages)]
IN_TURN = {bath: HEATED[n % len(HEATED)] for n, bath in enumerate(BATHS)}


# ---- scenes ----

DEFAULT = {"particles": "Verlet", "spins": "SUBLATTICES[EA]", "lattice": "SUBLATTICES[EA]"}
OTHERS = {
    "direction": ("GBS12", "LIEMID[E1]"),
    "momentum": ("GBS12", "SW"),
    "tensor": ("LIEMID[I]",),
    "compensated": ("JACOBI[SRKN14a]", "GBS12"),
    "axis": ("GBS12",),
    "free": ("JACOBI[SRKN14a]", "RK4"),
    "free axis": ("SYMMETRIC[SRKN6b]",),
    "two": ("JACOBI[SRKN6b]",),
    "five": ("GBS12", "DLM[EA]"),
    "lattice": ("SUBLATTICES[SRKN6b]",),
}
SYMMETRIC = {"top", "free top", "axis", "free axis", "two axes", "five axes", "two free axes", "five free axes"}


def default_method(state: str, scheme: str = "EA") -> str:
    if state in DEFAULT:
        return DEFAULT[state].replace("EA", scheme)
    return f"{'SYMMETRIC' if state in SYMMETRIC else 'JACOBI'}[{scheme}]"


def _state_of(method: Any) -> str:
    bodies = getattr(method, "bodies", ml.RigidBody)
    if issubclass(bodies, ml.spins.Spins):
        return "lattice" if method.random else "spins"
    if issubclass(bodies, ml.Particles):
        return "particles"
    flight = getattr(method, "flight", None)
    return "top" if flight is not None and flight.equal_moments else "rigid"


def _plain_torque(method: Any, state: str) -> Any:
    if method.random:
        return thermal if state == "lattice" else langevin(state)
    needs_potential = "PGBS" in method.name
    return torques.HeavyTop(0.9, [0.48, 0.6, 0.64]) if needs_potential else torque_for(state)


def of_methods() -> dict[str, Scene]:
    methods = {name: (entry.method, _state_of(entry.method)) for name, entry in entries().items()}
    return {f"method {name}": _scene(name, state, _plain_torque(m, state)) for name, (m, state) in methods.items()}


def of_schemes() -> dict[str, Scene]:
    """One scene for each scheme without a registered method."""
    found = {}
    for name, scheme in SCHEMES.items():
        if name not in HEATED and not any(entry.endswith(f"[{name}]") for entry in entries()):
            torque = torques.HeavyTop(0.9, [0.48, 0.6, 0.64]) if scheme.gradients else torque_for("rigid")
            found[f"scheme {name}"] = _scene(f"JACOBI[{name}]", "rigid", torque)
    return found


def of_torques() -> dict[str, Scene]:
    return {f"torque {name}": _scene(default_method(state), state, one) for name, (state, one) in TORQUES.items()}


def of_states() -> dict[str, Scene]:
    """Each kind of state with a fast method, and with those of `OTHERS` that move it."""
    moved = [(state, method) for state in STATES for method in (default_method(state), *OTHERS.get(state, ()))]
    return {f"state {state}, {method}": _scene(method, state, torque_for(state)) for state, method in moved}


def of_baths() -> dict[str, Scene]:
    """Each bath with one scheme, other flights, and the method without momenta for some kinds of state."""
    made = [(bath, scheme, default_method(BATHS[bath][0], scheme)) for bath, scheme in IN_TURN.items()]
    made += [(bath, "BROWNIAN", "BROWNIAN") for bath in ("field", "tensor(t)", "axis", "travelling")]
    made += [("free", "DLM[BAOAB]", "DLM[BAOAB]"), ("kT(t)", "SYMMETRIC[BAOAB]", "SYMMETRIC[BAOAB]")]
    return {f"bath {bath}, {label}": _scene(method, *BATHS[bath]) for bath, label, method in made}


def _scene(method: str, state: str, torque: Any) -> Scene:
    body, start = STATES[state]
    return Scene(method, body, torque, start)


SUMMED = ("top", "free top", "spins")
LONG = {"GravityGradient, Kepler", "GravityGradient, table", "DipoleField", "FreeMolecularDrag", "Sunlight"}


def of_sums() -> dict[str, Scene]:
    """All torques on one kind of state at once, but long ones: the cheapest program that has each of them."""
    kept = [(state, one) for name, (state, one) in TORQUES.items() if name not in LONG]
    return {
        f"all torques on {kind}": _scene(
            default_method(kind), kind, torques.Sum(*(x for state, x in kept if state == kind))
        )
        for kind in SUMMED
    }


SCENES = of_sums() | of_torques() | of_states() | of_baths() | of_methods() | of_schemes()
# The cheapest scenes that have every torque (but the long ones), every public state, and baths of each kind of noise.
CHEAPEST = [
    *of_sums(),
    *(f"state {name}, {default_method(name)}" for name in ("momentum", "direction", "compensated", "particles")),
    *(f"state {name}, {default_method(name)}" for name in ("free axis", "two rigid", "five axes", "two free axes")),
    *(f"bath {bath}, {IN_TURN[bath]}" for bath in NOISES),
]
# Torques that are in no sum; each kind of state with a fast method.
ALONE = [name for name, (state, _) in TORQUES.items() if state not in SUMMED or name in LONG]
FASTEST = [f"state {state}, {default_method(state)}" for state in STATES]
# Baths and kinds of methods, for the law of steps of length zero.
STILL = [
    *(f"bath {bath}, {IN_TURN[bath]}" for bath in ("free", "kT(t)", "axis", "five", "spins", "recoil")),
    *(f"method {name}" for name in ("LIEMID[EA]", "SW")),
    *(f"bath {bath}, {scheme}" for bath, scheme in IN_TURN.items()),
    *(f"method {name}" for name in ("RK4", "GBS12")),
]


def classes_in(torque: Any) -> set[str]:
    names = {kind.__name__ for kind in type(torque).__mro__}
    for value in vars(torque).values() if isinstance(torque, torques.Torque) else ():
        for one in value if isinstance(value, tuple) else (value,):
            names |= classes_in(one)
    return names


def public_states() -> set[str]:
    named = {n: getattr(ml, n) for n in dir(ml)} | {"SpinState": ml.spins.SpinState}
    return {n for n, kind in named.items() if inspect.isclass(kind) and issubclass(kind, ml.base.State)} - {"State"}
