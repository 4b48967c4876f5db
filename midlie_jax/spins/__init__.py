"""Classical spins on lattices: states, fields on spins, a thermal field, and methods."""

from .._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
