"""What a body-step costs with each kind of state, and beside MuJoCo and MJX: docs/reports/speed.md.

    python benchmarks/kinds_of_state.py [kinds] [throw] [--write]

Ratios of processor times on one core, medians of rounds in which all programs take turns; 4096 bodies through
`ml.ensemble`. First calls are measured in separate processes. `--write` puts the tables into the page.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import one_core  # noqa: F401
from harness import Table, compiled, first_call, in_turn, main
from laboratory import scenes, thrown_brick

import midlie_jax as ml

BODIES, DT, ROUNDS = 4096, 0.005, 9
STEPS = {"EA": 800, "SRKN6b": 160, "SRKN14a": 80, "GBS12": 80, "DOP853": 160}  # by scheme or method
PULL = ml.torques.UniformGravity([0.0, 0.0, -9.81])
DTYPES = ("float64", "float32")


def rigid(name: str) -> tuple[Any, Any, Any]:
    """Body, torque and perturbed starts of a scene."""
    scene = scenes.scene(name)
    return scene.body, scene.torque, scenes.perturbed(scene.start, BODIES, 1e-3)


def thrown() -> tuple[Any, ...]:
    """Linear momenta and positions."""
    return tuple(jnp.broadcast_to(jnp.array(x), (BODIES, 3)) for x in ([1.0, 0.0, 2.0], [0.0, 0.0, 1.0]))


def travelling() -> tuple[Any, Any, Any]:
    """The asymmetric top, also thrown, in uniform gravity."""
    body, torque, starts = rigid("asymmetric-top")
    return ml.FreeBody(body, 3.0), torque + PULL, ml.FreeState(starts.momentum, starts.attitude, *thrown())


def axis() -> tuple[Any, Any, Any]:
    """The axis of the fast top P1, tilted."""
    body, torque, starts = rigid("P1-tilted")
    return ml.SymmetricRotor(body.moments[0]), torque, ml.AxisState.of(starts)


def direction() -> tuple[Any, Any, Any]:
    """The asymmetric top, of whose attitude only the vertical is kept."""
    body, torque, starts = rigid("asymmetric-top")
    return body, torque, ml.DirectionState(starts.momentum, ml.so3.to_matrix(starts.attitude)[:, 2])


def travelling_axis() -> tuple[Any, Any, Any]:
    """The axis of P1, thrown in uniform gravity."""
    rotor, torque, starts = axis()
    start = ml.FreeAxisState(starts.momentum, starts.axis, *thrown())
    return ml.FreeBody(rotor, 3.0), torque + PULL, start


def coupled() -> tuple[Any, Any, Any]:
    """The tops that travel, two in a state: they could act on each other and do not."""
    body, wrench, starts = travelling()
    pairs = jax.tree.map(lambda x: x.reshape(-1, 2, x.shape[-1]), vars(starts))
    return body, ml.torques.OnEach(wrench), ml.CoupledState(**pairs)


def compensated() -> tuple[Any, Any, Any]:
    """The asymmetric top, with what rounding loses."""
    body, torque, starts = rigid("asymmetric-top")
    return body, torque, ml.CompensatedState(starts.momentum, starts.attitude)


def free(attitude: bool) -> tuple[Any, Any, Any]:
    """The asymmetric top without its weight."""
    body, _, starts = rigid("asymmetric-top")
    return body, None, starts if attitude else ml.MomentumState(starts.momentum)


# By flight or method the states that are compared with the first of them: what makes body, torque and starts.
TOP = partial(rigid, "asymmetric-top")
FREE = {"RigidState, no torque": partial(free, True), "MomentumState, no torque": partial(free, False)}
SYSTEMS: dict[str, dict[str, Callable[[], tuple[Any, Any, Any]]]] = {
    "JACOBI": {
        "RigidState": TOP,
        "DirectionState": direction,
        "FreeState": travelling,
        "CoupledState": coupled,
        "CompensatedState": compensated,
        **FREE,
    },
    "SYMMETRIC": {"RigidState": partial(rigid, "P1-tilted"), "AxisState": axis, "FreeAxisState": travelling_axis},
    **{name: {"RigidState": TOP, "DirectionState": direction, **FREE} for name in ("GBS12", "DOP853")},
}
METHODS = [f"{flight}[{scheme}]" for flight in ("JACOBI", "SYMMETRIC") for scheme in ("EA", "SRKN6b", "SRKN14a")]
CASES = [(name, state) for name in (*METHODS, "GBS12", "DOP853") for state in SYSTEMS[name.partition("[")[0]]]


def measure(state: str) -> str:
    """The state by which the cost of a state is divided."""
    return "RigidState" + state.partition("State")[2]


def cast(tree: Any, dtype: str) -> Any:
    """The arrays of a body, torque or state in a dtype."""
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, tree)


def steps_of(method: str) -> int:
    """How many steps are timed."""
    return STEPS[method.removesuffix("]").rpartition("[")[2]]


def ensemble(method: str, state: str, dtype: str) -> tuple[Callable[[Any], Any], Any]:
    """A run as a function of the starts, and the starts."""
    body, torque, starts = cast(SYSTEMS[method.partition("[")[0]][state](), dtype)
    return lambda start: ml.ensemble(method, body, torque, start, dt=DT, steps=steps_of(method)), starts


def program(*case: str) -> Callable[[], Any]:
    """A run as a compiled program, without the checks of each call."""
    run, starts = ensemble(*case)
    call = compiled(run, starts, bodies=BODIES)
    if not bool(jnp.all(call().ok)):
        raise RuntimeError(f"{' '.join(case)} failed; take a shorter step.")
    return call


def call_of(*case: str) -> Callable[[], Any]:
    run, starts = ensemble(*case)
    jax.block_until_ready(starts)
    return lambda: run(starts)


def rows() -> Iterator[list[str]]:
    """For each method and state the time of a body-step, in both dtypes, and of a first call."""
    keys = [(*case, dtype) for case in CASES for dtype in DTYPES]
    times = in_turn([program(*key) for key in keys], ROUNDS)
    costs = {key: 1e9 * t / (BODIES * steps_of(key[0])) for key, t in zip(keys, times, strict=True)}
    for method, state in CASES:
        own = [costs[method, state, dtype] for dtype in DTYPES]
        whole = [costs[method, measure(state), dtype] for dtype in DTYPES]
        cells = [text for mine, its in zip(own, whole, strict=True) for text in (f"{mine:.3g}", f"{mine / its:.2f}")]
        first = first_call(__file__, method, state, "float64")
        yield [f"`{method}`", re.sub(r"\w+State", r"`\g<0>`", state), *cells, f"{first:.1f}"]


def is_short(row: list[str]) -> bool:
    """Of the page: what two methods take in float64 with the other states."""
    return row[0] in ("`JACOBI[EA]`", "`SYMMETRIC[EA]`") and not row[1].startswith("`RigidState`")


OVER = "relative to `RigidState`"
KINDS = Table(
    *(
        "reports/speed.md",
        "kinds",
        ("method", "state", "float64, ns", OVER, "float32, ns", OVER, "first call, s"),
        rows,
    ),
    *("kinds-of-state", is_short, range(4)),
)
THROW = Table(
    *("reports/speed.md", "throw", thrown_brick.HEADS, thrown_brick.rows),
    *("thrown-brick", lambda row: not row[0].endswith("Euler"), range(4)),
)


if __name__ == "__main__":
    main(__doc__, {"kinds": KINDS, "throw": THROW}, first=call_of)
