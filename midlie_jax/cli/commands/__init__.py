"""The commands of `midlie`: `main` parses the line and calls `act`. No other module imports this."""

import argparse

import jax

from . import chart, lists, run


def _fit(options: argparse.Namespace) -> None:
    from .fit import fit  # imported here, because no other command needs the optimisers

    fit(options)


def _stability(options: argparse.Namespace) -> None:
    from .stability import stability  # compiles nothing that another command needs

    stability(options)


def _inspect(options: argparse.Namespace) -> None:
    from .long_run import inspect_run

    inspect_run(options)


def _view(options: argparse.Namespace) -> None:
    from .view import view_run

    view_run(options)


def _export(options: argparse.Namespace) -> None:
    from .export import export

    export(options)


_ACTIONS = {
    "chart": chart.chart,
    "run": run.run,
    "inspect": _inspect,
    "view": _view,
    "export": _export,
    "fit": _fit,
    "stability": _stability,
    "methods": lists.methods,
    "scenes": lists.scenes,
}


def act(options: argparse.Namespace) -> None:
    """Runs the command of the parsed options."""
    jax.config.update("jax_enable_x64", True)  # must come before any array is created, including the arrays of scenes
    _ACTIONS[options.command](options)
