"""The errors of averages of a dipole against the step and against the time, by our schemes and by diffrax."""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import REPORTS, Table, in_turn

from midlie_jax.cli.figures import End, label_ends, write
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, new_figure

from . import diffrax_sde, dipole
from .dipole import FIELDS, Average, exact, step

OURS = {f"SYMMETRIC[{scheme}]": (0.25, 0.5, 0.75, 1.0, 1.5) for scheme in ("BAOAB", "OBABO", "ABOBA")}
THEIRS = {
    "Heun": (0.125, 0.25, 0.375, 0.5, 0.75, 1.0),
    "ShARK": (0.25, 0.375, 0.5, 0.75),
    "EulerHeun": (0.0625, 0.125, 0.25),
}
# Runs of each, so that the larger errors have larger standard errors.
_RUNS = {"SYMMETRIC[BAOAB]": 24, "SYMMETRIC[OBABO]": 8, "SYMMETRIC[ABOBA]": 12, "Heun": 8, "ShARK": 6, "EulerHeun": 2}
_STEPS, _ROUNDS, _TIMES = 300, 9, 3  # of the runs that are timed
ERRORS = 0.003, 0.01, 0.03  # at which costs are compared
_SURE = 3.0  # standard errors from which an error counts as measured
_LARGEST, _THEIR_LARGEST = 1.0, 0.5  # steps for the slopes: larger ones are close to where a method diverges


class Rung(NamedTuple):
    """One method in the field x: the step is a share of 1/rate and takes nanoseconds for a body."""

    method: str
    x: float
    share: float
    nanoseconds: float
    found: Average

    @property
    def error(self) -> float:
        """Relative error of <cos(theta)>."""
        return abs(self.found.cosine / exact(self.x) - 1)

    @property
    def uncertain(self) -> float:
        return self.found.cosine_error / exact(self.x)

    @property
    def warmth(self) -> float:
        """Relative error of the kinetic temperature."""
        return abs(self.found.temperature - 1)

    @property
    def either(self) -> float:
        """The larger one of both errors."""
        return max(self.error, self.warmth)

    @property
    def cost(self) -> float:
        """Nanoseconds of a body and a unit of time, 1/rate."""
        return self.nanoseconds / self.share


def costs() -> dict[str, float]:
    """Nanoseconds of a body and a step, float32, without observations; the programs take turns.

    The least of several medians, because other work on the machine only adds to a time.
    """
    names = [*OURS, *THEIRS]
    place = 2.0, step(2.0, 0.25), _STEPS
    runs = [(dipole if name in OURS else diffrax_sde).timed(name, *place) for name in names]
    times = zip(*(in_turn(runs, _ROUNDS) for _ in range(_TIMES)), strict=True)
    return {name: 1e9 / _STEPS / dipole.BODIES * min(own) for name, own in zip(names, times, strict=True)}


def extend(kept: Path, seconds: float) -> list[Rung]:
    """Measures what is not in the file yet, for some time, and puts it there; returns all that is there."""
    data: Any = json.loads(kept.read_text()) if kept.exists() else {"costs": costs(), "rungs": []}
    began, done = time.monotonic(), {(method, share) for method, _, share, _ in data["rungs"]}
    for method, shares in (OURS | THEIRS).items():
        for share in shares:
            if (method, share) not in done and time.monotonic() - began < seconds:
                run = dipole.ours(method, share) if method in OURS else diffrax_sde.theirs(method, share)
                for x in FIELDS:
                    found = dipole.averaged(run, x, share, _RUNS[method])
                    data["rungs"].append((method, x, share, found))
                kept.write_text(json.dumps(data))
    named = data["costs"]
    return [Rung(method, x, share, named[method], Average(*found)) for method, x, share, found in data["rungs"]]


def slope(steps: Sequence[float], errors: Sequence[float], uncertain: Sequence[float]) -> tuple[float, float]:
    """The slope of log error against log step, and its standard error; NaN of fewer than two."""
    if len(steps) < 2:
        return math.nan, math.nan
    x, y = np.log(steps), np.log(errors)
    weights = (np.array(errors) / np.array(uncertain)) ** 2
    x = x - np.average(x, weights=weights)
    scatter = np.sum(weights * x * x)
    return float(np.sum(weights * x * y) / scatter), float(scatter**-0.5)


