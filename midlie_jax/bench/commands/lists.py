"""`midlie methods` and `midlie scenes`: print tables of all methods and scenes."""

import argparse

from ...methods.flights import FLIGHTS
from ...methods.registry import ENTRIES
from ...methods.schemes import SCHEMES
from .. import scenes as all_scenes
from .output import show_table


def methods(options: argparse.Namespace) -> None:
    """Prints the methods, the flights and the schemes, best first."""
    del options
    show_table(
        ["method", "moves", "order", "symmetric", "symplectic", "evaluations a step", "when to take it"],
        [
            [
                *(entry.method.name, entry.method.bodies.__name__, str(entry.method.order)),
                *(
                    _yes(entry.method.symmetric),
                    _yes(entry.method.symplectic),
                    str(entry.method.evaluations),
                    entry.use,
                ),
            ]
            for entry in ENTRIES.values()
        ],
    )
    print("\nAny combination FLIGHT[SCHEME] is a method, too:\n")
    show_table(
        ["flight", "order", "symplectic", "when to take it"],
        [[f.name, "exact" if f.order is None else str(f.order), _yes(f.symplectic), f.use] for f in FLIGHTS.values()],
    )
    print()
    show_table(
        ["scheme", "order", "symmetric", "when to take it"],
        [[s.name, str(s.order), _yes(s.symmetric), s.use] for s in SCHEMES.values()],
    )


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def scenes(options: argparse.Namespace) -> None:
    """Prints the scenes."""
    del options
    listed = [all_scenes.scene(name) for name in all_scenes.scenes()]
    show_table(
        ["scene", "step", "duration", "title"],
        [[s.name, f"{s.dt:g}", f"{s.duration:g}", s.title] for s in listed],
    )
