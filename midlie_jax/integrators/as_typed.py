"""`midlie_jax.flights` and `midlie_jax.schemes` for type checkers, which do not support callable modules.

At run time both are modules, and these classes are never used. `tests/test_schemes.py` compares the names in both.
"""

from . import scheme_order, stages
from .listing import Listing


class _Flights(type):
    def __call__(cls) -> Listing:
        """The names of the flights, best first; the list prints as a table of when to use each flight."""
        raise NotImplementedError


class _Schemes(type):
    def __call__(cls) -> Listing:
        """The names of the schemes, best first; the list prints as a table of when to use each scheme."""
        raise NotImplementedError


class flights(metaclass=_Flights):  # noqa: N801  (the name of the module)
    """The module `midlie_jax.flights`."""

    from .flights import FLIGHTS as FLIGHTS
    from .flights import Flight as Flight
    from .flights import Inertia as Inertia
    from .flights import Jacobi as Jacobi
    from .flights import LieMidpoint as LieMidpoint
    from .flights import Linear as Linear
    from .flights import MoserVeselov as MoserVeselov
    from .flights import MoserVeselov4 as MoserVeselov4
    from .flights import MoserVeselov6 as MoserVeselov6
    from .flights import NearSymmetric as NearSymmetric
    from .flights import Symmetric as Symmetric
    from .flights import SymplecticMidpoint as SymplecticMidpoint
    from .flights import SymplecticMidpoint4 as SymplecticMidpoint4
    from .flights import ThreeAxis as ThreeAxis
    from .flights import components as components
    from .flights import short_series as short_series


class schemes(metaclass=_Schemes):  # noqa: N801  (the name of the module)
    """The module `midlie_jax.schemes`."""

    from .schemes import ABA82 as ABA82
    from .schemes import ABA1064 as ABA1064
    from .schemes import ABADABA as ABADABA
    from .schemes import ABOBA as ABOBA
    from .schemes import BADAB as BADAB
    from .schemes import BAOAB as BAOAB
    from .schemes import BATH as BATH
    from .schemes import BM4 as BM4
    from .schemes import CHIN4A as CHIN4A
    from .schemes import E1 as E1
    from .schemes import E2 as E2
    from .schemes import EA as EA
    from .schemes import EA_STAR as EA_STAR
    from .schemes import FLIGHT as FLIGHT
    from .schemes import KAHAN_LI6 as KAHAN_LI6
    from .schemes import KAHAN_LI8 as KAHAN_LI8
    from .schemes import KICK as KICK
    from .schemes import OBABO as OBABO
    from .schemes import RKN8 as RKN8
    from .schemes import RKN8G as RKN8G
    from .schemes import SCHEMES as SCHEMES
    from .schemes import SRKN6B as SRKN6B
    from .schemes import SRKN11B as SRKN11B
    from .schemes import SRKN14A as SRKN14A
    from .schemes import SUZUKI as SUZUKI
    from .schemes import SUZUKI_UMENO8 as SUZUKI_UMENO8
    from .schemes import TAKAHASHI_IMADA as TAKAHASHI_IMADA
    from .schemes import TAKAHASHI_IMADA_PROCESSOR as TAKAHASHI_IMADA_PROCESSOR
    from .schemes import TRIPLE as TRIPLE
    from .schemes import YOSHIDA6 as YOSHIDA6
    from .schemes import Scheme as Scheme

    measured_order = staticmethod(scheme_order.measured_order)
    measured_weak_order = staticmethod(scheme_order.measured_weak_order)
    run = staticmethod(stages.run)
