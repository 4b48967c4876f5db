"""Molecules and rods: bodies from points, forces between sites in a box, molecule files, elastic rods.

`read` needs the extra `molecules` (ase), `write_xyz` nothing. In files, lengths are in nm, times in ps, masses in
amu.
"""

from .boxes import Pressure as Pressure
from .boxes import integrate as integrate
from .files import Molecules as Molecules
from .files import read as read
from .files import write_xyz as write_xyz
from .neighbours import Neighbours as Neighbours
from .pair_forces import PairForces as PairForces
from .points import from_points as from_points
from .points import sites as sites
from .points import wrench_on_sites as wrench_on_sites
from .rods import Rod as Rod
from .rods import StraightRod as StraightRod
from .rods import straight_rod as straight_rod
