"""What a day of many binaries costs at an error, by method and step: the ladder of steps, its times and its errors."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.advice.timing import timed_in_turn

from . import didymos

BINARIES = 1000
# Steps a day.
LADDERS = {
    "JACOBI[EA]": (360, 1440, 5760),
    "JACOBI[SRKN6b]": (96, 144, 192, 288, 432, 576),
    "JACOBI[SRKN14a]": (48, 72, 96, 108, 120, 144),
    "GBS12": (32, 40, 48, 60, 72, 96),
}
FINEST = "JACOBI[SRKN14a]", 576  # whose end counts as exact where none is published
# What the program of the field takes for a day of one binary, seconds, and its error after it: its Lie-group integrator
# of order 2 with its own step of 30 s, on one core of the same kind of machine, compiled with -O2.
GUBAS = {2: (0.39, 6.1e-3), 4: (8.1, 6.1e-3)}
ROUNDS = 5


class Rung(NamedTuple):
    """One method with one step.

    Attributes:
        method, degree, steps: steps a day, with the gravity of this degree.
        milliseconds: of a binary and a day, in a batch.
        error: the largest relative error of place, velocity, attitudes and momenta after a day of the known start.
    """

    method: str
    degree: int
    steps: int
    milliseconds: float
    error: float


def gravity(degree: int) -> Any:
    """The torque."""
    return ml.torques.MutualGravity(didymos.G, degree=degree)


def end(method: str, degree: int, steps: int) -> ml.CoupledState:
    """The state of the known binary after a day."""
    options: Any = {"dt": didymos.DAY / steps, "steps": steps, "save_every": None}
    path = ml.integrate(method, didymos.BODY, gravity(degree), didymos.start(), **options)
    if not bool(path.ok):
        raise RuntimeError(f"{method} with {steps} steps a day failed.")
    return path.states


def known_end(degree: int) -> dict[str, tuple[float, ...]]:
    """The published end after a day or, of degree 4, that of the finest run."""
    if (didymos.TILTED, degree, didymos.DAY) in didymos.ENDS:
        return didymos.ENDS[didymos.TILTED, degree, didymos.DAY]
    return didymos.as_end(end(FINEST[0], degree, FINEST[1]))


def day(method: str, degree: int, steps: int) -> Callable[[], Any]:
    """A day of many binaries with different shapes, compiled."""
    body, start = didymos.scattered(BINARIES)
    options: Any = {"dt": didymos.DAY / steps, "steps": steps}

    def run(start: ml.CoupledState) -> Any:
        return ml.ensemble(method, body, gravity(degree), start, **options)

    program = jax.jit(run, compiler_options=compiler_options(BINARIES)).lower(start).compile()
    if not bool(np.all(program(start).ok)):
        raise RuntimeError(f"{method} with {steps} steps a day failed.")
    return lambda: jax.block_until_ready(program(start))


def rungs(degree: int) -> list[Rung]:
    """Every method with every step, timed in turns on one core."""
    cases = [(method, steps) for method, ladder in LADDERS.items() for steps in ladder]
    exact = known_end(degree)
    errors = [max(didymos.errors(end(method, degree, steps), exact).values()) for method, steps in cases]
    timings = timed_in_turn([day(method, degree, steps) for method, steps in cases], least=ROUNDS, most=ROUNDS)
    return [
        Rung(method, degree, steps, 1e3 * timing.seconds / BINARIES, error)
        for (method, steps), (_, timing), error in zip(cases, timings, errors, strict=True)
    ]


def fastest(found: list[Rung], error: float) -> Rung:
    """The one that takes least among those within this error."""
    return min((rung for rung in found if rung.error <= error), key=lambda rung: rung.milliseconds)
