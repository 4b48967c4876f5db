"""Free flights: what a body does in time h under no torque, exactly or nearly. One flight, one file, one line here.

A flight is called with the body's constants, the time and the momentum, and returns the rotation that the body made,
the change of its momentum, and whether its numbers can be trusted. How the orientation is stored is the business of
states. `midlie_jax.flights()` lists the flights, best first. To write one, take the arithmetic of `components` and
`short_series` (`docs/extending.md`).
"""

import sys
from types import ModuleType

from ..._kernel import components as components
from ..._kernel import short_series as short_series
from ...model.bodies import RigidBody
from ..inertia import Inertia as Inertia
from ..listing import Listing
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


def _better_first(flight: Flight) -> tuple[bool, bool, bool, int, str]:
    """Rigid bodies first, then symplectic before others, exact before approximate, for any body before for some."""
    return (
        flight.body is not RigidBody,
        not flight.symplectic,
        flight.equal_moments if flight.order is None else True,
        -(flight.order or 99),
        flight.name,
    )


_KINDS = [kind for kind in list(globals().values()) if isinstance(kind, type) and issubclass(kind, Flight)]
FLIGHTS: dict[str, Flight] = {
    flight.name: flight for flight in sorted((kind() for kind in _KINDS if kind is not Flight), key=_better_first)
}


class _Callable(ModuleType):
    """`midlie_jax.flights()` beside `midlie_jax.flights.Jacobi`."""

    def __call__(self) -> Listing:
        """The names of the flights, best first, with when to take each."""
        return Listing({name: flight.use for name, flight in FLIGHTS.items()})


sys.modules[__name__].__class__ = _Callable
