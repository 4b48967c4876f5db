"""Every method by name, once. Laws, charts and benchmarks choose from here by what a method is, never by its name."""

from typing import NamedTuple, overload

from jax import Array

from .._kernel.checks import described, unknown
from ..model.bodies import RigidBody
from . import flights, schemes
from .base import Method
from .flights import FLIGHTS, Flight
from .implicit import AKW, SW, ImplicitMidpoint, LieMidpointImplicit, NewmarkBody
from .listing import Listing
from .runge_kutta import DOP853, RK4
from .schemes import SCHEMES, Scheme
from .splitting import Splitting


class Entry(NamedTuple):
    """A method that `midlie_jax.methods()` shows.

    Attributes:
        method: the method.
        use: when to take it.
        paper: whether it is one of the methods for rigid bodies of Krysl 2004, which its Figure 1 compares.
        chart: whether charts of error against cost show it, beside the exact flight with the leading schemes.
    """

    method: Method
    use: str
    paper: bool = False
    chart: bool = False


def _split(flight: Flight, scheme: Scheme, use: str, name: str | None = None, *, chart: bool = False) -> Entry:
    return Entry(Splitting(flight, scheme, name or f"{flight.name}[{scheme.name}]"), use, chart=chart)


def _paper(scheme: Scheme, use: str, **options: bool) -> Entry:
    return _split(flights.LieMidpoint(), scheme, use)._replace(paper=True, **options)


_PARTICLES = flights.Linear()
DEFAULT = "JACOBI[EA]"
ENTRIES: dict[str, Entry] = {
    entry.method.name: entry
    for entry in (  # best first
        _split(flights.Jacobi(), schemes.EA, "any body, any torque, up to three digits: start here"),
        _split(flights.Jacobi(), schemes.SRKN6B, "any body, four to six digits"),
        _split(flights.Jacobi(), schemes.SRKN14A, "any body, six digits and more, or long runs to them"),
        _split(flights.Jacobi(), schemes.CHIN4A, "any body, three to five digits, torque from a potential"),
        _split(flights.Symmetric(), schemes.EA, "two equal moments, up to three digits: three times as fast as JACOBI"),
        _split(flights.Symmetric(), schemes.SRKN6B, "two equal moments, four to six digits"),
        _split(flights.Symmetric(), schemes.SRKN14A, "two equal moments, six digits and more"),
        _split(flights.Symmetric(), schemes.ABA1064, "fast tops in weak fields, to many digits"),
        Entry(DOP853, "short runs to many digits under a strong torque; keeps no structure", chart=True),
        _split(flights.SymplecticMidpoint4(), schemes.SRKN6B, "comparison: order 4 without an exact flight"),
        _split(flights.SymplecticMidpoint(), schemes.EA, "comparison: the paper's method made symplectic"),
        _split(flights.NearSymmetric(), schemes.EA, "first two moments nearly equal, up to three digits"),
        _split(flights.ThreeAxis(), schemes.EA, "comparison: the usual splitting of molecular dynamics", chart=True),
        _split(flights.ThreeAxis(), schemes.KAHAN_LI8, "comparison: the same, composed to order 8", chart=True),
        _split(flights.MoserVeselov(), schemes.EA, "comparison: the discrete Moser-Veselov body"),
        _paper(schemes.E1, "the paper's flight, then a kick: order 1"),
        _paper(schemes.E2, "a kick, then the paper's flight: order 1"),
        _paper(schemes.EA, "the paper's alternating method: order 2, explicit, not symplectic", chart=True),
        Entry(LieMidpointImplicit(), "the paper's implicit midpoint rule, torque half way", paper=True),
        Entry(AKW(), "Austin, Krishnaprasad and Wang's implicit rule, as in the paper", paper=True),
        Entry(SW(), "Simo and Wong's conserving implicit rule, as in the paper", paper=True),
        Entry(
            NewmarkBody(), "explicit Newmark in the body frame, as in the paper; spatial momentum drifts", paper=True
        ),
        _paper(schemes.EA_STAR, "the paper's alternating method, cut the other way"),
        Entry(RK4, "comparison: the classical Runge-Kutta method; keeps no structure", chart=True),
        _split(_PARTICLES, schemes.EA, "particles: order 2, symplectic", "Verlet"),
        _split(_PARTICLES, schemes.EA_STAR, "particles: Verlet with the force half way", "position Verlet"),
        _split(_PARTICLES, schemes.E2, "particles: order 1, symplectic", "symplectic Euler"),
        _split(_PARTICLES, schemes.E1, "particles: the adjoint of symplectic Euler", "adjoint symplectic Euler"),
        Entry(ImplicitMidpoint(), "particles under stiff forces: order 2, implicit"),
    )
}

