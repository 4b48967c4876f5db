"""What `benchmarks/claims.py` does: measures methods, prints figures and verdicts, writes the page and the picture."""

import argparse
import os
import shlex
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

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

from . import page, picture
from .measure import Bench, Measured
from .verdicts import PUBLISHED_DRIFTS, Verdict, is_alternating, paper_verdicts, published_verdicts

_PARTS = 4  # parts of `Bench.measure` that are reported
_DRAWN = (*PUBLISHED_DRIFTS, "LIEMID[I]", "SLIEMID[EA]", RK4.name)


def claims(options: argparse.Namespace) -> None:
    """Measures, prints, and writes what was asked for."""
    require("tqdm", *(["matplotlib"] if options.out else []))
    methods = _methods(options)
    bench = Bench(options.steps) if options.steps else Bench()
    found = _measured(bench, methods)
    show_table(list(page.HEADS), [page.cells(one) for one in found])
    for title, verdicts in (
        ("The paper's claims", paper_verdicts(methods, found)),
        ("The published drift", published_verdicts(found)),
    ):
        if verdicts:
            print(f"\n{title}\n")
            show_table(["method", "claim", "verdict", "measured"], [_cells(verdict) for verdict in verdicts])
    print(f"\n{page.summary(methods, found)}")
    if options.out:
        drawn = [one for one in found if one.method in _DRAWN] or found
        picture.draw(drawn, options.out)
        print(f"wrote {options.out}")
    if options.page:
        page.write_page(
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
    return [verdict.method, verdict.claim, page.word(verdict), verdict.measured]


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
