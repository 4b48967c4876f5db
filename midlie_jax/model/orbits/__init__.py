"""Orbits, and magnetic fields along an orbit: inputs of torques and step densities.

`base` defines the interface. `circular`, `kepler` (with `elements`) and `table` have orbits, `dipole` and `table` have
fields. `units` scales their numbers to about one.
"""

from .base import Orbit as Orbit
from .circular import CircularOrbit as CircularOrbit
from .dipole import DipoleField as DipoleField
from .kepler import KeplerOrbit as KeplerOrbit
from .table import TableField as TableField
from .table import TableOrbit as TableOrbit
