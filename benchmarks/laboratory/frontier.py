"""Which method is cheapest at a given error: the frontier (lower envelope) of many methods, and ratios of costs.

Works on plain numbers, without JAX. Between two points of a method its cost is interpolated in the logarithms of cost
and error. For errors larger than that of its cheapest point the cost is that of the cheapest point; for errors smaller
than its smallest the cost is infinite."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from midlie_jax.integrators.base import Method

from .rivals.problem import Point

# ---- the three families of methods that charts and tables of error against cost keep apart ----
#
# General methods are all methods. Conserving ones are the reversible and the symplectic methods, whose errors of the
# energy stay bounded over long runs, and those that keep the energy by a projection. Symplectic ones preserve the
# Lie-Poisson structure. Each family contains the next: the best conserving method may be a symplectic one, and the best
# general method is the best of all.

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


# ---- frontiers ----
#
# Between two points of a method its cost is interpolated in the logarithms of cost and error. For errors larger than
# that of its cheapest point the cost is that of the cheapest point; for errors smaller than its smallest, infinite.

DECADES = tuple(10.0**-n for n in range(3, 13))


class Best(NamedTuple):
    """The cheapest method at an error; cost infinity and method "" if no method reaches the error.

    Attributes:
        cost: in the unit of the points.
        method: name of the method.
        spread: the larger spread of the two points between which the cost was interpolated; NaN if unknown.
    """

    cost: float
    method: str
    spread: float = math.nan


def by_method(points: Iterable[Point]) -> dict[str, list[Point]]:
    """The points of each method, in the order in which the methods first appear."""
    groups: dict[str, list[Point]] = {}
    for point in points:
        groups.setdefault(point.method, []).append(point)
    return groups


def envelope(costs: Sequence[float], errors: Sequence[float]) -> list[tuple[float, float]]:
    """The points (cost, error) for which no other point is better in both, cheapest first; their errors decrease."""
    best: list[tuple[float, float]] = []
    for cost, error in sorted(zip(costs, errors, strict=True)):
        if math.isfinite(cost) and math.isfinite(error) and (not best or error < best[-1][1]):
            best.append((cost, error))
    return best


def cost_at(line: Sequence[tuple[float, float]], error: float) -> float:
    """The cost at which an envelope reaches an error, interpolated in logarithms.

    For an error larger than that of the first point it is the cost of the first point; for an error smaller than that
    of the last point it is infinity.
    """
    neighbours = _neighbours(line, error)
    if len(neighbours) < 2:
        return neighbours[0][0] if neighbours else math.inf
    (before, coarser), (cost, reached) = neighbours
    part = math.log(coarser / error) / math.log(coarser / max(reached, 1e-300))
    return math.exp(math.log(before) + part * (math.log(cost) - math.log(before)))


def _neighbours(line: Sequence[tuple[float, float]], error: float) -> Sequence[tuple[float, float]]:
    """The points of an envelope from which the cost at an error is interpolated: none, one or two."""
    index = next((i for i, (_, reached) in enumerate(line) if reached <= error), None)
    if index is None:
        return []
    return line[index : index + 1] if index == 0 or line[index][1] == error else line[index - 1 : index + 1]


def best_at(points: Iterable[Point], error: float, cost: str = "seconds") -> Best:
    """The cheapest method at an error among the methods of the points.

    Args:
        cost: the attribute of the points that is the cost: "seconds", "evaluations" or "steps".
    """
    best = Best(math.inf, "")
    for name, line in by_method(points).items():
        edge = envelope([getattr(p, cost) for p in line], [p.error for p in line])
        method_cost = cost_at(edge, error)
        if method_cost < best.cost:
            neighbours = _neighbours(edge, error)
            best = Best(method_cost, name, max(p.spread for p in line if (getattr(p, cost), p.error) in neighbours))
    return best


def frontier(points: Sequence[Point], cost: str = "seconds", per_decade: int = 24) -> list[tuple[float, float]]:
    """The lower envelope of the lines of all methods, finely sampled: pairs (cost, error) with decreasing errors."""
    errors = [p.error for p in points if math.isfinite(p.error) and p.error > 0]
    if not errors:
        return []
    top, bottom = math.log10(max(errors)), math.log10(min(errors))
    count = max(2, round((top - bottom) * per_decade))
    levels = [10 ** (top + (bottom - top) * i / count) for i in range(count)] + [min(errors)]
    sampled = [(best_at(points, level, cost).cost, level) for level in levels]
    edge = [pair for pair in sampled if math.isfinite(pair[0])]
    # For errors larger than that of the cheapest run the frontier would be vertical: these samples are dropped.
    first = next((i for i, (cost, _) in enumerate(edge) if cost > edge[0][0]), len(edge))
    return edge[max(0, first - 1) :]


class Share(NamedTuple):
    """The fastest method of a family at one error.

    Attributes:
        best: the method and its time.
        over_heyoka: its time over that of heyoka; NaN if one of the two does not reach the error.
    """

    best: Best
    over_heyoka: float


class Ratio(NamedTuple):
    """Times of our methods over those of rivals at one error; a ratio is NaN if either side does not reach the error.

    Attributes:
        error: error at the end.
        families: for each of `FAMILIES` its fastest method; the general family contains all our methods.
        rival: the fastest rival.
        over_rival, over_diffrax: time of our fastest method over that of the fastest rival, and of diffrax.
    """

    error: float
    families: dict[str, Share]
    rival: Best
    over_rival: float
    over_diffrax: float


def ratios(
    ours: Sequence[Point], rivals: Sequence[Point], families: Mapping[str, str], errors: Sequence[float] = DECADES
) -> list[Ratio]:
    """One row for each error.

    Args:
        ours, rivals: points of our methods and of the rivals.
        families: the smallest family of each of our methods, by its name.
        errors: the errors at which to compare.
    """
    ours_by_family = {name: members(ours, families, name) for name in FAMILIES}
    rows = []
    for error in errors:
        rival = best_at(rivals, error)
        heyoka = best_at([p for p in rivals if p.method.startswith("heyoka")], error)
        diffrax = best_at([p for p in rivals if p.method.startswith("diffrax")], error)
        bests = {name: best_at(points, error) for name, points in ours_by_family.items()}
        shares = {name: Share(best, _over(best, heyoka)) for name, best in bests.items()}
        rows.append(Ratio(error, shares, rival, _over(bests[GENERAL], rival), _over(bests[GENERAL], diffrax)))
    return rows


def _over(first: Best, second: Best) -> float:
    return first.cost / second.cost if math.isfinite(first.cost) and math.isfinite(second.cost) else math.nan


HEADS = (
    "error",
    *(head for name in FAMILIES for head in (f"{name}: µs per body", f"{name} / heyoka")),
    "best rival: µs per body",
    "general / rival",
    "general / diffrax",
)


def cells(row: Ratio) -> list[str]:
    """A row of the table: a text for each column of `HEADS`; "same" is the method of the family before."""

    def show(value: float) -> str:
        return "-" if not math.isfinite(value) else f"{value:.3g}"

    def method(best: Best) -> str:
        if not best.method:
            return "-"
        return f"{best.method}: {show(1e6 * best.cost)}" + (
            f" ±{best.spread:.0%}" if math.isfinite(best.spread) else ""
        )

    texts, before = [f"{row.error:.0e}"], ""
    for name in FAMILIES:
        best, over_heyoka = row.families[name]
        texts += ["same" if best.method and best.method == before else method(best), show(over_heyoka)]
        before = best.method
    return [*texts, method(row.rival), show(row.over_rival), show(row.over_diffrax)]


def span(ratios: Sequence[float]) -> str:
    """The least and the largest of the ratios, in words, and how many are not known (NaN)."""
    known = [ratio for ratio in ratios if math.isfinite(ratio)]
    if not known:
        return "not compared: one of the two reaches none of these errors"
    text = f"{min(known):.2g} to {max(known):.2g}"
    return text + ("" if len(known) == len(ratios) else f" ({len(ratios) - len(known)} of {len(ratios)} not compared)")
