"""Error against time, for midlie_jax and for other programs, on one core: the charts and tables under docs/reports/.

    python benchmarks/work_precision.py [--scene NAME ...] [--quick] [--out FOLDER]
    python benchmarks/work_precision.py --data     what pages show of the data, without measuring: times-faster.png
    python benchmarks/work_precision.py --scene SCENE --methods [NAME ...]     a table and a chart, in no page

Writes FOLDER/work-precision-SCENE.png for each scene, and the data, FOLDER/tables/work-precision*.csv, of which only
the rows of the scenes named are replaced. In docs/reports, the default, it also puts what it found into the page
work-precision.md and into other pages. `--quick` times fewer runs, and by default writes into a temporary folder.

With `--methods` a scene or method may be your own, MODULE:NAME of a module in the current folder.
"""

import math
import platform
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import DOCS, REPORTS, Line, Panel, Table, by_scene, chart, main, put, save, saved, shown, table
from laboratory import rivals as programs
from laboratory.rivals import FREE_MOTION, RIGID, RIVALS, Point, Problem, Rival, exact_point, kind_of, ladder, numbers

from midlie_jax.advice.timing import Load, cost_clock, spread_in_words
from midlie_jax.cli import chosen
from midlie_jax.cli.figures import (
    FAINT,
    INK,
    SOLID,
    WARM,
    Style,
    heading,
    new_figure,
    panel,
    spread_bars,
    styles,
    write,
)
from midlie_jax.cli.scenes import Scene
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.projection import steady_potential
from midlie_jax.integrators.registry import ENTRIES, exact_flight
from midlie_jax.integrators.schemes import SCHEMES
from midlie_jax.model.torques import on_body
from midlie_jax.plot.style import BLACK, BLUE, GREEN

# ---- the three families of methods that charts and tables of error against cost keep apart ----
#
# General methods are all methods. Conserving ones are the reversible and the symplectic methods, whose errors of the
# energy stay bounded over long runs, and those that keep the energy by a projection. Each family contains the next.

GENERAL, CONSERVING, SYMPLECTIC = FAMILIES = ("general", "conserving", "symplectic")


def family(method: Method) -> str:
    if method.symplectic:
        return SYMPLECTIC
    return CONSERVING if method.symmetric or method.keeps_energy else GENERAL


def members(points: Iterable[Point], families: Mapping[str, str], name: str) -> list[Point]:
    contained = FAMILIES[FAMILIES.index(name) :]
    return [point for point in points if families[point.method] in contained]


# ---- which method is cheapest at an error: the frontier (lower envelope) of many methods, and ratios of costs ----
#
# Between two points of a method its cost is interpolated in the logarithms of cost and error. For errors larger than
# that of its cheapest point the cost is that of the cheapest point; for errors smaller than its smallest, infinite.

DECADES = tuple(10.0**-n for n in range(3, 13))


class Best(NamedTuple):
    """The cheapest method at an error; cost infinity and method "" if no method reaches the error.

    The spread is the larger one of the two points between which the cost was interpolated; NaN if unknown.
    """

    cost: float
    method: str
    spread: float = math.nan


def by_method(points: Iterable[Point]) -> dict[str, list[Point]]:
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
    """The fastest method of a family at one error, and its time over that of heyoka; NaN if one does not reach it."""

    best: Best
    over_heyoka: float


class Ratio(NamedTuple):
    """Our times over those of rivals at one error, NaN if a side does not reach it; of each family the fastest."""

    error: float
    families: dict[str, Share]
    rival: Best
    over_rival: float
    over_diffrax: float


def ratios(
    ours: Sequence[Point], rivals: Sequence[Point], families: Mapping[str, str], errors: Sequence[float] = DECADES
) -> list[Ratio]:
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
    known = [ratio for ratio in ratios if math.isfinite(ratio)]
    if not known:
        return "not compared: one of the two reaches none of these errors"
    text = f"{min(known):.2g} to {max(known):.2g}"
    return text + ("" if len(known) == len(ratios) else f" ({len(ratios) - len(known)} of {len(ratios)} not compared)")


# ---- the chart: the frontiers of our three families in bold, beside the rivals by time and our methods by torques ----


class Band(NamedTuple):
    colour: str
    width: float
    alpha: float


# From the widest to the narrowest, drawn in this order: where frontiers coincide, each is seen beside the next.
BANDS = {"general": Band(BLUE, 11.0, 0.4), "conserving": Band(GREEN, 6.0, 1.0), "symplectic": Band(BLACK, 2.4, 1.0)}


