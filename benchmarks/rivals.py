"""Error against time on one scene, for our methods and for other programs: a table and a chart.

    python benchmarks/rivals.py [SCENE] [--methods NAME ...] [--out FILE] [--quick]

A method or a scene of your own is given as MODULE:NAME, of a module in the current folder. `make rivals` does the same
for seven scenes and writes docs/reports/work-precision.md (`work_precision.py`).
"""

import argparse
from collections.abc import Sequence

import jax
from laboratory import frontier, rivals, scenes, work_precision

from midlie_jax.advice.timing import one_core
from midlie_jax.cli import chosen
from midlie_jax.cli.options import OWN, file
from midlie_jax.cli.tables import require, show_table

jax.config.update("jax_enable_x64", True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "scene", nargs="?", default="P1", metavar="SCENE", help=f"orbit, axis, see `midlie scenes`{OWN}"
    )
    parser.add_argument("--methods", nargs="+", metavar="NAME", help=f"see `midlie methods`{OWN}")
    parser.add_argument("--out", type=file(".png"), metavar="FILE", help="by default chart-SCENE-rivals.png")
    parser.add_argument("--quick", action="store_true", help="time fewer and shorter runs")
    options = parser.parse_args(arguments)
    try:
        with one_core():
            compare(options)
    except (ValueError, ImportError, OSError) as error:
        parser.error(str(error))


def compare(options: argparse.Namespace) -> None:
    rivals.require()
    require("matplotlib")
    scene, methods = scenes.scene(options.scene), chosen.methods(options.methods or ())
    path = options.out or f"chart-{scene.name}-rivals.png"
    comparison = work_precision.compared(scene, methods or None, quick=options.quick)
    print()
    show_table(list(frontier.HEADS), [frontier.cells(row) for row in comparison.ratios])
    print(f"\n{work_precision.timing_note(comparison)}")
    work_precision.draw(comparison, path)
    print(f"\nwrote {path}")


if __name__ == "__main__":
    main()
