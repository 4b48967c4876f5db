"""Rigid water beside LAMMPS and OpenMM: docs/reports/heat.md.

    python benchmarks/molecules.py dimer [--write]           two waters against their known end after 1 ps
    python benchmarks/molecules.py box [--write]             216 waters: how much their energy fluctuates; waters.png
    python benchmarks/molecules.py speed [--write]           216 and 1,728 waters: the time of a step
    python benchmarks/molecules.py equipartition [--write]   temperatures of rotation and translation

Needs `pip install 'midlie_jax[bench-molecules]'`. Times are processor times on one core; programs that are
compared take turns. `equipartition --minutes 35` goes on with the runs in `--kept`, a file, before it shows what they
say.
"""

from pathlib import Path

import one_core  # noqa: F401
from harness import main
from laboratory.molecules import box, dimer

PARTS = {
    "dimer": dimer.TABLE,
    "box": box.energies,
    "speed": box.SPEED,
    "equipartition": box.equipartition,
}
ARGUMENTS = {
    "--minutes": {"type": float, "default": 0.0, "help": "how long the runs of equipartition go on"},
    "--kept": {"type": Path, "default": Path("equipartition.npz"), "help": "the file with these runs"},
}

if __name__ == "__main__":
    main(__doc__, PARTS, ARGUMENTS)
