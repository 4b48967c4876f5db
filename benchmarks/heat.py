"""Bodies in a heat bath: errors of known averages, costs, and the spectrum of a nanodumbbell: docs/reports/heat.md.

    python benchmarks/heat.py dipole [--write]         a dipole in a field, beside diffrax; heat-averages.png
    python benchmarks/heat.py cost [--write]           what a step in a bath costs beside a step of EA
    python benchmarks/heat.py dumbbell [--write]       a nanodumbbell in polarised light; dumbbell-spectrum.png
    python benchmarks/heat.py correlations [--write]   how a sphere forgets its velocity and direction
    python benchmarks/heat.py temperature [--write]    free rotors keep their temperature, whatever is saved
    python benchmarks/heat.py diffusion [--write]      how much too fast free bodies diffuse at long steps
    python benchmarks/heat.py brownian [--write]       a dipole under strong friction, by BROWNIAN and others

Times are processor times on one core; programs that are compared take turns. `dipole --seconds 400` measures for some
time only; the next call goes on with the runs in `--kept`, a file.
"""

import math
from pathlib import Path

import one_core  # noqa: F401
from harness import main
from laboratory.heat import dipole, dumbbell, known

PARTS = {
    "dipole": dipole.measure,
    "cost": dipole.COST,
    "dumbbell": dumbbell.measure,
    "correlations": known.correlations,
    "temperature": known.TEMPERATURE,
    "diffusion": known.DIFFUSION,
    "brownian": known.BROWNIAN,
}
ARGUMENTS = {
    "--seconds": {"type": float, "default": math.inf, "help": "after which dipole measures nothing more"},
    "--kept": {"type": Path, "default": Path("heat-dipole.json"), "help": "the file with the runs of dipole"},
}

if __name__ == "__main__":
    main(__doc__, PARTS, ARGUMENTS)
