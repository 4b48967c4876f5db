"""Asteroids: light curves, sunlight, mutual gravity, and tumbling described by periods and a pole."""

from .brightness import Brightness as Brightness
from .brightness import EllipsoidBrightness as EllipsoidBrightness
from .brightness import Lambert as Lambert
from .brightness import LommelSeeliger as LommelSeeliger
from .brightness import Scattering as Scattering
from .brightness import Sunlight as Sunlight
from .mutual_gravity import MutualGravity as MutualGravity
from .photometry import Photometry as Photometry
from .tides import SolarTide as SolarTide
from .tides import TidalDissipation as TidalDissipation
from .tumbling_motion import Tumble as Tumble
from .tumbling_motion import tumble as tumble
from .tumbling_motion import tumbling as tumbling
from .tumbling_motion import tumblings as tumblings
