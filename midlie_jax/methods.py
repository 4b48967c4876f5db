"""Every method by name. A new one is a line here, and every law test, chart and benchmark picks it up."""

from . import schemes
from .flights import LieMidpoint, Linear
from .implicit import AKW, SW, ImplicitMidpoint, LieMidpointImplicit, NewmarkBody
from .schemes import Scheme
from .stepper import Method, Splitting


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


def method(name: str) -> Method:
    """The integrator of that name.

    Raises:
        ValueError: unknown name; the message lists all.
    """
    if name not in _METHODS:
        raise ValueError(f"unknown method {name!r}; choose from {', '.join(_METHODS)}.")
    return _METHODS[name]


def methods() -> list[str]:
    """The names of all methods, the seven of the paper's Figure 1 first."""
    return list(_METHODS)
