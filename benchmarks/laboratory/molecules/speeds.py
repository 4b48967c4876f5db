"""What a step of a box of water takes, here and in LAMMPS, which take turns on one core."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
from harness import Table

from midlie_jax.advice.timing import timed_in_turn

from . import water
from .lammps_runs import Waters

# Copies of the box along an edge: skin of the list in nm (None: all are neighbours), steps. LAMMPS' skin of 2 A is the
# fastest of 1, 1.5, 2 and 2.5.
SIZES: dict[int, tuple[float | None, int]] = {1: (None, 120), 2: (0.24, 48)}
ROUNDS, LAMMPS_SKIN = 9, 2.0


def rows() -> Iterator[list[str]]:
    for copies, (skin, total) in SIZES.items():
        start, edge = water.box(copies)
        with Waters(start, 1.0, edge, skin=LAMMPS_SKIN) as other:
            other.run(total, prepare=True)
            runs = [_own(start, edge, skin or edge, total, single) for single in (False, True)]
            timings = timed_in_turn([lambda: other.run(total), *runs], least=ROUNDS, most=ROUNDS)  # noqa: B023
        names = ("LAMMPS `rigid/nve/small`", "`JACOBI[EA]`", "`JACOBI[EA]`, pairs in float32")
        for name, (_, timing) in zip(names, timings, strict=True):
            ratio = timing.seconds / timings[0][1].seconds
            time = f"{1e3 * timing.seconds / total:.3g}"
            yield [f"{start.count:,}", name, time, f"±{timing.spread:.0%}", f"{ratio:.2f}"]


def _own(start: Any, edge: float, skin: float, total: int, single: bool) -> Callable[[], Any]:
    """Some lists with their steps, the lists included; compiled."""

    def run() -> Any:
        return jax.block_until_ready(
            water.motion("JACOBI[EA]", start, edge, 1e-3, total, every=total, skin=skin, single=single)
        )

    run()
    return run


TABLE = Table(
    *("reports/heat.md", "speed", ("molecules", "program", "time per step, ms", "spread", "relative to LAMMPS"), rows),
    data="waters-speed",
    columns=(0, 1, 2, 4),
)
