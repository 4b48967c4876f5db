"""The fixed bar of d'Alembert: Verlet on linear elements with lumped masses, beside the closed forms of its nodes.

The bar has length 1 and wave speed c = 1, N elements of length dx = 1/N, and mass dx at each node within. In mode n its
nodes move as sin(n pi i/N) cos(omega t) with sin(omega h/2) = (c h/dx) sin(n pi/(2 N)). At c h = dx this omega is that
of the bar itself, n pi c: the nodes move as d'Alembert's waves do.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import midlie_jax as ml

ELEMENTS, MODE = 50, 3
HEADS = ("c h/dx", "steps", "time", "frequency", "of the bar", "largest error of a node")
CASES = ((1.0, 10_000), (0.4, 10_000))  # c h/dx, and steps


class Case(NamedTuple):
    """A run: times (k,), the motion of the nodes and its closed form (k, N - 1), and the frequency of this form."""

    times: np.ndarray
    found: np.ndarray
    exact: np.ndarray
    frequency: float


def elastic(t: Any, state: ml.ParticleState) -> Any:
    """The energy of the elements; the nodes at the ends are fixed and so are no coordinates."""
    del t
    u = jnp.pad(state.position, 1)
    return ELEMENTS / 2 * jnp.sum(jnp.diff(u) ** 2)


def case(courant: float, steps: int) -> Case:
    """The bar that is let go from its mode, at the step courant/N."""
    shape = np.sin(MODE * np.pi * np.arange(1, ELEMENTS) / ELEMENTS)
    start = ml.ParticleState(jnp.zeros(ELEMENTS - 1), jnp.asarray(shape))
    h = courant / ELEMENTS
    body, force = ml.Particles(jnp.asarray(1 / ELEMENTS)), ml.torques.FromPotential(elastic)
    path = ml.integrate("Verlet", body, force, start, dt=h, steps=steps)
    # Extended precision: in float64 the phase of the closed form itself has an error above that of the run.
    half = np.arcsin(np.longdouble(str(courant)) * np.sin(MODE * PI / (2 * ELEMENTS)))
    exact = np.cos(2 * half * np.arange(steps + 1, dtype=np.longdouble))[:, None] * shape
    return Case(np.asarray(path.times), np.asarray(path.states.position), exact, float(2 * half / h))


PI = np.longdouble("3.14159265358979323846264338327950288")


def rows() -> Iterator[list[str]]:
    """For each case the frequency, that of the continuous bar, and the largest error of all nodes at all steps."""
    for courant, steps in CASES:
        run = case(courant, steps)
        error = float(np.abs(run.found - run.exact).max())
        yield [
            f"{courant:g}", str(steps), f"{run.times[-1]:g}", f"{run.frequency:.9f}", f"{MODE * np.pi:.9f}",
            f"{error:.1e}",
        ]  # fmt: skip
