"""The claims of the paper and of the package on trial: figures, verdicts, a page and a picture.

    python benchmarks/claims.py [--methods NAME ... | --all] [--steps N] [--page FILE] [--out FILE]

Measures order, symplectic defect, spatial momentum, reversal, energy over long runs, a published drift test and the
work of a step, and holds the claims against the figures. By default the methods of the paper and one with each flight
and each scheme of `midlie methods`, in under five minutes on two cores. `make claims` writes docs/reports/claims.md.
"""

import argparse
from collections.abc import Sequence

import jax
from laboratory.claims.command import claims

from midlie_jax.cli.options import MOST_STEPS, OWN, file, whole

jax.config.update("jax_enable_x64", True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--methods", nargs="+", metavar="NAME", help=f"only these methods{OWN}")
    which.add_argument("--all", action="store_true", help="every method, and every flight with every scheme: hours")
    parser.add_argument("--steps", type=whole(8, MOST_STEPS), metavar="N", help="steps of the long run (default: 1e6)")
    parser.add_argument("--page", type=file(".md"), metavar="FILE", help="write figures and verdicts as Markdown")
    parser.add_argument("--out", type=file(".png"), metavar="FILE", help="draw the energy over the long runs, as a PNG")
    options = parser.parse_args(arguments)
    try:
        claims(options)
    except (ValueError, ImportError, OSError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
