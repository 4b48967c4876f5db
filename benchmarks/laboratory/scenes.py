"""The scenes on which programs are compared: those of the package, and a few whose state is of another kind."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from midlie_jax.cli import chosen, scenes
from midlie_jax.cli.scenes import Scene
from midlie_jax.model import so3
from midlie_jax.model.bodies import RigidBody
from midlie_jax.model.free_body import FreeBody
from midlie_jax.model.rotor import SymmetricRotor
from midlie_jax.model.states import AxisState, FreeState
from midlie_jax.model.torques import HeavyTop, PointMass
from midlie_jax.spacecraft.disturbances import GravityGradient


@dataclass(frozen=True, eq=False)
class SceneOfAnyKind(Scene):
    """A scene whose body and start may be of any kind."""

    body: Any
    start: Any


def _orbit() -> Scene:
    moments, mass = jnp.array([0.01, 0.02, 0.025]), 3.0
    attitude = np.array([0.8, 0.3, -0.4, 0.33])
    return SceneOfAnyKind(
        name="orbit",
        title="asymmetric body in the gravity of a point mass, two orbits",
        body=FreeBody(RigidBody(moments), mass),
        torque=PointMass(1.0),
        start=FreeState(
            momentum=moments * jnp.array([0.5, 0.8, 4.0]),
            attitude=attitude / np.linalg.norm(attitude),
            linear=mass * np.array([0.0, 1.1, 0.0]),
            position=[1.0, 0.0, 0.0],
        ),
        dt=0.01,
        duration=20.0,
        # A spin of 2 instead of 4 would make the motion chaotic: errors of 1e-12 would be below its rounding.
        source="chosen here, not published",
        units="any consistent units",
    )


def _axis() -> Scene:
    whole = scenes.scene("P1-tilted", "float64")
    return SceneOfAnyKind(
        name="axis",
        title="the axis of the fast heavy top P1, tilted by 0.3 rad, without its spin angle",
        body=SymmetricRotor(whole.body.moments[0], whole.body.moments[2]),
        torque=whole.torque,
        start=AxisState.of(whole.start),
        dt=whole.dt,
        duration=whole.duration,
        source=whole.source,
        units=whole.units,
    )


OWN: dict[Any, Callable[[], Scene]] = {"orbit": _orbit, "axis": _axis}


def scene(which: str | Scene) -> Scene:
    """The scene, or that of this name, of `OWN` or of the package; with the axis of symmetry as third axis."""
    found = OWN[which]() if which in OWN else chosen.scene(which, jnp.float64)
    return axis_third(found) if isinstance(found.body, RigidBody) else found


def perturbed(start: Any, count: int, size: float) -> Any:
    """Perturbed copies of a state of any kind, with a leading axis; the first is the start itself.

    Each component changes by a normal number of the standard deviation `size`, relative to the norm of its array; an
    attitude or axis turns by so many radians. They are those of `scenes.perturbed` where both exist.
    """
    norms = [float(jnp.linalg.norm(leaf)) for leaf in jax.tree.leaves(start)]
    whole = start.minus(start).shape[-1]
    counts = [3, whole - 3 * (len(norms) - 1), *([3] * (len(norms) - 2))]  # the pose has 3 or 2, vectors have 3
    changes = size * np.repeat(norms, counts) * np.random.default_rng(0).standard_normal((count, whole))
    changes[0] = 0
    starts = jax.vmap(start.plus)(jnp.asarray(changes))
    return starts.kind.normalised(starts)


def axis_third(scene: Scene) -> Scene:
    """The scene with the axis of symmetry of the body as third axis, as the exact flight of such a body needs.

    If there are several, it is the axis of the torque, otherwise the last. Without one the scene is unchanged.
    """
    moments, torque = np.asarray(scene.body.moments), scene.torque
    own = torque.axis if isinstance(torque, HeavyTop) else (0.0, 0.0, 0.0)
    axes = [k for k in range(3) if moments[(k + 1) % 3] == moments[(k + 2) % 3]]
    return renumbered(scene, max(axes, key=lambda k: (abs(own[k]), k), default=2))


def renumbered(scene: Scene, third: int) -> Scene:
    """The scene with this axis of the body as third, by a cyclic change; unchanged if its torque does not allow it."""
    order, torque = ((third + 1) % 3, (third + 2) % 3, third), scene.torque
    if third == 2 or not (torque is None or isinstance(torque, HeavyTop | GravityGradient)):
        return scene
    pick = jnp.array(order)
    moments = scene.body.moments[pick]
    if isinstance(torque, HeavyTop):
        a, b, c = (torque.axis[i] for i in order)
        torque = HeavyTop(torque.mgl, (a, b, c))
    elif torque is not None:
        torque = GravityGradient(moments, torque.orbit, torque.mu)
    momentum, attitude = scene.start.momentum, scene.start.attitude
    turn = jnp.array([(0.5, 0.5, 0.5, 0.5), (0.5, -0.5, -0.5, -0.5)][third], attitude.dtype)  # from new axes to old
    start = type(scene.start)(momentum[pick], so3.multiply(attitude, turn))
    return replace(scene, body=RigidBody(moments), torque=torque, start=start, axes=None)
