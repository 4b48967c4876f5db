"""`midlie run`: integrates a scene or perturbed copies of it; reports errors of energy and momentum, and times."""

import argparse
import math
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._xla.platform import cores
from ..advice.check import check
from ..advice.timing import Load, Timing, timed, user_clock
from ..advice.trials import MOST_STEPS
from ..drivers.integrate import integrate
from ..drivers.path import Path
from ..integrators.base import Method
from ..model.states import AxisState
from ..plot.style import FEW
from ..simulation.simulate import simulate
from ..simulation.summary import inspect
from . import chosen, scenes
from .figures import write
from .options import MOST_STEPS as COUNTED
from .record import SCENE, Record, save
from .run_chart import run_figure
from .saved import draw
from .scenes import Scene
from .tables import require

_FEW, _MANY = 200, 2000  # largest number of saved states per body: for the errors alone, and for a file or a chart
_MOST_NUMBERS = 2**25  # largest number of saved numbers of all bodies: 256 MiB in float64
_TIMINGS, _TIMING_SECONDS = 30, 1.0  # largest number of timed runs, and the seconds after which no further run starts
_MOST_CHECKED = 1000  # bodies whose step is checked before the run


def run(options: argparse.Namespace) -> None:
    if options.plot:
        require("matplotlib")
    dtype = jnp.dtype(jnp.float32 if options.float32 else jnp.float64)
    scene = chosen.scene(options.scene, dtype)
    if ":" in options.scene:  # so that output does not name a scene of this package by mistake
        scene = replace(scene, name=options.scene)
    options.method = options.method or scene.method
    method = chosen.method(options.method)
    options.method_from = options.method if ":" in options.method else "midlie_jax"
    dt, steps = _steps(options, scene, dtype)
    start = scenes.perturbed(scene, options.bodies, options.size, options.seed)
    few = jax.tree.map(lambda leaf: leaf[:_MOST_CHECKED], start)
    # All copies are in one field: with three of them its vectors would look like one component per body.
    trial: dict[str, Any] = {"dt": dt, "steps": min(steps, MOST_STEPS), "torque_axes": None}
    checked = check(method, scene.body, scene.torque, few, **trial).parts_of(steps)
    if options.out and options.out.lower().endswith(".zarr"):
        print(*(f"{name}: {value}" for name, value in checked), sep="\n")
        _long_run(options, method, scene, dt, steps, start)
        return
    every = _save_every(steps, options.bodies, _MANY if options.out or options.plot else _FEW)
    load = Load()
    path, compile_seconds, timing = _integrated(method, scene, start, dt, steps, every)
    record = Record.of(scene, method.name, dt, steps, options.size, options.seed, path)
    record = record._replace(method_from=options.method_from)
    _report(record, checked, compile_seconds, timing, load)
    if options.out:
        save(record, options.out)
        print(f"wrote {options.out}")
    if options.plot:
        write(run_figure(record), options.plot)
        print(f"wrote {options.plot}")


def _steps(options: argparse.Namespace, scene: Scene, dtype: Any) -> tuple[float, int]:
    with np.errstate(over="ignore"):  # infinity raises a ValueError below
        dt = float(np.asarray(scene.dt if options.dt is None else options.dt, dtype))
    if not (math.isfinite(dt) and dt != 0):
        original = "" if options.dt is None or dt == options.dt else f" (from {options.dt:g}, in {dtype})"
        raise ValueError(f"dt must be finite and not zero, got {dt:g}{original}; write for example --dt {scene.dt:g}.")
    if options.steps:
        return dt, options.steps
    count = max(1.0, scene.duration / abs(dt))
    if count > COUNTED:
        raise ValueError(
            f"dt {dt:g} gives {count:.1e} steps in the duration {scene.duration:g} of the scene, more "
            f"than {COUNTED}; give a larger --dt, or --steps."
        )
    return dt, round(count)


