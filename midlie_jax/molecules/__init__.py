"""Molecule files: initial states from files of other programs, and trajectories for OVITO and VMD.

`read` needs the extra `molecules` (ase), `write_xyz` nothing. Lengths are in nm, times in ps, masses in amu.
"""

from .read import Molecules as Molecules
from .read import read as read
from .write import write_xyz as write_xyz
