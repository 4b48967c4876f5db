"""What a call costs besides its steps: a second call, a first one, and one with another number of steps.

    python benchmarks/calls.py [--write]

A second call is of the same body and torque and takes two steps, so it consists of checks, of the search for the
compiled program, and of its dispatch. "In your jit" is the same run inside a function that `jax.jit` compiled: what JAX
itself takes. Times are medians of processor time on one core, of calls that take turns. First calls run in a process of
their own; they include tracing and compiling, not imports, and the next call has another number of steps.
"""

import sys
from collections.abc import Callable, Iterator
from typing import Any

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_enable_x64", True)

import first_call  # noqa: E402
from pages import command, publish  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax.advice.timing import timed_in_turn  # noqa: E402
from midlie_jax.cli import scenes  # noqa: E402

BODIES = 64
HEADS = ("call", "second call", "inside `jax.jit`")
FIRST_MARKS = "<!-- first calls -->", "<!-- /first calls -->"
FIRST = ("method, torque", "first call", "another number of steps")
SCENE = scenes.scene("P1")
ONE, MANY = SCENE.start, scenes.perturbed(SCENE, BODIES, 1e-3)
RUN = {"dt": 0.005, "steps": 2}


def solve(start):
    term, solver = ml.RigidBodyTerm(SCENE.body, SCENE.torque), ml.LieSolver("SYMMETRIC[EA]")
    return diffrax.diffeqsolve(term, solver, 0.0, 0.01, 0.005, start, adjoint=diffrax.ForwardMode()).ys


CALLS: dict[str, tuple[Any, Callable[[Any], Any]]] = {
    "`ml.integrate`": (
        ONE,
        lambda x: ml.integrate("SYMMETRIC[EA]", SCENE.body, SCENE.torque, x, save_every=None, **RUN),
    ),
    "`ml.integrate` in `jax.vmap`, 64 bodies": (
        MANY,
        jax.vmap(lambda x: ml.integrate("SYMMETRIC[EA]", SCENE.body, SCENE.torque, x, save_every=None, **RUN)),
    ),
    "`ml.ensemble`, 64 bodies": (MANY, lambda x: ml.ensemble("SYMMETRIC[EA]", SCENE.body, SCENE.torque, x, **RUN)),
    "`ml.integrate_adaptive`": (
        ONE,
        lambda x: ml.integrate_adaptive(
            "SYMMETRIC[EA]", SCENE.body, SCENE.torque, x, density=even_density, save_every=None, **RUN
        ),
    ),
    "`ml.free_motion`": (ONE, lambda x: ml.free_motion(SCENE.body, x, [0.0, 0.005, 0.01])),
    "`diffeqsolve` with `ml.LieSolver`": (ONE, solve),
}


def even_density(t, state):
    return 1.0 + 0.0 * state.momentum[0]


def rows() -> Iterator[list[str]]:
    for name, (start, call) in CALLS.items():
        compiled = jax.jit(call)
        calls = [
            lambda call=call, start=start: jax.block_until_ready(call(start)),
            lambda compiled=compiled, start=start: jax.block_until_ready(compiled(start)),
        ]
        (_, ours), (_, inside) = timed_in_turn(calls, least=101, most=301)
        yield [name, *(f"{1e3 * timing.seconds:.2f} ms" for timing in (ours, inside))]


def orbiting(name: str, bodies: int | None, steps: int) -> Any:
    """A run in the field of a centre around which the body goes, with an orbit that all bodies share."""
    orbit = ml.orbits.KeplerOrbit(jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 1.1, 0.0]), 1.0)
    return driven(name, ml.torques.GravityGradient(None, orbit, 1.0), bodies, steps)


def topping(name: str, bodies: int | None, steps: int) -> Any:
    return driven(name, SCENE.torque, bodies, steps)


def driven(name: str, torque: Any, bodies: int | None, steps: int) -> Any:
    body = SCENE.body if name.startswith("SYMMETRIC") else ml.RigidBody([5.0, 4.5, 1.0])
    if bodies is None:
        return ml.integrate(name, body, torque, ONE, dt=0.005, steps=steps, save_every=None)
    return ml.ensemble(name, body, torque, MANY, dt=0.005, steps=steps)


KINDS = {"top": topping, "orbit": orbiting}
PROGRAMS = [
    (name, kind, bodies)
    for kind in KINDS
    for name in ("SYMMETRIC[EA]", "JACOBI[EA]", "GBS12")
    for bodies in (None, BODIES)
    if not (kind == "orbit" and name == "SYMMETRIC[EA]")
]


def first_rows() -> Iterator[list[str]]:
    for name, kind, bodies in PROGRAMS:
        parts = name, kind, str(bodies or "")
        first = first_call.seconds(__file__, *parts)
        both = first_call.seconds(__file__, *parts, "again")
        what = "a heavy top" if kind == "top" else "gravity gradient on an orbit"
        who = "`ml.integrate`" if bodies is None else f"`ml.ensemble`, {bodies} bodies"
        yield [f"{name}, {what}, {who}", f"{first:.1f} s", f"{1e3 * both:.0f} ms"]


def write(lines: list[str]) -> None:
    """Writes all first calls to their data file, and the first calls of two programs into the page."""
    kept = ("JACOBI[EA], a heavy top", "GBS12, gravity gradient")
    publish("reports/speed.md", *FIRST_MARKS, lines, "first-calls", lambda row: row[0].startswith(kept))


def one_process(name: str, kind: str, bodies: str, again: str = "") -> None:
    run = KINDS[kind]
    count = int(bodies) if bodies else None
    if again:
        jax.block_until_ready(run(name, count, 1000))
    first_call.report(lambda: run(name, count, 1001 if again else 1000))


if __name__ == "__main__":
    if "--first" in sys.argv:
        one_process(*sys.argv[sys.argv.index("--first") + 1 :])
    else:
        command(__doc__, "reports/speed.md", "<!-- calls -->", "<!-- /calls -->", HEADS, rows())
        command(__doc__, "reports/speed.md", *FIRST_MARKS, FIRST, first_rows(), write)
