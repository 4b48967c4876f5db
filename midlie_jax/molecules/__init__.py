"""Molecules and rods. In files, lengths are in nm, times in ps, masses in amu; `read` needs the extra `molecules`
(ase).
"""

from .._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
