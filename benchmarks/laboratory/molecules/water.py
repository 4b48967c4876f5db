"""SPC/E water: its data, two molecules with known ends, and 216 in a box in equilibrium at 300 K."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

import midlie_jax as ml

# Oxygen and two hydrogens. x is along H-H, z from the oxygen to between them.
MASSES = (15.9994, 1.008, 1.008)
CHARGES = (-0.8476, 0.4238, 0.4238)
SIGMAS, EPSILONS = (0.3166, 0.0, 0.0), (0.650, 0.0, 0.0)
_HALF = np.deg2rad(109.4712206) / 2
PLACES = 0.1 * np.array([[0, 0, 0], [np.sin(_HALF), 0, np.cos(_HALF)], [-np.sin(_HALF), 0, np.cos(_HALF)]])
BODY, POINTS = ml.molecules.from_points(MASSES, PLACES)
MOMENTS = jnp.array(BODY.inertia().rotation.moments)
# The principal axes in that frame are x, -z and y; this takes components along them to x, y, z.
FRAME = jnp.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
BOLTZMANN = 0.00831446261815324  # kJ/mol/K
COULOMB = 138.935457644  # 1 / (4 pi epsilon_0), kJ/mol nm / e^2
CUTOFF = 0.9

# The edge of a box of 216 molecules with .997 g/cm3; the start was made by rescaling velocities for some ps.
EDGE = 1.8643
_START = Path(__file__).with_name("start216.npz")


def molecules(number: int) -> ml.FreeBody:
    """Equal waters."""
    return ml.FreeBody(ml.RigidBody(jnp.tile(MOMENTS, (number, 1))), jnp.full(number, BODY.mass))


def in_principal_axes(momentum: Any, attitude: Any, linear: Any, position: Any) -> ml.CoupledState:
    """A state whose momenta and attitudes are given in the frame of `PLACES`."""
    momentum, attitude = jnp.asarray(momentum), jnp.asarray(attitude)
    frame = jnp.tile(FRAME, (len(momentum), 1))
    turned = ml.so3.rotate(ml.so3.conjugate(frame), momentum)
    return ml.CoupledState(turned, ml.so3.multiply(attitude, frame), linear, position)


def dimer() -> ml.CoupledState:
    """Two molecules .28 nm apart that turn and travel."""
    momentum, linear = np.array([-0.05, -0.1, -0.15]), np.array([0.0, 2.0, 0.0])
    attitude = [[0.8, 0.0, 0.6, 0.0], [0.6, 0.48, 0.0, 0.64]]
    position = [[0.0, 0.0, 0.0], [0.28, 0.0, 0.02]]
    return in_principal_axes([momentum, -momentum], attitude, jnp.asarray([linear, -linear]), position)


# After 1 ps, to the digits that steps of .1 and .2 fs of SRKN6b have in common: position and attitude of the second.
DIMER_POSITION = np.array([0.26902629, -0.07283731, 0.05932941])
DIMER_ATTITUDE = np.array([0.00491685, 0.90134910, 0.41820523, 0.11247224])


def dimer_energy(t: Any, state: Any) -> Array:
    """The potential energy of two molecules without a cut-off."""
    del t
    first, second = ml.molecules.sites(state, POINTS)
    difference = first[:, None, :] - second[None, :, :]
    distance = jnp.sqrt(jnp.sum(difference**2, axis=-1))
    sixth = (SIGMAS[0] / distance[0, 0]) ** 6
    return jnp.sum(COULOMB * jnp.outer(jnp.array(CHARGES), jnp.array(CHARGES)) / distance) + 4 * EPSILONS[0] * (
        sixth**2 - sixth
    )


def box(copies: int = 1) -> tuple[ml.CoupledState, float]:
    """The molecules of the box, repeated `copies` times along each axis, and its edge."""
    with np.load(_START) as data:
        start = {name: np.tile(data[name], (copies**3, 1)) for name in ("momentum", "attitude", "linear", "position")}
    shifts = EDGE * np.stack(np.meshgrid(*[np.arange(copies)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    start["position"] += np.repeat(shifts, len(start["position"]) // len(shifts), axis=0)
    cells = np.floor(3 * start["position"] / EDGE).astype(int) % (3 * copies)
    order = np.lexsort(cells.T[::-1])  # neighbours in space are neighbours in memory: a tenth faster for 1,728
    return in_principal_axes(**{name: values[order] for name, values in start.items()}), copies * EDGE


def forces(edge: float, single: bool = False) -> ml.molecules.PairForces:
    """The pair force with the data of this water."""
    data: Any = {"charges": CHARGES, "sigmas": SIGMAS, "epsilons": EPSILONS, "coulomb": COULOMB}
    return ml.molecules.PairForces(POINTS, **data, box=edge, cutoff=CUTOFF, single=single)


def motion(
    method: str, start: ml.CoupledState, edge: float, dt: float, steps: int, *, every: int, skin: float, single: bool
) -> ml.Path[Any]:
    """The path of a box, saved after every `every` steps. A skin as wide as the edge lists all molecules for ever."""
    forced = forces(edge, single)
    run: Any = {"dt": dt, "steps": steps, "save_every": every, "skin": skin}
    return ml.molecules.integrate(method, molecules(start.count), forced, start, **run)


def forces_per_step(method: str) -> int:
    """How many forces a step costs; the derivative of a force along a direction counts as another force."""
    scheme: Any = getattr(ml.method(method), "scheme", None)
    gradients = 0 if scheme.displaced else sum(bool(gradient) for gradient in scheme.gradients)
    return ml.method(method).evaluations + gradients


def temperatures(state: ml.CoupledState) -> tuple[Array, Array]:
    """Of travel, with three degrees of freedom less because the centre of all rests, and of rotation; in kelvin."""
    number = state.momentum.shape[-2]
    both = (state.linear, BODY.mass, 3 * number - 3), (state.momentum, MOMENTS, 3 * number)
    travel, turn = (jnp.sum(p * p / inertia, axis=(-2, -1)) / (n * BOLTZMANN) for p, inertia, n in both)
    return travel, turn
