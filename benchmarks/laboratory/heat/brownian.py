"""Relaxation of a dipole under strong friction: BROWNIAN, BAOAB with a small moment, and Euler-Maruyama on quaternions.

The energy is -x kT cos(theta), with x = 2; friction, kT and therefore D = kT/G are 1. All bodies start along the field.
The exact mean at the time 1/2 comes from the moments of Smoluchowski's equation,

    d<P_l>/dt = l (l + 1) (x (<P_l-1> - <P_l+1>)/(2 l + 1) - <P_l>).

BAOAB has inertia, with G/I = 1000, and needs steps below I/G. Euler-Maruyama adds the random rotation to the quaternion
and normalises it: weak order 1.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Compiled, Table, compiled, in_turn
from scipy.linalg import expm

import midlie_jax as ml

BODIES, TIME, X, MOMENT = 400_000, 0.5, 2.0, 1e-3
STEPS = {"BROWNIAN": (0.125, 0.0625), "Euler-Maruyama": (0.125, 0.0625, 0.03125), "JACOBI[BAOAB]": (0.004, 0.0005)}
_LARGEST = 40  # Legendre polynomials


def exact() -> float:
    degree = np.arange(1, _LARGEST + 1)
    strength = degree * (degree + 1.0)
    coupling = X * strength / (2 * degree + 1)
    rates = np.zeros((_LARGEST + 1, _LARGEST + 1))
    rates[degree, degree] = -strength
    rates[degree, degree - 1] = coupling
    rates[degree[:-1], degree[:-1] + 1] = -coupling[:-1]
    return float((expm(rates * TIME) @ np.ones(_LARGEST + 1))[1])


def ours(method: str, h: float) -> Callable[..., Any]:
    bath = ml.baths.Langevin(1.0, 1.0, jax.random.split(jax.random.key(1), BODIES))
    body, field = ml.RigidBody(MOMENT * jnp.ones(3)), ml.torques.HeavyTop(-X)

    def run(start: ml.RigidState) -> Any:
        return ml.ensemble(method, body, field, start, dt=h, steps=round(TIME / h), bath=bath).states.attitude

    return run


def euler_maruyama(h: float) -> Callable[..., Any]:
    def step(attitude: Any, n: Any) -> tuple[Any, None]:
        up = ml.so3.to_matrix(attitude)[:, 2]
        torque = X * jnp.stack([-up[:, 1], up[:, 0], jnp.zeros(BODIES)], -1)
        noise = jax.random.normal(jax.random.fold_in(jax.random.key(1), n), (BODIES, 3))
        turn = h * torque + jnp.sqrt(2 * h) * noise
        pure = jnp.concatenate([jnp.zeros((BODIES, 1)), turn / 2], axis=-1)
        moved = attitude + ml.so3.multiply(attitude, pure)
        return moved / jnp.linalg.norm(moved, axis=-1, keepdims=True), None

    return lambda start: jax.lax.scan(step, start.attitude, jnp.arange(round(TIME / h)))[0]


def runs() -> Iterator[tuple[str, float, Compiled]]:
    upright = jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (BODIES, 1))
    momenta = jnp.sqrt(MOMENT) * jax.random.normal(jax.random.key(0), (BODIES, 3))
    start = ml.RigidState(momenta, upright)
    for name, steps in STEPS.items():
        for h in steps:
            made = euler_maruyama(h) if name == "Euler-Maruyama" else ours(name, h)
            yield name, h, compiled(made, start, bodies=BODIES)


def rows() -> Iterator[Sequence[str]]:
    programs = list(runs())
    seconds = in_turn([program for _, _, program in programs], 3)
    for (name, h, program), time in zip(programs, seconds, strict=True):
        cosine = np.asarray(ml.so3.to_matrix(program()))[:, 2, 2]
        error, chance = cosine.mean() - exact(), cosine.std() / np.sqrt(BODIES)
        shown = name if name == "Euler-Maruyama" else f"`{name}`"
        yield [shown, f"{h:g}", f"{error:+.4f} ± {chance:.4f}", f"{time / BODIES / TIME * 1e9:.0f}"]


TABLE = Table(
    *("reports/heat.md", "brownian"),
    ("method", "step", "⟨cos θ⟩ - exact", "ns per body and unit of time"),
    *(rows, "heat-brownian"),
    key=lambda row: row[1] in ("0.0625", "0.0005"),
)
