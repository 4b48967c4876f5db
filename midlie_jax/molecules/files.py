"""`read`: rigid molecules from a file of atoms, such as GRO, PDB or LAMMPS data, by ase."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._checks.arguments import as_count
from ..model import so3
from ..model.bodies import SymmetricRotor
from ..model.free_body import FreeBody
from ..model.states import CoupledFreeAxisState, CoupledState
from .points import from_points, sites

_NM_PER_ANGSTROM = 0.1
_ROUNDED = 0.002  # the largest distance in nm from a line that is rounding; GRO files have three digits after the point
_RIGID = 0.01  # the largest difference in nm between the atoms of a molecule and of the first


class Molecules(NamedTuple):
    """N equal rigid molecules.

    Attributes:
        body: one body for all molecules; moments in amu nm^2.
        points: the atoms of a molecule in its principal frame, (a, 3), nm.
        start: positions in nm, momenta in amu nm/ps and amu nm^2/ps; at rest if the file has no velocities. Linear
            molecules have a `CoupledFreeAxisState`.
        box: the edges of the box, (3,), nm; zero along axes that are not periodic.
        symbols: the chemical symbols of the atoms of a molecule.

    Examples:
        >>> from ase.build import molecule
        >>> molecule("H2O").write("water.xyz")
        >>> ml.molecules.read("water.xyz", atoms=3).body.mass
        Array(18.015, dtype=float64)
    """

    body: FreeBody
    points: Any
    start: CoupledState | CoupledFreeAxisState
    box: np.ndarray
    symbols: list[str]


def read(file: str | PathLike[str], atoms: int, *, masses: Any = None, **options: Any) -> Molecules:
    """Reads molecules of `atoms` consecutive atoms each, all of the shape of the first.

    They are linear if its atoms are on a line to 0.002 nm. A molecule that crosses the border of a periodic box is
    joined at its first atom. Only the rigid part of the velocities is used.

    Args:
        file: in any format of ase, with positions in the units that ase assumes.
        atoms: of a molecule, at least 2.
        masses: of the atoms of a molecule, (atoms,), amu; by default the masses of their elements. Required for
            LAMMPS data without a section Masses, where they also determine the elements.
        options: for `ase.io.read`, such as format="lammps-data", units="real".

    Raises:
        ImportError: ase is not installed: pip install 'midlie_jax[molecules]'.
        ValueError: the number of atoms is not a multiple of `atoms`, the box is not rectangular, the molecules differ
            in shape or elements, or the file has neither elements nor masses.

    Examples:
        >>> from ase.build import molecule
        >>> molecule("H2O").write("water.xyz")
        >>> ml.molecules.read("water.xyz", atoms=3).symbols
        ['O', 'H', 'H']
    """
    try:
        from ase import data, io, units
    except ImportError as error:
        raise ImportError("reading molecules needs ase: pip install 'midlie_jax[molecules]'.") from error
    size = as_count("atoms", atoms)
    found: Any = io.read(str(file), **options)
    if len(found) % size or not len(found):
        raise ValueError(f"{file} must have a multiple of {size} atoms, got {len(found)}. Correct atoms=.")
    typed = "type" in found.arrays and np.array_equal(found.arrays["type"], found.numbers)
    if typed and not found.has("masses") and options.get("Z_of_type") is None:
        if masses is None:
            raise ValueError(
                f"{file} must have a section Masses, got type numbers that ase reads as elements "
                f"({found[:size].symbols}). Pass masses, or Z_of_type={{1: 6, 2: 1}}."
            )
        given = np.resize(np.asarray(masses, float), len(found))
        # The elements with the nearest masses, as ase finds them from a section Masses.
        found.numbers = 1 + np.abs(given[:, None] - data.atomic_masses[1:]).argmin(axis=1)
    symbols = found.get_chemical_symbols()
    if symbols != symbols[:size] * (len(found) // size):
        raise ValueError(f"the molecules must be equal and consecutive, but the elements of {file} do not repeat.")
    box = _box(found)
    weights = np.asarray(found.get_masses()[:size] if masses is None else masses, float)
    places = np.asarray(found.get_positions()).reshape(-1, size, 3) * _NM_PER_ANGSTROM
    velocities = np.asarray(found.get_velocities()).reshape(-1, size, 3) * (1000 * units.fs * _NM_PER_ANGSTROM)
    edges, arms = np.where(box > 0, box, 1), places - places[:, :1]
    places = places[:, :1] + (arms - np.where(box > 0, edges * np.round(arms / edges), 0))
    body, points = from_points(weights, _straight(places[0]))
    start = _start(weights, np.asarray(points), places, velocities, linear=isinstance(body.body, SymmetricRotor))
    return Molecules(body, points, start, box, symbols[:size])


def _box(atoms: Any) -> np.ndarray:
    cell = np.asarray(atoms.get_cell())
    if np.any(np.abs(cell - np.diag(np.diag(cell))) > 1e-9):
        raise ValueError("the box must be rectangular, with edges along x, y and z.")
    return np.where(atoms.get_pbc(), np.diag(cell), 0) * _NM_PER_ANGSTROM


def _straight(places: np.ndarray) -> np.ndarray:
    """The atoms put on a line, if they are on one up to the rounding of a file."""
    middle = places.mean(axis=0)
    along = np.linalg.svd(places - middle)[2][0]
    line = middle + np.outer((places - middle) @ along, along)
    return line if np.abs(places - line).max() < _ROUNDED else places


def _start(masses: np.ndarray, points: np.ndarray, places: np.ndarray, velocities: np.ndarray, linear: bool) -> Any:
    """The rigid motion nearest to the motion of the atoms: attitudes by Kabsch's method, momenta by sums."""
    weights = masses[:, None] / masses.sum()
    position, velocity = np.sum(weights * places, axis=1), np.sum(weights * velocities, axis=1)
    arms = places - position[:, None]
    u, _, v = np.linalg.svd(np.einsum("a,nai,aj->nij", masses, arms, points))
    signs = np.ones((len(places), 3))
    signs[:, 2] = np.linalg.det(u) * np.linalg.det(v)
    frames = np.einsum("nij,nj,njk->nik", u, signs, v)
    missed = np.abs(np.einsum("nij,aj->nai", frames, points) - arms).max()
    if missed > _RIGID:
        raise ValueError(f"the molecules must be rigid and equal, but differ in shape by {missed:.3g} nm.")
    spin = np.einsum("a,nai->ni", masses, np.cross(arms, velocities - velocity[:, None]))
    if linear:
        axis = frames[:, :, 2]
        spin = spin - np.sum(spin * axis, axis=1, keepdims=True) * axis  # rounding
        return CoupledFreeAxisState(spin, axis, masses.sum() * velocity, position)
    momentum = np.einsum("nij,ni->nj", frames, spin)
    return CoupledState(momentum, so3.from_matrix(jnp.asarray(frames)), masses.sum() * velocity, position)


