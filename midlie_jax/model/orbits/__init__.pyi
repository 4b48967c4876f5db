from .base import Orbit as Orbit
from .circular import CircularOrbit as CircularOrbit
from .circular import DipoleField as DipoleField
from .kepler import KeplerOrbit as KeplerOrbit
from .table import TableField as TableField
from .table import TableOrbit as TableOrbit
