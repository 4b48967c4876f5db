"""What it costs to observe 10,000 free tops at every step: their states, or a statistic of one momentum component.

    python benchmarks/observed.py [--write]

`--write` puts the table into docs/api.md.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, in_turn, main

import midlie_jax as ml

BODIES, STEPS, TURNS = 10_000, 100, 11


def component(t: Any, state: Any) -> Any:
    return state.momentum[0]


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    """What is saved, and the options of `ensemble` for it."""
    yield "nothing", {"save_every": None}
    yield "the states", {"save_every": 1}
    yield "`Mean`", {"save_every": 1, "observe": ml.observe.Mean(component)}
    for bins in (10, 100, 1000):
        edges = np.linspace(-3, 3, bins + 1)
        yield f"`Histogram` of {bins} bins", {"save_every": 1, "observe": ml.observe.Histogram(component, edges)}


def rows() -> Iterator[list[str]]:
    random = np.random.default_rng(0)
    attitudes = random.normal(size=(BODIES, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    start = ml.RigidState(jnp.asarray(random.normal(size=(BODIES, 3))), jnp.asarray(attitudes))
    body = ml.RigidBody(jnp.array([2.0, 2.0, 1.0]))
    names, runs = zip(*((name, partial(run, body, start, options)) for name, options in cases()), strict=True)
    times = [seconds / (BODIES * STEPS) * 1e9 for seconds in in_turn(runs, TURNS)]
    for name, nanoseconds in zip(names, times, strict=True):
        yield [name, f"{nanoseconds:.0f}", f"{nanoseconds - times[0]:.0f}"]


def run(body: Any, start: Any, options: dict[str, Any]) -> Any:
    return ml.ensemble("SYMMETRIC[EA]", body, None, start, dt=0.05, steps=STEPS, **options)


HEADS = "at each step", "ns per body-step", "more than the motion alone, ns"
TABLE = Table("api.md", "observed", HEADS, rows)

if __name__ == "__main__":
    main(__doc__, TABLE)
