"""What a call costs besides its steps: a second call, a first one, and one with another number of steps.

    python benchmarks/calls.py [--write]

A second call is of the same body and torque and takes two steps, so it consists of checks, of the search for the
compiled program, and of its dispatch. "In your jit" is the same run inside a function that `jax.jit` compiled: what JAX
itself takes. Times are medians of processor time on one core, of calls that take turns. First calls run in a process of
their own; they include tracing and compiling, not imports, and the next call has another number of steps.
"""

from collections.abc import Callable, Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import one_core  # noqa: F401
from harness import Table, first_call, in_turn, main

import midlie_jax as ml
from midlie_jax.cli import scenes

BODIES = 64
SCENE = scenes.scene("P1")
ONE, MANY = SCENE.start, scenes.perturbed(SCENE, BODIES, 1e-3)
RUN = {"dt": 0.005, "steps": 2}


def solve(start):
    term, solver = ml.diffrax.RigidBodyTerm(SCENE.body, SCENE.torque), ml.diffrax.LieSolver("SYMMETRIC[EA]")
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
    "`ml.integrate_variable_step`": (
        ONE,
        lambda x: ml.integrate_variable_step(
            "SYMMETRIC[EA]", SCENE.body, SCENE.torque, x, density=even_density, save_every=None, **RUN
        ),
    ),
    "`ml.free_motion`": (ONE, lambda x: ml.free_motion(SCENE.body, x, [0.0, 0.005, 0.01])),
    "`diffeqsolve` with `ml.diffrax.LieSolver`": (ONE, solve),
}


def even_density(t, state):
    return 1.0 + 0.0 * state.momentum[0]


def rows() -> Iterator[list[str]]:
    for name, (start, call) in CALLS.items():
        compiled = jax.jit(call)
        times = in_turn((lambda: call(start), lambda: compiled(start)), 101, 301)  # noqa: B023  (called here)
        yield [name, *(f"{1e3 * seconds:.2f} ms" for seconds in times)]


def orbiting(name: str, bodies: int | None, steps: int) -> Any:
    """A run in the field of a centre around which the body goes, with an orbit that all bodies share."""
    orbit = ml.orbits.KeplerOrbit(jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 1.1, 0.0]), 1.0)
    return driven(name, ml.spacecraft.GravityGradient(None, orbit, 1.0), bodies, steps)


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
        first, both = first_call(__file__, *parts), first_call(__file__, *parts, "again")
        what = "a heavy top" if kind == "top" else "gravity gradient on an orbit"
        who = "`ml.integrate`" if bodies is None else f"`ml.ensemble`, {bodies} bodies"
        yield [f"{name}, {what}, {who}", f"{first:.1f} s", f"{1e3 * both:.0f} ms"]


def one_process(name: str, kind: str, bodies: str, again: str = "") -> Callable[[], Any]:
    run, count = KINDS[kind], int(bodies) if bodies else None
    if again:
        jax.block_until_ready(run(name, count, 1000))
    return lambda: run(name, count, 1001 if again else 1000)


KEPT = ("JACOBI[EA], a heavy top", "GBS12, gravity gradient")  # on the page
TABLES = {
    "calls": Table("reports/speed.md", "calls", ("call", "second call", "inside `jax.jit`"), rows),
    "first": Table(
        *("reports/speed.md", "first calls", ("method, torque", "first call", "another number of steps"), first_rows),
        *("first-calls", lambda row: row[0].startswith(KEPT)),
    ),
}

if __name__ == "__main__":
    main(__doc__, TABLES, first=one_process)
