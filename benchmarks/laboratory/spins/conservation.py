"""What a run keeps: the energy, the total spin and the lengths, of a closed Heisenberg chain, H = sum S_i . S_i+1."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from harness import Table

import midlie_jax as ml

from . import random

SPINS, TIME = 64, 20.0
STEPS = 0.1, 0.2
METHODS = "SUBLATTICES[EA]", "SUBLATTICES[KL6]", "spherical midpoint", "Lie midpoint of spins", "RK4"


def errors(method: str, dt: float, *, spins: int = SPINS, time: float = TIME) -> tuple[float, float, float]:
    """The largest errors in a run of energy and total spin, each over the number of spins, and of a length."""
    body, field, start = ml.spins.Spins(), ml.spins.Exchange(-1.0), random((spins,), 0)
    path = ml.integrate(method, body, field, start, dt=dt, steps=round(time / dt))
    assert bool(jnp.all(path.ok))
    energy = np.asarray(ml.observe.energy(body, field, path))
    spin = np.asarray(path.states.spin)
    total = np.linalg.norm(spin.sum(axis=1) - spin[0].sum(axis=0), axis=-1)
    lengths = np.abs(np.linalg.norm(spin, axis=-1) - 1)
    return float(np.abs(energy - energy[0]).max() / spins), float(total.max() / spins), float(lengths.max())


def rows() -> Iterator[list[str]]:
    for method in METHODS:
        for dt in STEPS:
            yield [f"`{method}`", f"{dt:g}", *(f"{error:.1e}" for error in errors(method, dt))]


TABLE = Table(
    *("reports/heat.md", "conservation"),
    ("method", "h", "energy error / N", "total spin error / N", "length error"),
    *(rows, "spins-conservation", lambda row: row[1] == "0.2", (0, 2, 3, 4)),
)
