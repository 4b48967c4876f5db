"""The speed of the methods on an accelerator, against the number of bodies: one table and one chart.

    make gpu                                      everything, written to docs/reports/gpu.md and docs/reports/gpu.png
    python benchmarks/gpu.py [--quick] [--seconds N] [--write]

The scene is the fast top P1, or for JACOBI[...] and GBS12 an asymmetric top. Each figure is the median of runs after
the first, by the wall clock, without compiling. Beside each method stands the difference of its result from that of the
CPU. Programs are traced in turn and compiled by as many threads as the machine has cores. The most informative programs
come first; no program is begun after N seconds (540 by default), and what was measured by then is written.

The forms of a program:

- `midlie_jax`: as the package compiles it, with several steps an iteration of the loop.
- `one kernel`: no program of JAX, but CUDA by hand (`limit.cu`), built by nvcc where there is one: the same arithmetic,
  and the whole run of a top in one thread of one kernel. What could be gained by leaving XLA's loop of launches.
"""

import itertools
import os
import shutil
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import limit
import numpy as np
from harness import REPORTS, Line, Panel, chart, link, main, part, put, row_of, save
from laboratory.rivals import rates

import midlie_jax as ml
from midlie_jax.cli import scenes

jax.config.update("jax_enable_x64", True)
DRAWN = "<!-- drawn by: `python benchmarks/gpu.py --write` -->"
DT = 0.005
COMPARED = 64  # bodies whose result is compared with the CPU's
# Bodies of the runs that are compared. These have 384 steps; in more, differences grow with the motion.
COMPARED_AT = 10**6
OURS, KERNEL = "midlie_jax", "one kernel"
TSIT5, SOLVER = "diffrax Tsit5", "LIEMID[EA] by diffrax"
METHODS = ("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]", "JACOBI[SRKN14a]", "GBS12")


class Job(NamedTuple):
    method: str
    dtype: str
    bodies: int
    form: str = OURS

    @property
    def steps(self) -> int:
        """A run takes a fraction of a second: a launch takes some microseconds, a step of 1e7 bodies a millisecond."""
        return 64 * max(1, min(160, round(4e8 / self.bodies / 64)))


class Figure(NamedTuple):
    """Body-steps a second, and the difference of the momenta from the CPU's, in units of eps |Pi|."""

    job: Job
    speed: float
    difference: float


def jobs(quick: bool) -> Iterator[Job]:
    by_nvcc = METHODS[:3] if shutil.which("nvcc") and jax.default_backend() == "gpu" else ()
    if quick:
        yield from (Job(method, "float32", 1000, KERNEL) for method in by_nvcc)
        yield from (Job(method, "float32", 1000) for method in METHODS)
        yield from (Job(form, "float32", 1000, form) for form in (TSIT5, SOLVER))
        return
    sizes, dtypes = (6, 4, 2, 5, 3, 7), ("float32", "float64")
    yield from (Job(method, dtype, 10**n) for n in sizes for dtype in dtypes for method in METHODS[:3])
    yield from (Job(method, dtype, 10**n, KERNEL) for n in sizes for dtype in dtypes for method in by_nvcc)
    yield from (Job(form, dtype, 10**n, form) for dtype in dtypes for n in (6, 4, 2) for form in (TSIT5, SOLVER))
    yield from (Job(method, dtype, 10**n) for dtype in dtypes for n in (6, 4, 2) for method in METHODS[3:])
    yield from (Job(form, dtype, 10**n, form) for dtype in dtypes for n in (5, 3) for form in (TSIT5, SOLVER))
    yield from (Job(method, dtype, 10**n) for dtype in dtypes for n in (5, 3) for method in METHODS[3:])


def run_of(job: Job):
    scene = scene_of(job)

    def ours(start):
        every = {"dt": DT, "steps": job.steps, "save_every": job.steps}
        return ml.integrate(job.method, scene.body, scene.torque, start, **every).states.momentum[-1]

    def by_diffrax(terms, solver, start):
        end = jnp.asarray(DT * job.steps, job.dtype)
        options = {"adjoint": diffrax.ForwardMode(), "max_steps": None}
        return diffrax.diffeqsolve(terms, solver, 0 * end, end, end / job.steps, start, **options).ys

    def tsit5(start):
        field = rates(scene)
        term = diffrax.ODETerm(lambda t, y, args: jnp.stack(field([y[i] for i in range(7)])))
        return by_diffrax(term, diffrax.Tsit5(), jnp.concatenate([start.momentum, start.attitude]))[-1, :3]

    def solver(start):
        term = ml.diffrax.RigidBodyTerm(scene.body, scene.torque)
        return by_diffrax(term, ml.diffrax.LieSolver("LIEMID[EA]"), start).momentum[-1]

    return {TSIT5: tsit5, SOLVER: solver}.get(job.form, ours)


