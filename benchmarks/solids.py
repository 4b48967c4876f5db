"""Deformable solids by the methods for particles: docs/reports/applications.md, and the pictures of docs/solids.md.

    python benchmarks/solids.py block [--write]    a thrown block of gel: momenta, energy bands; thrown-block.png, .gif
    python benchmarks/solids.py bar [--write]      a fixed bar beside d'Alembert's solution
    python benchmarks/solids.py cost [--write]     a step beside the one force that it evaluates

Times are processor times on one core; programs that are compared take turns. The meshes are made by scikit-fem, which
`pip install 'midlie_jax[solids]'` brings.
"""

import argparse
from types import ModuleType

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from laboratory.solids import bar, block, cost, drawing  # noqa: E402
from pages import DOCS, publish, put, shown  # noqa: E402

PAGE = "reports/applications.md"
MARKERS = {
    "bar": ("<!-- solids bar -->", "<!-- /solids bar -->"),
    "block": ("<!-- solids block -->", "<!-- /solids block -->"),
    "limits": ("<!-- solids limits -->", "<!-- /solids limits -->"),
    "cost": ("<!-- solids cost -->", "<!-- /solids cost -->"),
}


def write(name: str, lines: list[str]) -> None:
    """Writes a table into the page; the times of a step are for the finest mesh in float64."""
    if name == "cost":
        finest = lambda row: row[0] == "3072" and row[2] == "float64"  # noqa: E731
        publish(PAGE, *MARKERS[name], lines, "solids-cost", finest, (3, 4, 5))
    elif name == "block":
        publish(PAGE, *MARKERS[name], lines, "solids-block", columns=(0, 2, 3, 6, 8))
    else:
        put(PAGE, *MARKERS[name], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("block", "bar", "cost"))
    parser.add_argument("--write", action="store_true", help="put what is found into docs/")
    options = parser.parse_args()
    part: ModuleType = {"block": block, "bar": bar, "cost": cost}[options.part]
    tables = {options.part: shown(part.HEADS, part.rows())}
    if part is block:
        tables["limits"] = shown(block.LIMIT_HEADS, block.limit_rows())
    if not options.write:
        return
    for name, lines in tables.items():
        write(name, lines)
    if part is block:
        drawing.draw(DOCS)


if __name__ == "__main__":
    main()
