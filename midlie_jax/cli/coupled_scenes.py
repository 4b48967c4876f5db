"""The scenes of coupled bodies; `scenes` gives them their names."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..model.bodies import RigidBody
from ..model.free_body import FreeBody
from ..model.states import CoupledState
from ..model.straight_rod import straight_rod
from ..model.torques import MutualGravity
from .scene import Scene
from .water import WATER, Waters


def _body(moments: Any, mass: Any, dtype: Any) -> FreeBody:
    return FreeBody(RigidBody(jnp.asarray(moments, dtype)), jnp.asarray(mass, dtype))


def _start(momentum: Any, attitude: Any, linear: Any, position: Any, dtype: Any) -> CoupledState:
    return CoupledState(*(jnp.asarray(x, dtype) for x in (momentum, attitude, linear, position)))


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
        start=_start(moments * spins, attitudes, linear, share[:, None] * way, dtype),
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
        start=_start(
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