def _save_every(steps: int, bodies: int, most: int) -> int:
    """The number of steps between two saved states.

    It is a divisor of `steps` if a divisor saves between half of `most` states and `most`. A prime number of steps has
    no such divisor: then there are fewer steps between the last two saved states.
    """
    most = max(1, min(most, _MOST_NUMBERS // (8 * bodies)))
    least = -(-steps // most)
    return next((n for n in range(least, 2 * steps // most + 1) if steps % n == 0), least)


def _integrated(
    method: Method, scene: Scene, start: Any, dt: float, steps: int, every: int
) -> tuple[Path[Any], float, Timing]:
    rest = steps % every

    def path_of_body(start: Any, dt: Any) -> Any:
        def part(start: Any, first: int, count: int, every: int) -> Any:
            options: dict[str, Any] = {"dt": dt, "steps": count, "save_every": every, "first_step": first}
            return integrate(method, scene.body, scene.torque, start, **options)

        path = part(start, 0, steps - rest, every)
        if not rest:
            return path
        end = part(jax.tree.map(lambda leaf: leaf[-1], path.states), steps - rest, rest, rest)
        times, states = jax.tree.map(
            lambda a, b: jnp.concatenate([a, b[1:]]), (path.times, path.states), (end.times, end.states)
        )
        first_bad = jnp.where(path.ok, path.times.size - 1 + end.first_bad, path.first_bad)
        return Path(times, states, path.ok & end.ok, first_bad)

    step = jnp.asarray(dt, start.momentum.dtype)
    began = time.perf_counter()
    compiled = jax.jit(jax.vmap(path_of_body, in_axes=(0, None))).lower(start, step).compile()
    compile_seconds = time.perf_counter() - began
    path, timing = timed(
        lambda: jax.block_until_ready(compiled(start, step)),
        least=1,
        most=_TIMINGS,
        longest=_TIMING_SECONDS,
        clock=user_clock(),
    )
    return path, compile_seconds, timing


def _report(record: Record, checked: list[tuple[str, str]], compile_seconds: float, timing: Timing, load: Load) -> None:
    count, failed = len(record.ok), int(np.sum(~record.ok))
    said = "yes"
    if failed:
        last_good = max(int(np.min(np.asarray(record.first_bad))) - 1, 0)
        said = f"NO: failed for {failed} of {count}; the first after time {float(record.times[last_good]):g}"
    print(f"{record.headline}, on the {jax.default_backend().upper()}")
    runs = f"median, ±{timing.spread:.0%}" if math.isfinite(timing.spread) else "one run"
    clock = user_clock().name + (f" on {cores()} cores" if cores() > 1 else " on one core")
    warning = load.warning()
    lines = (
        *checked,
        *record.errors,
        *_end(record),
        ("ok", said),
        ("compile time", f"{compile_seconds:.2f} s"),
        ("run time", f"{timing.seconds:.3g} s of {clock} ({runs})"),
        ("throughput", f"{count * record.steps / timing.seconds:.3g} body-steps/s"),
        *([("note", warning)] if warning else []),
    )
    width = 1 + max(len(name) for name, _ in lines)
    for name, value in lines:
        print(f"  {name:<{width}} {value}")


def _end(record: Record) -> list[tuple[str, str]]:
    """The position of the first body at the end, if it translates, or its axis, if it has no attitude."""
    ends: dict[str, np.ndarray] = {}
    if record.travel and record.several:
        places = record.travel[-1][0, -1]
        shown = sorted({0, *(range(len(places)) if len(places) <= FEW else ()), len(places) - 1})
        ends = {f"place of body {i} at the end": places[i] for i in shown}
    elif record.travel:
        ends = {"place at the end": record.travel[-1][0, -1]}
    elif isinstance(record.scene.start, AxisState):
        ends = {"axis at the end": record.attitudes[0, -1]}
    return [(name, ", ".join(f"{x:.6g}" for x in end.astype(np.float64))) for name, end in ends.items()]


def _long_run(options: argparse.Namespace, method: Method, scene: Scene, dt: float, steps: int, start: Any) -> None:
    devices = jax.devices()[: options.devices] if options.devices else []
    if options.devices and len(devices) < options.devices:
        raise ValueError(f"there are {len(devices)} devices, but --devices requires {options.devices}.")
    result = simulate(
        method,
        scene.body,
        scene.torque,
        start,
        out=options.out,
        dt=dt,
        steps=steps,
        # The least divisor of the number of steps that divides the run into at most 100 intervals.
        save_every=options.save_every or next(steps // n for n in range(100, 0, -1) if steps % n == 0),
        torque_axes=None,  # all copies are in one field
        resume=options.resume,
        mesh=jax.make_mesh((len(devices),), ("bodies",), devices=devices) if devices else None,
        attributes={
            "title": f"{scene.name}: {scene.title}",
            "method_from": options.method_from,
            **dict(zip(SCENE, (scene.name, options.size, options.seed), strict=True)),
        },
    )
    print(result)
    if options.plot:
        draw(inspect(options.out), options.plot)
    else:
        print(f"look at it with: midlie inspect {options.out}")
