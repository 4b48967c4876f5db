"""What a body-step costs with each kind of state, and beside MuJoCo and MJX: docs/reports/speed.md.

    python benchmarks/kinds_of_state.py [kinds] [throw] [--write]

Ratios of processor times on one core, medians of rounds in which all programs take turns; 4096 bodies through
`ml.ensemble`. `--write` puts the tables into the page.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, compiled, in_turn, main
from laboratory.rivals import matrices, perturbed, program, scene

import midlie_jax as ml
from midlie_jax._xla.compiler import vector_width_options
from midlie_jax.advice.timing import timed_in_turn
from midlie_jax.cli.scenes import scene as package_scene

BODIES, DT, ROUNDS = 4096, 0.005, 9
STEPS = {"EA": 800, "SRKN6b": 160, "SRKN14a": 80, "GBS12": 80, "DOP853": 160}  # by scheme or method
PULL = ml.torques.UniformGravity([0.0, 0.0, -9.81])
DTYPES = ("float64", "float32")


def rigid(name: str) -> tuple[Any, Any, Any]:
    found = scene(name)
    return found.body, found.torque, perturbed(found.start, BODIES, 1e-3)


def thrown() -> tuple[Any, ...]:
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
    body, torque, starts = rigid("asymmetric-top")
    return body, torque, ml.CompensatedState(starts.momentum, starts.attitude)


def free(attitude: bool) -> tuple[Any, Any, Any]:
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
    return "RigidState" + state.partition("State")[2]


def cast(tree: Any, dtype: str) -> Any:
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, tree)


def steps_of(method: str) -> int:
    return STEPS[method.removesuffix("]").rpartition("[")[2]]


def ensemble(method: str, state: str, dtype: str) -> tuple[Callable[[Any], Any], Any]:
    """A run as a function of the starts, and the starts."""
    body, torque, starts = cast(SYSTEMS[method.partition("[")[0]][state](), dtype)
    return lambda start: ml.ensemble(method, body, torque, start, dt=DT, steps=steps_of(method)), starts


def timed_run(*case: str) -> Callable[[], Any]:
    """A run as a compiled program, without the checks of each call."""
    run, starts = ensemble(*case)
    call = compiled(run, starts, bodies=BODIES)
    if not bool(jnp.all(call().ok)):
        raise RuntimeError(f"{' '.join(case)} failed; take a shorter step.")
    return call


def rows() -> Iterator[list[str]]:
    keys = [(*case, dtype) for case in CASES for dtype in DTYPES]
    times = in_turn([timed_run(*key) for key in keys], ROUNDS)
    costs = {key: 1e9 * t / (BODIES * steps_of(key[0])) for key, t in zip(keys, times, strict=True)}
    for method, state in CASES:
        own = [costs[method, state, dtype] for dtype in DTYPES]
        whole = [costs[method, measure(state), dtype] for dtype in DTYPES]
        cells = [text for mine, its in zip(own, whole, strict=True) for text in (f"{mine:.3g}", f"{mine / its:.2f}")]
        yield [f"`{method}`", re.sub(r"\w+State", r"`\g<0>`", state), *cells]


def is_short(row: list[str]) -> bool:
    return row[0] in ("`JACOBI[EA]`", "`SYMMETRIC[EA]`") and not row[1].startswith("`RigidState`")


OVER = "relative to `RigidState`"
# ---- a thrown brick, in uniform gravity and turning freely, by MuJoCo, MJX and this package at equal steps ----
#
# Errors are those at the end against the closed forms: `ml.free_motion` for the rotation, the parabola for the centre.
# MuJoCo runs its own loop in C (`rollout`), MJX one compiled loop over the batch with every feature off that the brick
# does not use. Its free joint has the velocity of the centre in space and the angular velocity in the body frame.

BRICKS, BRICK_STEPS, BRICK_DT = 1024, 200, 0.01
MASS, GRAVITY = 0.155404754, 32.174  # slug and ft/s^2, as the moments of the scene `tumbling-brick`
VELOCITY, SPIN = (5.0, 1.0, 30.0), (2.0, 9.0, 4.0)  # ft/s, and rad/s in the body frame
THROW_HEADS = (
    *("program", "time per body-step, relative to midlie_jax"),
    *("error of attitude, rad", "error of position, ft", "drift of energy"),
)


class Ends(NamedTuple):
    """Positions (n, 3), attitudes (n, 4), velocities in space (n, 3), and angular velocities in the body (n, 3)."""

    position: np.ndarray
    attitude: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


Run = tuple[Callable[[], Any], Callable[[Any], Ends]]  # the timed run, and what makes the ends of its result


def starts() -> tuple[Any, Any]:
    body = package_scene("tumbling-brick", "float64").body
    linear = jnp.array(VELOCITY) * MASS
    one = ml.FreeState(body.moments * jnp.array(SPIN), [1.0, 0.0, 0.0, 0.0], linear, [0.0, 0.0, 6.0])
    return ml.FreeBody(body, MASS), perturbed(one, BRICKS, 1e-2)


def closed_forms(body: Any, start: Any) -> Ends:
    time = BRICK_STEPS * BRICK_DT
    turning = jax.vmap(lambda s: ml.free_motion(body.body, s, jnp.array([time])).states)(start.turning)
    velocity, gravity = start.linear / MASS, jnp.array([0.0, 0.0, -GRAVITY])
    position = start.position + time * velocity + time**2 / 2 * gravity
    spin = turning.momentum[:, 0] / body.body.moments
    return Ends(*map(np.asarray, (position, turning.attitude[:, 0], velocity + time * gravity, spin)))


def energy(body: Any, ends: Ends) -> np.ndarray:
    """Kinetic and potential energy of each body, (n,)."""
    turning = np.sum(np.asarray(body.body.moments) * ends.spin**2, axis=1) / 2
    return turning + MASS * (np.sum(ends.velocity**2, axis=1) / 2 + GRAVITY * ends.position[:, 2])


def brick_ours(body: Any, start: Any, name: str = "JACOBI[EA]") -> Run:
    """`ml.ensemble` in uniform gravity."""
    gravity = ml.torques.UniformGravity([0.0, 0.0, -GRAVITY])

    def run(start: Any) -> Any:
        return ml.ensemble(name, body, gravity, start, dt=BRICK_DT, steps=BRICK_STEPS).states

    def ends(state: Any) -> Ends:
        spin = state.momentum / body.body.moments
        return Ends(*map(np.asarray, (state.position, state.attitude, state.linear / MASS, spin)))

    return compiled(run, start, bodies=BRICKS), ends


def model(body: Any, integrator: str, mass: float = MASS, gravity: float = GRAVITY, dt: float = BRICK_DT) -> Any:
    """MuJoCo's model of the brick, or of another body: a free joint, and everything else off."""
    mujoco = program("mujoco")
    flags = ("contact", "constraint", "equality", "limit", "spring", "damper", "sensor", "actuation", "warmstart")
    off = " ".join(f'{flag}="disable"' for flag in flags)
    made = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option integrator="{integrator}" timestep="{dt!r}" gravity="0 0 {-gravity!r}">
        <flag {off}/></option>
        <worldbody><body><freejoint/><inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/></body></worldbody>
        </mujoco>"""
    )
    made.body_inertia[1] = np.asarray(body.body.moments)
    mujoco.mj_setConst(made, mujoco.MjData(made))
    return made


def joint(body: Any, start: Any) -> tuple[np.ndarray, np.ndarray]:
    """qpos (n, 7) and qvel (n, 6) of the starts."""
    spin = start.momentum / body.body.moments
    return np.hstack([start.position, start.attitude]), np.hstack([start.linear / MASS, spin])


def of_joint(positions: Any, velocities: Any) -> Ends:
    q, v = np.asarray(positions), np.asarray(velocities)
    return Ends(q[:, :3], q[:, 3:], v[:, :3], v[:, 3:])


def by_mujoco(body: Any, start: Any, integrator: str) -> Run:
    mujoco, rollout = program("mujoco"), program("mujoco.rollout")
    made, loop = model(body, integrator), rollout.Rollout(nthread=0)
    data, first = mujoco.MjData(made), np.hstack([np.zeros((BRICKS, 1)), *joint(body, start)])

    def run() -> Any:
        return loop.rollout(made, data, first, nstep=BRICK_STEPS, skip_checks=False)[0]

    return run, lambda states: of_joint(states[:, -1, 1:8], states[:, -1, 8:14])


def by_mjx(body: Any, start: Any, integrator: str) -> Run:
    mjx = program("mujoco.mjx")
    made = mjx.put_model(model(body, integrator))
    data = mjx.make_data(made)

    def moved(position: Any, velocity: Any) -> Any:
        first = data.replace(qpos=position, qvel=velocity)
        last = jax.lax.fori_loop(0, BRICK_STEPS, lambda _, d: mjx.step(made, d), first)
        return last.qpos, last.qvel

    given = tuple(map(jnp.asarray, joint(body, start)))
    run = compiled(jax.vmap(moved), *given, options=vector_width_options())
    return run, lambda found: of_joint(*found)


def runs(body: Any, start: Any) -> dict[str, Run]:
    found = {"`JACOBI[EA]`, `FreeState`": brick_ours(body, start)}
    for integrator in ("RK4", "implicitfast", "Euler"):
        found[f"MuJoCo, {integrator}"] = by_mujoco(body, start, integrator)
        found[f"MJX, {integrator}"] = by_mjx(body, start, integrator)
    return found


def throw_rows(rounds: int = 5) -> Iterator[list[str]]:
    """The table: each program by ours, and its errors."""
    body, start = starts()
    exact, programs = closed_forms(body, start), runs(body, start)
    before = energy(body, exact)  # which is that at the start
    found = timed_in_turn([run for run, _ in programs.values()], least=rounds, most=rounds)
    for (name, (_, ends_of)), (result, timing) in zip(programs.items(), found, strict=True):
        ends, first = ends_of(result), found[0][1].seconds
        chord = np.linalg.norm(matrices(ends.attitude) - matrices(exact.attitude), axis=(1, 2)) / np.sqrt(8)
        angle, away = 2 * np.arcsin(np.minimum(chord, 1.0)), np.linalg.norm(ends.position - exact.position, axis=1)
        drift = (energy(body, ends) - before) / before
        errors = (float(np.sqrt(np.mean(x**2))) for x in (angle, away, drift))
        yield [name, f"{timing.seconds / first:.3g}", *(f"{error:.1e}" for error in errors)]


KINDS = Table(
    *(
        "reports/speed.md",
        "kinds",
        ("method", "state", "float64, ns", OVER, "float32, ns", OVER),
        rows,
    ),
    *("kinds-of-state", is_short, range(4)),
)
THROW = Table(
    *("reports/speed.md", "throw", THROW_HEADS, throw_rows),
    *("thrown-brick", lambda row: not row[0].endswith("Euler"), range(4)),
)


if __name__ == "__main__":
    main(__doc__, {"kinds": KINDS, "throw": THROW})
