"""The three families of methods that charts and tables of error against cost keep apart.

A method conserves if it is reversible or keeps quadratic invariants; a symplectic method preserves the Lie-Poisson
structure as well. So each family contains the next: the best conserving method may be a symplectic one, and the best
general method is the best of all.
"""

from collections.abc import Iterable, Mapping

from ..methods.base import Method
from .rivals.problem import Point

GENERAL, CONSERVING, SYMPLECTIC = FAMILIES = ("general", "conserving", "symplectic")


def family(method: Method) -> str:
    """The smallest family that contains the method."""
    if method.symplectic:
        return SYMPLECTIC
    # Methods that conserve for another reason than their symmetry have an attribute `conserving`; others need none.
    return CONSERVING if method.symmetric or getattr(method, "conserving", False) else GENERAL


def members(points: Iterable[Point], families: Mapping[str, str], name: str) -> list[Point]:
    """The points of the methods that a family contains.

    Args:
        points: points of our methods.
        families: the smallest family of each method, by the name of the method.
        name: one of `FAMILIES`.
    """
    contained = FAMILIES[FAMILIES.index(name) :]
    return [point for point in points if families[point.method] in contained]
