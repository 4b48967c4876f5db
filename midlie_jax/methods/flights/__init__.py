"""Free flights: what a body does in time h under no torque, exactly or nearly. One flight, one file.

A flight is called with the body's constants, the time and the momentum, and returns the rotation it made, the
new momentum, and whether its numbers can be trusted. What carries the orientation is not its business.
"""

from ..inertia import Inertia as Inertia
from .base import Flight as Flight
from .jacobi import Jacobi as Jacobi
from .lie_midpoint import LieMidpoint as LieMidpoint
from .linear import Linear as Linear
from .moser_veselov import MoserVeselov as MoserVeselov
from .moser_veselov import MoserVeselov4 as MoserVeselov4
from .moser_veselov import MoserVeselov6 as MoserVeselov6
from .near_symmetric import NearSymmetric as NearSymmetric
from .symmetric import Symmetric as Symmetric
from .symplectic_midpoint import SymplecticMidpoint as SymplecticMidpoint
from .symplectic_midpoint import SymplecticMidpoint4 as SymplecticMidpoint4
from .three_axis import ThreeAxis as ThreeAxis
