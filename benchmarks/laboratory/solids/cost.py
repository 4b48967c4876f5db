"""What a step takes beside the one force that it evaluates, and beside Verlet written by hand."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp

import midlie_jax as ml
from midlie_jax.advice.timing import timed_in_turn

from .block import LAME, MU, Block, block, limit
from .tetrahedra import NeoHookean

MESHES = ((8, 4, 2), (16, 8, 4))  # cells
METHODS = ("Verlet", "position Verlet", "symplectic Euler")
HEADS = ("tetrahedra", "coordinates", "dtype", "", "µs per step", "relative to the force", "steps/s")
_STEPS, _ROUNDS = 400, 9


def programs(made: Block, dt: Any) -> dict[str, Callable[[], Any]]:
    """Functions that take `_STEPS` steps, or evaluate as many forces, and wait for the end."""
    mass, start, energy = made.body.mass, made.start, made.energy
    force = ml.torques.FromPotential(energy)
    slow = NeoHookean(made.nodes, made.corners, MU, LAME, jnp.linalg.det)

    def gradient(x: Any, energy: Any = energy) -> Any:
        return jax.grad(lambda y: energy(0.0, ml.ParticleState(jnp.zeros_like(y), y)))(x)

    def forces(energy: Any) -> Callable[[], Any]:
        """Each force needs the one before, so that none is left out."""

        def next_one(_: Any, x: Any) -> Any:
            return x - dt * dt / mass * gradient(x, energy)

        program = jax.jit(lambda x: jax.lax.fori_loop(0, _STEPS, next_one, x))
        return lambda: jax.block_until_ready(program(start.position))

    def by_hand(_: Any, pxf: Any) -> Any:
        p, x, f = pxf
        half = p + dt / 2 * f
        x = x + dt * half / mass
        f = -gradient(x)
        return half + dt / 2 * f, x, f

    hand = jax.jit(lambda p, x: jax.lax.fori_loop(0, _STEPS, by_hand, (p, x, -gradient(x))))

    def run(method: str) -> Callable[[], Any]:
        def call() -> Any:
            path = ml.integrate(method, made.body, force, start, dt=dt, steps=_STEPS, save_every=_STEPS)
            return jax.block_until_ready(path)

        return call

    return {
        "force alone, `jax.grad`": forces(energy),
        "the same with `jnp.linalg.det`": forces(slow),
        "Verlet by hand in `jax.lax.fori_loop`": lambda: jax.block_until_ready(hand(start.momentum, start.position)),
    } | {f"`{method}`": run(method) for method in METHODS}


def rows() -> Iterator[list[str]]:
    """For each mesh and dtype the time of a force, and of a step by hand and by each method."""
    for cells in MESHES:
        made = {dtype: block(cells, dtype) for dtype in ("float64", "float32")}
        named = {
            (dtype, name): run
            for dtype, own in made.items()
            for name, run in programs(own, jnp.asarray(limit(cells) / 3, dtype)).items()
        }
        found = timed_in_turn(list(named.values()), least=_ROUNDS, most=_ROUNDS)
        seconds = {key: timing.seconds / _STEPS for key, (_, timing) in zip(named, found, strict=True)}
        for (dtype, name), own in seconds.items():
            size = str(len(made[dtype].corners)), str(made[dtype].nodes.size), dtype
            least = next(value for (other, _), value in seconds.items() if other == dtype)
            yield [*size, name, f"{1e6 * own:.0f}", f"{own / least:.2f}", f"{1 / own:.0f}"]