_ANGSTROM_PER_NM = 10.0


def write_xyz(
    file: str | PathLike[str],
    path: Any,
    *,
    points: Any = None,
    symbols: Sequence[str] | str = "X",
    box: Any = None,
    scale: float = _ANGSTROM_PER_NM,
) -> None:
    """Writes a frame for each saved state.

    Without points a particle is a body, with its orientation as a quaternion (x, y, z, w), in the column that OVITO
    uses for shapes. With points a particle is a site of a body, for molecular viewers, and the column `molecule` has
    the number of its body.

    Args:
        file: the file; an existing one is replaced.
        path: from a run of a `CoupledState` (one replica): states with arrays (n, N, 3).
        points: the sites of each body in its frame, (a, 3), or None.
        symbols: the chemical symbols of the sites, or one for all particles.
        box: the edges of a periodic box, (3,) or (), in the unit of length of the states; or None.
        scale: Angstroms, the unit of viewers, per unit of length of the states: 10 for nm.

    Raises:
        ValueError: the states are not coupled bodies that translate, or have more leading axes than the times; or the
            number of symbols differs from the number of points.

    Examples:
        >>> from ase.build import molecule
        >>> molecule("H2O").write("water.xyz")
        >>> water = ml.molecules.read("water.xyz", atoms=3)
        >>> path = ml.integrate("JACOBI[EA]", water.body, None, water.start, dt=0.01, steps=10)
        >>> ml.molecules.write_xyz("run.xyz", path, points=water.points, symbols=water.symbols)
    """
    states, times = path.states, np.asarray(path.times)
    if not getattr(states, "several", False) or not hasattr(states, "position") or states.position.ndim != 3:
        raise ValueError("path must come from one run of a CoupledState, with positions (n, N, 3).")
    if points is None and not hasattr(states, "attitude"):
        raise ValueError(f"a {type(states).__name__} has no attitude; give points on its axis.")
    per_body = 1 if points is None else len(points)
    names = [symbols] * per_body if isinstance(symbols, str) else list(symbols)
    if len(names) != per_body:
        raise ValueError(f"symbols must be one for each of {per_body} points, got {len(names)}.")
    columns = "species:S:1:pos:R:3" + (":orientation:R:4" if points is None else ":molecule:I:1")
    lattice = ""
    if box is not None:
        edges = np.broadcast_to(np.asarray(box, float), 3) * scale
        lattice = 'Lattice="{:.10g} 0 0 0 {:.10g} 0 0 0 {:.10g}" '.format(*edges)
    with open(file, "w", encoding="utf-8") as out:
        for frame, time in enumerate(times):
            here = jax.tree.map(lambda x, frame=frame: x[frame], states)
            if points is None:
                w, *vector = np.asarray(here.attitude).T
                numbers = np.column_stack([np.asarray(here.position) * scale, *vector, w])
            else:
                places = np.asarray(sites(here, points)) * scale
                bodies = np.repeat(np.arange(1, len(places) + 1), per_body)
                numbers = np.column_stack([places.reshape(-1, 3), bodies])
            out.write(f"{len(numbers)}\n{lattice}Properties={columns} Time={time:.10g}\n")
            for number, row in enumerate(numbers):
                out.write(" ".join([names[number % per_body], *(f"{x:.9g}" for x in row)]) + "\n")
