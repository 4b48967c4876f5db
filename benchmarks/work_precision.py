"""Error against time, for midlie_jax and for other programs, on one core: the charts and tables under docs/reports/.

    python benchmarks/work_precision.py [--scene NAME ...] [--quick] [--out FOLDER]

The process pins itself to one core before XLA counts the cores. It writes FOLDER/work-precision-SCENE.png for each
scene, the page FOLDER/work-precision.md, and its data, FOLDER/tables/work-precision*.csv. It replaces only the parts of
the scenes named. `--quick` times fewer runs, and by default writes into a temporary folder.
"""

import argparse
import platform
import re
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import choosing
import jax
import times_faster
from laboratory import frontier, rivals, work_precision
from laboratory.families import FAMILIES
from laboratory.frontier_chart import work_precision_chart
from laboratory.rivals import spinning_top
from pages import compact, link, put, save, saved, shown

from midlie_jax.advice.timing import cost_clock, pin, spread_in_words

jax.config.update("jax_enable_x64", True)
pin()

ROOT = Path(__file__).resolve().parent.parent
REPORTS = ROOT / "docs" / "reports"
SPIN = "A spinning frame is expensive for the Taylor series of heyoka."
PROGRAMS = ("jax", "diffrax", "heyoka", "scipy", "mujoco")
DATA = ("work-precision", "work-precision-heyoka", "work-precision-ratios")
ERRORS = ("1e-03", "1e-06", "1e-09", "1e-12")  # in the tables of the page; the data file has every decade
HEAD = """# Error against run time

This page compares the run times of midlie_jax, heyoka, diffrax, SciPy and MuJoCo at equal error, for seven scenes.
The fastest method of midlie_jax is faster than heyoka and diffrax in every scene and at every error from 1e-3 to
1e-12. Symplectic methods are slower than heyoka for `asymmetric-top` and `orbit` at small errors.

`make rivals` measures and writes this page. The times use one core, float64 and {bodies} bodies with slightly
different initial states. A time is processor time per body, the median of several runs, without compilation. The
errors are root mean squares over the first {judged} bodies at the end of the run. Versions: {versions};
{machine}.

## Times faster at equal error

Each entry is the range over the errors from 1e-3 to 1e-12. A value below 1 means that midlie_jax is slower.

{summary}

- **General**: the fastest of all methods of midlie_jax.
- **Conserving**: the fastest method that is reversible or symplectic, or that conserves energy to machine precision.
- **Symplectic**: the fastest symplectic method.
- **In steps**: without `ml.free_motion`, the closed form for a torque-free body, which belongs to all three families.

{link}

The charts use the same families. A bold line gives, for each error, the time of the fastest method of one family.
Hollow marks are other programs. The right panel has the number of torque evaluations.

## Conditions and limits

- Times between two runs of a method are interpolated in logarithms. An error larger than the largest measured error
  gets the time of the coarsest run.
- heyoka uses `taylor_adaptive_batch`, the fastest of several batch widths and options, without the time of the Python
  loop over batches. heyoka's errors for each tolerance are in
  [work-precision-heyoka.csv](tables/work-precision-heyoka.csv).
- diffrax uses the better of a constant step and a PID controller, with the compiler options of midlie_jax.
- SciPy and MuJoCo integrate a few bodies, one after another. MuJoCo runs neither the satellite, the orbit nor the
  axis.
- Every program integrates as many numbers as midlie_jax: seven for a rigid body, thirteen in `orbit`, six in `axis`.
- The method NO_SQUISH is identical to DLM (`tests/test_work_precision.py`).
- These results hold for batches. For one body, heyoka is about 8 times faster ([comparison with
  heyoka](../coming-from/heyoka.md)).
"""
CURVE = ("tolerance", "fastest variant", "error", "µs per body")
RATIOS = (*(f"{family} / heyoka" for family in FAMILIES), "general / diffrax")
HEADS = (
    *("error", "fastest method: µs per body", "times faster than heyoka", "than diffrax"),
    "symplectic: times faster than heyoka",
)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scene", nargs="+", choices=work_precision.SCENES, default=list(work_precision.SCENES))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rivals.require()
    out = options.out or (Path(tempfile.mkdtemp(prefix="midlie-")) if options.quick else REPORTS)
    out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    page = out / "work-precision.md"
    texts = texts_of(page.read_text()) if page.exists() else {}
    for name in options.scene:
        texts[name] = scene_report(name, out, options.quick)
        print(f"[{time.perf_counter() - began:.0f} s]", flush=True)
    page.write_text(whole_page(texts, out / "tables"))
    if out == REPORTS:
        into_pages()
        times_faster.main()
    print(f"wrote {out}")


def whole_page(texts: Mapping[str, str], folder: Path) -> str:
    """The page of all scenes, from what is said about each scene and from the data files in the folder."""
    heads = ["scene", *(f"{family}: than heyoka" for family in FAMILIES), "general: than diffrax"]
    faster = [[name, *map(times_faster.inverse, ratios)] for name, *ratios in map(dict.values, saved(DATA[2], folder))]
    head = HEAD.format(
        bodies=work_precision.BODIES,
        judged=work_precision.JUDGED,
        versions=", ".join(f"{p} {version(p)}" for p in PROGRAMS),
        machine=f"{platform.machine()}, {platform.system()}",
        summary="\n".join(_table(heads, faster)),
        link=link(DATA[0], DATA[2]),
    )
    rows = saved(DATA[0], folder)
    sections = [
        text + "\n" + "\n".join(key_rows([row for row in rows if row["scene"] == name])) + "\n"
        for name, text in sorted(texts.items(), key=lambda one: work_precision.SCENES.index(one[0]))
    ]
    return "\n".join([head, *sections])


