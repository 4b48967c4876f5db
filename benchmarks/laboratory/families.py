"""The three families of methods that charts and tables of error against cost keep apart.

General methods are all methods. Conserving ones are the reversible and the symplectic methods, whose errors of the
energy stay bounded over long runs, and those that keep the energy by a projection. Symplectic ones preserve the
Lie-Poisson structure. Each family contains the next: the best conserving method may be a symplectic one, and the best
general method is the best of all.
"""

from collections.abc import Iterable, Mapping

from midlie_jax.integrators.base import Method

from .rivals.problem import Point

GENERAL, CONSERVING, SYMPLECTIC = FAMILIES = ("general", "conserving", "symplectic")


def family(method: Method) -> str:
    """The smallest family that contains the method."""
    if method.symplectic:
        return SYMPLECTIC
    return CONSERVING if method.symmetric or method.keeps_energy else GENERAL


def members(points: Iterable[Point], families: Mapping[str, str], name: str) -> list[Point]:
    """The points of the methods that a family contains.

    Args:
        points: points of our methods.
        families: the smallest family of each method, by the name of the method.
        name: one of `FAMILIES`.
    """
    contained = FAMILIES[FAMILIES.index(name) :]
    return [point for point in points if families[point.method] in contained]
