"""A table for two parts, applied to any number of parts.

With the first-order step X(a) = P1(a) P2(a) ... Pm(a), the first part acting first, and its adjoint X*(a) = Pm(a) ...
P2(a) P1(a), two successive steps share an end part: X(a1) X*(a2) X(a3) ... contains P1 with a1, a2 + a3, ... and Pm
with a1 + a2, a3 + a4, ..., like an alternating table. Every table therefore has such numbers a1, a2, ..., and its order
equals the order of the sequence for any number of parts (McLachlan, SIAM J. Sci. Comput. 16, 1995, 151).
"""

from ..integrators.scheme import BATH as BATH
from ..integrators.scheme import KICK as KICK
from ..integrators.scheme import Scheme

_LARGEST_GENERAL_ORDER = 4
_ROUNDING = 1e-14


def order_of_parts(scheme: Scheme) -> int:
    """The order of a table for parts that are not kicks.

    Tables of kicks and flights may use that the commutator [K, [K, [K, F]]] is zero. It is of fourth order, and its
    terms cancel in a symmetric table. A symmetric table of order 4 therefore holds for any parts, and one of higher
    order only if it is composed of symmetric steps.
    """
    if scheme.composed:
        return scheme.order
    return min(scheme.order, _LARGEST_GENERAL_ORDER if scheme.symmetric or scheme.random else 3)


def word(scheme: Scheme, count: int) -> list[tuple[int | str, float]]:
    """The rotations of a step: pairs of the number of a part, counted from 0, or of BATH, and its coefficient.

    The kicks of the scheme are the first part and its flights the last; with one part, flights are skipped.
    """
    if count == 1:
        return [(kind if kind == BATH else 0, c) for kind, c in scheme.stages if kind in (KICK, BATH)]
    turns: list[tuple[int | str, float]] = []
    begun = 0.0  # the coefficient of the step X or X* whose first end part has acted

    def between(coefficient: float, backwards: bool) -> None:
        if abs(coefficient) > _ROUNDING:
            middle = range(1, count - 1)
            turns.extend((part, coefficient) for part in (reversed(middle) if backwards else middle))

    for kind, coefficient in scheme.stages:
        if kind == BATH:
            turns.append((BATH, coefficient))
            continue
        first = kind == KICK
        turns.append((0 if first else count - 1, coefficient))
        begun = coefficient - begun
        between(begun, backwards=not first)
    return turns


def rows_of_loop(scheme: Scheme) -> list[tuple[float, ...]]:
    """An alternating scheme as a loop: for each iteration of `Sublattices`, the coefficients and times.

    Each row has the coefficients of the outer part, of X, of the inner part and of X*, and the times, in steps, before
    X, between X and X*, and after X*. The last row has only the coefficient of the outer part that ends the step.
    """
    coefficients = [c for _, c in scheme.stages]
    rows: list[tuple[float, ...]] = []
    begun, elapsed = 0.0, 0.0
    for outer, inner in zip(coefficients[0:-1:2], coefficients[1::2], strict=True):
        forth = outer - begun
        begun = inner - forth
        between, after = elapsed + forth, elapsed + forth + begun
        rows.append((outer, forth, inner, begun, elapsed, between, after))
        elapsed = after
    last = (*rows[-1][:-1], 1.0)  # rounded coefficients do not sum exactly to 1
    return [*rows[:-1], last, (coefficients[-1],)]