def key_rows(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """The table of a scene on the page: times and how many times faster, at `ERRORS`."""
    return _table(
        HEADS,
        [
            [
                *(row["error"], row["general: µs per body"], times_faster.inverse(row["general / heyoka"])),
                *(times_faster.inverse(row["general / diffrax"]), times_faster.inverse(row["symplectic / heyoka"])),
            ]
            for row in rows
            if row["error"] in ERRORS
        ],
    )


def texts_of(page: str) -> dict[str, str]:
    """The text of a page on each scene, without the table, by the name of the scene."""
    found: dict[str, str] = {}
    for section in re.split(r"^(?=## )", page, flags=re.MULTILINE):
        name = section.removeprefix("## ").partition(":")[0]
        if name in work_precision.SCENES:
            found[name] = section.partition("\n| ")[0]
    return found


def into_pages() -> None:
    """Puts the fastest methods into docs/choosing-a-method.md."""
    put("choosing-a-method.md", choosing.BEGIN, choosing.END, shown(choosing.HEADS, choosing.rows()))


def keep(name: str, heads: Sequence[str], file: str, rows: Sequence[Sequence[str]], folder: Path) -> None:
    """Replaces the rows of a scene in a data file; the scenes stay in the order of the page."""
    before = [list(row.values()) for row in saved(file, folder)] if (folder / f"{file}.csv").exists() else []
    every = [row for row in before if row[0].partition(",")[0] != name] + [list(row) for row in rows]
    every.sort(key=lambda row: work_precision.SCENES.index(row[0].partition(",")[0]))
    save(file, _table(["scene", *heads], every), folder)


def scene_report(name: str, out: Path, quick: bool) -> str:
    """Measures and draws a scene, and keeps its data; returns its text for the page."""
    comparison = work_precision.compared(name, quick=quick)
    problem, rows = comparison.problem, comparison.ratios
    picture = out / f"work-precision-{name}.png"
    work_precision_chart(
        *(comparison.ours, comparison.rivals, comparison.families, str(picture)),
        title=message(name, _spans(rows)[0]),
        note=work_precision.note(comparison),
        measured=problem.kind.measured,
        clock=cost_clock().name,
    )
    curve = [
        [name, *p.setting.removeprefix("tol ").split(", ", 1), f"{p.error:.1e}", f"{1e6 * p.seconds:.3g}"]
        for p in comparison.rivals
        if p.method == "heyoka"
    ]
    summary = [[name, *_spans(rows)]]
    if comparison.in_steps:
        summary.append([f"{name}, in steps", *_spans(comparison.in_steps)])
    folder = out / "tables"
    keep(name, frontier.HEADS, DATA[0], [[name, *frontier.cells(row)] for row in rows], folder)
    keep(name, CURVE, DATA[1], curve, folder)
    keep(name, RATIOS, DATA[2], summary, folder)
    spreads = [point.spread for point in comparison.ours + comparison.rivals]
    text = section(
        work_precision.title(problem),
        f"Error: {problem.kind.measured}. Reference: {problem.source}, uncertainty {problem.uncertainty:.0e}.",
        f"Times: {spread_in_words(spreads)}. {comparison.warning}".strip(),
        with_the_spin(comparison),
        picture.name,
        name,
    )
    print(text, *summary, sep="\n", flush=True)
    return text


def message(name: str, over_heyoka: str) -> str:
    """The title of a chart, from the span of the ratios of all methods to heyoka."""
    faster = times_faster.inverse(over_heyoka)
    return f"{name}: {faster} times faster than heyoka" if faster[0].isdigit() else name


def section(title: str, errors: str, times: str, spin: str, picture: str, name: str) -> str:
    """The text of the page on a scene, up to the table."""
    return f"""## {title}

{errors}
{times}
{spin}
![Error against run time and torque evaluations]({picture})

<!-- drawn by: `python benchmarks/work_precision.py --scene {name}` -->
"""


def with_the_spin(comparison: work_precision.Comparison) -> str:
    """What heyoka takes for the axis, and what with the spin of the top; "" where the state is not an axis."""

    def took(program: str) -> str:
        points = [point for point in comparison.rivals if point.method == program]
        costs = [1e6 * frontier.best_at(points, error).cost for error in frontier.DECADES]
        return f"{min(costs):.2g} to {max(costs):.2g} µs"

    if not any(point.method == spinning_top.LABEL for point in comparison.rivals):
        return ""
    return spin_text(took("heyoka"), took(spinning_top.LABEL))


def spin_text(axis: str, whole: str) -> str:
    """The paragraph on the times of heyoka for the six equations of an axis and the seven of a spinning body."""
    return f"""
{SPIN} heyoka takes {axis} per body for these six
equations, and {whole} for the seven equations of a spinning body ("{spinning_top.LABEL}").
The tables use the times for six equations, which suffice for the axis alone.
"""


def _spans(rows: list[frontier.Ratio]) -> list[str]:
    """The spans of the ratios to heyoka by family, and of the ratio to diffrax."""
    over_heyoka = [frontier.span([row.families[family].over_heyoka for row in rows]) for family in FAMILIES]
    return [*over_heyoka, frontier.span([row.over_diffrax for row in rows])]


def _table(heads: Sequence[str], rows: Iterable[Iterable[str]]) -> list[str]:
    return [compact(f"| {' | '.join(row)} |") for row in (heads, ["---"] * len(heads), *rows)]


if __name__ == "__main__":
    main()
