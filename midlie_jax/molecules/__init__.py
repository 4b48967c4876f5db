"""Files of molecules: a start from what other programs write, and trajectories for OVITO and VMD.

`read` needs the extra `molecules` (ase), `write_xyz` nothing. Lengths are nm, times ps, masses amu.
"""

from .read import Molecules as Molecules
from .read import read as read
from .write import write_xyz as write_xyz
