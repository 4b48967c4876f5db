"""The `midlie` command: `chart`, `run`, `methods`, `scenes`. Top of the package: nothing imports it.

Everything a user can get wrong ends as one line on stderr and exit code 2; tracebacks are for bugs.
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

from . import charts, convergence, scenes, torques
from .bodies import RigidBody
from .integrate import integrate
from .methods import method as find_method
from .methods import methods as all_methods
from .observables import energy, spatial_momentum
from .states import RigidState
from .torques import TorqueLike

_KEPT_STATES = 200  # states kept of each body by `run`, at most
_KEPT_NUMBERS = 2**25  # and of all bodies together: 256 MiB in float64
_TIMINGS, _TIMING_SECONDS = 3, 2.0  # runs timed by `run`, at most, and the seconds after which one is enough


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        arguments: as on the command line, without the program's name; those of the process if None.

    Returns:
        The exit code: 0, or 2 after an error of the user's, which has been printed.
    """
    try:
        options = _parser().parse_args(arguments)
        jax.config.update("jax_enable_x64", True)  # before any array exists, the scenes' included
        options.act(options)
    except (ValueError, ImportError, OSError) as error:
        print(f"midlie: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


class _Parser(argparse.ArgumentParser):
    """Reports a wrong command line like every other error."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message} (see {self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="midlie", description="Rigid bodies in rotation by midpoint Lie integrators, on JAX.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    chart = commands.add_parser("chart", help="errors of all methods against step, time and torque evaluations")
    chart.add_argument("scene", nargs="?", default="P1", metavar="SCENE", help="see `midlie scenes` (default: P1)")
    chart.add_argument("--out", metavar="FILE", help="the PNG to write (default: chart-SCENE.png)")
    chart.add_argument("--methods", nargs="+", metavar="NAME", help="only these (default: all that move a rigid body)")
    chart.add_argument("--steps", type=_positive, metavar="N", help="steps on the coarsest rung of the ladder")
    chart.add_argument(
        "--levels", type=_positive, default=convergence.LEVELS, metavar="K", help="rungs, each half the step before"
    )
    chart.add_argument(
        "--rivals", action="store_true", help="error against cost instead, beside other programs (the extra bench)"
    )
    chart.set_defaults(act=_chart)

    run = commands.add_parser("run", help="integrate one scene, or many perturbed copies of it")
    run.add_argument("scene", metavar="SCENE", help="see `midlie scenes`")
    run.add_argument("--method", default="LIEMID[EA]", metavar="NAME", help="default: LIEMID[EA]")
    run.add_argument("--dt", type=float, metavar="H", help="step (default: the scene's)")
    run.add_argument("--steps", type=_positive, metavar="N", help="number of steps (default: the scene's duration)")
    run.add_argument(
        "--bodies", type=_positive, default=1, metavar="N", help="perturbed copies (default: 1, unperturbed)"
    )
    run.add_argument("--size", type=float, default=1e-3, help="relative size of the perturbations (default: 1e-3)")
    run.add_argument("--seed", type=int, default=0, help="of the perturbations (default: 0)")
    run.add_argument("--float32", action="store_true", help="integrate in single precision")
    run.set_defaults(act=_run)

    commands.add_parser("methods", help="list the methods").set_defaults(act=_methods)
    commands.add_parser("scenes", help="list the scenes").set_defaults(act=_scenes)
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be positive, got {text}")
    return value


def _require(*packages: str) -> None:
    """Tells what is missing before, not after, a minute of measuring."""
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise ImportError(f"this command needs {' and '.join(missing)}: pip install 'midlie_jax[cli]'.")


def _methods(options: argparse.Namespace) -> None:
    del options
    _table(
        ["method", "moves", "order", "symmetric", "evaluations a step"],
        [
            [m.name, m.bodies.__name__, str(m.order), "yes" if m.symmetric else "no", str(m.evaluations)]
            for m in map(find_method, all_methods())
        ],
    )


def _scenes(options: argparse.Namespace) -> None:
    del options
    found = [scenes.scene(name) for name in scenes.scenes()]
    _table(
        ["scene", "step", "duration", "title"],
        [[s.name, f"{s.dt:g}", f"{s.duration:g}", s.title] for s in found],
    )


def _rivals(options: argparse.Namespace) -> None:
    """The chart beside other programs."""
    from . import frontier, rivals, work_precision
    from .frontier_chart import work_precision_chart
    from .rivals.problem import pin

    rivals.require()
    _require("matplotlib", "mpmath")
    path = _writable(options.out or f"chart-{options.scene}-rivals.png")
    if options.steps or options.levels != convergence.LEVELS:
        raise ValueError("--steps and --levels do not go with --rivals, which finds its own.")
    ours = _chosen(options.methods)
    pin()
    given, rows, mine, theirs = work_precision.compared(options.scene, ours)
    print()
    _table(list(frontier.HEADS), [frontier.cells(row) for row in rows])
    true, note = work_precision.symplectic(mine), work_precision.note(given)
    work_precision_chart(mine, theirs, true, path, title=work_precision.title(given), note=note)
    print(f"\nwrote {path}")


def _chosen(names: list[str] | None) -> list[str] | None:
    """The methods named, all of which move a rigid body."""
    for name in names or []:
        if find_method(name).bodies is not RigidBody:
            raise ValueError(f"method {name!r} does not move a rigid body; see `midlie methods`.")
    return names


def _writable(path: str) -> str:
    if not Path(path).absolute().parent.is_dir():
        raise ValueError(f"cannot write {path}: there is no such folder.")
    return path


def _chart(options: argparse.Namespace) -> None:
    if options.rivals:
        _rivals(options)
        return
    _require("matplotlib", "tqdm", "mpmath")
    from tqdm import tqdm

    scene = scenes.scene(options.scene)
    methods = _chosen(options.methods) or convergence.body_methods()
    rungs = convergence.ladder(scene, options.steps, options.levels)
    path = _writable(options.out or f"chart-{scene.name}.png")
    reference = convergence.find_reference(scene, rungs[-1])
    title = f"{scene.name}: {scene.title}, T = {scene.duration:g}"
    known = f"{reference.source}, good to {reference.uncertainty:.0e} of its size"
    print(f"{title}\nErrors at the end against the {known}. Times on the {jax.default_backend().upper()}, "
          f"per body in a batch of {convergence.COPIES}.\n", flush=True)  # fmt: skip
    rows = []
    with tqdm(total=len(methods) * len(rungs), unit="run", mininterval=0.5, dynamic_ncols=True, leave=False) as bar:
        bar.set_description(methods[0])
        for row in convergence.measure(scene, methods, rungs, reference):
            rows.append(row)
            bar.update()
            bar.set_description(methods[min(len(rows) // len(rungs), len(methods) - 1)])
    _table(
        ["method", "step", "error Pi", "slope", "error R", "slope", "torque ev.", "time [s]", "ns/step", "ok"],
        [
            cells
            for row in rows
            for cells in ([[]] if row.steps == rungs[0] and row is not rows[0] else []) + [_cells(row)]
        ],
    )
    charts.convergence_chart(rows, path, title=title, reference=known)
    print(f"\nwrote {path}")


def _cells(row: convergence.Row) -> list[str]:
    if row.failure:
        return [row.method, f"{row.dt:.6g}", f"failed: {row.failure}"]
    return [
        row.method,
        f"{row.dt:.6g}",
        f"{row.momentum_error:.2e}",
        "" if math.isnan(row.momentum_slope) else f"{row.momentum_slope:.2f}",
        f"{row.attitude_error:.2e}",
        "" if math.isnan(row.attitude_slope) else f"{row.attitude_slope:.2f}",
        str(row.evaluations),
        f"{row.seconds:.2e}",
        f"{1e9 * row.seconds / row.steps:.1f}",
        "yes" if row.ok else "NO",
    ]


def _table(heads: list[str], rows: list[list[str]]) -> None:
    """Aligned columns: text to the left, numbers to the right; a row cut short may run over, an empty one is a gap."""
    whole = [row for row in rows if len(row) == len(heads)]
    widths = [max([len(head), *(len(row[i]) for row in whole)]) for i, head in enumerate(heads)]
    numeric = [bool(whole) and all(_is_number(row[i]) for row in whole) for i in range(len(heads))]

    def show(cells: list[str]) -> None:
        padded = [
            cell if i >= 2 and len(cells) < len(heads) else cell.rjust(width) if right else cell.ljust(width)
            for i, (cell, width, right) in enumerate(zip(cells, widths, numeric, strict=False))
        ]
        print("  ".join(padded).rstrip())

    show(heads)
    print("  ".join("-" * width for width in widths))
    for row in rows:
        show(row)


def _is_number(text: str) -> bool:
    try:
        float(text or "0")
    except ValueError:
        return False
    return True


def _run(options: argparse.Namespace) -> None:
    dtype = jnp.dtype(jnp.float32 if options.float32 else jnp.float64)
    scene = scenes.scene(options.scene, dtype)
    method = find_method(options.method)
    dt = scene.dt if options.dt is None else options.dt
    if not (math.isfinite(dt) and dt != 0):
        raise ValueError(f"dt must be finite and not zero, got {dt}.")
    steps = options.steps or max(1, round(scene.duration / abs(dt)))
    start = scenes.perturbed(scene, options.bodies, options.size, options.seed)
    save_every = _save_every(steps, options.bodies)

    def one(start: Any, dt: Any) -> Any:
        return integrate(method, scene.body, scene.torque, start, dt=dt, steps=steps, save_every=save_every)

    step = jnp.asarray(dt, dtype)
    began = time.perf_counter()
    compiled = jax.jit(jax.vmap(one, in_axes=(0, None))).lower(start, step).compile()
    compile_seconds = time.perf_counter() - began
    path, seconds = _timed(lambda: compiled(start, step))

    bodies = f"{options.bodies} perturbed bodies" if options.bodies > 1 else "one body"
    print(f"{scene.name}: {scene.title}; {bodies}, {method.name}, {steps} steps of {dt:g}, {dtype.name}, "
          f"on the {jax.default_backend().upper()}")  # fmt: skip
    # In float64, so that what is seen is the rounding of the run and not that of these sums.
    body, torque, states = _cast((scene.body, scene.torque, path.states), jnp.float64)
    energy = _energy_error(body, torque, states, np.asarray(path.times[0], np.float64))
    momentum = _momentum_error(torque, states)
    failed = int(np.sum(~np.asarray(path.ok)))
    print(f"  energy error, largest relative    {energy}")
    print(f"  momentum error, largest relative  {momentum}")
    print(
        f"  ok                                {'yes' if not failed else f'NO: failed for {failed} of {options.bodies}'}"
    )
    print(f"  compile time                      {compile_seconds:.2f} s")
    print(f"  run time                          {seconds:.3g} s")
    print(f"  throughput                        {options.bodies * steps / seconds:.3g} body-steps/s")


def _cast(tree: Any, dtype: Any) -> Any:
    def cast(leaf: Any) -> Any:
        floating = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, dtype) if floating else leaf

    return jax.tree.map(cast, tree)


def _save_every(steps: int, bodies: int) -> int:
    """The smallest divisor of the steps that keeps the states few enough to hold."""
    most = max(1, min(_KEPT_STATES, _KEPT_NUMBERS // (8 * bodies)))
    return next(n for n in range(-(-steps // most), steps + 1) if steps % n == 0)


def _timed(run: Any) -> tuple[Any, float]:
    """The result, and the seconds of the quickest of a few runs."""
    clock: list[float] = []
    while True:
        began = time.perf_counter()
        result = jax.block_until_ready(run())
        clock.append(time.perf_counter() - began)
        if len(clock) == _TIMINGS or sum(clock) > _TIMING_SECONDS:
            return result, min(clock)


def _energy_error(body: RigidBody, torque: TorqueLike | None, states: RigidState, times: np.ndarray) -> str:
    """Largest |E(t) - E(0)| / |E(0)| of all bodies and times; says so where energy is not conserved."""
    try:
        still = [
            float(energy(body, torque, jax.tree.map(lambda leaf: leaf[0, 0], states), t))
            for t in np.unique(times[:: max(1, len(times) // 8)])
        ]
    except ValueError as error:
        return f"not defined: {str(error).split(';')[0]}"
    if min(still) != max(still):
        return "not conserved: the potential depends on time"
    each = jax.vmap(lambda state: energy(body, torque, state))
    energies = np.asarray(jax.jit(jax.vmap(each))(states))
    return _largest(np.abs(energies - energies[:, :1]), np.abs(energies[:, :1]))


def _momentum_error(torque: TorqueLike | None, states: RigidState) -> str:
    """Largest change of the conserved part of the spatial momentum, relative to the momentum at the start."""
    size = np.linalg.norm(np.asarray(states.momentum), axis=-1)
    momenta = np.asarray(spatial_momentum(states))
    change = momenta - momenta[:, :1]
    if torque is None:
        return _largest(np.linalg.norm(change, axis=-1), size[:, :1]) + "  (all of it)"
    if isinstance(torque, torques.HeavyTop):
        return _largest(np.abs(change[..., 2]), size[:, :1]) + "  (vertical component, the one conserved)"
    if isinstance(torque, torques.DipoleInField):
        field = np.asarray(torque.field)
        along = np.abs(change @ field) / np.linalg.norm(field)
        return _largest(along, size[:, :1]) + "  (component along the field, the one conserved)"
    return "not conserved: the torque changes it"


def _largest(change: np.ndarray, scale: np.ndarray) -> str:
    return f"{float(np.max(change / np.where(scale > 0, scale, 1))):.2e}"


if __name__ == "__main__":
    sys.exit(main())
