"""`write_xyz`: the motion of coupled bodies as extended XYZ, for OVITO and VMD."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import jax
import numpy as np

from .points import sites

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
            rows = _rows(states, frame, points, scale)
            out.write(f"{len(rows)}\n{lattice}Properties={columns} Time={time:.10g}\n")
            for number, row in enumerate(rows):
                out.write(f"{names[number % per_body]} {row}\n")


def _rows(states: Any, frame: int, points: Any, scale: float) -> list[str]:
    here = jax.tree.map(lambda x: x[frame], states)
    if points is None:
        w, *vector = np.asarray(here.attitude).T
        numbers = np.column_stack([np.asarray(here.position) * scale, *vector, w])
        return [" ".join(f"{x:.9g}" for x in row) for row in numbers]
    places = np.asarray(sites(here, points)) * scale
    return [
        " ".join(f"{x:.9g}" for x in place) + f" {body + 1}" for body, group in enumerate(places) for place in group
    ]
