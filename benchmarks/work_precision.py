"""Error against time, for our methods and for other programs, on one core: the charts and tables under docs/reports/.

    python benchmarks/work_precision.py [--scene NAME ...] [--quick] [--out FOLDER]

The process pins itself to one core before XLA counts the cores. It writes FOLDER/work-precision-SCENE.png for each
scene and FOLDER/work-precision.md, of which it replaces only the parts of the scenes named.
`--quick` times fewer runs, and by default writes into a temporary folder.
"""

import argparse
import platform
import re
import tempfile
import time
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

import choosing
import jax
import times_faster
from laboratory import frontier, rivals, work_precision
from laboratory.families import FAMILIES
from laboratory.frontier_chart import work_precision_chart
from laboratory.rivals import spinning_top
from pages import put, shown

from midlie_jax.advice.timing import cost_clock, pin

jax.config.update("jax_enable_x64", True)
pin()

ROOT = Path(__file__).resolve().parent.parent
REPORTS = ROOT / "docs" / "reports"
BEGIN, END = "<!-- ratios -->", "<!-- /ratios -->"
SPIN_BEGIN, SPIN_END = "<!-- spin -->", "<!-- /spin -->"
SPIN = "A spinning frame is expensive for the series of heyoka:"
PROGRAMS = ("jax", "diffrax", "heyoka", "scipy", "mujoco")
HEAD = """# Error against time

Written by `make rivals`. One core, float64, {bodies} bodies with slightly different starts. Times are processor times
per body, medians of several runs, without compiling; on one core that is wall time without the time that other
processes take. ± is half the distance between the quartiles of the runs. Errors are those at the end, root mean square
over the first {judged} bodies; each section says of what.

In the charts, the lower and the further left a line is, the better. The three bold lines of the left panel belong to
our families of methods (see below): each shows, at every error, the time of the fastest method of the family. They are
drawn on top of each other, from the widest (general) to the narrowest (symplectic), so where a line has three stripes
the fastest of all our methods is symplectic. Hollow marks are other programs. The right panel shows our methods one by
one, each in the colour of its family, against the number of torque evaluations.

In the tables, "general" is the fastest of all our methods, "conserving" the fastest of those that are reversible, keep
the energy to rounding or are symplectic, and "symplectic" the fastest of the symplectic ones. "same" stands for the
method in the column of the family before. A ratio below 1 means that our method is faster; "-" means that one of the
two does not reach the error. Costs between two points of a method are interpolated in logarithms; for errors larger
than that of a method's coarsest run, the cost is that of the coarsest run. "free_motion" is the closed form of a body
under no torque (`ml.free_motion`): it takes no steps, is exact to rounding, and so belongs to all three families. The
row "in steps" has the ratios without it.

heyoka: `taylor_adaptive_batch`, at each tolerance the fastest of several widths of the batch and options, without the
time of the Python loop over batches. diffrax: the better of a constant step and a PID controller, compiled with the
options of our own programs. Every program is given as many numbers as we have: seven for a rigid body, thirteen for one
that travels (`orbit`), six for an axis (`axis`). SciPy, MuJoCo: a few bodies, one after another; MuJoCo does not run
the satellite and the orbit, whose torques would need a callback in Python, nor the axis. NO_SQUISH is another name of
DLM (`tests/test_work_precision.py`).

{versions}; {machine}.
"""


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
    parts = parts_of(page.read_text()) if page.exists() else {}
    for name in options.scene:
        parts[name] = scene_report(name, out, options.quick)
        print(f"[{time.perf_counter() - began:.0f} s]", flush=True)
    page.write_text(whole_page([parts[name] for name in work_precision.SCENES if name in parts]))
    if out == REPORTS:
        into_page(page.read_text())
        times_faster.main()
    print(f"wrote {out}")


def whole_page(parts: list[tuple[str, str]]) -> str:
    """The page of all scenes, from the section and the summary of each."""
    versions = ", ".join(f"{p} {version(p)}" for p in PROGRAMS)
    machine = f"{platform.machine()}, {platform.system()}"
    head = HEAD.format(bodies=work_precision.BODIES, judged=work_precision.JUDGED, versions=versions, machine=machine)
    heads = ["scene", *(f"{family} / heyoka" for family in FAMILIES), "general / diffrax"]
    summary = [_row(heads), _row("---" for _ in heads), *(row for _, row in parts), ""]
    return "\n".join([head, *summary, *(section for section, _ in parts)])


