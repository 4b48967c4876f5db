"""What `benchmarks/claims.py` does: measures methods, prints figures and verdicts, writes the page and the picture."""

import argparse
import os
import shlex
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from harness import REPORTS, Line, Panel, chart, compact, link, part, put, save, table
from harness import cells as cells_of

from midlie_jax._xla.platform import cores
from midlie_jax.cli import chosen
from midlie_jax.cli.tables import progress_bar, require, show_table
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.flights import FLIGHTS
from midlie_jax.integrators.registry import ENTRIES
from midlie_jax.integrators.registry import method as find_method
from midlie_jax.integrators.runge_kutta import RK4
from midlie_jax.integrators.schemes import SCHEMES
from midlie_jax.integrators.splitting import Splitting
from midlie_jax.model.bodies import RigidBody

from .drift import EIGHTHS
from .measure import Bench, Measured
from .verdicts import (
    DECLARED,
    PUBLISHED_DRIFTS,
    RANK,
    Verdict,
    is_alternating,
    paper_verdicts,
    published_verdicts,
    registry_verdicts,
    shifts,
    trend,
)

_PARTS = 4  # parts of `Bench.measure` that are reported
_DRAWN = (*PUBLISHED_DRIFTS, "LIEMID[I]", "SLIEMID[EA]", RK4.name)


def claims(options: argparse.Namespace) -> None:
    """Measures, prints, and writes what was asked for."""
    require("tqdm", *(["matplotlib"] if options.out else []))
    methods = _methods(options)
    bench = Bench(options.steps) if options.steps else Bench()
    found = _measured(bench, methods)
    show_table(list(HEADS), [cells(one) for one in found])
    for title, verdicts in (
        ("The paper's claims", paper_verdicts(methods, found)),
        ("The published drift", published_verdicts(found)),
    ):
        if verdicts:
            print(f"\n{title}\n")
            show_table(["method", "claim", "verdict", "measured"], [_cells(verdict) for verdict in verdicts])
    print(f"\n{summary(methods, found)}")
    if options.out:
        drawn = [one for one in found if one.method in _DRAWN] or found
        draw(drawn, options.out)
        print(f"wrote {options.out}")
    if options.page:
        write_page(
            Path(options.page),
            methods,
            found,
            command=_command(options),
            given={chosen.method(name).name: name for name in options.methods or ()},
            chaos=bench.chaos(),
            picture=os.path.relpath(options.out, Path(options.page).parent) if options.out else None,
        )
        print(f"wrote {options.page}")


def _command(options: argparse.Namespace) -> str:
    words = ["python", "benchmarks/claims.py", *(["--all"] if options.all else [])]
    words += ["--methods", *map(shlex.quote, options.methods)] if options.methods else []
    words += ["--steps", str(options.steps)] if options.steps else []
    words += ["--out", options.out] if options.out else []
    return " ".join([*words, "--page", options.page])


def _cells(verdict: Verdict) -> list[str]:
    return [verdict.method, verdict.claim, word(verdict), verdict.measured]


def _methods(options: argparse.Namespace) -> list[Method]:
    """The methods to measure: those named, or all, or the default ones."""
    if options.methods:
        return chosen.methods(options.methods)
    rigid = {name: entry for name, entry in ENTRIES.items() if issubclass(RigidBody, entry.method.bodies)}
    if options.all:
        pairs = [
            find_method(f, s) for f in FLIGHTS.values() if f.body is RigidBody for s in SCHEMES.values() if not s.random
        ]
        return [*{method.name: method for method in (*(e.method for e in rigid.values()), *pairs)}.values()]
    flights: set[str] = set()
    schemes: set[str] = set()
    found: list[Method] = []
    for entry in rigid.values():
        method = entry.method
        new = method is RK4 or method.keeps_energy
        if isinstance(method, Splitting):
            new = method.flight.name not in flights or method.scheme.name not in schemes
            flights.add(method.flight.name)
            schemes.add(method.scheme.name)
        if new or entry.paper:
            found.append(method)
    return found