_ANY = f"Any FLIGHT[SCHEME] is a method, of the flights {', '.join(FLIGHTS)} and the schemes {', '.join(SCHEMES)}."


@overload
def method(name: str | Flight, scheme: str | Scheme) -> Splitting: ...
@overload
def method(name: str | Flight, scheme: None = None) -> Method: ...
def method(name: str | Flight, scheme: str | Scheme | None = None) -> Method:
    """An integrator: by its name, as "FLIGHT[SCHEME]", or from the two parts.

    `ml.method("SLIEMID4[SRKN6b]")`, `ml.method("SLIEMID4", "SRKN6b")` and
    `ml.method(ml.flights.SymplecticMidpoint4(), ml.schemes.SRKN6B)` are the same. Its order is the lower of the
    flight's and the scheme's; compositions of a whole step (TJ4, S4, Y6, KL6, SU8, KL8) raise that of the flight, too.
    "RK4" and "DOP853" are Runge-Kutta methods that keep no structure, for comparison and for short runs to many digits.

    Raises:
        ValueError: unknown name; the message has the nearest and all.
    """
    for what, given, kinds in (("name", name, (str, Flight)), ("scheme", scheme, (str, Scheme, type(None)))):
        if not isinstance(given, kinds):
            choose = " or ".join(f"a midlie_jax {kind.__name__}" if kind is not str else "a name" for kind in kinds[:2])
            raise ValueError(f"{what} must be {choose}, got {described(given)}.")
    if scheme is None:
        name = name if isinstance(name, str) else name.name
        if name in ENTRIES:
            return ENTRIES[name].method
        flight, bracket, rest = name.partition("[")
        if name in FLIGHTS:
            raise ValueError(f"{name!r} is a flight; add a scheme, as in '{name}[EA]', of {', '.join(SCHEMES)}.")
        if not bracket or not rest.endswith("]"):
            more = [f"{flight}[{scheme}]" for flight in FLIGHTS for scheme in SCHEMES]
            raise unknown("method", name, ENTRIES, more=more, note=_ANY)
        name, scheme = flight, rest.removesuffix("]")
    for kind, part, known in (("flight", name, FLIGHTS), ("scheme", scheme, SCHEMES)):
        if isinstance(part, str) and part not in known:
            raise unknown(kind, part, known)
    flight = FLIGHTS[name] if isinstance(name, str) else name
    table = SCHEMES[scheme] if isinstance(scheme, str) else scheme
    made = Splitting(flight, table, f"{flight.name}[{table.name}]")
    known = ENTRIES.get(made.name)
    return known.method if known is not None and known.method == made else made


def methods() -> Listing:
    """The names of the methods, those to take first; printed, it says when to take each.

    Any FLIGHT[SCHEME] of `midlie_jax.flights()` and `midlie_jax.schemes()` is a method, too.
    """
    note = "Any FLIGHT[SCHEME] of midlie_jax.flights() and midlie_jax.schemes() is a method, too."
    return Listing({name: entry.use for name, entry in ENTRIES.items()}, note)


def paper_methods() -> list[Method]:
    """The methods for rigid bodies of Krysl 2004, the seven of its Figure 1 first."""
    return [entry.method for entry in ENTRIES.values() if entry.paper]


def exact_flight(moments: Array) -> Flight:
    """The fastest flight that is exact for a rigid body of these moments, (3,)."""
    exact = [flight for flight in FLIGHTS.values() if flight.body is RigidBody and flight.order is None]
    return next(flight for flight in sorted(exact, key=lambda f: not f.equal_moments) if flight.moves(moments))
