"""Rigid water beside LAMMPS and OpenMM: docs/reports/heat.md.

    python benchmarks/molecules.py dimer [--write]           two waters against their known end after 1 ps
    python benchmarks/molecules.py box [--write]             216 waters: how much their energy fluctuates; waters.png
    python benchmarks/molecules.py speed [--write]           216 and 1,728 waters: the time of a step
    python benchmarks/molecules.py equipartition [--write]   temperatures of rotation and translation

Needs `pip install 'midlie_jax[bench-molecules]'`. Times are processor times on one core; programs that are
compared take turns. `equipartition --minutes 35` goes on with the runs in `--kept`, a file, before it shows what they
say.
"""

import argparse
from pathlib import Path

import jax

from midlie_jax.advice.timing import pin

jax.config.update("jax_enable_x64", True)
pin()  # before XLA counts the cores

from laboratory.molecules import energies, equipartition, speeds, two_molecules  # noqa: E402
from pages import DOCS, publish, put, shown  # noqa: E402

PAGE = "reports/heat.md"
MARKERS = {
    "dimer": ("<!-- dimer -->", "<!-- /dimer -->"),
    "box": ("<!-- box -->", "<!-- /box -->"),
    "speed": ("<!-- speed -->", "<!-- /speed -->"),
    "equipartition": ("<!-- equipartition -->", "<!-- /equipartition -->"),
}
TWO = (
    *(("`JACOBI[EA]`", "1"), ("`JACOBI[CHIN4A]`", "1"), ("`JACOBI[SRKN6b]`", "1"), ("`JACOBI[SRKN14a]`", "5")),
    *(("LAMMPS `rigid/nve/small`", "1"), ("OpenMM SETTLE", "1"), ("OpenMM SETTLE", "0.1")),
)
PICTURE = DOCS / "reports" / "waters.png"


def box(write: bool) -> list[str]:
    """The table, and with `write` the picture."""
    results = list[tuple[str, float, list[float]]]()

    def rows():
        for result in energies.measured():
            results.append(result)
            yield energies.row(*result)

    lines = shown(energies.HEADS, rows())
    lines += [
        "",
        f"After 0.1 ps, no site is farther than {energies.places_apart():.1e} nm from its position in LAMMPS.",
    ]
    print(lines[-1])
    if write:
        energies.draw(results, PICTURE)
    return lines


def write(name: str, lines: list[str]) -> None:
    """Puts a table into the page; the whole tables of two waters and of speeds into data files, too."""
    if name == "dimer":
        publish(PAGE, *MARKERS[name], lines, "waters-two", lambda row: tuple(row[:2]) in TWO)
    elif name == "speed":
        publish(PAGE, *MARKERS[name], lines, "waters-speed", columns=(0, 1, 2, 4))
    elif name == "equipartition":
        publish(PAGE, *MARKERS[name], lines, "waters-equipartition", lambda row: "6b" not in row[0], (0, 2, 4))
    else:
        put(PAGE, *MARKERS[name], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=list(MARKERS))
    parser.add_argument("--write", action="store_true", help=f"put what is found into docs/{PAGE}")
    parser.add_argument("--minutes", type=float, default=0.0, help="how long the runs of equipartition go on")
    parser.add_argument("--kept", type=Path, default=Path("equipartition.npz"), help="the file with these runs")
    options = parser.parse_args()
    if options.part == "dimer":
        lines = shown(two_molecules.HEADS, two_molecules.rows())
    elif options.part == "box":
        lines = box(options.write)
    elif options.part == "speed":
        lines = shown(speeds.HEADS, speeds.rows())
    else:
        equipartition.extend(options.kept, options.minutes)
        lines = shown(equipartition.HEADS, equipartition.rows(options.kept))
    if options.write:
        write(options.part, lines)


if __name__ == "__main__":
    main()