def _measured(bench: Bench, methods: list[Method]) -> list[Measured]:
    """What was measured of each method, in their order; two methods at a time if there are two cores."""
    with progress_bar(_PARTS * len(methods), "part") as bar, ThreadPoolExecutor(min(2, cores())) as pool:
        # The alternating method first: what all methods share is computed with it, before others start.
        first = next((i for i, method in enumerate(methods) if is_alternating(method)), 0)

        def one(method: Method) -> Measured:
            def done(part: str) -> None:
                bar.set_description(f"{method.name}: {part}")
                bar.update()

            return bench.measure(method, done)

        found = {first: one(methods[first])}
        rest = [i for i in range(len(methods)) if i != first]
        found |= dict(zip(rest, pool.map(one, [methods[i] for i in rest]), strict=True))
    return [found[i] for i in range(len(methods))]


# ---- the tables, for the terminal, for docs/reports/claims.md and for its data files ----
#
# The tables of the claims, for the terminal, for docs/reports/claims.md and for its data files.

HEADS = (
    *("method", "order", "defect, h=0.1", "area, h=0.1", "R Pi", "reversal", "top: shift", "top: osc."),
    *("drift: first", "last", "ev.", "solves", "error, top", "error, P1", "ok"),
)

TRIED = ("method", "claim", "measured", "verdict", "command")
SHOWN = (0, 1, 2, 4, 5, 8, 9, 13)  # the columns of `HEADS` on the page; the data file has all


def cells(found: Measured) -> list[str]:
    """The row of a method, for `HEADS`."""
    shift, oscillation = trend(found)
    drifts = found.drift.eighths[0]
    return [
        found.method,
        f"{found.order:.2f}",
        f"{found.symplectic[-1]:.0e}",
        f"{found.area[-1]:.0e}",
        f"{found.momentum:.0e}",
        f"{found.reversal:.0e}",
        f"{shift:.1e}",
        f"{oscillation:.1e}",
        f"{drifts[0]:.1e}",
        f"{drifts[-1]:.1e}",
        str(found.work.evaluations) + ("" if found.work.explicit else " implicit"),
        str(found.solves),
        f"{found.accuracy:.1e}",
        f"{found.accuracy_p1:.1e}",
        "yes" if found.ok else "NO",
    ]


def word(verdict: Verdict) -> str:
    return "holds" if verdict.holds else "FALLS"


def summary(methods: Sequence[Method], all_found: Sequence[Measured]) -> str:
    """How many of the registry's declarations hold, in a sentence, and which fall."""
    verdicts = [v for m, f in zip(methods, all_found, strict=True) for v in registry_verdicts(m, f)]
    falls = [v for v in verdicts if not v.holds]
    text = f"{len(verdicts) - len(falls)} of {len(verdicts)} declarations of the registry hold."
    return text + "".join(f"\n{v.method}: {v.claim} FALLS, measured {v.measured}." for v in falls)


def write_page(
    file: Path,
    methods: Sequence[Method],
    all_found: Sequence[Measured],
    *,
    command: str,
    given: Mapping[str, str],
    chaos: str,
    picture: str | None,
) -> None:
    """Writes what was measured into docs/reports/claims.md, or another page, and the data files beside it.

    Args:
        file: the page.
        methods, all_found: the methods, and what was measured of each.
        command: the command that measured it.
        given: how the command calls a method, by its name, where it does not call it so.
        chaos: the sentence that shows that the motion of the tops is chaotic.
        picture: name of the picture beside the page, if there is one.
    """

    def alone(method: str) -> str:
        return f"python benchmarks/claims.py --methods '{given.get(method, method)}'"

    def tried(verdicts: Sequence[Verdict]) -> list[str]:
        rows = [
            [f"`{v.method}`", v.claim, v.measured, word(v), f"`{command if v.key == RANK else alone(v.method)}`"]
            for v in verdicts
        ]
        return table(TRIED, rows)

    paper = paper_verdicts(methods, all_found)
    claims, drifts = tried(paper), tried(published_verdicts(all_found))
    figures = table(HEADS, [[f"`{row[0]}`", *row[1:]] for row in map(cells, all_found)])
    data = {"claims": claims, "drifts": drifts, "figures": figures, "declared": _declared(methods, all_found)}
    for name, lines in data.items():
        save(f"claims-{name}", lines, file.parent / "tables")
    sections = {
        "claims outcome": [outcome(paper)],
        "claims chaos": [f"The motion of the tops is chaotic: {chaos}"],
        "claims verdicts": [*_of_first_method(claims), "", link("claims-claims")],
        "claims drifts": [*part(drifts, columns=range(4)), "", link("claims-drifts")],
        "claims values": [*part(figures, columns=SHOWN), "", link("claims-figures")],
        "claims declared": [summary(methods, all_found), "", link("claims-declared")],
    }
    if file.resolve() == REPORTS / "claims.md":
        for mark, lines in sections.items():
            put("reports/claims.md", mark, lines)
        return
    drawn = [f"![Energy over the two long runs]({picture})", ""] if picture else []
    text = [line for lines in sections.values() for line in (*map(compact, lines), "")]
    file.write_text("\n".join(["# The claims", "", f"Written by `{command}`.", "", *text, *drawn]))


