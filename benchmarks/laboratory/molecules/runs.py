"""Runs of a box of water with a list of neighbours that is built anew after every few steps."""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

import midlie_jax as ml

from . import water
from .damped_water import DampedPairs
from .neighbours import farthest_move, neighbour_list

CUTOFF = 0.9
_places = jax.jit(ml.sites)
_energy = jax.jit(ml.energy)


def motion(
    method: str,
    start: ml.CoupledState,
    edge: float,
    dt: float,
    steps: int,
    *,
    skin: float = 0.14,
    single: bool = False,
) -> Iterator[tuple[ml.CoupledState, DampedPairs]]:
    """The state after every `steps` steps of `dt` ps, without end, and the force with the list of these steps.

    In the small box every molecule is everybody's neighbour if the skin is as wide as the edge, and lists last.

    Raises:
        ValueError: a site moved by more than half the skin within one list. RuntimeError: a run failed.
    """
    body, state, slots, first = water.molecules(start.count), start, None, 0
    while True:
        places = np.asarray(_places(state, water.POINTS))
        neighbours = neighbour_list(places, edge, CUTOFF, skin, slots)
        slots, torque = len(neighbours), water.forces(neighbours, edge, single)
        path = ml.integrate(method, body, torque, state, dt=dt, steps=steps, save_every=steps, first_step=first)
        if not path.ok:
            raise RuntimeError(f"{method} failed at a step of {dt:g} ps; take a shorter step.")
        state, first = jax.tree.map(lambda x: x[-1], path.states), first + steps
        if (moved := farthest_move(places, _places(state, water.POINTS))) > skin / 2:
            raise ValueError(
                f"skin must be at least twice the way of a site within one list, {moved:.3f} nm, got {skin:g}; take "
                "a wider skin or fewer steps a list."
            )
        yield state, torque


def energy(state: ml.CoupledState, torque: Any) -> float:
    """Kinetic and potential energy of all molecules, kJ/mol."""
    return float(_energy(water.molecules(state.count), torque, state))


def forces_per_step(method: str) -> int:
    """How many forces a step costs; the derivative of a force along a direction counts as another force."""
    scheme: Any = getattr(ml.method(method), "scheme", None)
    gradients = sum(bool(gradient) for gradient in scheme.gradients)
    return ml.method(method).evaluations + gradients
