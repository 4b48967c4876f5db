"""The registry of all methods by name, from which tests, charts and benchmarks select methods by their properties."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Literal, NamedTuple, overload

from .._checks.arguments import described, unknown
from ..model.bodies import Body, RigidBody, principal_of
from .base import Method
from .brownian import Brownian
from .flights import FLIGHTS, Flight
from .implicit import AKW, SW, ImplicitMidpoint, LieMidpointImplicit, NewmarkBody
from .listing import Listing
from .runge_kutta import DOP853, GBS8, GBS10, GBS12, PGBS8, PGBS12, RK4
from .schemes import SCHEMES, Scheme
from .spiral import Spiral
from .splitting import Splitting


class Entry(NamedTuple):
    """A method that `midlie_jax.methods()` shows."""

    method: Method
    use: str  # when to use the method
    paper: bool = False  # whether the method is one of the rigid-body methods of Krysl 2004
    # whether the method was published later, for the same purpose, and is compared with the methods of the paper
    rival: bool = False
    # whether charts of error against cost include the method; they always include the exact flight with the leading
    # schemes
    chart: bool = False


def _entry(pair: str, use: str, name: str | None = None, **options: bool) -> Entry:
    """The entry of a FLIGHT[SCHEME]."""
    flight, scheme = pair.removesuffix("]").split("[")
    return Entry(Splitting(FLIGHTS[flight], SCHEMES[scheme], name or pair), use, **options)


DEFAULT = "JACOBI[EA]"
# Applications with methods of their own. Such a module has `ENTRIES`, and `FAMILIES`: by name, classes of methods that
# are made from a scheme.
_ROOMS = ("midlie_jax.spins.methods",)
ENTRIES: dict[str, Entry] = {
    entry.method.name: entry
    for entry in (  # best first
        _entry("JACOBI[EA]", "any body, any torque, up to three digits: start here"),
        _entry("JACOBI[SRKN6b]", "any body, four to six digits"),
        _entry("JACOBI[SRKN14a]", "any body, six digits and more, also over long runs"),
        _entry("JACOBI[RKN8]", "any body, seven digits and more, also over long runs"),
        _entry("JACOBI[CHIN4A]", "any body, three to five digits, torque from a potential"),
        _entry(
            "SYMMETRIC[EA]",
            "two equal moments, up to three digits: 3 times faster than JACOBI, 6 times on an AxisState",
        ),
        _entry("SYMMETRIC[SRKN6b]", "two equal moments, four to six digits"),
        _entry("SYMMETRIC[SRKN14a]", "two equal moments, six digits and more"),
        _entry("SYMMETRIC[RKN8G]", "fast tops, nine digits and more"),
        _entry("SYMMETRIC[ABA1064]", "fast tops in weak fields, high accuracy"),
        Entry(GBS12, "short runs under a strong torque, any accuracy; preserves no structure", chart=True),
        Entry(PGBS12, "GBS12 that conserves the energy to rounding, torque from a potential", chart=True),
        Entry(PGBS8, "GBS8 that conserves the energy to rounding, torque from a potential", chart=True),
        Entry(DOP853, "comparison: Dormand and Prince's method of order 8; preserves no structure", chart=True),
        Entry(GBS8, "comparison: GBS12 with fewer substeps, order 8; preserves no structure", chart=True),
        Entry(GBS10, "comparison: GBS12 with fewer substeps, order 10; preserves no structure", chart=True),
        _entry("SLIEMID4[SRKN6b]", "comparison: order 4 without an exact flight"),
        _entry("SLIEMID[EA]", "comparison: the paper's method made symplectic"),
        _entry("NEARSYM[EA]", "first two moments nearly equal, up to three digits"),
        _entry("DLM[EA]", "comparison: the usual splitting of molecular dynamics", chart=True),
        _entry("DLM[KL8]", "comparison: the DLM splitting, composed to order 8", chart=True),
        _entry("DMV[EA]", "comparison: the discrete Moser-Veselov body"),
        _entry("LIEMID[E1]", "the paper's first Euler method, a flight and then a kick: order 1", paper=True),
        _entry("LIEMID[E2]", "the paper's second Euler method, a kick and then a flight: order 1", paper=True),
        _entry(
            "LIEMID[EA]", "the paper's alternating method: order 2, explicit, not symplectic", paper=True, chart=True
        ),
        Entry(LieMidpointImplicit(), "the paper's implicit midpoint rule, torque at mid-step", paper=True),
        Entry(AKW(), "Austin, Krishnaprasad and Wang's implicit rule, as in the paper", paper=True),
        Entry(SW(), "Simo and Wong's conserving implicit rule, as in the paper", paper=True),
        Entry(
            NewmarkBody(), "explicit Newmark in the body frame, as in the paper; spatial momentum drifts", paper=True
        ),
        _entry("LIEMID[EA*]", "the paper's alternating method with the kick at mid-step", paper=True),
        Entry(
            Spiral(),
            "comparison: the leapfrog of the discrete element method, as in Yade; preserves nothing",
            rival=True,
        ),
        _entry(
            "JACOBI[BADAB]",
            "CHIN4A for a torque that cannot be differentiated, three to five digits; not symplectic",
            rival=True,
        ),
        Entry(RK4, "comparison: the classical Runge-Kutta method; preserves no structure", chart=True),
        _entry("linear[EA]", "particles: order 2, symplectic", "Verlet"),
        _entry("linear[EA*]", "particles: Verlet with the force at mid-step", "position Verlet"),
        _entry("linear[E2]", "particles: order 1, symplectic", "symplectic Euler"),
        _entry("linear[E1]", "particles: the adjoint of symplectic Euler", "adjoint symplectic Euler"),
        Entry(ImplicitMidpoint(), "particles under stiff forces: order 2, implicit"),
    )
}

# Methods that need a heat bath, and whose order is weak.
_RANDOM = {"BROWNIAN": Entry(Brownian(), "strong friction: overdamped motion in a heat bath; weak order 2")}

_ANY_PAIR = f"Any FLIGHT[SCHEME] is a method; flights: {', '.join(FLIGHTS)}; schemes: {', '.join(SCHEMES)}."


def entries() -> dict[str, Entry]:
    """All methods by name: `ENTRIES`, the methods that need a bath, and the methods of the applications."""
    return ENTRIES | _RANDOM | {entry.method.name: entry for room in _ROOMS for entry in import_module(room).ENTRIES}


def families() -> dict[str, Callable[[Scheme], Method]]:
    return {name: family for room in _ROOMS for name, family in import_module(room).FAMILIES.items()}


@overload
def method(name: Literal["SUBLATTICES"], scheme: str | Scheme) -> Method: ...  # pyright: ignore[reportOverlappingOverload]
@overload
def method(name: str | Flight, scheme: str | Scheme) -> Splitting: ...
@overload
def method(name: str | Flight, scheme: None = None) -> Method: ...
def method(name: str | Flight, scheme: str | Scheme | None = None) -> Method:
    """An integrator, from its name, or from a flight and a scheme.

    `ml.method("SLIEMID4[SRKN6b]")`, `ml.method("SLIEMID4", "SRKN6b")` and `ml.method(ml.flights.SymplecticMidpoint4(),
    ml.schemes.SRKN6B)` return the same method. The order of a FLIGHT[SCHEME] is the lower of the orders of flight and
    scheme. Schemes that compose whole steps (TJ4, S4, Y6, KL6, SU8, KL8) reach their own order even with a flight of
    lower order.

    Raises:
        ValueError: a name is unknown (the message suggests the nearest name and lists all), a flight comes without a
            scheme, an argument is neither a name nor a midlie_jax Flight or Scheme, or a custom flight has the name of
            one of this package.

    Examples:
        >>> method = ml.method("JACOBI[SRKN6b]")
        >>> method.name, method.order
        ('JACOBI[SRKN6b]', 4)
        >>> ml.method(ml.flights.Jacobi(), ml.schemes.SRKN6B) == method
        True
    """
    for what, value, kinds in (("name", name, (str, Flight)), ("scheme", scheme, (str, Scheme, type(None)))):
        if not isinstance(value, kinds):
            choose = " or ".join(f"a midlie_jax {kind.__name__}" if kind is not str else "a name" for kind in kinds[:2])
            raise ValueError(f"{what} must be {choose}, got {described(value)}.")
    if scheme is None:
        name = name if isinstance(name, str) else name.name
        if name in ENTRIES:
            return ENTRIES[name].method
        flight, bracket, rest = name.partition("[")
        if flight not in FLIGHTS and name in (known := entries()):
            return known[name].method
        if not bracket and name in (*FLIGHTS, *families()):
            raise ValueError(f"{name!r} is a flight; add a scheme, as in '{name}[EA]', of {', '.join(SCHEMES)}.")
        if not bracket or not rest.endswith("]"):
            more = [f"{flight}[{scheme}]" for flight in FLIGHTS for scheme in SCHEMES]
            raise unknown("method", name, entries(), more=more, note=_ANY_PAIR)
        name, scheme = flight, rest.removesuffix("]")
    if isinstance(name, str) and name not in FLIGHTS and name not in (made := families()):
        raise unknown("flight", name, (*FLIGHTS, *made))
    if isinstance(scheme, str) and scheme not in SCHEMES:
        raise unknown("scheme", scheme, SCHEMES)
    table = SCHEMES[scheme] if isinstance(scheme, str) else scheme
    if isinstance(name, str) and name not in FLIGHTS:
        return families()[name](table)
    flight = FLIGHTS[name] if isinstance(name, str) else name
    if flight.name in FLIGHTS and type(flight) is not type(FLIGHTS[flight.name]):
        raise ValueError(f"flight {flight.name!r}: midlie_jax has a flight of this name; choose another name.")
    splitting = Splitting(flight, table, f"{flight.name}[{table.name}]")
    known = ENTRIES.get(splitting.name)
    return known.method if known is not None and known.method == splitting else splitting


def methods() -> Listing:
    """The names of the methods, best first; the list prints as a table of when to use each method.

    Any FLIGHT[SCHEME] of `midlie_jax.flights.names()` and `midlie_jax.schemes.names()` is also a method.

    Examples:
        >>> ml.methods()[:3]
        ['JACOBI[EA]', 'JACOBI[SRKN6b]', 'JACOBI[SRKN14a]']
        >>> ml.method("NEARSYM[SU8]").order  # any FLIGHT[SCHEME] is also a method
        8
    """
    note = "Any FLIGHT[SCHEME] of midlie_jax.flights.names() and midlie_jax.schemes.names() is also a method."
    return Listing({name: entry.use for name, entry in entries().items()}, note)


def paper_methods() -> list[Method]:
    """The methods for rigid bodies of Krysl 2004, the seven of its Figure 1 first."""
    return [entry.method for entry in ENTRIES.values() if entry.paper]


def methods_of_figure_1() -> list[Method]:
    """`paper_methods` and their later alternatives."""
    return [*paper_methods(), *(entry.method for entry in ENTRIES.values() if entry.rival)]


def exact_flight(body: Body) -> Flight:
    """The fastest exact flight for the rotation of a rigid body or a `SymmetricRotor`, which may translate."""
    turning: Any = principal_of(body).turning
    exact = [flight for flight in FLIGHTS.values() if isinstance(turning, flight.bodies) and flight.order is None]
    fastest_first = sorted(exact, key=lambda flight: not flight.equal_moments)
    return next(f for f in fastest_first if not isinstance(turning, RigidBody) or f.moves(turning.moments))
