"""Measures what a step costs with each way of rounding that `rounding_growth.py` compares, for docs/rounding.md.

    python benchmarks/rounding_cost.py [--write]

Nanoseconds of one step of one body on one core: the median of runs that take turns, of 1024 bodies.
"""

from collections.abc import Iterator
from functools import partial

from pages import command
from rounding_growth import MODES, Run, cases

from midlie_jax.drivers.timing import pin, timed_in_turn

BODIES, STEPS, TURNS = 1024, 2000, 9
BEGIN, END = "<!-- cost -->", "<!-- /cost -->"


def measured() -> Iterator[list[str]]:
    free, _, top = cases()
    for name, case in (
        ("free body", free),
        ("P1", top._replace(method="SYMMETRIC[EA]")),
        ("P1", top),
    ):
        runs = [Run(case, mode, BODIES) for mode in MODES]
        timings = timed_in_turn([partial(run.take, STEPS) for run in runs], least=TURNS, most=TURNS)
        yield [name, f"`{case.method}`", *(f"{1e9 * t.seconds / (BODIES * STEPS):.1f}" for _, t in timings)]


if __name__ == "__main__":
    pin()
    command(__doc__, "rounding.md", BEGIN, END, ["run", "method", *(mode.name for mode in MODES)], measured())
