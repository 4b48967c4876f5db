"""The same lattice in Spirit (G. P. Mueller et al., Phys. Rev. B 99, 2019, 224414): `pip install spirit`.

Spirit measures energies in meV, fields in T and times in ps. A spin has the moment of one Bohr magneton, so that with
J = 1 meV the time 1/J of our units is mu_B/gamma. Spirit rounds its time step to float32, which changes the time that
is reached by a share of 1e-8.
"""

import contextlib
import os
import tempfile
from collections.abc import Callable, Generator
from importlib.util import find_spec
from typing import Any

import numpy as np

SOLVERS = {"Spirit, Depondt": 2, "Spirit, SIB": 1, "Spirit, RK4": 4}


def installed() -> bool:
    return find_spec("spirit") is not None


@contextlib.contextmanager
def lattice(shape: tuple[int, int]) -> Generator[Any]:
    """A square lattice of Spirit with exchange J = 1 between nearest neighbours, periodic, without anything else."""
    from spirit import geometry, hamiltonian, state  # pyright: ignore[reportMissingImports]
    from spirit.parameters import llg  # pyright: ignore[reportMissingImports]

    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        _quiet(),
        state.State("", quiet=True) as own,
    ):
        geometry.set_mu_s(own, 1.0)
        geometry.set_n_cells(own, [*shape, 1])
        hamiltonian.set_boundary_conditions(own, [True, True, False])
        hamiltonian.set_field(own, 0.0, [0, 0, 1])
        hamiltonian.set_anisotropy(own, 0.0, [0, 0, 1])
        hamiltonian.set_exchange(own, 1, [1.0])
        hamiltonian.set_dmi(own, 0, [])
        hamiltonian.set_ddi(own, 0)
        llg.set_damping(own, 0.0)
        llg.set_temperature(own, 0.0)
        llg.set_convergence(own, 0.0)
        llg.set_output_general(own, any=False, initial=False, final=False)
        yield own


@contextlib.contextmanager
def _quiet() -> Generator[None]:
    """What a library of C++ writes to the terminal goes nowhere."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(nowhere)
        os.close(kept)


def runner(own: Any, solver: str, start: np.ndarray, dt: float, steps: int) -> Callable[[], np.ndarray]:
    """A run from spins (n, m, 3), which returns those at its end."""
    from spirit import constants, simulation, system  # pyright: ignore[reportMissingImports]
    from spirit.parameters import llg  # pyright: ignore[reportMissingImports]

    # Spirit's first index is the fastest, which is our last one.
    begin = np.swapaxes(start, 0, 1).reshape(-1, 3)

    def run() -> np.ndarray:
        llg.set_timestep(own, dt * constants.mu_B / constants.gamma)
        system.get_spin_directions(own)[:] = begin
        simulation.start(own, simulation.METHOD_LLG, SOLVERS[solver], single_shot=True)
        simulation.n_shot(own, steps)
        simulation.stop(own)
        n, m = start.shape[:2]
        return np.swapaxes(system.get_spin_directions(own).reshape(m, n, 3), 0, 1).copy()

    return run