def outcome(verdicts: Sequence[Verdict]) -> str:
    """How many of the claims hold for each method that they are about, and which do not."""
    groups: dict[str, list[str]] = {}
    for method in dict.fromkeys(v.method for v in verdicts):
        own = [v for v in verdicts if v.method == method]
        falls = [v.claim for v in own if not v.holds]
        text = f"{len(own) - len(falls)} of {len(own)} claims hold."
        text += f" These do not:\n{'; '.join(falls)}." if falls else ""
        groups.setdefault(text, []).append(f"`{method}`")
    return "\n".join(f"For {' and '.join(methods)}, {text}" for text, methods in groups.items())


def _of_first_method(lines: Sequence[str]) -> list[str]:
    """Claims, measured values and verdicts for the first method of the table."""
    first = cells_of(lines[2])[0] if len(lines) > 2 else ""
    return part(lines, lambda row: row[0] == first, range(1, 4))


def _declared(methods: Sequence[Method], all_found: Sequence[Measured]) -> list[str]:
    rows: list[list[str]] = []
    for method, found in zip(methods, all_found, strict=True):
        words = {v.key: word(v) for v in registry_verdicts(method, found)}
        rows.append([f"`{found.method}`", *(words.get(key, "-") for key in DECLARED)])
    return table(["method", *DECLARED], rows)


# ---- the picture: the mean energy error over the two long runs ----
#
# The picture of the claims: the mean energy error over the two long runs, for each method.

_COLOURS = (
    *("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00"),
    *("#56B4E9", "#000000", "#A03060", "#1B3A6B", "#662506"),
)
MOST = len(_COLOURS)


def draw(all_found: Sequence[Measured], path: str) -> None:
    """Draws at most `MOST` methods, and writes a PNG."""
    shown, middles = all_found[:MOST], np.arange(EIGHTHS) + 0.5

    def lines(time: Any, values: Sequence[Any]) -> list[Line]:
        look: Any = {"linewidth": 2, "marker": "o", "markersize": 4}
        rows = zip(shown, values, _COLOURS, strict=False)
        return [Line(found.method, time, value, colour, "-", True, look) for found, value, colour in rows]

    drifts = lines(10 / EIGHTHS * middles, [found.drift.eighths[0] for found in shown])
    time = 0.05 * all_found[0].steps / 1000 / EIGHTHS * middles
    tops = lines(time[1:], [shifts(found)[1:] for found in shown])
    across = "time [1000 units of time]"
    shift = "mean energy error relative to the first eighth [initial energy]"
    panels = [
        Panel("Drift test, h = 0.25", across, "mean energy error [unit of energy]", drifts),
        Panel("Chaotic heavy tops, h = 0.05", across, shift, tops, {"yscale": "log"}),
    ]
    title = "JACOBI[EA] and SLIEMID[EA] have no energy trend in either test"
    right = f"right, {all_found[0].steps:.0e} steps and the root mean square over the tops."
    note = f"Means over eighths of the run; {right}"
    chart(Path(path), [panels], (14.0, 6.2), title, note, bottom=0.11, wspace=0.2)
