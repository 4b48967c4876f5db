"""Orbits, and magnetic fields along an orbit: inputs of torques and step densities.

`base` defines the interface. `circular`, `kepler` (with `elements`) and `table` have orbits, `dipole` and `table` have
fields. `units` scales their numbers to about one.
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
