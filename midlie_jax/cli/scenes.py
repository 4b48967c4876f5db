"""Scenes: named test problems, each with a body, a torque, a start and a duration.

They are the published test cases of the package, and a few others for pictures. Each scene is built in the requested
dtype when needed, not on import.
"""

from collections.abc import Callable
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from ..model import so3
from ..model.bodies import RigidBody
from ..model.orbits import KeplerOrbit
from ..model.state import Time
from ..model.states import RigidState
from ..model.torques import DipoleInField, FromPotential, HeavyTop, Prescribed, Torque
from ..spacecraft.gravity_gradient import GravityGradient
from . import moving_scenes
from .moving_scenes import JEOD
from .scene import Scene as Scene
from .scene import perturbed as perturbed

_WELL = (np.cos(1.25), np.sin(1.25) / np.sqrt(2.0), 0.0, np.sin(1.25) / np.sqrt(2.0))  # exp(2.5 (1, 0, 1) / sqrt(2))


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

    Attributes:
        torque: the torque between the switches, (3,), body frame.
        on, off: times of the switches, on < off.
    """

    torque: Float[Array, "3"]
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


Maker = Callable[[Any], Scene]  # builds a scene in a dtype
_SCENES: dict[str, Maker] = {}


def _named(name: str) -> Callable[[Maker], Maker]:
    """Decorator that registers the builder of a scene by the name of the scene."""

    def register(make: Maker) -> Maker:
        _SCENES[name] = make
        return make

    return register


def scenes() -> list[str]:
    """The names of all scenes."""
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
        lower = {known.lower(): known for known in _SCENES}
        close = get_close_matches(name.lower(), lower, n=1)
        hint = f" Did you mean {lower[close[0]]!r}?" if close else ""
        raise ValueError(f"unknown scene {name!r}; choose from {', '.join(_SCENES)}.{hint}")
    widest = jnp.result_type(float)
    dtype = jnp.dtype(widest if dtype is None else dtype)
    if not jnp.issubdtype(dtype, jnp.floating):
        raise ValueError(f"dtype must be floating point, got {dtype}; use float32 or float64.")
    if dtype.itemsize > widest.itemsize:
        raise ValueError(f"dtype {dtype} is off; turn it on with jax.config.update('jax_enable_x64', True).")
    return replace(_SCENES[name](dtype), name=name)


def _rotation(vector: tuple[float, float, float]) -> np.ndarray:
    """The unit quaternion exp(vector), in float64 even if that is not enabled in JAX."""
    angle = np.linalg.norm(vector)
    return np.append(np.cos(angle / 2), np.asarray(vector) * np.sinc(angle / (2 * np.pi)) / 2)


def _start(momentum: Any, attitude: Any, dtype: Any) -> RigidState:
    return RigidState(momentum=jnp.asarray(momentum, dtype), attitude=jnp.asarray(attitude, dtype))


def _body(moments: Any, dtype: Any) -> RigidBody:
    return RigidBody(jnp.asarray(moments, dtype))


_UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_ANY_UNITS = "any consistent units; z up"
_SIMO_WONG = "parameters of Simo & Wong, IJNME 31 (1991) 19, and of those who follow Krysl, IJNME 63 (2005) 2171"


def _p1(title: str, tilt: float, spin: float, duration: float, source: str, dtype: Any) -> Scene:
    """The top of scene P1, started with a tilt (radian) and a momentum `spin` about its axis."""
    return Scene(
        name="",
        title=title,
        body=_body([5.0, 5.0, 1.0], dtype),
        torque=HeavyTop(jnp.asarray(20.0, dtype)),
        start=_start([0.0, 0.0, spin], _rotation((tilt, 0.0, 0.0)), dtype),
        dt=0.005,
        duration=duration,
        source=source,
        units=_ANY_UNITS,
    )


@_named("P1")
def _fast_top(dtype: Any) -> Scene:
    return _p1("fast heavy top, nearly upright (Figure 1)", 0.05, 50.0, 10.0, _SIMO_WONG, dtype)


@_named("P1-tilted")
def _tilted_top(dtype: Any) -> Scene:
    return _p1("fast heavy top P1, tilted by .3", 0.3, 50.0, 10.0, _SIMO_WONG, dtype)


@_named("P2")
def _krysl_block(dtype: Any) -> Scene:
    moments = np.array([0.0454896, 0.0454896, 0.00139968])
    return Scene(
        name="",
        title="Krysl's block, a prism 60 x 60 x 240 mm spinning on the middle of one end",
        body=_body(moments, dtype),
        torque=HeavyTop(jnp.asarray(2.74617216, dtype)),
        start=_start([0.0, 0.0, moments[2] * 313 * np.pi], _rotation((0.05, 0.0, 0.0)), dtype),
        dt=1e-4,
        duration=0.8,
        source="Krysl's block; see Krysl & Endres, IJNME 62 (2005) 2154, and Krysl, IJNME 63 (2005) 2171",
        units="kg, m, s; density 2700 kg/m^3; z up",
    )


@_named("slow-top")
def _slow_top(dtype: Any) -> Scene:
    # A top that spins upright is stable ("sleeps") if Pi3^2 > 4 I1 mgl = 400.
    source = "P1's body; spin 10, half of the 20 that a stable upright spin needs: chosen here, not published"
    return _p1("slow heavy top: too slow to spin upright, it swings down and up again", 0.05, 10.0, 20.0, source, dtype)


@_named("compass")
def _compass(dtype: Any) -> Scene:
    return Scene(
        name="",
        title="compass needle in a field: it swings about the field and spins slowly about its axis",
        body=_body([1.0, 1.0, 1.2], dtype),
        torque=DipoleInField(jnp.asarray([0.0, 0.0, 4.0], dtype), jnp.asarray([0.0, 0.0, 1.0], dtype)),
        start=_start([0.0, 0.0, 0.6], _rotation((0.05, 0.0, 0.0)), dtype),
        dt=0.05,
        duration=20.0,
        source="chosen here, not published: the frequency of small oscillations without spin is 2",
        units=_ANY_UNITS,
    )


@_named("tumbling-brick")
def _tumbling_brick(dtype: Any) -> Scene:
    moments = np.array([0.00189422, 0.006211019, 0.007194665])
    return Scene(
        name="",
        title="tumbling brick without drag, in free fall",
        body=_body(moments, dtype),
        torque=None,
        start=_start(moments * np.deg2rad([10.0, 20.0, 30.0]), _UPRIGHT, dtype),
        dt=0.05,
        duration=30.0,
        source="NASA NESC six-degree-of-freedom check-case 2, as carried by nasa/simupy-flight",
        units="slug, ft, s; space is North-East-Down over the equator at longitude and time 0, not turning",
    )


@_named("dzhanibekov")
def _dzhanibekov(dtype: Any) -> Scene:
    moments = np.array([0.6, 0.8, 1.0])
    return Scene(
        name="",
        title="Dzhanibekov's body: it spins about its middle axis and turns over again and again",
        body=_body(moments, dtype),
        torque=None,
        start=_start(moments * np.array([0.01, 10.0, 0.01]), _UPRIGHT, dtype),
        dt=0.005,
        duration=20.0,
        source="moments of Hairer & Vilmart's driver; the spin is chosen here, not published",
        units="any consistent units",
    )


@_named("free-asymmetric")
def _free_asymmetric(dtype: Any) -> Scene:
    return Scene(
        name="",
        title="free asymmetric body",
        body=_body([0.6, 0.8, 1.0], dtype),
        torque=None,
        start=_start([1.8, 0.4, -0.9], _UPRIGHT, dtype),
        dt=0.01,
        duration=10.0,
        source="driver of Hairer & Vilmart's programs, J. Phys. A 39 (2006) 13225",
        units="any consistent units",
    )


@_named("asymmetric-top")
def _asymmetric_top(dtype: Any) -> Scene:
    attitude = np.array([0.8, 0.3, -0.4, 0.33])
    return Scene(
        name="",
        title="asymmetric heavy top with a strong torque: no symmetry and no closed form",
        body=_body([1.0, 2.0, 3.0], dtype),
        torque=HeavyTop(jnp.asarray(3.0, dtype)),
        start=_start([1.1, -0.7, 4.0], attitude / np.linalg.norm(attitude), dtype),
        dt=0.01,
        duration=10.0,
        source="chosen here, not published",
        units=_ANY_UNITS,
    )


@_named("bruls-cardona")
def _bruls_cardona(dtype: Any) -> Scene:
    moments = np.array([15.234375, 0.46875, 15.234375])
    return Scene(
        name="",
        title="heavy top of Bruls and Cardona, axis along y, spinning at 150 rad/s",
        body=_body(moments, dtype),
        torque=HeavyTop(jnp.asarray(15 * 9.81, dtype), axis=(0.0, 1.0, 0.0)),
        start=_start(moments * np.array([0.0, 150.0, -4.61538]), _UPRIGHT, dtype),
        dt=0.001,
        duration=2.0,
        source="Bruls & Cardona, J. Comput. Nonlinear Dynam. 5 (2010) 031002; mass 15, its centre 1 from the pivot",
        units="kg, m, s; z up",
    )


@_named("gravity-gradient")
def _gravity_gradient(dtype: Any) -> Scene:
    orbit = KeplerOrbit(*(jnp.asarray(x, dtype) for x in (JEOD.position, JEOD.velocity, JEOD.mu)))
    moments = jnp.asarray(JEOD.moments, dtype)
    return Scene(
        name="",
        title="satellite in the Earth's gravity gradient, on a nearly circular orbit",
        body=_body(moments, dtype),
        torque=GravityGradient(moments, orbit, orbit.mu),
        # The source gives the matrix from inertial to body components; an attitude is its inverse, from body to space.
        start=RigidState(
            momentum=jnp.asarray(np.array(JEOD.moments) * np.array(JEOD.rates), dtype),
            attitude=so3.from_matrix(jnp.asarray(JEOD.to_body, dtype).T),
        ),
        dt=10.0,
        duration=28800.0,
        source="NASA JEOD, verification case RUN_10A",
        units="kg, m, s; space is Earth-centred inertial",
    )


@_named("gravity-gradient-10")
def _ten_orbits(dtype: Any) -> Scene:
    return replace(
        _gravity_gradient(dtype),
        title="the same satellite over ten orbits",
        duration=55350.0,
    )


@_named("pulsed-body")
def _pulsed_body(dtype: Any) -> Scene:
    tensor = [[1.02e8, -6.96e6, -5.48e6], [-6.96e6, 0.91e8, 5.90e5], [-5.48e6, 5.90e5, 1.64e8]]
    velocity = [0.0, -0.001134454274550824, 0.0]
    body, axes = RigidBody.from_tensor(jnp.asarray(tensor, dtype))
    to_principal = np.asarray(axes, np.float64).T
    return Scene(
        name="",
        title="large body with a full inertia tensor, pushed for 1000 s",
        body=body,
        torque=Prescribed(Pulse(jnp.asarray(to_principal @ np.array([10.0, 0.0, 0.0]), dtype), 1000.0, 2000.0)),
        start=_start(to_principal @ np.array(tensor) @ np.array(velocity), so3.from_matrix(axes), dtype),
        # Both switches are at the end of a step.
        dt=10.0,
        duration=28800.0,
        source="NASA JEOD, verification case RUN_9B",
        units="kg, m, s; the tensor's frame, `axes` from the body frame, starts along space",
        axes=axes,
    )


for _name in (
    "thrown-brick",
    "dropped-brick",
    "boomerang",
    "satellite",
    "spherical-pendulum",
    "binary-asteroid",
    "dimer",
    "rod",
):
    _SCENES[_name] = getattr(moving_scenes, _name.replace("-", "_"))


@_named("drift-test")
def _drift_test(dtype: Any) -> Scene:
    return Scene(
        name="",
        title="drift test: between a ring and a well, where methods that are not symplectic drift",
        body=_body([2.0, 2.0, 4.0], dtype),
        torque=PairPotential(),
        start=_start([0.0, 0.0, 4 * 0.625], _rotation((0.0, 0.7227, 0.0)), dtype),
        dt=0.25,
        duration=1e4,
        source="Bou-Rabee, Ortolan & Saccon, arXiv 1005.3078",
        units="any consistent units",
    )
