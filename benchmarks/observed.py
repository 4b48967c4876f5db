"""What it costs to observe 10,000 free tops at every step: their states, or a statistic of one momentum component.

    python benchmarks/observed.py [--write]

`--write` puts the table into docs/api.md.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from pages import command  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax.advice.timing import pin, timed_in_turn  # noqa: E402

BEGIN, END = "<!-- observed -->", "<!-- /observed -->"
BODIES, STEPS, TURNS = 10_000, 100, 11
HEADS = ("at each step", "ns per body-step", "more than the motion alone, ns")


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
    timings = timed_in_turn(runs, least=TURNS, most=TURNS)
    times = [timing.seconds / (BODIES * STEPS) * 1e9 for _, timing in timings]
    for name, nanoseconds in zip(names, times, strict=True):
        yield [name, f"{nanoseconds:.0f}", f"{nanoseconds - times[0]:.0f}"]


def run(body: Any, start: Any, options: dict[str, Any]) -> Any:
    return jax.block_until_ready(ml.ensemble("SYMMETRIC[EA]", body, None, start, dt=0.05, steps=STEPS, **options))


if __name__ == "__main__":
    pin()
    command(__doc__, "api.md", BEGIN, END, HEADS, rows())
