"""Molecules and rods: bodies from points, forces on their sites, molecule files, elastic rods of coupled bodies.

`read` needs the extra `molecules` (ase), `write_xyz` nothing. In files, lengths are in nm, times in ps, masses in
amu.
"""

from .._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
