"""Error against wall time, ours and others', on one core: the charts and the table under docs/.

    python benchmarks/work_precision.py [--scene NAME ...] [--quick] [--out FOLDER]

Pins itself to one core before XLA counts them. Writes FOLDER/work-precision-SCENE.png for each scene and, for all
scenes, FOLDER/work-precision.md. `--quick` times less, and writes into a temporary folder unless told otherwise.
"""

import argparse
import os
import platform
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax

jax.config.update("jax_enable_x64", True)

from midlie_jax import frontier, rivals, work_precision  # noqa: E402
from midlie_jax.frontier_chart import work_precision_chart  # noqa: E402

DOCS = Path(__file__).resolve().parent.parent / "docs"
PROGRAMS = ("jax", "diffrax", "heyoka", "scipy", "mujoco")
HEAD = """# Error against wall time

Written by `make rivals`. One core, float64, {bodies} bodies that start a little apart, times per
body (compiling not counted), the quickest of some runs; errors of the attitude at the end, root mean square over the
first {judged} bodies. A ratio below 1 is ours quicker; "-" where one of the two does not reach the error. Costs between
two points of a method are interpolated in logarithms; at an error larger than that of a method's coarsest run that run
counts. heyoka: `taylor_adaptive_batch`, the better of `fast_math` on and off at each tolerance, without the time that
its loop takes in Python. diffrax: the better of a constant step and a PID controller. SciPy, MuJoCo: a few bodies, one
after another. Methods that are not symplectic are dashed on the charts. {versions}; {machine}.
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
        parts.append(one(name, out, options.quick))
        print(f"[{time.perf_counter() - began:.0f} s]", flush=True)
    if set(options.scene) == set(work_precision.SCENES):
        versions = ", ".join(f"{p} {version(p)}" for p in PROGRAMS)
        machine = f"{platform.machine()}, {platform.system()}"
        head = HEAD.format(
            bodies=work_precision.BODIES, judged=work_precision.JUDGED, versions=versions, machine=machine
        )
        (out / "work-precision.md").write_text("\n".join([head, *parts]))
    print(f"wrote {out}")


def one(name: str, out: Path, quick: bool) -> str:
    """Measures and draws a scene; its section of the file."""
    given, rows, mine, theirs = work_precision.compared(name, quick=quick)
    picture = out / f"work-precision-{name}.png"
    work_precision_chart(
        *(mine, theirs, work_precision.symplectic(given.scene), str(picture)),
        title=work_precision.title(given),
        note=work_precision.note(given),
    )
    reached = [f"{p.setting}: {p.error:.1e} in {1e6 * p.seconds:.3g} us" for p in theirs if p.method == "heyoka"]
    section = f"""## {work_precision.title(given)}

Errors against the {given.source}, good to {given.uncertainty:.0e}.

![error against cost]({picture.name})

{frontier.markdown(rows)}

heyoka's errors by tolerance, `fast_math` off and on: {"; ".join(reached)}.
"""
    print(section, flush=True)
    return section


if __name__ == "__main__":
    main()
