"""Classical spins on lattices: states, fields on spins, a thermal field, and methods."""

from .fields import Anisotropy as Anisotropy
from .fields import AppliedField as AppliedField
from .fields import CubicAnisotropy as CubicAnisotropy
from .fields import DzyaloshinskiiMoriya as DzyaloshinskiiMoriya
from .fields import Exchange as Exchange
from .fields import OwnField as OwnField
from .fields import SpinField as SpinField
from .state import Spins as Spins
from .state import SpinState as SpinState
from .state import checkerboard as checkerboard
from .thermal_field import ThermalField as ThermalField
