"""Surfaces of facets: what sunlight on them costs, and a light curve: docs/reports/applications.md, docs/surfaces.md.

    python benchmarks/surfaces.py cost [--write]      a step with sunlight beside a loop in C over the same facets
    python benchmarks/surfaces.py curve [--write]     the light curve of a tumbling body; light-curve.png

Times are processor times on one core; programs that are compared take turns.
"""

import argparse

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from laboratory.surfaces import cost, curve  # noqa: E402
from pages import DOCS, publish, shown  # noqa: E402

PAGE, PICTURE = "reports/applications.md", "light-curve.png"
BEGIN, END = "<!-- surfaces cost -->", "<!-- /surfaces cost -->"


def write(lines: list[str]) -> None:
    """Puts the whole table into its data file, and its main columns into the page."""
    publish(PAGE, BEGIN, END, lines, "surfaces", lambda row: row[1] == "float64", (0, 2, 3, 4, 7))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("cost", "curve"))
    parser.add_argument("--write", action="store_true", help="put what is found into docs/")
    options = parser.parse_args()
    if options.part == "curve":
        curve.draw(DOCS / PICTURE if options.write else None)
        return
    lines = shown(cost.HEADS, cost.rows())
    if options.write:
        write(lines)


if __name__ == "__main__":
    main()