LEGEND = "Bold: the fastest methods of midlie_jax in three families. Hollow: other programs."
CLOSED = "free_motion is the closed form and takes no steps."
ATTITUDE = RIGID.measured
_LEAST = 1e-17  # an error of exactly zero has no logarithm: it is drawn below rounding
_TOP = 10.0  # of the panels: a larger error of a rotation matrix has no meaning
_NAMED = 5  # thin lines of the right panel, beside three bold ones
_MOST = 1.0  # at larger errors a method does not follow the motion, and the frontiers show nothing


def work_precision_figure(
    ours: Sequence[Point],
    rivals: Sequence[Point],
    families: Mapping[str, str],
    *,
    title: str,
    note: str,
    measured: str = ATTITUDE,
    clock: str = "time",
) -> Any:
    """The chart as a matplotlib figure, for `write`; the note says how errors and times were measured."""
    figure = new_figure(15.0, 8.0)
    if not ours and not rivals:
        raise ValueError(
            "no method gave a finite result, so there is nothing to draw; see the failures printed before."
        )
    heading(figure, title, note)
    figure.subplots_adjust(bottom=0.08, right=0.855, wspace=0.05)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.2, 1.0))
    torque_free = all(math.isnan(p.evaluations) for p in ours)
    what = "steps" if torque_free else "torque evaluations"
    label = f"{what}, whole run [-]"
    error = f"error of {measured}, rms over the bodies [-]"
    panel(left, "Run time", f"{clock}, whole run, per body [s]", error)
    panel(right, f"Number of {what}", label, "")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log")
    bottom = min(max(p.error, _LEAST) for p in (*ours, *rivals))
    left.set_ylim(min(bottom, 1e-13) / 3, _TOP)
    our_styles = _our_styles(families)
    # All rivals have a style, measured or not: the same on all charts.
    rival_styles = styles([*(rival.label for rival in RIVALS), *by_method(rivals)], WARM, SOLID, ours=False)
    # A closed form is cheaper and more exact than all methods: with it the frontiers would be one point.
    useful = [p for p in ours if p.error <= _MOST and not math.isnan(p.steps)]
    for axes, cost in ((left, "seconds"), (right, "steps" if torque_free else "evaluations")):
        edges = {name: frontier(members(useful, families, name), cost) for name in FAMILIES}
        _draw_frontiers(axes, edges)
        if axes is left:  # with the closed form, which the right panel, by steps, does not show
            _draw_lines(axes, [p for p in ours if math.isnan(p.steps)], our_styles, cost)
            _draw_lines(axes, rivals, rival_styles, cost)
        else:
            leading = _leading(useful or ours, families, edges, cost)
            _draw_lines(axes, [p for p in ours if p.method in leading], our_styles, cost)
    named = {}
    for axes in (left, right):
        handles, names = axes.get_legend_handles_labels()
        named |= dict(zip(names, handles, strict=True))
    figure.legend(named.values(), named, loc="center right", fontsize=9, frameon=False)
    return figure


def _leading(
    points: Sequence[Point], families: Mapping[str, str], edges: Mapping[str, Sequence[tuple[float, float]]], cost: str
) -> list[str]:
    counts = Counter(
        best_at(members(points, families, name), error, cost).method
        for name, edge in edges.items()
        for _, error in edge
    )
    return [name for name, _ in counts.most_common(_NAMED)] or list(by_method(points))[:_NAMED]


def _our_styles(families: Mapping[str, str]) -> dict[str, Style]:
    found: dict[str, Style] = {}
    for name in FAMILIES:
        found |= styles(
            [m for m, family in families.items() if family == name], (BANDS[name].colour,), SOLID, ours=True
        )
    return found


