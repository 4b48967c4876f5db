"""Runs of a box of water with a list of neighbours that is built anew after every few steps."""

from collections.abc import Iterator
from typing import Any

import jax

import midlie_jax as ml

from . import water
from .damped_water import DampedPairs
from .neighbours import neighbour_list

CUTOFF = 0.9
_places = jax.jit(ml.molecules.sites)
_energy = jax.jit(ml.observe.energy)


def motion(
    method: str,
    start: ml.CoupledState,
    edge: float,
    dt: float,
    steps: int,
    *,
    skin: float = 0.2,
    single: bool = False,
) -> Iterator[tuple[ml.CoupledState, DampedPairs]]:
    """The state after every `steps` steps of `dt` ps, without end, and the force with the list of these steps.

    In the small box every molecule is everybody's neighbour if the skin is as wide as the edge, and lists last.
    """
    body, state, slots, first = water.molecules(start.count), start, None, 0
    while True:
        neighbours = neighbour_list(_places(state, water.POINTS), edge, CUTOFF, skin, slots)
        slots, torque = len(neighbours.nearest), water.forces(neighbours, edge, single)
        path = ml.integrate(method, body, torque, state, dt=dt, steps=steps, save_every=steps, first_step=first)
        if not path.ok:
            raise RuntimeError(
                f"{method} failed at a step of {dt:g} ps, or a site moved by over {skin / 2:g} nm in {steps} steps; "
                "take a shorter step, a wider skin or fewer steps a list."
            )
        state, first = jax.tree.map(lambda x: x[-1], path.states), first + steps
        yield state, torque


def energy(state: ml.CoupledState, torque: Any) -> float:
    """Kinetic and potential energy of all molecules, kJ/mol."""
    return float(_energy(water.molecules(state.count), torque, state))


def forces_per_step(method: str) -> int:
    """How many forces a step costs; the derivative of a force along a direction counts as another force."""
    scheme: Any = getattr(ml.method(method), "scheme", None)
    gradients = 0 if scheme.displaced else sum(bool(gradient) for gradient in scheme.gradients)
    return ml.method(method).evaluations + gradients