def scene_of(job: Job):
    asymmetric = job.method.startswith(("JACOBI", "GBS")) and job.form != KERNEL
    return scenes.scene("asymmetric-top" if asymmetric else "P1", jnp.dtype(job.dtype))


def starts_of(job: Job) -> ml.RigidState:
    return scenes.perturbed(scene_of(job), job.bodies, 1e-3)


def difference(job: Job, starts: ml.RigidState, momentum) -> float:
    """Of the first bodies from the same run on the CPU, in units of eps |Pi|; NaN where that is not compared."""
    if job.form in (TSIT5, SOLVER) or job.bodies != COMPARED_AT:
        return float("nan")
    few = jax.tree.map(lambda x: np.asarray(x[:COMPARED]), starts)
    with jax.default_device(jax.devices("cpu")[0]):
        expected = np.asarray(jax.jit(jax.vmap(run_of(job)))(few))
    gap = np.linalg.norm(np.asarray(momentum)[:COMPARED] - expected, axis=-1) / np.linalg.norm(expected, axis=-1)
    return float(gap.max() / np.finfo(job.dtype).eps)


def attempted(measure: Callable[..., Figure], job: Job, *others: Any) -> Iterator[Figure]:
    try:
        yield measure(job, *others)
    except Exception as error:
        print(f"{job}: {type(error).__name__}: {str(error)[:200]}", flush=True)


def measured(queue: list[Job], seconds: float) -> Iterator[Figure]:
    began = time.perf_counter()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        by_nvcc = dict.fromkeys((job.method, job.dtype) for job in queue if job.form == KERNEL)
        builds = [pool.submit(kernels, *kind) for kind in by_nvcc]
        for part in range(0, len(queue), 12):
            programs: list[tuple[Job, ml.RigidState, Future[Any]]] = []
            for job in queue[part : part + 12]:
                if time.perf_counter() - began > seconds:
                    print(f"out of time before {job}", flush=True)
                    break
                if job.form == KERNEL:
                    wait(builds)
                    yield from attempted(by_hand, job)
                    continue
                starts = starts_of(job)
                lowered = jax.jit(jax.vmap(run_of(job))).lower(starts)
                programs.append((job, starts, pool.submit(lowered.compile)))
            for job, starts, future in programs:
                yield from attempted(timed, job, future, starts)


def kernels(method: str, dtype: str) -> list[Path]:
    return [limit.built_for_gpu(method.partition("[")[0], dtype, rough) for rough in (False, True)]


def by_hand(job: Job) -> Figure:
    runs = [limit.measured(program, job.bodies, job.steps) for program in kernels(job.method, job.dtype)]
    cost, momentum = min(runs)
    start = jax.tree.map(lambda x: x[None], scene_of(job).start)
    return Figure(job, 1 / cost, difference(job, start, [momentum]))


def timed(job: Job, compiled: Future[Any], starts: ml.RigidState) -> Figure:
    program = compiled.result()
    momentum = jax.block_until_ready(program(starts))
    laps = []
    for _ in range(5):
        began = time.perf_counter()
        jax.block_until_ready(program(starts))
        laps.append(time.perf_counter() - began)
    speed = job.bodies * job.steps / statistics.median(laps)
    return Figure(job, speed, difference(job, starts, momentum))