def _draw_frontiers(axes: Any, edges: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    for order, (name, band) in enumerate(BANDS.items()):
        if edges[name]:
            shape = {"color": band.colour, "linewidth": band.width, "alpha": band.alpha, "zorder": 2.6 + 0.1 * order}
            axes.plot(
                *zip(*edges[name], strict=True), label=name, solid_capstyle="round", solid_joinstyle="round", **shape
            )


def _draw_lines(axes: Any, points: Sequence[Point], line_styles: Mapping[str, Style], cost: str) -> None:
    for name, own in by_method(points).items():
        line = envelope([getattr(p, cost) for p in own], [max(p.error, _LEAST) for p in own])
        if not line or line[-1][1] > _TOP:  # all of it is above the panel
            continue
        style = line_styles[name]
        x, y = zip(*line, strict=True)
        shape = style.drawn(0.9, 4.5) if style.ours else style.drawn(1.3, 5.0)
        axes.plot(x, y, label=name, zorder=2 if style.ours else 4, **shape)
        if cost == "seconds" and not style.ours:
            spreads = {(p.seconds, max(p.error, _LEAST)): p.spread for p in own}
            spread_bars(axes, x, y, [spreads[point] for point in line], style.colour)


# ---- error against cost for the methods of this package and for other programs, on the same bodies ----

BODIES, JUDGED, SIZE = 1024, 16, 1e-3  # bodies moved, bodies whose error is measured, size of the perturbations
SCENES = ("P1", "asymmetric-top", "bruls-cardona", "gravity-gradient-10", "tumbling-brick", "orbit", "axis")
_ROUNDING = 2.3e-16  # rounding error of an entry of a matrix in float64, in which errors are computed


def methods_for(scene: Scene) -> tuple[str, ...]:
    """The names in the chart of a scene: the exact flight of its body with the leading schemes, and a few others.

    A scene without torque has the closed form, `free_motion`, which is no method, as well. Where the energy is not
    constant, methods that keep it are left out, because there they are those that do not.
    """
    flight = exact_flight(scene.body)
    leading = [scheme for scheme in SCHEMES.values() if scheme.leading]
    if scene.torque is None:
        leading = leading[:1]
    charted = [e.method for e in ENTRIES.values() if e.chart and e.method.moves(scene.body)]
    others = [method.name for method in charted if _steady(scene) or not method.keeps_energy]
    closed = () if scene.torque is not None else (FREE_MOTION,)
    return (*closed, *(f"{flight.name}[{scheme.name}]" for scheme in leading), *others)


def _steady(scene: Scene) -> bool:
    if scene.torque is None:
        return True
    return steady_potential(on_body(scene.torque, scene.body), jnp.asarray(0.0), scene.start) is not None


def problem(which: str | Scene, bodies: int = BODIES, judged: int = JUDGED, *, quick: bool = False) -> Problem:
    """Perturbed copies of the body of a scene, and the reference ends of the first of them, whose error is measured.

    The ends are from the closed form if there is one, otherwise from heyoka's Taylor series in 38 digits.
    """
    scene = programs.scene(which)
    # Perturbed states are normalised to rounding, because programs differ in the rotations of other quaternions.
    starts = programs.perturbed(scene.start, bodies, SIZE)
    ends, source, uncertainty = _ends(scene, numbers(starts)[: min(judged, bodies)])
    repeats, longest = (2, 0.2) if quick else (5, 0.3)
    return Problem(scene, kind_of(scene), starts, ends, source, uncertainty, repeats, longest)


def _ends(scene: Scene, states: np.ndarray) -> tuple[np.ndarray, str, float]:
    kind = kind_of(scene)
    if exact := kind.exact(scene, states):
        return *exact, 1e-15
    ends = programs.reference(scene, kind, states)
    change = float(np.max(kind.errors(ends[:1], programs.reference(scene, kind, states[:1], digits=46))))
    return ends, "Taylor series in 38 digits (heyoka, MPFR)", max(change, _ROUNDING)


def measure(
    case: Problem,
    ours: Sequence[str | Method],
    rivals: Sequence[Rival] = RIVALS,
    *,
    said: Callable[[str], None] = print,
) -> tuple[list[Point], list[Point]]:
    """The points of our methods and of the rivals on a problem. If one fails, the others are still measured."""

    def attempt(label: str, points: Callable[[], Iterator[Point]]) -> list[Point]:
        said(label)
        try:
            return list(points())
        except Exception as error:  # the other methods and programs are measured even if one raises an error
            said(f"{label} failed: {type(error).__name__}: {str(error).strip().splitlines()[0]}")
            return []

    closed = [FREE_MOTION] if FREE_MOTION in ours else []
    methods = chosen.methods([one for one in ours if one != FREE_MOTION])
    our_points = [p for name in closed for p in attempt(name, lambda: exact_point(case))]
    our_points += [p for method in methods for p in attempt(method.name, lambda method=method: ladder(method, case))]
    rival_points = [p for rival in rivals for p in attempt(rival.label, lambda rival=rival: rival.measure(case))]
    return our_points, rival_points


class Comparison(NamedTuple):
    """The measurements on a scene; `in_steps` has the ratios without the closed form, where there is one."""

    problem: Problem
    ratios: list[Ratio]
    in_steps: list[Ratio]
    ours: list[Point]
    rivals: list[Point]
    families: dict[str, str]
    warning: str


def compared(
    which: str | Scene,
    ours: Sequence[str | Method] | None = None,
    *,
    quick: bool = False,
    said: Callable[[str], None] = print,
) -> Comparison:
    load = Load()
    case = problem(which, quick=quick)
    methods = methods_for(case.scene) if ours is None else ours
    our_points, rival_points = measure(case, methods, said=said)
    families, in_steps = families_of(our_points, methods), [p for p in our_points if p.method != FREE_MOTION]
    our_ratios = ratios(our_points, rival_points, families)
    ratios_in_steps = [] if len(in_steps) == len(our_points) else ratios(in_steps, rival_points, families)
    return Comparison(case, our_ratios, ratios_in_steps, our_points, rival_points, families, load.warning())


def families_of(points: Sequence[Point], ours: Sequence[str | Method] = ()) -> dict[str, str]:
    """The smallest family of each method of the points, by its name; `ours` has those that are not known by name.

    The closed form is exact to rounding, so it is symplectic and conserves what the body conserves.
    """
    known = {method.name: method for method in chosen.methods([one for one in ours if one != FREE_MOTION])}
    names = dict.fromkeys(point.method for point in points)
    return {n: SYMPLECTIC if n == FREE_MOTION else family(known.get(n) or chosen.method(n)) for n in names}


def draw(comparison: Comparison, path: str, title: str = "") -> None:
    case = comparison.problem
    figure = work_precision_figure(
        *(comparison.ours, comparison.rivals, comparison.families),
        title=title or f"{case.scene.name}: {case.scene.title}, T = {case.scene.duration:g}",
        note=note(comparison),
        measured=case.kind.measured,
        clock=cost_clock().name,
    )
    write(figure, path)


def note(comparison: Comparison) -> str:
    case = comparison.problem
    closed = any(point.method == FREE_MOTION for point in comparison.ours)
    legend = f"{LEGEND} {CLOSED}" if closed else LEGEND
    return f"{case.bodies} bodies, one core, float64. {legend} {timing_note(comparison)}"


def timing_note(comparison: Comparison) -> str:
    spread = spread_in_words([point.spread for point in comparison.ours + comparison.rivals])
    return f"Times: medians of {cost_clock().name}, {spread}. {comparison.warning}".strip()


# ---- what the data say: docs/times-faster.png, and the fastest methods ----

PICTURE = DOCS / "times-faster.png"
COLUMNS = {"heyoka": "general / heyoka", "diffrax": "general / diffrax"}
LOOKS = {
    "P1": ("fast heavy top", "#0072B2", "o"),
    "bruls-cardona": ("heavy top of Brüls and Cardona", "#009E73", "s"),
    "tumbling-brick": ("tumbling brick", "#D55E00", "^"),
    "asymmetric-top": ("asymmetric heavy top", "#7F3C8D", "D"),
    "gravity-gradient-10": ("satellite, ten orbits", "#222222", "v"),
    "orbit": ("body in orbit", "#A6761D", "P"),
    "axis": ("axis of the fast top", "#56B4E9", "X"),
}
NOTE = "Run time of the other program over the fastest method's, at equal error; 1024 bodies, one core, float64."


def measured() -> dict[str, dict[str, list[tuple[float, float]]]]:
    scenes = by_scene("work-precision")
    return {
        name: {
            scene: [(float(row["error"]), float(row[column])) for row in rows if row[column] != "-"]
            for scene, rows in scenes.items()
        }
        for name, column in COLUMNS.items()
    }


def inverse(ratios: str) -> str:
    """How many times faster, to two digits, from ratios of times such as "0.032 to 0.12"; words stay as they are."""
    known, *rest = ratios.partition(" (")
    found = [float(f"{1 / float(number):.2g}") for number in re.findall(r"\d[\d.]*(?:e[+-]\d+)?", known)]
    words = [f"{times:.0f}" if times >= 10 else f"{times:g}" for times in reversed(found)]
    return " to ".join(words) + "".join(rest) if words else ratios


def _digits(number: float) -> str:
    return f"{float(f'{number:.2g}'):g}"


def draw_times_faster() -> None:
    def more(axes: Any) -> None:
        axes.axhline(1.0, color=FAINT, linewidth=1.2)
        axes.annotate("equal", (2.4e-3, 1.06), color=INK, fontsize=9)
        axes.set_xticks([1e-3, 1e-6, 1e-9, 1e-12], minor=False)
        axes.set_yticks([1, 3, 10, 30, 100, 300, 1000], ["1", "3", "10", "30", "100", "300", "1000"])

    every, panels = measured(), list[Panel]()
    spans = {name: [1 / ratio for rows in scenes.values() for _, ratio in rows] for name, scenes in every.items()}
    faster = [f"{_digits(min(span))} to {_digits(max(span))} times faster than {name}" for name, span in spans.items()]
    limits: Any = {"xscale": "log", "yscale": "log", "xlim": (3e-3, 3e-13), "ylim": (0.7, 2000)}
    for name, scenes in every.items():
        lines = list[Line]()
        for scene, (label, colour, marker) in LOOKS.items():
            if scene in scenes:
                errors, ratios = zip(*scenes[scene], strict=True)
                options: Any = {"marker": marker, "markersize": 5, "linewidth": 1.8}
                lines.append(Line(label, errors, [1 / ratio for ratio in ratios], colour, options=options))
        words = f"Compared with {name}", "error at the end [-]", "times faster [-]"
        panels.append(Panel(*words, lines, limits, more))
    title = f"midlie_jax is {' and '.join(faster)}"
    chart(PICTURE, [panels], (13.0, 5.6), title, NOTE, bottom=0.12, wspace=0.2)
    print(f"wrote {PICTURE.name}")


# ---- the fastest methods at four errors ----

ERRORS = ("1e-03", "1e-06", "1e-09", "1e-12")
TOLD = {"general": "any", "symplectic": "symplectic"}  # the family in the data file, and what readers are told
EQUAL = "any, symplectic"


def _cell(row: dict[str, str], family: str) -> str:
    order = ["general: µs per body", "conserving: µs per body", "symplectic: µs per body"]
    place = order.index(f"{family}: µs per body")
    while row[order[place]] == "same":
        place -= 1
    name, _, time = row[order[place]].partition(": ")
    return f"`{name}` {time.split()[0]}" if time else "-"


def fastest_rows() -> Iterator[list[str]]:
    for scene, rows in by_scene("work-precision").items():
        at = {row["error"]: row for row in rows}
        found = {told: [_cell(at[error], family) for error in ERRORS] for family, told in TOLD.items()}
        first, second = found.values()
        for told, cells in ({EQUAL: first} if first == second else found).items():
            yield [scene, told, *cells]


FASTEST = Table(
    "choosing-a-method.md", "fastest", ["scene", "method", *(f"error {error}" for error in ERRORS)], fastest_rows
)


# ---- into pages and data files ----

PAGE = "reports/work-precision.md"
PROGRAMS = ("jax", "diffrax", "heyoka", "scipy", "mujoco")
DATA = ("work-precision", "work-precision-heyoka", "work-precision-ratios")
CURVE = ("tolerance", "fastest variant", "error", "µs per body")
RATIOS = (*(f"{family} / heyoka" for family in FAMILIES), "general / diffrax")
PAGE_HEADS = (
    *("error", "fastest method: µs per body", "times faster than heyoka", "than diffrax"),
    "symplectic: times faster than heyoka",
)


def one_scene(options: Any) -> None:
    scene = programs.scene(options.scene[0])
    comparison = compared(scene, chosen.methods(options.methods) or None, quick=options.quick)
    path = str((options.out or Path()) / f"chart-{scene.name}-rivals.png")
    shown(HEADS, map(cells, comparison.ratios))
    print(f"\n{timing_note(comparison)}")
    draw(comparison, path)
    print(f"wrote {path}")


def everything(options: Any) -> None:
    if options.data:
        into_pages()
        return
    programs.require()
    if options.methods is not None:
        one_scene(options)
        return
    out = options.out or (Path(tempfile.mkdtemp(prefix="midlie-")) if options.quick else REPORTS)
    (out / "tables").mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    for name in options.scene:
        comparison = compared(name, quick=options.quick)
        lines = said(comparison)
        keep_and_draw(name, comparison, out)
        if out == REPORTS:
            put(PAGE, name, [*lines, "", *key_rows(name)])
        print(*lines, f"[{time.perf_counter() - began:.0f} s]", sep="\n", flush=True)
        if spin := spin_text(comparison):
            print(*spin, sep="\n")
            if out == REPORTS:
                put(PAGE, "spin", spin)
    if out == REPORTS:
        versions = ", ".join(f"{program} {version(program)}" for program in PROGRAMS)
        put(PAGE, "versions", [f"Versions: {versions};", f"{platform.machine()}, {platform.system()}."])
        into_pages()
    print(f"wrote {out}")


def into_pages() -> None:
    rows = [list(row.values()) for row in saved(DATA[2])]
    heads = ["scene", *(f"{family}: than heyoka" for family in FAMILIES), "general: than diffrax"]
    put(PAGE, "times faster", table(heads, [[name, *map(inverse, ratios)] for name, *ratios in rows]))
    FASTEST.show(write=True)
    draw_times_faster()


def said(comparison: Comparison) -> list[str]:
    problem, spreads = comparison.problem, [point.spread for point in comparison.ours + comparison.rivals]
    return [
        f"Error: {problem.kind.measured}. Reference: {problem.source}, uncertainty {problem.uncertainty:.0e}.",
        f"Times: {spread_in_words(spreads)}. {comparison.warning}".strip(),
    ]


def key_rows(name: str) -> list[str]:
    columns = "general / heyoka", "general / diffrax", "symplectic / heyoka"
    return table(
        PAGE_HEADS,
        [
            [row["error"], row["general: µs per body"], *(inverse(row[column]) for column in columns)]
            for row in saved(DATA[0])
            if row["scene"] == name and row["error"] in ERRORS
        ],
    )


def keep(name: str, heads: Sequence[str], file: str, rows: Sequence[Sequence[str]], folder: Path) -> None:
    """Replaces the rows of a scene in a data file; the scenes stay in the order of the page."""
    before = [list(row.values()) for row in saved(file, folder)] if (folder / f"{file}.csv").exists() else []
    every = [row for row in before if row[0].partition(",")[0] != name] + [list(row) for row in rows]
    every.sort(key=lambda row: SCENES.index(row[0].partition(",")[0]))
    save(file, table(["scene", *heads], every), folder)


def keep_and_draw(name: str, comparison: Comparison, out: Path) -> None:
    title = message(name, spans(comparison.ratios)[0])
    draw(comparison, str(out / f"work-precision-{name}.png"), title)
    curve = [
        [name, *p.setting.removeprefix("tol ").split(", ", 1), f"{p.error:.1e}", f"{1e6 * p.seconds:.3g}"]
        for p in comparison.rivals
        if p.method == "heyoka"
    ]
    summary = [[name, *spans(comparison.ratios)]]
    if comparison.in_steps:
        summary.append([f"{name}, in steps", *spans(comparison.in_steps)])
    print(*summary, sep="\n")
    keep(name, HEADS, DATA[0], [[name, *cells(row)] for row in comparison.ratios], out / "tables")
    keep(name, CURVE, DATA[1], curve, out / "tables")
    keep(name, RATIOS, DATA[2], summary, out / "tables")


def message(name: str, over_heyoka: str) -> str:
    faster = inverse(over_heyoka)
    return f"{name}: {faster} times faster than heyoka" if faster[0].isdigit() else name


def spans(rows: list[Ratio]) -> list[str]:
    over_heyoka = [span([row.families[family].over_heyoka for row in rows]) for family in FAMILIES]
    return [*over_heyoka, span([row.over_diffrax for row in rows])]


def spin_text(comparison: Comparison) -> list[str]:
    def took(program: str) -> str:
        points = [point for point in comparison.rivals if point.method == program]
        costs = [1e6 * best_at(points, error).cost for error in DECADES]
        return f"{min(costs):.2g} to {max(costs):.2g} µs"

    if not any(point.method == programs.LABEL for point in comparison.rivals):
        return []
    return [
        "A spinning frame is expensive for the Taylor series of heyoka. "
        f"heyoka takes {took('heyoka')} per body for these six",
        f'equations, and {took(programs.LABEL)} for the seven equations of a spinning body ("{programs.LABEL}").',
        "The tables use the times for six equations, which suffice for the axis alone.",
    ]


ARGUMENTS = {
    "--scene": {"nargs": "+", "metavar": "SCENE", "default": list(SCENES), "help": ", ".join(SCENES)},
    "--methods": {"nargs": "*", "metavar": "NAME", "help": "by default those of the scene"},
    "--quick": {"action": "store_true"},
    "--out": {"type": Path, "metavar": "FOLDER"},
    "--data": {"action": "store_true", "help": "measure nothing"},
}

if __name__ == "__main__":
    main(__doc__, everything, ARGUMENTS)
