"""What a body-step costs with each kind of state, and beside MuJoCo and MJX: docs/reports/speed.md.

    python benchmarks/kinds_of_state.py [--write]

Ratios of processor times on one core, medians of rounds in which all programs take turns; 4096 bodies through
`ml.ensemble`. First calls are measured in processes of their own. `--write` puts the tables into the page.
"""

import argparse
import re
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
from pages import publish, shown  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax._xla.compiler import compiler_options  # noqa: E402

PAGE = "reports/speed.md"
BEGIN, END = "<!-- kinds -->", "<!-- /kinds -->"
THROW_BEGIN, THROW_END = "<!-- throw -->", "<!-- /throw -->"
BODIES, DT, ROUNDS = 4096, 0.005, 9
STEPS = {"EA": 800, "SRKN6b": 160, "SRKN14a": 80, "GBS12": 80, "DOP853": 160}  # by scheme or method
PULL = ml.torques.UniformGravity([0.0, 0.0, -9.81])
DTYPES = ("float64", "float32")
HEADS = (
    "method",
    "state",
    "float64, ns",
    "relative to `RigidState`",
    "float32, ns",
    "relative to `RigidState`",
    "first call, s",
)


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
    return ml.Rotor(body.moments[0]), torque, ml.AxisState.of(starts)


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
        whole = [costs[method, measure(state), dtype] for dtype in DTYPES]
        cells = [text for mine, its in zip(own, whole, strict=True) for text in (f"{mine:.3g}", f"{mine / its:.2f}")]
        yield [
            f"`{method}`",
            re.sub(r"\w+State", r"`\g<0>`", state),
            *cells,
            f"{first_call.seconds(__file__, method, state, 'float64'):.1f}",
        ]


def write(states: list[str]) -> None:
    """Puts the whole table into its data file, and what two methods take in float64 into the page."""
    key = ("`JACOBI[EA]`", "`SYMMETRIC[EA]`")
    chosen = lambda row: row[0] in key and not row[1].startswith("`RigidState`")  # noqa: E731
    publish("reports/speed.md", BEGIN, END, states, "kinds-of-state", chosen, range(4))


def write_throw(lines: list[str]) -> None:
    """Puts the whole table of the thrown brick into its data file, and all but the Euler methods into the page."""
    marks = THROW_BEGIN, THROW_END
    publish("reports/speed.md", *marks, lines, "thrown-brick", lambda row: not row[0].endswith("Euler"), range(4))


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
        write(states)
        write_throw(throw)


if __name__ == "__main__":
    main()
