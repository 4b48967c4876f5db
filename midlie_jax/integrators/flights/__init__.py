"""Flights: maps for the torque-free motion of a body for a time h, exact or approximate.

A flight is called with the constants of the body, the time and the momentum. It returns the rotation of the body, the
change of its momentum, and whether the result is valid. To add a flight to the package, write one file and add the
class here; to write one, use the arithmetic of `components` and `short_series` (`docs/extending.md`).
"""

from ..._math import components as components
from ..._math import short_series as short_series
from ...model.inertia import Inertia as Inertia
from ..listing import Listing
from .base import Flight as Flight
from .base import Linear as Linear
from .jacobi import Jacobi as Jacobi
from .lie_midpoint import LieMidpoint as LieMidpoint
from .moser_veselov import MoserVeselov as MoserVeselov
from .moser_veselov import MoserVeselov4 as MoserVeselov4
from .moser_veselov import MoserVeselov6 as MoserVeselov6
from .rotations import NearSymmetric as NearSymmetric
from .rotations import ThreeAxis as ThreeAxis
from .symmetric import Symmetric as Symmetric
from .symplectic_midpoint import SymplecticMidpoint as SymplecticMidpoint
from .symplectic_midpoint import SymplecticMidpoint4 as SymplecticMidpoint4

FLIGHTS: dict[str, Flight] = {
    kind.name: kind()
    for kind in (  # best first
        *(Jacobi, Symmetric, SymplecticMidpoint4, ThreeAxis, MoserVeselov, NearSymmetric, SymplecticMidpoint),
        *(MoserVeselov6, MoserVeselov4, LieMidpoint, Linear),
    )
}


def names() -> Listing:
    """The names of the flights, best first; the list prints as a table of when to use each flight.

    Examples:
        >>> ml.flights.names()[:2]
        ['JACOBI', 'SYMMETRIC']
    """
    return Listing({name: flight.use for name, flight in FLIGHTS.items()})
