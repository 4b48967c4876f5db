"""Error against time, for our methods and for other programs, on one core: the charts and tables under docs/.

    python benchmarks/work_precision.py [--scene NAME ...] [--quick] [--out FOLDER]

The process pins itself to one core before XLA counts the cores. It writes FOLDER/work-precision-SCENE.png for each
scene and, if all scenes are measured, FOLDER/work-precision.md. `--quick` times fewer runs, and by default writes into
a temporary folder.
"""

import argparse
import platform
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import jax

from midlie_jax.bench import frontier, rivals, work_precision
from midlie_jax.bench.frontier_chart import work_precision_chart
from midlie_jax.drivers.timing import cost_clock, pin

jax.config.update("jax_enable_x64", True)
pin()

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
BEGIN, END = "<!-- ratios -->", "<!-- /ratios -->"
# Largest wanted ratio of our time to heyoka's, at each error; to diffrax's best it is 1/100 for all scenes.
TARGETS = {"P1": 0.2, "gravity-gradient-10": 0.5, "asymmetric-top": 1.0}
PROGRAMS = ("jax", "diffrax", "heyoka", "scipy", "mujoco")
HEAD = """# Error against time

Written by `make rivals`. One core, float64, {bodies} bodies with slightly different starts. Times are processor times
per body, medians of several runs, without compiling; on one core that is wall time without the time that other
processes take. ± is half the distance between the quartiles of the runs. Errors are of the attitude at the end, root
mean square over the first {judged} bodies. A ratio below 1 means that our method is faster; "-" means that one of the
two does not reach the error. Costs between two points of a method are interpolated in logarithms; for errors larger
than that of a method's coarsest run, the cost is that of the coarsest run. heyoka: `taylor_adaptive_batch`, without the
time of the Python loop over batches. diffrax: the better of a constant step and a PID controller. SciPy, MuJoCo: a few
bodies, one after another; MuJoCo does not run the satellite, whose torque would need a callback in Python. NO_SQUISH is
another name of DLM (`tests/test_work_precision.py`). Methods that are not symplectic are dashed on the charts.
{versions}; {machine}.
"""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scene", nargs="+", choices=work_precision.SCENES, default=list(work_precision.SCENES))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rivals.require()
    out = options.out or (Path(tempfile.mkdtemp(prefix="midlie-")) if options.quick else DOCS)
    out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    parts = []
    for name in options.scene:
        parts.append(scene_report(name, out, options.quick))
        print(f"[{time.perf_counter() - began:.0f} s]", flush=True)
    if set(options.scene) == set(work_precision.SCENES):
        versions = ", ".join(f"{p} {version(p)}" for p in PROGRAMS)
        machine = f"{platform.machine()}, {platform.system()}"
        head = HEAD.format(
            bodies=work_precision.BODIES, judged=work_precision.JUDGED, versions=versions, machine=machine
        )
        summary = [
            "| scene | ours / heyoka, 1e-03 to 1e-12 | target | ours / diffrax | target |",
            "| --- | --- | --- | --- | --- |",
            *(row for _, row in parts),
            "",
        ]
        text = "\n".join([head, *summary, *(section for section, _ in parts)])
        (out / "work-precision.md").write_text(text)
        if out == DOCS:
            into_page(text)
    print(f"wrote {out}")


def into_page(text: str) -> None:
    """Copies the first table of the text, ratios of our times to heyoka's and diffrax's, to docs/how-it-compares.md."""
    lines = text.split("\n")
    first = next(i for i, line in enumerate(lines) if line.startswith("|"))
    last = next(i for i in range(first, len(lines)) if not lines[i].startswith("|"))
    page = DOCS / "how-it-compares.md"
    head, rest = page.read_text().split(BEGIN)
    table = "\n".join(lines[first:last])
    page.write_text(f"{head}{BEGIN}\n{table}\n{END}{rest.split(END)[1]}")


def scene_report(name: str, out: Path, quick: bool) -> tuple[str, str]:
    """Measures and draws a scene; returns its section of the file and its row of the summary."""
    comparison = work_precision.compared(name, quick=quick)
    problem, rows = comparison.problem, comparison.ratios
    picture = out / f"work-precision-{name}.png"
    work_precision_chart(
        *(comparison.ours, comparison.rivals, work_precision.symplectic(comparison.ours), str(picture)),
        title=work_precision.title(problem),
        note=work_precision.note(comparison),
        clock=cost_clock().name,
    )
    curve = "\n".join(
        f"| {p.setting[4:]} | {p.error:.1e} | {1e6 * p.seconds:.3g} |"
        for p in comparison.rivals
        if p.method == "heyoka"
    )
    section = f"""## {work_precision.title(problem)}

Errors against the {problem.source}, uncertainty {problem.uncertainty:.0e}. {work_precision.timing_note(comparison)}

![error against cost]({picture.name})

{frontier.markdown(rows)}

<details markdown="1"><summary>heyoka's errors by tolerance</summary>

| tolerance | error of R | us a body |
| --- | --- | --- |
{curve}

</details>
"""
    target = TARGETS.get(name)
    over_heyoka = frontier.verdict([(r.error, r.over_heyoka) for r in rows], target or 1.0)
    over_diffrax = frontier.verdict([(r.error, r.over_diffrax) for r in rows], 0.01)
    summary = f"| {name} | {over_heyoka} | {target or 'none, 1 taken'} | {over_diffrax} | 0.01 |"
    print(section + "\n" + summary, flush=True)
    return section, summary


if __name__ == "__main__":
    main()