def slopes(found: Sequence[Rung]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of <cos(theta)> and of the temperature, of one method in one field; errors lost in the noise are left out."""
    small = [r for r in found if r.share <= (_THEIR_LARGEST if r.method in THEIRS else _LARGEST)]
    sure = [r for r in small if r.error > _SURE * r.uncertain]
    warm = [r for r in small if r.warmth > _SURE * r.found.temperature_error]
    of_cosine = slope([r.share for r in sure], [r.error for r in sure], [r.uncertain for r in sure])
    errors = [r.found.temperature_error for r in warm]
    return of_cosine, slope([r.share for r in warm], [r.warmth for r in warm], errors)


def step_at(found: Sequence[Rung], error: float, kind: str) -> float:
    """The largest step with this error, between the measured ones by their logarithms.

    The largest measured step that does not diverge if no error is as large; 0 if all are larger. A step counts only if
    all smaller ones are within the error, so that an average is not trusted where its error happens to change sign.
    """
    best: Rung | None = None
    for rung in sorted(found, key=lambda r: r.share):
        value = getattr(rung, kind)
        if value <= error:
            best = rung
        elif best is None:
            return 0.0
        elif not math.isfinite(value) or getattr(best, kind) == 0:
            return best.share
        else:
            part = math.log(error / getattr(best, kind)) / math.log(value / getattr(best, kind))
            return best.share * (rung.share / best.share) ** part
    return 0.0 if best is None else best.share


def rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    """Every method with every step in every field."""
    for r in sorted(found, key=lambda r: r.x):
        a = r.found
        if not math.isfinite(a.cosine):
            yield [f"{r.x:g}", name(r.method), f"{r.share:g}", f"{r.nanoseconds:.1f}", "", "", "diverges", ""]
            continue
        cosine = f"{exact(r.x):.5f}", f"{a.cosine - exact(r.x):+.5f} ± {a.cosine_error:.5f}"
        warmth = f"{a.temperature - 1:+.4f} ± {a.temperature_error:.4f}"
        yield [f"{r.x:g}", name(r.method), f"{r.share:g}", f"{r.nanoseconds:.1f}", f"{r.cost:.0f}", *cosine, warmth]


def name(method: str) -> str:
    return f"diffrax `{method}`" if method in THEIRS else f"`{method}`"


def _grouped(found: Sequence[Rung]) -> dict[tuple[float, str], list[Rung]]:
    groups = dict[tuple[float, str], list[Rung]]()
    for r in sorted(found, key=lambda r: r.x):
        groups.setdefault((r.x, r.method), []).append(r)
    return groups


def slope_rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    for (x, method), own in _grouped(found).items():
        cells = [f"{a:.2f} ± {b:.2f}" if math.isfinite(a) else "below the noise" for a, b in slopes(own)]
        yield [f"{x:g}", name(method), *cells]


def ratio_rows(found: Sequence[Rung]) -> Iterator[list[str]]:
    """The cheapest of ours and of theirs within some errors of <cos(theta)>, and of both averages."""
    groups = _grouped(found)
    for x in FIELDS:
        for kind, words in (("error", "⟨cos θ⟩"), ("either", "⟨cos θ⟩ and T")):
            for error in ERRORS:
                best = [_cheapest(groups, methods, x, error, kind) for methods in (OURS, THEIRS)]
                if all(math.isfinite(cost) for _, cost in best):
                    cells = [cell for method, cost in best for cell in (name(method), f"{cost:.0f}")]
                    yield [f"{x:g}", words, f"{error:g}", *cells, f"{best[1][1] / best[0][1]:.1f}"]


def _cheapest(groups: Any, methods: Any, x: float, error: float, kind: str) -> tuple[str, float]:
    """A method and its cost at this error."""
    costs = dict[str, float]()
    for method in methods:
        own = groups.get((x, method), ())
        share = step_at(own, error, kind)
        costs[method] = own[0].nanoseconds / share if share else math.inf
    finite = {method: cost for method, cost in costs.items() if math.isfinite(cost)}
    return min(finite.items(), key=lambda pair: pair[1]) if finite else ("", math.nan)


PAGE = "reports/heat.md"
DIPOLE = Table(
    *(PAGE, "dipole"),
    ("x", "method", "step", "ns per step", "ns per time", "exact ⟨cos θ⟩", "error of ⟨cos θ⟩", "error of T"),
    data="heat-dipole",
    words=lambda rows: [],
)
SLOPES = Table(
    *(PAGE, "slopes", ("x", "method", "slope of the error of ⟨cos θ⟩", "of T")),
    data="heat-slopes",
    words=lambda rows: [],
)
RATIOS = Table(
    *(PAGE, "ratios", ("x", "of", "relative error", "midlie_jax", "ns", "diffrax", "ns", "times faster")),
    data="heat-ratios",
    key=lambda row: row[2] == "0.03",
    columns=(0, 1, 3, 4, 5, 6, 7),
)


def measure(options: argparse.Namespace) -> None:
    found = extend(options.kept, options.seconds)
    DIPOLE.show(options.write, rows(found))
    SLOPES.show(options.write, slope_rows(found))
    RATIOS.show(options.write, ratio_rows(found))
    if options.write:
        draw(found, REPORTS / "heat-averages.png")


_COLOURS = dict(zip((*OURS, *THEIRS), (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY), strict=True))
_SIZE = 9.0  # font size of names, points
_LEAST, _MOST = 1e-5, 1.0  # errors that are drawn


def draw(found: Sequence[Rung], out: Path) -> None:
    """A column for each field; above against the step, below against the time."""
    figure = new_figure(13, 8.4)
    axes = figure.subplots(2, len(FIELDS), sharey=True)
    figure.subplots_adjust(left=0.06, right=0.99, top=0.9, bottom=0.07, wspace=0.06, hspace=0.22)
    title = "BAOAB and ABOBA reach a given error in less time than the diffrax solvers"
    figure.suptitle(title, x=0.06, ha="left", fontsize=13, weight="bold")
    for column, x in enumerate(FIELDS):
        own = [rung for rung in found if rung.x == x and rung.error < _MOST]
        steps, times = axes[:, column]
        by_step, by_time = _panel(steps, own, "share"), _panel(times, own, "cost")
        steps.set_title(f"μB/kT = {x:g}", loc="left", fontsize=10)
        steps.set_xlabel("step [1/rate]")
        times.set_xlabel("run time per body and 1/rate of simulated time [ns]")
        label_ends(steps, [_end(lines[-1]) for method, lines in by_step.items() if method != "EulerHeun"])
        _write_name(steps, by_step["EulerHeun"][-1], (0, 9), "center")
        for method, lines in by_time.items():
            theirs = method in THEIRS
            _write_name(times, lines[-1 if theirs else 0], (6 if theirs else -6, 0), "left" if theirs else "right")
    for row in axes:
        row[0].set_ylabel("relative error of ⟨cos θ⟩ [-]")
    write(figure, str(out))


Place = tuple[str, float, float]  # a method and a point of its line


def _end(place: Place) -> End:
    method, x, y = place
    return End(_name_of(method), _COLOURS[method], x, y)


def _name_of(method: str) -> str:
    return f"diffrax {method}" if method in THEIRS else method.removeprefix("SYMMETRIC[").removesuffix("]")


def _write_name(panel: Any, place: Place, offset: tuple[float, float], side: str) -> None:
    method, *point = place
    options: Any = {"textcoords": "offset points", "ha": side, "va": "center", "fontsize": _SIZE}
    panel.annotate(_name_of(method), point, xytext=offset, color=_COLOURS[method], **options)


def _panel(panel: Any, found: Sequence[Rung], across: str) -> dict[str, list[Place]]:
    """Draws one panel; returns the places of the points of each method."""
    panel.set_xscale("log")
    panel.set_yscale("log")
    places = dict[str, list[Place]]()
    for method in dict.fromkeys(rung.method for rung in found):
        own = sorted((r for r in found if r.method == method), key=lambda r: getattr(r, across))
        x, y = [getattr(r, across) for r in own], [r.error for r in own]
        bars = [[min(r.uncertain, 0.9 * r.error) for r in own], [r.uncertain for r in own]]
        theirs = method in THEIRS
        style: Any = {"linestyle": "--" if theirs else "-", "marker": "s" if theirs else "o", "markersize": 3.5}
        panel.errorbar(x, y, yerr=bars, color=_COLOURS[method], **style)
        places[method] = [(method, *place) for place in zip(x, y, strict=True)]
    low, high = (end(getattr(r, across) for r in found) for end in (min, max))
    panel.set_xlim(low / (1.2 if across == "share" else 3.5), high * (1.2 if across == "share" else 14))
    panel.set_ylim(_LEAST, _MOST)
    panel.grid(alpha=0.3, color=GREY)
    return places
