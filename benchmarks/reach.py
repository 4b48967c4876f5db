"""What a longer reach of JACOBI would cost: flights that subdivide themselves, put into docs/reports/limits.md.

    python benchmarks/reach.py [--write]

JACOBI turns a body by at most 1.2 radians a step. Two exact flights of h/2 are one of h, so a flight may subdivide
itself and reach 2.4 radians. 1000 heavy tops take 128 steps in float64 on one core, with programs that take turns.
"""

from typing import ClassVar

from midlie_jax.drivers.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_enable_x64", True)

from pages import command  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax._kernel import components as cp  # noqa: E402
from midlie_jax.bench import scenes  # noqa: E402
from midlie_jax.drivers.timing import timed_in_turn  # noqa: E402

BEGIN, END = "<!-- reach -->", "<!-- /reach -->"
BODIES, STEPS = 1000, 128
TOP = scenes.scene("asymmetric-top")
STARTS = scenes.perturbed(TOP, BODIES, 1e-3)


class Halves(ml.flights.Jacobi):
    """Two flights of half the time."""

    name: ClassVar[str] = "two flights of h/2"
    per_loop: ClassVar[int] = 1

    def __call__(self, inertia, h, momentum):
        flight = ml.flights.Jacobi()
        first, change, ok = flight(inertia, h / 2, momentum)
        second, rest, fine = flight(inertia, h / 2, cp.add(momentum, change))
        return cp.multiply(first, second), cp.add(change, rest), ok & fine


class Either(ml.flights.Jacobi):
    """One flight where the step is small, two where it is not: each body computes both, as a loop over bodies does."""

    name: ClassVar[str] = "one flight, or two of h/2 where the turn is large"
    per_loop: ClassVar[int] = 1

    def __call__(self, inertia, h, momentum):
        whole, parts = ml.flights.Jacobi()(inertia, h, momentum), Halves()(inertia, h, momentum)
        return jax.tree.map(lambda x, y: jnp.where(whole[2], x, y), whole, parts)


FLIGHTS = {"one flight, up to 1.2 radians": ml.flights.Jacobi(), Halves.name: Halves(), Either.name: Either()}
TORQUES = {"heavy top": TOP.torque, "satellite": scenes.scene("gravity-gradient").torque}


def program(flight, torque):
    """The ends of all bodies, compiled."""
    method = ml.method(flight, "EA")

    def end(start):
        return ml.integrate(method, TOP.body, torque, start, dt=0.01, steps=STEPS, save_every=STEPS).states

    return jax.jit(jax.vmap(end)).lower(STARTS).compile()


def rows():
    for label, torque in TORQUES.items():
        programs = [program(flight, torque) for flight in FLIGHTS.values()]
        runs = [lambda p=p: jax.block_until_ready(p(STARTS)) for p in programs]
        seconds = [time.seconds for _, time in timed_in_turn(runs, least=5, most=9)]
        yield [label, *(f"{1e9 * s / BODIES / STEPS:.0f} ns ({s / seconds[0]:.2f})" for s in seconds)]


if __name__ == "__main__":
    command(__doc__, "reports/limits.md", BEGIN, END, ["torque", *FLIGHTS], rows())
