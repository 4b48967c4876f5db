"""Error against time, for midlie_jax and for other programs, on one core: the charts and tables under docs/reports/.

    python benchmarks/work_precision.py [--scene NAME ...] [--quick] [--out FOLDER]
    python benchmarks/work_precision.py --data     what pages show of the data, without measuring: times-faster.png

Writes FOLDER/work-precision-SCENE.png for each scene, and the data, FOLDER/tables/work-precision*.csv, of which only
the rows of the scenes named are replaced. In docs/reports, the default, it also puts what it found into the page
work-precision.md and into other pages. `--quick` times fewer runs, and by default writes into a temporary folder.
"""

import platform
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import one_core  # noqa: F401
from harness import REPORTS, main, put, save, saved, table
from laboratory import frontier, rivals, times_faster, work_precision
from laboratory.frontier import FAMILIES
from laboratory.rivals import heyoka_taylor
from laboratory.times_faster import ERRORS, inverse

from midlie_jax.advice.timing import spread_in_words

PAGE = "reports/work-precision.md"
PROGRAMS = ("jax", "diffrax", "heyoka", "scipy", "mujoco")
DATA = ("work-precision", "work-precision-heyoka", "work-precision-ratios")
CURVE = ("tolerance", "fastest variant", "error", "µs per body")
RATIOS = (*(f"{family} / heyoka" for family in FAMILIES), "general / diffrax")
HEADS = (
    *("error", "fastest method: µs per body", "times faster than heyoka", "than diffrax"),
    "symplectic: times faster than heyoka",
)


def measure(options):
    if options.data:
        into_pages()
        return
    rivals.require()
    out = options.out or (Path(tempfile.mkdtemp(prefix="midlie-")) if options.quick else REPORTS)
    (out / "tables").mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    for name in options.scene:
        comparison = work_precision.compared(name, quick=options.quick)
        lines = said(comparison)
        keep_and_draw(name, comparison, out)
        if out == REPORTS:
            put(PAGE, name, [*lines, "", *key_rows(name)])
        print(*lines, f"[{time.perf_counter() - began:.0f} s]", sep="\n", flush=True)
        if spin := spin_text(comparison):
            print(*spin, sep="\n")
            if out == REPORTS:
                put(PAGE, "spin", spin)
    if out == REPORTS:
        versions = ", ".join(f"{program} {version(program)}" for program in PROGRAMS)
        put(PAGE, "versions", [f"Versions: {versions};", f"{platform.machine()}, {platform.system()}."])
        into_pages()
    print(f"wrote {out}")


def into_pages() -> None:
    """What pages show of the data of all scenes."""
    rows = [list(row.values()) for row in saved(DATA[2])]
    heads = ["scene", *(f"{family}: than heyoka" for family in FAMILIES), "general: than diffrax"]
    put(PAGE, "times faster", table(heads, [[name, *map(inverse, ratios)] for name, *ratios in rows]))
    times_faster.FASTEST.show(write=True)
    times_faster.draw()


def said(comparison: work_precision.Comparison) -> list[str]:
    """What is said of a scene above its table."""
    problem, spreads = comparison.problem, [point.spread for point in comparison.ours + comparison.rivals]
    return [
        f"Error: {problem.kind.measured}. Reference: {problem.source}, uncertainty {problem.uncertainty:.0e}.",
        f"Times: {spread_in_words(spreads)}. {comparison.warning}".strip(),
    ]


def key_rows(name: str) -> list[str]:
    """The table of a scene on the page: times, and how many times faster, at `ERRORS`."""
    columns = "general / heyoka", "general / diffrax", "symplectic / heyoka"
    return table(
        HEADS,
        [
            [row["error"], row["general: µs per body"], *(inverse(row[column]) for column in columns)]
            for row in saved(DATA[0])
            if row["scene"] == name and row["error"] in ERRORS
        ],
    )


def keep(name: str, heads: Sequence[str], file: str, rows: Sequence[Sequence[str]], folder: Path) -> None:
    """Replaces the rows of a scene in a data file; the scenes stay in the order of the page."""
    before = [list(row.values()) for row in saved(file, folder)] if (folder / f"{file}.csv").exists() else []
    every = [row for row in before if row[0].partition(",")[0] != name] + [list(row) for row in rows]
    every.sort(key=lambda row: work_precision.SCENES.index(row[0].partition(",")[0]))
    save(file, table(["scene", *heads], every), folder)


def keep_and_draw(name: str, comparison: work_precision.Comparison, out: Path) -> None:
    title = message(name, spans(comparison.ratios)[0])
    work_precision.draw(comparison, str(out / f"work-precision-{name}.png"), title)
    curve = [
        [name, *p.setting.removeprefix("tol ").split(", ", 1), f"{p.error:.1e}", f"{1e6 * p.seconds:.3g}"]
        for p in comparison.rivals
        if p.method == "heyoka"
    ]
    summary = [[name, *spans(comparison.ratios)]]
    if comparison.in_steps:
        summary.append([f"{name}, in steps", *spans(comparison.in_steps)])
    print(*summary, sep="\n")
    keep(name, frontier.HEADS, DATA[0], [[name, *frontier.cells(row)] for row in comparison.ratios], out / "tables")
    keep(name, CURVE, DATA[1], curve, out / "tables")
    keep(name, RATIOS, DATA[2], summary, out / "tables")


def message(name: str, over_heyoka: str) -> str:
    """The title of a chart, from the span of the ratios of all methods to heyoka."""
    faster = inverse(over_heyoka)
    return f"{name}: {faster} times faster than heyoka" if faster[0].isdigit() else name


def spans(rows: list[frontier.Ratio]) -> list[str]:
    """The spans of the ratios to heyoka by family, and of the ratio to diffrax."""
    over_heyoka = [frontier.span([row.families[family].over_heyoka for row in rows]) for family in FAMILIES]
    return [*over_heyoka, frontier.span([row.over_diffrax for row in rows])]


def spin_text(comparison: work_precision.Comparison) -> list[str]:
    """What heyoka takes for the axis, and what with the spin of the top; nothing where the state is not an axis."""

    def took(program: str) -> str:
        points = [point for point in comparison.rivals if point.method == program]
        costs = [1e6 * frontier.best_at(points, error).cost for error in frontier.DECADES]
        return f"{min(costs):.2g} to {max(costs):.2g} µs"

    if not any(point.method == heyoka_taylor.LABEL for point in comparison.rivals):
        return []
    return [
        "A spinning frame is expensive for the Taylor series of heyoka. "
        f"heyoka takes {took('heyoka')} per body for these six",
        f"equations, and {took(heyoka_taylor.LABEL)} for the seven equations of a spinning body "
        f'("{heyoka_taylor.LABEL}").',
        "The tables use the times for six equations, which suffice for the axis alone.",
    ]


ARGUMENTS = {
    "--scene": {"nargs": "+", "choices": work_precision.SCENES, "default": list(work_precision.SCENES)},
    "--quick": {"action": "store_true"},
    "--out": {"type": Path, "metavar": "FOLDER"},
    "--data": {"action": "store_true", "help": "measure nothing"},
}

if __name__ == "__main__":
    main(__doc__, measure, ARGUMENTS)
