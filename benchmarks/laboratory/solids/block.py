"""A block of gel that is thrown and spins freely: what the methods keep, and how large their energy bands are."""

from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import midlie_jax as ml

from .tetrahedra import NeoHookean, angular_momentum, longest_step

SIZES, CELLS = (0.2, 0.1, 0.05), (4, 2, 1)  # m, and cells along each edge in the tables; each cell has six tetrahedra
MU, LAME, DENSITY = 8e3, 3e4, 1000.0  # Pa, Pa, kg/m^3
VELOCITY, SPIN = (2.0, 0.0, 2.5), (3.0, 25.0, 6.0)  # m/s, rad/s
TIME = 0.2  # s
METHODS = ("symplectic Euler", "adjoint symplectic Euler", "Verlet", "position Verlet", "implicit midpoint", "RK4")
HALVINGS = 3
HEADS = (
    "method", "linear momentum", "angular momentum", "energy, h", "h/2", "h/4", "ratio", "ratio", "h, 10 times as long",
)  # fmt: skip

_SHARES, _LIMIT_STEPS, _SMALL = (0.99, 1.01), 60, 1e-9  # m, of the nodes at the start
LIMIT_CELLS = ((4, 2, 1), (8, 4, 2), (16, 8, 4))
LIMIT_HEADS = ("tetrahedra", "nodes", "2/omega_max, ms", *(f"growth at {share} of it" for share in _SHARES))


class Block(NamedTuple):
    """A block at its start: undeformed, with the velocities of a rigid body."""

    body: ml.Particles
    energy: NeoHookean
    start: ml.ParticleState
    nodes: Any
    corners: Any


def block(cells: tuple[int, int, int], dtype: Any = "float64") -> Block:
    """The thrown block, with its middle at the origin."""
    from skfem import MeshTet

    axes = [np.linspace(-size / 2, size / 2, count + 1) for size, count in zip(SIZES, cells, strict=True)]
    mesh = MeshTet.init_tensor(*axes)
    nodes = jnp.asarray(mesh.p.T, dtype)
    energy = NeoHookean(nodes, mesh.t.T, MU, LAME)
    mass = energy.masses(nodes, DENSITY)
    velocity = jnp.asarray(VELOCITY, dtype) + jnp.cross(jnp.asarray(SPIN, dtype), nodes)
    return Block(ml.Particles(mass), energy, ml.ParticleState(mass * velocity, nodes), nodes, mesh.t.T)


class Kept(NamedTuple):
    """What a run keeps, of each saved state: the energy (k,), J, and the momenta (k, 3), kg m/s and kg m^2/s."""

    energy: Any
    linear: Any
    angular: Any


@cache
def limit(cells: tuple[int, int, int] = CELLS) -> float:
    """The longest stable step of Verlet, s."""
    made = block(cells)
    return longest_step(made.energy, made.body.mass, made.nodes)


def observed(method: str, step: float, times: int = 1) -> Kept:
    """Energy and momenta of every state of a free flight of so many times `TIME`."""
    made = block(CELLS)
    force = ml.torques.FromPotential(made.energy)

    def seen(t: Any, state: ml.ParticleState) -> Kept:
        energy = ml.kinetic_energy(made.body, state) + made.energy(t, state)
        return Kept(energy, jnp.sum(state.momentum, axis=0), angular_momentum(state))

    steps = times * round(TIME / step)
    path = ml.integrate(method, made.body, force, made.start, dt=step, steps=steps, observe=seen)
    if not bool(path.ok):
        raise RuntimeError(f"{method} failed; take a shorter step.")
    return jax.tree.map(np.asarray, path.states)


def drift(values: np.ndarray) -> float:
    """The largest change of a vector in a run, relative to its length at the start."""
    return float(np.linalg.norm(values - values[0], axis=1).max() / np.linalg.norm(values[0]))


def band(energies: np.ndarray) -> float:
    """The largest change of the energy, relative to the energy at the start."""
    return float(np.abs(energies - energies[0]).max() / energies[0])


def first_step() -> float:
    """The longest step of the table: a third of the limit, so that it divides the time."""
    return TIME / round(3 * TIME / limit())


def rows() -> Iterator[list[str]]:
    """For each method the drift of the momenta, and the energy band at three steps and in a long run."""
    for method in METHODS:
        runs = [observed(method, first_step() / 2**k) for k in range(HALVINGS)]
        bands = [band(run.energy) for run in runs]
        ratios = [f"{a / b:.2f}" for a, b in pairwise(bands)]
        kept = [f"{drift(getattr(runs[0], name)):.0e}" for name in ("linear", "angular")]
        longer = band(observed(method, first_step(), 10).energy)
        yield [f"`{method}`", *kept, *(f"{value:.1e}" for value in bands), *ratios, f"{longer:.1e}"]


def growth(cells: tuple[int, int, int], share: float) -> float:
    """How many times a small random displacement grows in 60 steps of this share of the limit."""
    made = block(cells)
    displaced = _SMALL * jax.random.normal(jax.random.key(1), made.nodes.shape)
    start = ml.ParticleState(jnp.zeros_like(made.nodes), made.nodes + displaced)
    force, dt = ml.torques.FromPotential(made.energy), share * limit(cells)
    end = ml.integrate("Verlet", made.body, force, start, dt=dt, steps=_LIMIT_STEPS).states.position
    return float(jnp.max(jnp.abs(end - made.nodes)) / jnp.max(jnp.abs(displaced)))


def limit_rows() -> Iterator[list[str]]:
    """For each mesh the limit by power iteration, and what happens just below and above."""
    for cells in LIMIT_CELLS:
        made = block(cells)
        sizes = str(len(made.corners)), str(len(made.nodes)), f"{1e3 * limit(cells):.3g}"
        yield [*sizes, *(f"{growth(cells, share):.2g}" for share in _SHARES)]
