"""Measures what a step costs with each state and dtype that `rounding_growth.py` compares.

    python benchmarks/rounding_cost.py [--write]

Nanoseconds of processor time for a step of one body, on one core: the median of runs that take turns. The bodies, 1024
of them, move as in `ensemble`, in chunks of 256; without torque with JACOBI, and as the top P1 with SYMMETRIC.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
from pages import command
from rounding_growth import BODIES, MODES, Case, Mode, cases, rows_of

import midlie_jax as ml
from midlie_jax.advice.program import Program
from midlie_jax.advice.timing import pin, timed_in_turn

COPIES, CHUNK, STEPS, TURNS = 64, 256, 2000, 15
BEGIN, END = "<!-- cost -->", "<!-- /cost -->"


def compiled(case: Case, mode: Mode) -> Callable[[], Any]:
    """A run of many copies of the first body of a case, from the starts of all."""
    rows = rows_of(case, mode)
    body, torque, dt = jax.tree.map(lambda x: x[0], (rows.body, rows.torque, rows.dt))
    starts = jax.tree.map(lambda x: jnp.concatenate([x] * COPIES), rows.start)
    program = Program(ml.method(case.method), body, torque, starts, chunk=CHUNK)
    _, ok = program.run(float(dt), STEPS)
    if not ok.all():
        raise RuntimeError(f"{case.name}, {mode.name}: a step failed.")
    return lambda: program.run(float(dt), STEPS)


def measured() -> Iterator[list[str]]:
    free, _, top = cases()
    for case in (free, top._replace(method="SYMMETRIC[EA]"), top):
        timings = timed_in_turn([compiled(case, mode) for mode in MODES], least=TURNS, most=TURNS)
        yield [f"`{case.method}`", *(f"{1e9 * t.seconds / (COPIES * BODIES * STEPS):.1f}" for _, t in timings)]


if __name__ == "__main__":
    pin()
    command(__doc__, "reports/rounding.md", BEGIN, END, ["method", *(mode.name for mode in MODES)], measured())
