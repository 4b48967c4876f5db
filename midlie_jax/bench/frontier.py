"""Who is quickest at an error: the lower envelope of many methods' points, and the ratios of two of them.

Plain numbers, no JAX. Between two points of a method its cost is interpolated in the logarithms of both; beyond its
points nothing is claimed, but that a smaller error serves a larger one as well.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from .rivals.problem import Point

DECADES = tuple(10.0**-n for n in range(3, 13))


class Best(NamedTuple):
    """The cheapest way to an error: its cost, and whose it is; infinity and "" where there is none.

    Attributes:
        cost: as in the points.
        method: whose it is.
        spread: of the times that it was found from, the larger of two; NaN where unknown.
    """

    cost: float
    method: str
    spread: float = math.nan


def by_method(points: Iterable[Point]) -> dict[str, list[Point]]:
    """The points of each method, in the order in which the methods first appear."""
    found: dict[str, list[Point]] = {}
    for point in points:
        found.setdefault(point.method, []).append(point)
    return found


def envelope(costs: Sequence[float], errors: Sequence[float]) -> list[tuple[float, float]]:
    """The points that no other one betters in both, cheapest first: errors fall along it."""
    kept: list[tuple[float, float]] = []
    for cost, error in sorted(zip(costs, errors, strict=True)):
        if math.isfinite(cost) and math.isfinite(error) and (not kept or error < kept[-1][1]):
            kept.append((cost, error))
    return kept


def cost_at(line: Sequence[tuple[float, float]], error: float) -> float:
    """What an envelope asks for an error: interpolated in logarithms, that of its first point for any larger error,
    infinity for a smaller one than its last.
    """
    about = _about(line, error)
    if len(about) < 2:
        return about[0][0] if about else math.inf
    (before, coarser), (cost, reached) = about
    part = math.log(coarser / error) / math.log(coarser / max(reached, 1e-300))
    return math.exp(math.log(before) + part * (math.log(cost) - math.log(before)))


def _about(line: Sequence[tuple[float, float]], error: float) -> Sequence[tuple[float, float]]:
    """The points of an envelope from which the cost of an error is found: none, one or two."""
    index = next((i for i, (_, reached) in enumerate(line) if reached <= error), None)
    if index is None:
        return []
    return line[index : index + 1] if index == 0 or line[index][1] == error else line[index - 1 : index + 1]


def best_at(points: Iterable[Point], error: float, cost: str = "seconds") -> Best:
    """The cheapest method at an error, among those whose points are given."""
    best = Best(math.inf, "")
    for name, line in by_method(points).items():
        edge = envelope([getattr(p, cost) for p in line], [p.error for p in line])
        here = cost_at(edge, error)
        if here < best.cost:
            about = _about(edge, error)
            best = Best(here, name, max(p.spread for p in line if (getattr(p, cost), p.error) in about))
    return best


def frontier(points: Sequence[Point], cost: str = "seconds", per_decade: int = 24) -> list[tuple[float, float]]:
    """The lower envelope of all methods' lines, finely sampled, as (cost, error) with errors falling."""
    errors = [p.error for p in points if math.isfinite(p.error) and p.error > 0]
    if not errors:
        return []
    top, bottom = math.log10(max(errors)), math.log10(min(errors))
    count = max(2, round((top - bottom) * per_decade))
    levels = [10 ** (top + (bottom - top) * i / count) for i in range(count)] + [min(errors)]
    sampled = [(best_at(points, level, cost).cost, level) for level in levels]
    edge = [pair for pair in sampled if math.isfinite(pair[0])]
    # An error larger than that of the cheapest run is nobody's.
    first = next((i for i, (cost, _) in enumerate(edge) if cost > edge[0][0]), len(edge))
    return edge[max(0, first - 1) :]


class Ratio(NamedTuple):
    """Our wall time over others' at one error; NaN where either does not reach it.

    Attributes:
        error: of attitude.
        ours: our quickest.
        symplectic: our quickest that is symplectic.
        rival: the quickest rival.
        over_rival, over_heyoka, over_diffrax: of our quickest.
        symplectic_over_heyoka: of our quickest that is symplectic.
    """

    error: float
    ours: Best
    symplectic: Best
    rival: Best
    over_rival: float
    over_heyoka: float
    over_diffrax: float
    symplectic_over_heyoka: float


def ratios(
    ours: Sequence[Point], rivals: Sequence[Point], symplectic: Iterable[str], errors: Sequence[float] = DECADES
) -> list[Ratio]:
    """One row for each error.

    Args:
        ours, rivals: points.
        symplectic: the names of our methods that are.
        errors: where to compare.
    """
    chosen = set(symplectic)
    whole = [p for p in ours if p.method in chosen]
    rows = []
    for error in errors:
        mine, true, best = best_at(ours, error), best_at(whole, error), best_at(rivals, error)
        heyoka = best_at([p for p in rivals if p.method.startswith("heyoka")], error)
        diffrax = best_at([p for p in rivals if p.method.startswith("diffrax")], error)
        rows.append(
            Ratio(
                *(error, mine, true, best),
                *(_over(mine, best), _over(mine, heyoka), _over(mine, diffrax), _over(true, heyoka)),
            )
        )
    return rows


def _over(mine: Best, other: Best) -> float:
    return mine.cost / other.cost if math.isfinite(mine.cost) and math.isfinite(other.cost) else math.nan


HEADS = (
    "error of R",
    "ours",
    "us a body",
    "best rival",
    "us a body",
    "ours / best rival",
    "ours / heyoka",
    "ours / diffrax",
    "our best symplectic",
    "it / heyoka",
)


def cells(row: Ratio) -> list[str]:
    """A row of the table, a text for each of `HEADS`."""

    def show(value: float) -> str:
        return "-" if not math.isfinite(value) else f"{value:.3g}"

    def time(best: Best) -> str:
        return show(1e6 * best.cost) + (f" ±{best.spread:.0%}" if math.isfinite(best.spread) else "")

    return [
        f"{row.error:.0e}",
        row.ours.method or "-",
        time(row.ours),
        row.rival.method or "-",
        time(row.rival),
        show(row.over_rival),
        show(row.over_heyoka),
        show(row.over_diffrax),
        row.symplectic.method or "-",
        show(row.symplectic_over_heyoka),
    ]


def markdown(rows: Sequence[Ratio]) -> str:
    """The table of ratios in Markdown."""
    lines = ["| " + " | ".join(HEADS) + " |", "| " + " | ".join("---" for _ in HEADS) + " |"]
    return "\n".join([*lines, *("| " + " | ".join(cells(row)) + " |" for row in rows)])


def verdict(values: Sequence[tuple[float, float]], target: float) -> str:
    """How (error, ratio) pairs stand to a target, in words."""
    known = [(error, ratio) for error, ratio in values if math.isfinite(ratio)]
    if not known:
        return "not compared: one of the two reaches none of these errors"
    span = f"{min(r for _, r in known):.2g} to {max(r for _, r in known):.2g}"
    missed = [f"{error:.0e}" for error, ratio in known if ratio > target]
    rest = "" if len(known) == len(values) else f" ({len(values) - len(known)} of {len(values)} not compared)"
    where = "throughout" if len(missed) == len(known) else f"at {', '.join(missed)}"
    return f"{span}: " + (f"missed {where}" if missed else "met") + rest
