"""Classical spins on lattices: states, fields on spins, a thermal field, and methods."""

from .body import Spins as Spins
from .body import checkerboard as checkerboard
from .fields import Anisotropy as Anisotropy
from .fields import AppliedField as AppliedField
from .fields import CubicAnisotropy as CubicAnisotropy
from .fields import OwnField as OwnField
from .fields import SpinField as SpinField
from .neighbours import DzyaloshinskiiMoriya as DzyaloshinskiiMoriya
from .neighbours import Exchange as Exchange
from .state import SpinState as SpinState
from .thermal_field import ThermalField as ThermalField