def table(figures: list[Figure]) -> list[str]:
    """One row for each method, dtype and form, one column for each number of bodies; then our speed over Tsit5's."""
    sizes = sorted({figure.job.bodies for figure in figures})
    found = {figure.job: figure for figure in figures}
    kinds = sorted(dict.fromkeys((f.job.dtype, f.job.form, f.job.method) for f in figures), key=lambda kind: kind[0])
    columns = (f"{n:.0e} bodies" for n in sizes)
    heads = ["body-steps per second", "dtype", "program", *columns, "difference from the CPU"]
    lines = [heads, ["---"] * len(heads)]
    for dtype, form, method in kinds:
        row = [found.get(Job(method, dtype, n, form)) for n in sizes]
        gaps = [f.difference for f in row if f and np.isfinite(f.difference)]
        gap = f"{max(gaps):.0f} eps" if gaps else ""
        cells = [f"{f.speed:.2g}" if f else "" for f in row]
        lines.append([method, dtype, "" if form == method else form, *cells, gap])
    others = {
        "Tsit5": lambda job: job._replace(method=TSIT5, form=TSIT5),
        KERNEL: lambda job: job._replace(form=KERNEL),
    }
    for (name, other), (dtype, form, method) in itertools.product(others.items(), kinds):
        if form == OURS:
            mine = [Job(method, dtype, n) for n in sizes]
            pairs = [(found.get(job), found.get(other(job))) for job in mine]
            cells = [f"{mine.speed / its.speed:.2g}" if mine and its else "" for mine, its in pairs]
            if any(cells):
                lines.append([f"{method} over {name}", dtype, "ratio of speeds", *cells, ""])
    return [row_of(line) for line in lines]


def draw(figures: list[Figure], path: Path) -> None:
    from midlie_jax.cli.figures import COOL, DASHED, SOLID, WARM, styles

    def lines(dtype: str) -> Iterator[Line]:
        chosen = [f for f in figures if f.job.dtype == dtype and f.job.form in (OURS, TSIT5, SOLVER)]
        names = list(dict.fromkeys(f.job.method for f in chosen))
        look = styles([name for name in names if name in METHODS], COOL, SOLID, ours=True)
        look |= styles([name for name in names if name not in METHODS], WARM, DASHED, ours=False)
        for name in names:
            x, y = zip(*sorted((f.job.bodies, f.speed) for f in chosen if f.job.method == name), strict=True)
            yield Line(name, x, y, look[name].colour, "", name in METHODS, look[name].drawn(1.8, 6))
            if limits := sorted(
                (f.job.bodies, f.speed) for f in figures if f.job == Job(name, dtype, f.job.bodies, KERNEL)
            ):
                x, y = zip(*limits, strict=True)
                yield Line(f"{name}, CUDA", x, y, look[name].colour, ":", options={"linewidth": 0.9})

    scales = {"xscale": "log", "yscale": "log"}
    dtypes = dict.fromkeys(f.job.dtype for f in figures)
    panels = [Panel(dtype, "number of bodies", "body-steps per second", list(lines(dtype)), scales) for dtype in dtypes]
    most = max((f for f in figures if f.job.form == OURS), key=lambda f: f.speed)
    words = f"{most.speed:.1e} body-steps per second".replace("e+", "e")
    title = f"{most.job.method} reaches {words}; a GPU needs 1e5 bodies or more"
    chart(path, [panels], (13.0, 6.5), title, where(), bottom=0.1, wspace=0.18)


def write_page(device: str, lines: list[str]) -> None:
    save("gpu", lines)
    rows = part(
        lines, lambda row: row[1] == "float32" and (row[2] in (OURS, KERNEL) or row[0] == TSIT5), (0, 1, 2, 3, 5, 7, 9)
    )
    picture = "![Speed against the number of bodies](gpu.png)"
    put("reports/gpu.md", "gpu", [picture, "", DRAWN, "", f"{device}.", "", *rows, "", link("gpu")])


def where() -> str:
    device = jax.devices()[0].device_kind
    day = time.strftime("%Y-%m-%d")
    return f"{device}, JAX {jax.__version__}, {day}. Dotted: one kernel for the whole run, CUDA by hand"


def measure(options: Any) -> None:
    if jax.default_backend() == "cpu" and not options.quick:
        sys.exit("JAX sees no accelerator here; `--quick` runs a few programs on the CPU.")
    figures: list[Figure] = []
    for figure in measured(list(jobs(options.quick)), options.seconds):
        figures.append(figure)
        print(f"{figure.job}: {figure.speed:.3g} body-steps per second, {figure.difference:.0f} eps", flush=True)
    print("\n".join([f"{where()}.", "", *table(figures)]))
    draw(figures, REPORTS / "gpu.png" if options.write else Path("gpu.png"))
    if options.write:
        write_page(where(), table(figures))


ARGUMENTS = {
    "--quick": {"action": "store_true", "help": "a few programs, to see that everything runs"},
    "--seconds": {"type": float, "default": 540.0, "help": "no program is begun later"},
}

if __name__ == "__main__":
    main(__doc__, measure, ARGUMENTS)
