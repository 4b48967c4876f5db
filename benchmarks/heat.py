"""Bodies in a heat bath: errors of known averages, costs, and the spectrum of a nanodumbbell: docs/reports/heat.md.

    python benchmarks/heat.py dipole [--write]   a dipole in a field, beside diffrax; heat-averages.png

Processor times on one core; programs that are compared take turns.
"""

import argparse
import math
from pathlib import Path

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from laboratory.heat import averages, chart  # noqa: E402
from pages import DOCS, put, shown  # noqa: E402

PAGE = "reports/heat.md"


def dipole(options: argparse.Namespace) -> list[str]:
    found = averages.extend(options.kept, options.seconds)
    lines = shown(averages.RUNG_HEADS, map(averages.row, found))
    if options.write:
        chart.draw(found, DOCS / "reports" / "heat-averages.png")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["dipole"])
    parser.add_argument("--write", action="store_true", help=f"put what is found into docs/{PAGE}")
    parser.add_argument("--seconds", type=float, default=math.inf, help="after which dipole measures nothing more")
    parser.add_argument("--kept", type=Path, default=Path("heat-dipole.json"), help="the file with these runs")
    options = parser.parse_args()
    dipole(options)


if __name__ == "__main__":
    main()