def parts_of(page: str) -> dict[str, tuple[str, str]]:
    """The section and the summary of each scene on a page."""
    head, *sections = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    found: dict[str, tuple[str, str]] = {}
    for section in sections:
        name = section.removeprefix("## ").partition(":")[0]
        rows = [line for line in head.split("\n") if line.startswith((f"| {name} |", f"| {name}, in steps |"))]
        found[name] = section.rstrip("\n") + "\n", "\n".join(rows)
    return found


def into_page(text: str) -> None:
    """Copies the ratios of all scenes to docs/how-it-compares.md, the fastest methods to docs/choosing-a-method.md."""
    lines = text.split("\n")
    first = next(i for i, line in enumerate(lines) if line.startswith("|"))
    last = next(i for i in range(first, len(lines)) if not lines[i].startswith("|"))
    put("how-it-compares.md", BEGIN, END, lines[first:last])
    at = next(i for i, line in enumerate(lines) if line.startswith(SPIN))
    put("how-it-compares.md", SPIN_BEGIN, SPIN_END, lines[at : lines.index("", at)])
    put("choosing-a-method.md", choosing.BEGIN, choosing.END, shown(choosing.HEADS, choosing.rows()))


def scene_report(name: str, out: Path, quick: bool) -> tuple[str, str]:
    """Measures and draws a scene; returns its section of the file and its row of the summary."""
    comparison = work_precision.compared(name, quick=quick)
    problem, rows = comparison.problem, comparison.ratios
    picture = out / f"work-precision-{name}.png"
    work_precision_chart(
        *(comparison.ours, comparison.rivals, comparison.families, str(picture)),
        title=work_precision.title(problem),
        note=work_precision.note(comparison),
        measured=problem.kind.measured,
        clock=cost_clock().name,
    )
    curve = "\n".join(
        _row([*p.setting.removeprefix("tol ").split(", ", 1), f"{p.error:.1e}", f"{1e6 * p.seconds:.3g}"])
        for p in comparison.rivals
        if p.method == "heyoka"
    )
    section = f"""## {work_precision.title(problem)}

Errors of {problem.kind.measured}, against the {problem.source}, uncertainty {problem.uncertainty:.0e}.
{work_precision.timing_note(comparison)}
{with_the_spin(comparison)}
![error against cost]({picture.name})

Drawn by `python benchmarks/work_precision.py --scene {name}`.

{frontier.markdown(rows)}

<details markdown="1"><summary>heyoka's errors by tolerance</summary>

| tolerance | fastest variant | error | us a body |
| --- | --- | --- | --- |
{curve}

</details>
"""
    summary = _row([name, *_spans(rows)])
    if comparison.in_steps:
        summary += "\n" + _row([f"{name}, in steps", *_spans(comparison.in_steps)])
    print(section + "\n" + summary, flush=True)
    return section, summary


def with_the_spin(comparison: work_precision.Comparison) -> str:
    """What heyoka takes for the axis, and what with the spin of the top; "" where the state is not an axis."""

    def took(program: str) -> str:
        points = [point for point in comparison.rivals if point.method == program]
        costs = [1e6 * frontier.best_at(points, error).cost for error in frontier.DECADES]
        return f"{min(costs):.2g} to {max(costs):.2g} us"

    if not any(point.method == spinning_top.LABEL for point in comparison.rivals):
        return ""
    return f"""
{SPIN} it takes {took("heyoka")} a body on these six
equations, and {took(spinning_top.LABEL)} on the seven of a spinning body ("{spinning_top.LABEL}"). Whoever
asks for the axis alone would write the six, so the table has their times.
"""


def _spans(rows: list[frontier.Ratio]) -> list[str]:
    """The spans of the ratios to heyoka by family, and of the ratio to diffrax."""
    over_heyoka = [frontier.span([row.families[family].over_heyoka for row in rows]) for family in FAMILIES]
    return [*over_heyoka, frontier.span([row.over_diffrax for row in rows])]


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
