"""Spins on lattices: what methods keep, spin waves, rivals, walls and skyrmions: docs/reports/heat.md.

    python benchmarks/spins.py conservation [--write]  energy, total spin and lengths in runs of a chain
    python benchmarks/spins.py area [--write]          symplectic defects of one step; spins-area.png
    python benchmarks/spins.py dispersion [--write]    spin waves beside their closed form; spins-waves.png
    python benchmarks/spins.py lattice [--write]       steps a second of a million spins, beside a copy of them
    python benchmarks/spins.py rivals [--write]        error against time, beside Spirit; spins-rivals.png
    python benchmarks/spins.py wall [--write]          a domain wall in a field, beside Walker; spins-wall.png
    python benchmarks/spins.py skyrmion [--write]      a skyrmion beside Thiele; spins-skyrmion.png, skyrmion.gif

Times are processor times on one core; programs that are compared take turns. Spirit is measured if it is installed:
`pip install spirit`.
"""

import argparse

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from laboratory.spins import conservation, dispersion, lattice, rivals, skyrmion, symplectic, wall  # noqa: E402
from pages import DOCS, link, publish, put, save, saved, shown  # noqa: E402

PAGE = "reports/heat.md"
MARKERS = {
    "conservation": ("<!-- conservation -->", "<!-- /conservation -->"),
    "area": ("<!-- area -->", "<!-- /area -->"),
    "steps": ("<!-- steps -->", "<!-- /steps -->"),
    "peaks": ("<!-- peaks -->", "<!-- /peaks -->"),
    "lattice": ("<!-- lattice -->", "<!-- /lattice -->"),
    "rivals": ("<!-- rivals -->", "<!-- /rivals -->"),
    "wall": ("<!-- wall -->", "<!-- /wall -->"),
    "skyrmion": ("<!-- skyrmion -->", "<!-- /skyrmion -->"),
}
KEY = {  # of tables that have a data file: which rows and columns are on the page
    "conservation": (lambda row: row[1] == "0.2", (0, 2, 3, 4)),
    "area": (lambda row: row[0] != "one spin" and row[2] == "symplectic", (1, 5, 7)),
    "steps": (lambda row: row[1] == "chain of 32", (0, 2, 4, 5)),
    "peaks": (bool, (0, 1)),
    "rivals": (lambda row: "SIB" not in row[0], (0, 1, 2, 3, 5)),
    "lattice": (lambda row: row[:2] == ["1,000,000", "float64"], (2, 3, 4, 5)),
}
PICTURES = DOCS / "reports"


def keeps(write: bool) -> dict[str, list[str]]:
    del write
    return {"conservation": shown(conservation.HEADS, conservation.rows())}


def area(write: bool) -> dict[str, list[str]]:
    found = symplectic.measured()
    if write:
        symplectic.draw(found, PICTURES / "spins-area.png")
    return {"area": shown(symplectic.HEADS, symplectic.rows(found))}


def waves(write: bool) -> dict[str, list[str]]:
    found = {method: dispersion.peaks(method) for method in dispersion.SEEN}
    if write:
        dispersion.draw(found, PICTURES / "spins-waves.png")
    peaks = shown(dispersion.PEAK_HEADS, dispersion.peak_rows(found))
    return {"peaks": peaks, "steps": shown(dispersion.HEADS, dispersion.rows())}


def large(write: bool) -> dict[str, list[str]]:
    del write
    return {"lattice": shown(lattice.HEADS, lattice.rows())}


def against(write: bool) -> dict[str, list[str]]:
    found = rivals.measured()
    if write:
        rivals.draw(found, PICTURES / "spins-rivals.png")
    return {"rivals": shown(rivals.HEADS, rivals.rows(found))}


def walls(write: bool) -> dict[str, list[str]]:
    found = wall.measured()
    if write:
        wall.draw(found, PICTURES / "spins-wall.png")
    return {"wall": shown(wall.HEADS, wall.rows(found))}


def skyrmions(write: bool) -> dict[str, list[str]]:
    found = skyrmion.measured()
    if write:
        skyrmion.draw(found, PICTURES / "spins-skyrmion.png")
        skyrmion.animate(found, PICTURES / "skyrmion.gif")
    return {"skyrmion": shown(skyrmion.HEADS, skyrmion.rows(found))}


PARTS = {
    "conservation": keeps,
    "area": area,
    "dispersion": waves,
    "lattice": large,
    "rivals": against,
    "wall": walls,
    "skyrmion": skyrmions,
}


def write(name: str, lines: list[str]) -> None:
    """Puts a table, or its key rows, into the page; of the walls the largest difference from the closed form."""
    if name in KEY:
        publish(PAGE, *MARKERS[name], lines, f"spins-{name}", *KEY[name])
    elif name == "wall":
        save("spins-wall", lines)
        off = max(abs(float(row["simulated / theory - 1"])) for row in saved("spins-wall"))
        text = f"The simulated speeds agree with theory within {off:.1e} (relative), below and above Walker's field."
        put(PAGE, *MARKERS[name], [text, "", link("spins-wall")])
    else:
        put(PAGE, *MARKERS[name], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=list(PARTS))
    parser.add_argument("--write", action="store_true", help=f"put what is found into docs/{PAGE}")
    options = parser.parse_args()
    for name, lines in PARTS[options.part](options.write).items():
        if options.write:
            write(name, lines)


if __name__ == "__main__":
    main()
