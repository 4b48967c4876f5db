"""Scenes: named test problems, each with a body, a torque, a start and a duration.

They are the published test cases of the package, and a few others for pictures. Each is built when needed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import described, unknown
from ..asteroids.mutual_gravity import MutualGravity
from ..integrators.registry import DEFAULT
from ..model import so3
from ..model.bodies import RigidBody, SymmetricRotor
from ..model.free_body import FreeBody
from ..model.orbits import KeplerOrbit
from ..model.states import AxisState, CoupledState, FreeState, RigidState, TravellingState
from ..model.torques import DipoleInField, HeavyTop, Oblateness, PointMass, Prescribed, TorqueLike, UniformGravity
from ..molecules.rods import straight_rod
from ..spacecraft.disturbances import GravityGradient
from .scene_forces import WATER, Blades, PairPotential, Pulse, Waters

_UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_ANY_UNITS = "any consistent units"
_Z_UP = "any consistent units; z up"
_INERTIAL = "kg, m, s; space is Earth-centred inertial"
_HERE = "chosen here, not published"
_BRICK, _BRICK_MASS = np.array([0.00189422, 0.006211019, 0.007194665]), 0.155404754  # moments and mass, slug and ft
_NESC = "NASA NESC six-degree-of-freedom check-case 2, as carried by nasa/simupy-flight"
_TURN_OF_EARTH = 7.292115e-5  # rad/s
_FOOT = 0.3048
_HAIRER_VILMART = np.array([0.6, 0.8, 1.0])  # moments
# NASA JEOD's verification case RUN_10A, kg, m and s: a satellite on a nearly circular orbit, Earth-centred inertial.
_JEOD_MU, _JEOD_MOMENTS = 3.986004415e14, (500.0, 12250.0, 12250.0)
_JEOD_POSITION, _JEOD_VELOCITY = (-4292653.41, 955168.47, 5139356.57), (109.649663, -7527.72649, 1484.521489)


@dataclass(frozen=True, eq=False)
class Scene:
    """A named test problem."""

    name: str
    title: str  # description in one line
    body: Any  # about its fixed point or its centre of mass; or several coupled bodies
    torque: TorqueLike | None  # None for a free body
    start: Any  # its state at time 0, of a kind of this package
    dt: float  # a step small enough that a picture of the motion by LIEMID[EA] shows no error
    duration: float  # a multiple of the step
    source: str  # of the numbers
    units: str  # of mass, length and time, and the space frame if it needs a definition
    # For a body given by a full tensor: the principal axes, as columns, in the frame of the tensor; None if the body
    # frame is the given frame.
    axes: Float[Array, "3 3"] | None = None
    method: str = DEFAULT  # of `midlie run`

    @property
    def steps(self) -> int:
        return round(self.duration / self.dt)

    @property
    def time_unit(self) -> str:
        units = self.units.partition(";")[0].split(",")  # mass, length, time
        return units[-1].strip() if len(units) == 3 else ""


Made = tuple[Any, ...]  # the body, the torque and the start; and the principal axes of a body given by a full tensor
_SCENES: dict[str, Callable[[], Scene]] = {}


def _named(
    name: str, title: str, times: tuple[float, float], source: str, units: str = _ANY_UNITS, method: str = DEFAULT
) -> Callable[[Callable[[], Made]], Callable[[], Made]]:
    """Registers a scene with this step and duration, from the function that makes it in the widest dtype."""

    def register(make: Callable[[], Made]) -> Callable[[], Made]:
        def made() -> Scene:
            body, torque, start, *axes = make()
            return Scene(name, title, body, torque, start, *times, source, units, *axes, method=method)

        _SCENES[name] = made
        return make

    return register


def scenes() -> list[str]:
    return list(_SCENES)


def scene(name: str, dtype: Any = None) -> Scene:
    """The scene of that name.

    Args:
        name: one of `scenes()`.
        dtype: the dtype of every array; by default float64 if it is enabled in JAX (`jax_enable_x64`), else float32.

    Raises:
        ValueError: the name is unknown (the message gives the nearest and all names); or the dtype is not floating
            point, or not enabled in JAX.
    """
    if name not in _SCENES:
        raise unknown("scene", name, _SCENES)
    widest = jnp.result_type(float)
    dtype = jnp.dtype(widest if dtype is None else dtype)
    if not jnp.issubdtype(dtype, jnp.floating):
        raise ValueError(f"dtype must be floating point, got {dtype}; use float32 or float64.")
    if dtype.itemsize > widest.itemsize:
        raise ValueError(f"dtype {dtype} is off; turn it on with jax.config.update('jax_enable_x64', True).")
    made = _SCENES[name]()
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), (made.body, made.torque, made.start, made.axes))
    return replace(made, **dict(zip(("body", "torque", "start", "axes"), arrays, strict=True)))


def perturbed(scene: Scene, count: int, size: float, seed: int = 0) -> Any:
    """Perturbed copies of the start of a scene.

    Args:
        size: standard deviation of each component of the perturbation: for a momentum relative to its norm, for the
            attitude a rotation vector in the body frame, radian, for an axis one in space, and for a position relative
            to the distance travelled per radian of rotation. Coupled bodies are perturbed separately.
        seed: the same seed gives the same copies in any dtype, and the same first copies for a larger count.

    Returns:
        The states, with leading axis `count`, as for `jax.vmap`; the first is the start itself.

    Raises:
        ValueError: `count` is not a positive int, `size` is negative or not finite, or the state is of a custom kind.
    """
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"count must be a positive Python int, got {count!r}.")
    if not np.isfinite(size) or size < 0:
        raise ValueError(f"size must be finite and not negative, got {size!r}.")
    start = scene.start
    if not type(start).__module__.startswith("midlie_jax."):
        raise ValueError(
            f"the initial state of a scene must be of a kind of midlie_jax, got {described(start)}; call "
            "midlie_jax.integrate for a custom kind."
        )
    parts = 4 if isinstance(start, TravellingState) else 2
    changes = size * np.random.default_rng(seed).standard_normal((count, parts, *start.momentum.shape))
    momentum_change, rotation, *travel = (jnp.asarray(changes[1:, i], start.momentum.dtype) for i in range(parts))
    turning = start.turning if isinstance(start, TravellingState) else start
    others: Any = _turned(turning, momentum_change, rotation)
    if isinstance(start, TravellingState):
        linear, position = travel
        push = _length(start.linear)[None] * linear
        others = start.made(
            others, start.linear[None] + push, start.position[None] + _way_of_a_radian(scene) * position
        )
    # The start is prepended instead of perturbed by zero, so the first state equals it bit for bit.
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), start, others)


def _turned(start: Any, momentum_change: Array, rotation: Array) -> Any:
    momentum = start.momentum[None] + _length(start.momentum)[None] * momentum_change
    turn = so3.exp(rotation)
    if isinstance(start, AxisState):
        axis = so3.rotate(turn, jnp.broadcast_to(start.axis, momentum.shape))
        # A momentum without a component along the axis, as for a pendulum, must keep this property.
        spin = jnp.sum(start.momentum * start.axis)
        along = jnp.sum(momentum * axis, axis=-1, keepdims=True)
        kept = jnp.where(spin == 0, momentum - along * axis, momentum)
        return AxisState(kept, axis)
    return RigidState(momentum, so3.multiply(start.attitude[None], turn))


def _way_of_a_radian(scene: Scene) -> Array:
    """The distance travelled at the start per radian of rotation; 0 without rotation; a mean over several bodies."""
    velocity = scene.start.linear / scene.body.mass[..., None]
    speed, rate = (jnp.sqrt(jnp.sum(v**2)) for v in (velocity, scene.body.velocity(scene.start.momentum)))
    return jnp.where(rate > 0, speed / jnp.where(rate > 0, rate, 1), 0)


def _length(vector: Array) -> Array:
    return jnp.sqrt(jnp.sum(vector**2, axis=-1, keepdims=True))


def _rotation(vector: tuple[float, float, float]) -> np.ndarray:
    """The unit quaternion exp(vector), in float64 even if that is not enabled in JAX."""
    angle = np.linalg.norm(vector)
    return np.append(np.cos(angle / 2), np.asarray(vector) * np.sinc(angle / (2 * np.pi)) / 2)


def _top(tilt: float, spin: float) -> Made:
    """The top of scene P1, started with a tilt (radian) and a momentum `spin` about its axis."""
    return RigidBody([5.0, 5.0, 1.0]), HeavyTop(20.0), RigidState([0.0, 0.0, spin], _rotation((tilt, 0.0, 0.0)))


_SIMO_WONG = "parameters of Simo & Wong, IJNME 31 (1991) 19, and of those who follow Krysl, IJNME 63 (2005) 2171"
_FIGURE_1 = "fast heavy top, nearly upright (Figure 1)"
_named("P1", _FIGURE_1, (0.005, 10.0), _SIMO_WONG, _Z_UP)(lambda: _top(0.05, 50.0))
_named("P1-tilted", "fast heavy top P1, tilted by .3", (0.005, 10.0), _SIMO_WONG, _Z_UP)(lambda: _top(0.3, 50.0))


@_named(
    "P2",
    "Krysl's block, a prism 60 x 60 x 240 mm spinning on the middle of one end",
    (1e-4, 0.8),
    "Krysl's block; see Krysl & Endres, IJNME 62 (2005) 2154, and Krysl, IJNME 63 (2005) 2171",
    "kg, m, s; density 2700 kg/m^3; z up",
)
def _krysl_block() -> Made:
    moments = [0.0454896, 0.0454896, 0.00139968]
    start = RigidState([0.0, 0.0, moments[2] * 313 * np.pi], _rotation((0.05, 0.0, 0.0)))
    return RigidBody(moments), HeavyTop(2.74617216), start


_named(
    "slow-top",
    "slow heavy top: too slow to spin upright, it swings down and up again",
    (0.005, 20.0),
    "P1's body; spin 10, half of the 20 that a stable upright spin needs: chosen here, not published",
    _Z_UP,
)(lambda: _top(0.05, 10.0))  # a top that spins upright is stable ("sleeps") if Pi3^2 > 4 I1 mgl = 400


@_named(
    "compass",
    "compass needle in a field: it swings about the field and spins slowly about its axis",
    (0.05, 20.0),
    "chosen here, not published: the frequency of small oscillations without spin is 2",
    _Z_UP,
)
def _compass() -> Made:
    start = RigidState([0.0, 0.0, 0.6], _rotation((0.05, 0.0, 0.0)))
    return RigidBody([1.0, 1.0, 1.2]), DipoleInField([0.0, 0.0, 4.0], [0.0, 0.0, 1.0]), start


_named(
    "tumbling-brick",
    "tumbling brick without drag, in free fall",
    (0.05, 30.0),
    _NESC,
    "slug, ft, s; space is North-East-Down over the equator at longitude and time 0, not turning",
)(lambda: (RigidBody(_BRICK), None, RigidState(_BRICK * np.deg2rad([10.0, 20.0, 30.0]), _UPRIGHT)))
_named(
    "dzhanibekov",
    "Dzhanibekov's body: it spins about its middle axis and turns over again and again",
    (0.005, 20.0),
    "moments of Hairer & Vilmart's driver; the spin is chosen here, not published",
)(lambda: (RigidBody(_HAIRER_VILMART), None, RigidState(_HAIRER_VILMART * [0.01, 10.0, 0.01], _UPRIGHT)))
_named(
    "free-asymmetric",
    "free asymmetric body",
    (0.01, 10.0),
    "driver of Hairer & Vilmart's programs, J. Phys. A 39 (2006) 13225",
)(lambda: (RigidBody(_HAIRER_VILMART), None, RigidState([1.8, 0.4, -0.9], _UPRIGHT)))


@_named(
    "asymmetric-top",
    "asymmetric heavy top with a strong torque: no symmetry and no closed form",
    (0.01, 10.0),
    _HERE,
    _Z_UP,
)
def _asymmetric_top() -> Made:
    attitude = np.array([0.8, 0.3, -0.4, 0.33])
    start = RigidState([1.1, -0.7, 4.0], attitude / np.linalg.norm(attitude))
    return RigidBody([1.0, 2.0, 3.0]), HeavyTop(3.0), start


@_named(
    "bruls-cardona",
    "heavy top of Bruls and Cardona, axis along y, spinning at 150 rad/s",
    (0.001, 2.0),
    "Bruls & Cardona, J. Comput. Nonlinear Dynam. 5 (2010) 031002; mass 15, its centre 1 from the pivot",
    "kg, m, s; z up",
)
def _bruls_cardona() -> Made:
    moments = np.array([15.234375, 0.46875, 15.234375])
    torque = HeavyTop(15 * 9.81, axis=(0.0, 1.0, 0.0))
    return RigidBody(moments), torque, RigidState(moments * [0.0, 150.0, -4.61538], _UPRIGHT)


def _jeod_start() -> tuple[np.ndarray, Any]:
    """Momentum and attitude; an attitude is the inverse of the published matrix, from body to space."""
    rates = [-1.97989570839746e-5, -0.001134281491669957, 0.0]  # body frame
    to_body = [  # from inertial to body components
        [-0.6443912270931274, 0.05284210190675609, 0.7628680480341864],
        [-0.7615617871470506, -0.1345758407161209, -0.6339660776454052],
        [0.06916350883930189, -0.9894933326514259, 0.1269620166955875],
    ]
    return np.array(_JEOD_MOMENTS) * rates, so3.from_matrix(jnp.asarray(to_body).T)


def _gravity_gradient() -> Made:
    orbit = KeplerOrbit(_JEOD_POSITION, _JEOD_VELOCITY, _JEOD_MU)
    return RigidBody(_JEOD_MOMENTS), GravityGradient(_JEOD_MOMENTS, orbit, orbit.mu), RigidState(*_jeod_start())


for _name, _title, _duration in (
    ("gravity-gradient", "satellite in the Earth's gravity gradient, on a nearly circular orbit", 28800.0),
    ("gravity-gradient-10", "the same satellite over ten orbits", 55350.0),
):
    _named(_name, _title, (10.0, _duration), "NASA JEOD, verification case RUN_10A", _INERTIAL)(_gravity_gradient)


@_named(
    "pulsed-body",
    "large body with a full inertia tensor, pushed for 1000 s",
    (10.0, 28800.0),
    "NASA JEOD, verification case RUN_9B",
    "kg, m, s; the tensor's frame, `axes` from the body frame, starts along space",
)
def _pulsed_body() -> Made:
    tensor = np.array([[1.02e8, -6.96e6, -5.48e6], [-6.96e6, 0.91e8, 5.90e5], [-5.48e6, 5.90e5, 1.64e8]])
    body, axes = RigidBody.from_tensor(tensor)
    to_principal = np.asarray(axes, np.float64).T
    # Both switches are at the end of a step.
    torque = Prescribed(Pulse(jnp.asarray(to_principal @ [10.0, 0.0, 0.0]), 1000.0, 2000.0))
    momentum = to_principal @ tensor @ [0.0, -0.001134454274550824, 0.0]
    return body, torque, RigidState(momentum, so3.from_matrix(axes)), axes


@_named(
    "thrown-brick",
    "a brick in a parabola that turns over again and again about its middle axis",
    (0.005, 2.0),
    "the brick of NASA NESC's check-case 2; the throw is chosen here, not published",
    "slug, ft, s; z up",
)
def _thrown_brick() -> Made:
    linear = _BRICK_MASS * np.array([15.0, 0.0, 32.174])
    start = FreeState(_BRICK * [0.1, 12.0, 0.1], _UPRIGHT, linear, [0.0, 0.0, 5.0])
    return FreeBody(RigidBody(_BRICK), _BRICK_MASS), UniformGravity([0.0, 0.0, -32.174]), start


@_named(
    "dropped-brick",
    "the tumbling brick dropped from 30000 ft over the turning Earth, east of the plumb line",
    (0.05, 30.0),
    f"{_NESC}; J2 of WGS-84",
    "slug, ft, s; space is North-East-Down over the equator at time 0, from the Earth's centre, not turning",
)
def _dropped_brick() -> Made:
    mu, radius, j2 = 3.986004418e14 / _FOOT**3, 6378137.0 / _FOOT, 1.08262982e-3  # of WGS-84
    earth = PointMass(mu, gradient=False) + Oblateness(mu, radius, j2, [1.0, 0.0, 0.0], gradient=False)  # as published
    height = radius + 30000
    momentum, linear = _BRICK * np.deg2rad([10.0, 20.0, 30.0]), [0.0, _BRICK_MASS * _TURN_OF_EARTH * height, 0.0]
    return FreeBody(RigidBody(_BRICK), _BRICK_MASS), earth, FreeState(momentum, _UPRIGHT, linear, [0.0, 0.0, -height])


@_named(
    "boomerang",
    "the lift of its blades turns its axis, and so it flies a circle and comes back",
    (0.001, 2.0),
    "mean over a turn of the lift and drag of its blades (after Hess, Sci. Am. 219 (1968) 124); numbers chosen here",
    "kg, m, s; z up; the throw is along x",
)
def _boomerang() -> Made:
    moments, mass, lean = np.array([1.25e-3, 1.25e-3, 2.5e-3]), 0.1, np.deg2rad(33.0)
    # The axis points to the left of the throw, along y, and leans upwards.
    attitude = _rotation((lean - np.pi / 2, 0.0, 0.0))
    blades = Blades(*map(jnp.asarray, (0.0145, 0.3, 0.8, 3.0, 0.016)))
    linear = mass * np.array([22.0, 0.0, 8.8])
    start = FreeState(moments * [0.0, 0.0, 100.0], attitude, linear, [0.0, 0.0, 1.8])
    return FreeBody(RigidBody(moments), mass), blades + UniformGravity([0.0, 0.0, -9.81]), start


@_named(
    "satellite",
    "orbit and attitude as one system: the Earth's oblateness turns the orbit",
    (10.0, 28800.0),
    "body and orbit of NASA JEOD's verification case RUN_10A, which has no oblateness; the mass is chosen here, and J2 "
    "is that of JGM-3",
    _INERTIAL,
)
def _satellite() -> Made:
    mass, mu = 1000.0, jnp.asarray(_JEOD_MU)
    start = FreeState(*_jeod_start(), mass * np.array(_JEOD_VELOCITY), _JEOD_POSITION)
    earth = PointMass(mu) + Oblateness(mu, 6378136.3, 1.0826357e-3)
    return FreeBody(RigidBody(_JEOD_MOMENTS), mass), earth, start


@_named(
    "spherical-pendulum",
    "an axis that hangs: the bob swings between two heights, and the swing turns",
    (0.01, 10.0),
    _HERE,
    "kg, m, s; z up; the axis points from the pivot to the bob",
    "SYMMETRIC[EA]",
)
def _spherical_pendulum() -> Made:
    mass, length, g = 1.0, 1.0, 9.81
    down = np.deg2rad(60.0)  # from the vertical, downwards
    push = 0.7 * np.sqrt(g / length)  # rad/s, about the vertical
    axis = np.array([np.sin(down), 0.0, -np.cos(down)])
    momentum = mass * length**2 * np.cross(axis, np.cross([0.0, 0.0, push], axis))
    return SymmetricRotor(mass * length**2), HeavyTop(mass * g * length), AxisState(momentum, axis)


@_named(
    "binary-asteroid",
    "a binary asteroid: its moon swings about the line to it, and both axes wander",
    (60.0, 172800.0),
    "like (65803) Didymos, from the example of GUBAS (Davis & Scheeres, Icarus 341 (2020) 113439), with a primary that "
    "is no sphere; to the second degree, tilted",
    "kg, m, s; the centre of mass rests at the origin",
    "JACOBI[SRKN6b]",
)
def _binary_asteroid() -> Made:
    masses = np.array([532661512390.31647, 4995532430.186578])
    primary = [3.0787835416160292e16, 3.162944060573699e16, 3.324873160340355e16]
    moments = np.array([primary, [10660065963959.85, 15001746242654.273, 16923273395857.004]])
    spins = np.array([7.72269580528e-4, 1.46420239261e-4])[:, None] * np.array([[0.05, 0.0, 1.0], [0.0, 0.05, 1.0]])
    attitudes = [_UPRIGHT, (0.9952465414778341, 0.0870727897926938, 0.0434534024273578, 0.0038016801040236755)]
    share = masses[::-1] / masses.sum() * [-1, 1]  # shares of distance and velocity from first to second
    way, velocity = np.array([1200.0, 0.0, 0.0]), np.array([0.0, 0.175704287113523, 0.0])
    start = CoupledState(moments * spins, attitudes, (masses * share)[:, None] * velocity, share[:, None] * way)
    return FreeBody(RigidBody(moments), masses), MutualGravity(6.67e-11), start


@_named(
    "dimer",
    "two waters that hang on each other by a hydrogen bond",
    (0.001, 1.0),
    "the rigid water SPC/E (Berendsen, Grigera & Straatsma, J. Phys. Chem. 91 (1987) 6269); the start is chosen here",
    "amu, nm, ps; energies in kJ/mol",
)
def _dimer() -> Made:
    start = CoupledState(
        [[-0.05, -0.1, -0.15], [0.05, 0.1, 0.15]],
        [[0.8, 0.0, 0.6, 0.0], [0.6, 0.48, 0.0, 0.64]],
        [[0.0, 2.0, 0.0], [0.0, -2.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.28, 0.0, 0.02]],
    )
    return FreeBody(RigidBody(np.tile(WATER.moments, (2, 1))), [WATER.mass] * 2), Waters(), start


@_named("rod", "an elastic rod that flies, bends and twists", (0.01, 10.0), _HERE)
def _rod() -> Made:
    elements, size = 20, 0.5
    where: Any = [0.0, 0.0, 0.0], [0.0, 0.6, 0.8], [1.0, 0.0, 0.0]
    sizes: Any = {"length": 2.0, "radius": 0.1, "density": 5.0, "youngs_modulus": 10.0, "shear_modulus": 4.0}
    body, torque, straight = straight_rod(elements, *where, **sizes)
    along = np.linspace(-1.0, 1.0, elements + 1)[:, None]
    momentum = body.momentum(jnp.asarray(size * np.array([0.4, -0.3, 2.0]) * (along + 0.2)))
    linear = body.mass[:, None] * jnp.asarray(size * np.array([0.5, 0.1, -0.2]) * (1 + along**2))
    return body, torque, CoupledState(momentum, straight.attitude, linear, straight.position)


@_named(
    "drift-test",
    "drift test: between a ring and a well, where methods that are not symplectic drift",
    (0.25, 1e4),
    "Bou-Rabee, Ortolan & Saccon, arXiv 1005.3078",
)
def _drift_test() -> Made:
    start = RigidState([0.0, 0.0, 4 * 0.625], _rotation((0.0, 0.7227, 0.0)))
    return RigidBody([2.0, 2.0, 4.0]), PairPotential(), start
