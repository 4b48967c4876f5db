"""Steps a second of a large cubic lattice on one core, beside what memory allows."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from harness import Compiled, Table, compiled, in_turn

import midlie_jax as ml

from . import depondt, random

SHAPES = (16, 16, 16), (100, 100, 100)
OURS, JAX = ("SUBLATTICES[EA]", "SUBLATTICES[SRKN6b]", "RK4"), "Depondt-Mertens in JAX"
LEAST, UPDATES = 16, 8_000_000  # steps, and spin-steps of a run
# A step must at least read every spin, and write it.
NUMBERS = 6


def _copy(spin: Any, steps: int) -> Compiled:
    """As many passes over memory as steps, each of which reads all spins and writes them."""
    factor = jnp.asarray(1.0000001, spin.dtype)

    def whole(parts: Any) -> Any:
        return jax.lax.fori_loop(0, steps, lambda _, x: tuple(factor * y for y in x), parts)

    parts = tuple(jnp.asarray(spin[..., i]) for i in range(3))
    return compiled(whole, parts, bodies=spin.size // 3)


def _ours(method: str, start: ml.spins.SpinState, steps: int) -> Callable[[], Any]:
    field = ml.spins.Exchange(jnp.ones((), start.spin.dtype))
    dt = jnp.asarray(0.05, start.spin.dtype)

    def run() -> Any:
        return ml.integrate(method, ml.spins.Spins(), field, start, dt=dt, steps=steps, save_every=None).states.spin

    return run


def rows(shapes: tuple[tuple[int, ...], ...] = SHAPES, rounds: int = 5) -> list[tuple[str, ...]]:
    """The table: for each lattice and dtype, methods that take turns with a copy of all spins."""
    found: list[tuple[str, ...]] = []
    for shape in shapes:
        for dtype in ("float64", "float32"):
            start = ml.spins.SpinState(random(shape, 1).spin.astype(dtype))
            spin, dt = start.spin, jnp.asarray(0.05, dtype)
            steps = max(LEAST, UPDATES // math.prod(shape))

            def theirs(spin: Any = spin, dt: Any = dt, steps: int = steps) -> Any:
                return depondt.run(spin, dt, steps)

            runs = [_copy(spin, steps), *(_ours(method, start, steps) for method in OURS), theirs]
            for run in runs:
                run()
            per = 1e9 / steps / math.prod(shape)
            limit, *times = (per * seconds for seconds in in_turn(runs, rounds))
            for method, time in zip((*(f"`{name}`" for name in OURS), JAX), times, strict=True):
                cells = f"{time:.3g}", f"{1e3 / time:.3g}", f"{limit / time:.2g}"
                found.append((f"{math.prod(shape):,}", dtype, method, *cells))
            bandwidth = NUMBERS * spin.dtype.itemsize / limit
            cells = f"{limit:.3g}", f"{1e3 / limit:.3g}", f"{bandwidth:.3g} GB/s"
            found.append((f"{math.prod(shape):,}", dtype, "a copy", *cells))
    return found


TABLE = Table(
    *("reports/heat.md", "lattice"),
    ("spins", "dtype", "method", "ns per spin-step", "million spin-steps per second", "relative to a copy"),
    *(rows, "spins-lattice", lambda row: row[:2] == ["1,000,000", "float64"], (2, 3, 4, 5)),
)
