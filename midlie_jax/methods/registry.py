"""Every method by name. A new one is a line here, and every law test, chart and benchmark picks it up."""

from .._kernel.checks import described, unknown
from . import flights, schemes
from .base import Method
from .flights import Flight, LieMidpoint, Linear
from .implicit import AKW, SW, ImplicitMidpoint, LieMidpointImplicit, NewmarkBody
from .runge_kutta import DOP853, RK4
from .schemes import SCHEMES, Scheme
from .splitting import Splitting


def _paper(scheme: Scheme) -> Splitting:
    return Splitting(LieMidpoint(), scheme, f"LIEMID[{scheme.name}]")


_METHODS: dict[str, Method] = {
    m.name: m
    for m in (
        # The paper's Figure 1, in its order.
        _paper(schemes.E1),
        _paper(schemes.E2),
        _paper(schemes.EA),
        LieMidpointImplicit(),
        AKW(),
        SW(),
        NewmarkBody(),
        # The other way to cut the alternating method.
        _paper(schemes.EA_STAR),
        # Vector space: particles.
        Splitting(Linear(), schemes.E2, "symplectic Euler"),
        Splitting(Linear(), schemes.E1, "adjoint symplectic Euler"),
        Splitting(Linear(), schemes.EA, "Verlet"),
        Splitting(Linear(), schemes.EA_STAR, "position Verlet"),
        ImplicitMidpoint(),
    )
}


# No structure of the motion is kept by these, so no law is tested on them, and `methods()` does not list them.
_GENERAL: dict[str, Method] = {m.name: m for m in (RK4, DOP853)}

_FLIGHTS: dict[str, Flight] = {
    f.name: f
    for f in (
        LieMidpoint(),
        flights.SymplecticMidpoint(),
        flights.SymplecticMidpoint4(),
        flights.Jacobi(),
        flights.Symmetric(),
        flights.NearSymmetric(),
        flights.ThreeAxis(),
        flights.MoserVeselov(),
        flights.MoserVeselov4(),
        flights.MoserVeselov6(),
        Linear(),
    )
}

_ANY = f"Any FLIGHT[SCHEME] is a method, of the flights {', '.join(_FLIGHTS)} and the schemes {', '.join(SCHEMES)}."


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
        for known in (_METHODS, _GENERAL):
            if name in known:
                return known[name]
        flight, bracket, rest = name.partition("[")
        if name in _FLIGHTS:
            raise ValueError(f"{name!r} is a flight; add a scheme, as in '{name}[EA]', of {', '.join(SCHEMES)}.")
        if not bracket or not rest.endswith("]"):
            more = [f"{flight}[{scheme}]" for flight in _FLIGHTS for scheme in SCHEMES]
            raise unknown("method", name, [*_METHODS, *_GENERAL], more=more, note=_ANY)
        name, scheme = flight, rest.removesuffix("]")
    for kind, part, known in (("flight", name, _FLIGHTS), ("scheme", scheme, SCHEMES)):
        if isinstance(part, str) and part not in known:
            raise unknown(kind, part, known)
    flight = _FLIGHTS[name] if isinstance(name, str) else name
    table = SCHEMES[scheme] if isinstance(scheme, str) else scheme
    made = Splitting(flight, table, f"{flight.name}[{table.name}]")
    known = _METHODS.get(made.name)
    return known if known is not None and known == made else made


def methods() -> list[str]:
    """The names of the methods that have one of their own, the seven of the paper's Figure 1 first."""
    return list(_METHODS)
