"""Whether the temperatures of rotation and travel of 216 waters are equal, as they are in equilibrium.

A symplectic method of step h follows a system whose energy differs by terms of order h^p, and the mean kinetic energies
are those of that system. At order 2 rotation, whose frequencies are higher, seems colder than travel.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Table

import midlie_jax as ml

from . import water

CASES = [(scheme, per_force) for per_force in (1.0, 2.0) for scheme in ("EA", "CHIN4A", "SRKN6b")] + [("EA", 4.0)]
STEPS = {"EA": 20, "CHIN4A": 6, "SRKN6b": 3}  # between two samples
TURN, FORGOTTEN = 4.0, 4.0  # ps of a run at a time, and at its begin
BLOCKS = 20
FIELDS = ("momentum", "attitude", "linear", "position")


def extend(kept: Path, minutes: float) -> None:
    """Continues all runs in turn, each from its state in the file, until the minutes are over."""
    ends, found = time.monotonic() + 60 * minutes, _read(kept)
    while True:
        for case in CASES:
            if time.monotonic() > ends:
                return
            state, samples = found.get(case) or (water.box()[0], np.zeros((0, 2)))
            state, more = _continued(*case, state)
            found[case] = state, np.concatenate([samples, more])
        _write(kept, found)


def _continued(scheme: str, per_force: float, start: ml.CoupledState) -> tuple[Any, np.ndarray]:
    """The state after a turn, and the temperatures of travel and rotation on the way."""
    name, edge = f"JACOBI[{scheme}]", water.EDGE
    dt, every = 1e-3 * per_force * water.forces_per_step(name), STEPS[scheme]
    steps = every * round(TURN / (dt * every))
    path = water.motion(name, start, edge, dt, steps, every=every, skin=edge, single=True)
    if not path.ok:
        raise RuntimeError(f"{name} at a step of {dt:g} ps: {path.result}")
    later = jax.tree.map(lambda x: x[1:], path.states)
    return jax.tree.map(lambda x: x[-1], path.states), np.stack(water.temperatures(later), axis=-1)


def _name(scheme: str, per_force: float) -> str:
    return f"{scheme} {per_force:g}"


def _read(kept: Path) -> dict[tuple[str, float], tuple[Any, np.ndarray]]:
    if not kept.exists():
        return {}
    with np.load(kept) as data:
        known = [case for case in CASES if f"{_name(*case)} samples" in data]
        return {
            case: (
                ml.CoupledState(*(jnp.asarray(data[f"{_name(*case)} {field}"]) for field in FIELDS)),
                data[f"{_name(*case)} samples"],
            )
            for case in known
        }


def _write(kept: Path, found: dict[tuple[str, float], tuple[Any, np.ndarray]]) -> None:
    arrays = dict[str, np.ndarray]()
    for case, (state, samples) in found.items():
        arrays |= {f"{_name(*case)} {field}": np.asarray(getattr(state, field)) for field in FIELDS}
        arrays[f"{_name(*case)} samples"] = samples
    beside = kept.with_suffix(".part.npz")
    np.savez(beside, **arrays)  # pyright: ignore[reportArgumentType]
    beside.replace(kept)


def rows(kept: Path) -> Iterator[list[str]]:
    """Means with the errors of means of blocks."""
    found = _read(kept)
    for case in CASES:
        if case not in found:
            continue
        scheme, per_force = case
        step = per_force * water.forces_per_step(f"JACOBI[{scheme}]")
        every = 1e-3 * step * STEPS[scheme]
        samples = found[case][1][round(FORGOTTEN / every) :]
        if len(samples) < 2 * BLOCKS:
            continue
        travel, turn = samples.T
        mean, error = with_error(turn - travel)
        length = f"{len(samples) * every:.0f}"
        whole = f"{np.mean(samples):.1f}"
        yield [f"`JACOBI[{scheme}]`", f"{per_force:g}", f"{step:g}", length, f"{mean:.2f} ± {error:.2f}", whole]


def with_error(samples: np.ndarray) -> tuple[float, float]:
    """The mean, and its standard error from that of the means of blocks."""
    means = [np.mean(block) for block in np.array_split(samples, BLOCKS)]
    return float(np.mean(samples)), float(np.std(means, ddof=1) / np.sqrt(BLOCKS))


TABLE = Table(
    *("reports/heat.md", "equipartition"),
    ("method", "time per force, fs", "step, fs", "run, ps", "T_rot - T_tr, K", "T, K"),
    data="waters-equipartition",
    key=lambda row: "6b" not in row[0],
    columns=(0, 2, 4),
)


def measure(options: Any) -> None:
    extend(options.kept, options.minutes)
    TABLE.show(options.write, rows(options.kept))
