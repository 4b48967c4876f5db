"""Spins on lattices: what methods keep, spin waves, rivals, walls and skyrmions: docs/reports/heat.md.

    python benchmarks/spins.py conservation [--write]  energy, total spin and lengths in runs of a chain
    python benchmarks/spins.py area [--write]          symplectic defects of one step; spins-area.png
    python benchmarks/spins.py dispersion [--write]    spin waves beside their closed form; spins-waves.png
    python benchmarks/spins.py lattice [--write]       steps a second of a million spins, beside a copy of them
    python benchmarks/spins.py rivals [--write]        error against time, beside Spirit; spins-rivals.png
    python benchmarks/spins.py wall [--write]          a domain wall in a field, beside Walker; spins-wall.png
    python benchmarks/spins.py skyrmion [--write]      a skyrmion beside Thiele; spins-skyrmion.png, skyrmion.gif

Times are processor times on one core; programs that are compared take turns. Spirit is measured if it is installed:
`pip install spirit`.
"""

import one_core  # noqa: F401
from harness import main
from laboratory.spins import kept, moving, rivals

PARTS = {
    "conservation": kept.CONSERVATION,
    "area": kept.area,
    "dispersion": kept.dispersion,
    "lattice": rivals.LATTICE,
    "rivals": rivals.measure,
    "wall": moving.wall,
    "skyrmion": moving.skyrmion,
}

if __name__ == "__main__":
    main(__doc__, PARTS)
