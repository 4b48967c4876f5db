"""What the commands of `midlie` do once `midlie_command` has read the line. Top of the package: nothing imports it."""

import argparse

import jax

from . import chart, lists, run

_ACTIONS = {"chart": chart.chart, "run": run.run, "methods": lists.methods, "scenes": lists.scenes}


def act(options: argparse.Namespace) -> None:
    """Does what was asked for.

    Raises:
        ValueError: something is wrong with it.
        ImportError: a package is missing.
        OSError: a file could not be written.
    """
    jax.config.update("jax_enable_x64", True)  # before any array exists, the scenes' included
    _ACTIONS[options.command](options)
