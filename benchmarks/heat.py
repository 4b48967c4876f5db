"""Bodies in a heat bath: errors of known averages, costs, and the spectrum of a nanodumbbell: docs/reports/heat.md.

    python benchmarks/heat.py dipole [--write]         a dipole in a field, beside diffrax; heat-averages.png
    python benchmarks/heat.py cost [--write]           what a step in a bath costs beside a step of EA
    python benchmarks/heat.py dumbbell [--write]       a nanodumbbell in polarised light; dumbbell-spectrum.png
    python benchmarks/heat.py correlations [--write]   how a sphere forgets its velocity and direction
    python benchmarks/heat.py temperature [--write]    free rotors keep their temperature, whatever is saved
    python benchmarks/heat.py diffusion [--write]      how much too fast free bodies diffuse at long steps

Times are processor times on one core; programs that are compared take turns. `dipole --seconds 400` measures for some
time only; the next call goes on with the runs in `--kept`, a file.
"""

import argparse
import math
from pathlib import Path

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from laboratory.heat import averages, chart, correlations, cost, diffusion, dumbbell, temperature  # noqa: E402
from pages import DOCS, link, publish, put, save, saved, shown  # noqa: E402

PAGE = "reports/heat.md"
MARKERS = {
    "slopes": ("<!-- slopes -->", "<!-- /slopes -->"),
    "ratios": ("<!-- ratios -->", "<!-- /ratios -->"),
    "dipole": ("<!-- dipole -->", "<!-- /dipole -->"),
    "cost": ("<!-- cost -->", "<!-- /cost -->"),
    "dumbbell": ("<!-- dumbbell -->", "<!-- /dumbbell -->"),
    "correlations": ("<!-- correlations -->", "<!-- /correlations -->"),
    "temperature": ("<!-- temperature -->", "<!-- /temperature -->"),
    "diffusion": ("<!-- diffusion -->", "<!-- /diffusion -->"),
}
KEY = {  # of tables that have a data file: which rows and columns are on the page
    "ratios": (lambda row: row[2] == "0.03", (0, 1, 3, 4, 5, 6, 7)),
    "cost": (lambda row: row[2] == "float32", (0, 1, 3, 4, 5)),
    "diffusion": (lambda row: row[0] == "`BAOAB`", (1, 2, 3, 4)),
    "dumbbell": (lambda row: row[1] != "slowest third", (0, 1, 3, 4, 5)),
}
PICTURES = DOCS / "reports"


def dipole(options: argparse.Namespace) -> dict[str, list[str]]:
    found = averages.extend(options.kept, options.seconds)
    lines = {
        "dipole": shown(averages.HEADS, averages.rows(found)),
        "slopes": shown(averages.SLOPE_HEADS, averages.slope_rows(found)),
        "ratios": shown(averages.RATIO_HEADS, averages.ratio_rows(found)),
    }
    if options.write:
        chart.draw(found, PICTURES / "heat-averages.png")
    return lines


def costs(options: argparse.Namespace) -> dict[str, list[str]]:
    del options
    return {"cost": shown(cost.HEADS, cost.rows())}


def spectrum(options: argparse.Namespace) -> dict[str, list[str]]:
    panels = [(difference, dumbbell.spectrum(difference)) for difference in dumbbell.DIFFERENCES]
    if options.write:
        dumbbell.draw(panels, PICTURES / "dumbbell-spectrum.png")
    return {"dumbbell": shown(dumbbell.HEADS, dumbbell.rows(panels))}


def sphere(options: argparse.Namespace) -> dict[str, list[str]]:
    found = correlations.measured()
    if options.write:
        correlations.draw(found, PICTURES / "heat-correlations.png")
    return {"correlations": shown(correlations.HEADS, correlations.rows(found))}


def rotors(options: argparse.Namespace) -> dict[str, list[str]]:
    del options
    return {"temperature": shown(temperature.HEADS, temperature.rows())}


def free(options: argparse.Namespace) -> dict[str, list[str]]:
    del options
    return {"diffusion": shown(diffusion.HEADS, diffusion.rows())}


PARTS = {
    "dipole": dipole,
    "cost": costs,
    "dumbbell": spectrum,
    "correlations": sphere,
    "temperature": rotors,
    "diffusion": free,
}


def write(name: str, lines: list[str]) -> None:
    """Puts a table, or its key rows, into the page; of the longest tables what they show, in a sentence."""
    if name in KEY:
        publish(PAGE, *MARKERS[name], lines, f"heat-{name}", *KEY[name])
        return
    save(f"heat-{name}", lines)
    rows = saved(f"heat-{name}")
    text = []
    if name == "correlations":
        off = max(abs(float(row["difference, standard errors"])) for row in rows)
        text = [f"The largest difference of {len(rows)} values from theory is {off:.1f} standard errors.", ""]
    elif name == "temperature":
        off = max(float(row["largest deviation, standard errors"]) for row in rows)
        same = sum(row["same bits"] == "yes" for row in rows)
        text = [
            f"In {len(rows)} runs, no temperature differs from theory by more than {off:.1f} standard errors (0.01).",
            f"The final states have the same bits for every `save_every` in {same} of {len(rows)} runs.",
            "",
        ]
    put(PAGE, *MARKERS[name], [*text, link(f"heat-{name}")])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=list(PARTS))
    parser.add_argument("--write", action="store_true", help=f"put what is found into docs/{PAGE}")
    parser.add_argument("--seconds", type=float, default=math.inf, help="after which dipole measures nothing more")
    parser.add_argument("--kept", type=Path, default=Path("heat-dipole.json"), help="the file with the runs of dipole")
    options = parser.parse_args()
    for name, lines in PARTS[options.part](options).items():
        if options.write:
            write(name, lines)


if __name__ == "__main__":
    main()
