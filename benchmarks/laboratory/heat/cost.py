"""What a step in a bath costs, beside a step of `EA` on the same bodies under the same torque without the bath."""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Compiled, Table, compiled, in_turn

import midlie_jax as ml

BODIES = 10_000
SCHEMES = "EA", "BAOAB", "OBABO", "ABOBA"
CASES = ("RigidState", "SYMMETRIC"), ("AxisState", "SYMMETRIC"), ("FreeState", "SYMMETRIC"), ("RigidState", "JACOBI")
_STEPS, _ROUNDS = 200, 9


def _states(kind: str, dtype: Any) -> tuple[Any, Any]:
    """The body and random states of it."""
    random = np.random.default_rng(0)

    def numbers(count: int) -> Any:
        return jnp.asarray(random.normal(size=(BODIES, count)), dtype)

    momentum, attitude = numbers(3), numbers(4)
    state = ml.RigidState(momentum, attitude / jnp.linalg.norm(attitude, axis=-1, keepdims=True))
    body = ml.RigidBody(jnp.asarray([1.0, 1.0, 0.5], dtype))
    if kind == "AxisState":
        return ml.SymmetricRotor(jnp.asarray(1.0, dtype), jnp.asarray(0.5, dtype)), ml.AxisState.of(state)
    if kind == "FreeState":
        free = ml.FreeBody(body, jnp.asarray(1.0, dtype))
        return free, ml.FreeState(state.momentum, state.attitude, numbers(3), numbers(3))
    return body, state


def _run(kind: str, flight: str, scheme: str, dtype: Any) -> Compiled:
    body, start = _states(kind, dtype)
    torque = ml.torques.HeavyTop(jnp.asarray(-2.0, dtype))
    options: Any = {"dt": jnp.asarray(0.1, dtype), "steps": _STEPS}
    if scheme != "EA":
        linear = jnp.asarray(1.0, dtype) if kind == "FreeState" else None
        keys = jax.random.split(jax.random.key(1), BODIES)
        options["bath"] = ml.baths.Langevin(jnp.asarray(1.0, dtype), jnp.asarray(1.0, dtype), keys, linear)

    def run(start: Any) -> Any:
        return ml.ensemble(f"{flight}[{scheme}]", body, torque, start, **options)

    return compiled(run, start, bodies=BODIES)


def rows() -> Iterator[list[str]]:
    for kind, flight in CASES:
        for dtype in (jnp.float32, jnp.float64):
            runs = [_run(kind, flight, scheme, dtype) for scheme in SCHEMES]
            found = [1e9 * seconds / BODIES / _STEPS for seconds in in_turn(runs, _ROUNDS)]
            cells = [f"{x:.1f}" for x in found] + [f"{x / found[0]:.2f}" for x in found[1:]]
            yield [kind, f"`{flight}`", jnp.dtype(dtype).name, *cells]


TABLE = Table(
    *("reports/heat.md", "cost"),
    ("state", "flight", "dtype", *(f"{scheme}, ns" for scheme in SCHEMES), *(f"{s} / EA" for s in SCHEMES[1:])),
    *(rows, "heat-cost", lambda row: row[2] == "float32", (0, 1, 3, 4, 5)),
)
