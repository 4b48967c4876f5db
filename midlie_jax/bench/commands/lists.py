"""`midlie methods` and `midlie scenes`."""

import argparse

from ...methods.registry import method as find_method
from ...methods.registry import methods as all_methods
from .. import scenes as all_scenes
from .output import show_table


def methods(options: argparse.Namespace) -> None:
    """Lists the methods."""
    del options
    show_table(
        ["method", "moves", "order", "symmetric", "evaluations a step"],
        [
            [m.name, m.bodies.__name__, str(m.order), "yes" if m.symmetric else "no", str(m.evaluations)]
            for m in map(find_method, all_methods())
        ],
    )


def scenes(options: argparse.Namespace) -> None:
    """Lists the scenes."""
    del options
    found = [all_scenes.scene(name) for name in all_scenes.scenes()]
    show_table(
        ["scene", "step", "duration", "title"],
        [[s.name, f"{s.dt:g}", f"{s.duration:g}", s.title] for s in found],
    )
