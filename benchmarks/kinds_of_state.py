"""What a body-step costs with each kind of state, and beside MuJoCo and MJX: docs/reports/kinds-of-state.md.

    python benchmarks/kinds_of_state.py [--write]

Ratios of processor times on one core, medians of rounds in which all programs take turns; 4096 bodies through
`ml.ensemble`. First calls are measured in processes of their own. `--write` puts the tables into the page.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from midlie_jax.advice.timing import pin, timed_in_turn

pin()  # before XLA counts the cores

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_enable_x64", True)

import first_call  # noqa: E402
from laboratory import scenes, thrown_brick  # noqa: E402
from pages import put, shown  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax._xla.compiler import compiler_options  # noqa: E402

PAGE = "reports/kinds-of-state.md"
BEGIN, END = "<!-- kinds -->", "<!-- /kinds -->"
THROW_BEGIN, THROW_END = "<!-- throw -->", "<!-- /throw -->"
BODIES, DT, ROUNDS = 4096, 0.005, 9
STEPS = {"EA": 800, "SRKN6b": 160, "SRKN14a": 80, "GBS12": 80, "DOP853": 160}  # by scheme or method
DTYPES = ("float64", "float32")
HEADS = ("method", "state", "float64, ns", "by `RigidState`", "float32, ns", "by `RigidState`", "first call, s")


def rigid(name: str) -> tuple[Any, Any, Any]:
    """Body, torque and perturbed starts of a scene."""
    scene = scenes.scene(name)
    return scene.body, scene.torque, scenes.perturbed(scene.start, BODIES, 1e-3)


def travelling() -> tuple[Any, Any, Any]:
    """The asymmetric top, also thrown, in uniform gravity."""
    body, torque, starts = rigid("asymmetric-top")
    linear, position = (jnp.broadcast_to(jnp.array(x), (BODIES, 3)) for x in ([1.0, 0.0, 2.0], [0.0, 0.0, 1.0]))
    start = ml.FreeState(starts.momentum, starts.attitude, linear, position)
    return ml.FreeBody(body, 3.0), torque + ml.torques.UniformGravity([0.0, 0.0, -9.81]), start


def axis() -> tuple[Any, Any, Any]:
    """The axis of the fast top P1, tilted."""
    body, torque, starts = rigid("P1-tilted")
    return ml.Rotor(body.moments[0]), torque, ml.AxisState.of(starts)


def direction() -> tuple[Any, Any, Any]:
    """The asymmetric top, of whose attitude only the vertical is kept."""
    body, torque, starts = rigid("asymmetric-top")
    return body, torque, ml.DirectionState(starts.momentum, ml.so3.to_matrix(starts.attitude)[:, 2])


# By flight or method the states that are compared with `RigidState`: what makes body, torque and starts.
SYSTEMS: dict[str, dict[str, Callable[[], tuple[Any, Any, Any]]]] = {
    "JACOBI": {
        "RigidState": partial(rigid, "asymmetric-top"),
        "DirectionState": direction,
        "FreeState": travelling,
    },
    "SYMMETRIC": {"RigidState": partial(rigid, "P1-tilted"), "AxisState": axis},
    **{
        name: {"RigidState": partial(rigid, "asymmetric-top"), "DirectionState": direction}
        for name in ("GBS12", "DOP853")
    },
}
METHODS = [f"{flight}[{scheme}]" for flight in ("JACOBI", "SYMMETRIC") for scheme in ("EA", "SRKN6b", "SRKN14a")]
CASES = [(name, state) for name in (*METHODS, "GBS12", "DOP853") for state in SYSTEMS[name.partition("[")[0]]]


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


def compiled(*case: str) -> Callable[[], Any]:
    """A run as a compiled program, without the checks of each call."""
    run, starts = ensemble(*case)
    program = jax.jit(run, compiler_options=compiler_options(BODIES)).lower(starts).compile()
    if not bool(jnp.all(program(starts).ok)):
        raise RuntimeError(f"{' '.join(case)} failed; take a shorter step.")
    return lambda: jax.block_until_ready(program(starts))


def print_first_call(*case: str) -> None:
    run, starts = ensemble(*case)
    jax.block_until_ready(starts)
    first_call.report(lambda: run(starts))


def rows() -> Iterator[list[str]]:
    """For each method and state the time of a body-step, in both dtypes, and of a first call."""
    keys = [(*case, dtype) for case in CASES for dtype in DTYPES]
    timings = timed_in_turn([compiled(*key) for key in keys], least=ROUNDS, most=ROUNDS)
    costs = {key: 1e9 * t.seconds / (BODIES * steps_of(key[0])) for key, (_, t) in zip(keys, timings, strict=True)}
    for method, state in CASES:
        own = [costs[method, state, dtype] for dtype in DTYPES]
        whole = [costs[method, "RigidState", dtype] for dtype in DTYPES]
        cells = [text for mine, its in zip(own, whole, strict=True) for text in (f"{mine:.3g}", f"{mine / its:.2f}")]
        yield [
            f"`{method}`",
            f"`{state}`",
            *cells,
            f"{first_call.seconds(__file__, method, state, 'float64'):.1f}",
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"put the tables into docs/{PAGE}")
    parser.add_argument("--first", nargs=3, metavar="PART", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.first:
        print_first_call(*options.first)
        return
    states, throw = shown(HEADS, rows()), shown(thrown_brick.HEADS, thrown_brick.rows())
    if options.write:
        put("reports/kinds-of-state.md", BEGIN, END, states)
        put("reports/kinds-of-state.md", THROW_BEGIN, THROW_END, throw)


if __name__ == "__main__":
    main()
