"""A thrown brick, in uniform gravity and turning freely, by MuJoCo, MJX and this package at equal steps.

Errors are those at the end against the closed forms: `ml.free_motion` for the rotation, the parabola for the centre.
MuJoCo runs its own loop in C (`rollout`), MJX one compiled loop over the batch with every feature off that the brick
does not use. Its free joint has the velocity of the centre in space and the angular velocity in the body frame.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import compiled

import midlie_jax as ml
from midlie_jax._xla.compiler import vector_width_options
from midlie_jax.advice.timing import timed_in_turn
from midlie_jax.cli import scenes as package_scenes

from . import scenes
from .kinds import matrices
from .rivals.problem import program

BODIES, STEPS, DT = 1024, 200, 0.01
MASS, GRAVITY = 0.155404754, 32.174  # slug and ft/s^2, as the moments of the scene `tumbling-brick`
VELOCITY, SPIN = (5.0, 1.0, 30.0), (2.0, 9.0, 4.0)  # ft/s, and rad/s in the body frame
HEADS = (
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
    """The body that travels, and the thrown bricks."""
    body = package_scenes.scene("tumbling-brick", "float64").body
    linear = jnp.array(VELOCITY) * MASS
    one = ml.FreeState(body.moments * jnp.array(SPIN), [1.0, 0.0, 0.0, 0.0], linear, [0.0, 0.0, 6.0])
    return ml.FreeBody(body, MASS), scenes.perturbed(one, BODIES, 1e-2)


def closed_forms(body: Any, start: Any) -> Ends:
    """The exact ends."""
    time = STEPS * DT
    turning = jax.vmap(lambda s: ml.free_motion(body.body, s, jnp.array([time])).states)(start.turning)
    velocity, gravity = start.linear / MASS, jnp.array([0.0, 0.0, -GRAVITY])
    position = start.position + time * velocity + time**2 / 2 * gravity
    spin = turning.momentum[:, 0] / body.body.moments
    return Ends(*map(np.asarray, (position, turning.attitude[:, 0], velocity + time * gravity, spin)))


def energy(body: Any, ends: Ends) -> np.ndarray:
    """Kinetic and potential energy of each body, (n,)."""
    turning = np.sum(np.asarray(body.body.moments) * ends.spin**2, axis=1) / 2
    return turning + MASS * (np.sum(ends.velocity**2, axis=1) / 2 + GRAVITY * ends.position[:, 2])


def ours(body: Any, start: Any, name: str = "JACOBI[EA]") -> Run:
    """`ml.ensemble` in uniform gravity."""
    gravity = ml.torques.UniformGravity([0.0, 0.0, -GRAVITY])

    def run(start: Any) -> Any:
        return ml.ensemble(name, body, gravity, start, dt=DT, steps=STEPS).states

    def ends(state: Any) -> Ends:
        spin = state.momentum / body.body.moments
        return Ends(*map(np.asarray, (state.position, state.attitude, state.linear / MASS, spin)))

    return compiled(run, start, bodies=BODIES), ends


def model(body: Any, integrator: str, mass: float = MASS, gravity: float = GRAVITY, dt: float = DT) -> Any:
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
    """The ends of qpos and qvel."""
    q, v = np.asarray(positions), np.asarray(velocities)
    return Ends(q[:, :3], q[:, 3:], v[:, :3], v[:, 3:])


def by_mujoco(body: Any, start: Any, integrator: str) -> Run:
    """MuJoCo's rollout, one body after another in its own loop."""
    mujoco, rollout = program("mujoco"), program("mujoco.rollout")
    made, loop = model(body, integrator), rollout.Rollout(nthread=0)
    data, first = mujoco.MjData(made), np.hstack([np.zeros((BODIES, 1)), *joint(body, start)])

    def run() -> Any:
        return loop.rollout(made, data, first, nstep=STEPS, skip_checks=False)[0]

    return run, lambda states: of_joint(states[:, -1, 1:8], states[:, -1, 8:14])


def by_mjx(body: Any, start: Any, integrator: str) -> Run:
    """MJX, vmapped over the bodies and compiled for the full vectors of the machine."""
    mjx = program("mujoco.mjx")
    made = mjx.put_model(model(body, integrator))
    data = mjx.make_data(made)

    def moved(position: Any, velocity: Any) -> Any:
        first = data.replace(qpos=position, qvel=velocity)
        last = jax.lax.fori_loop(0, STEPS, lambda _, d: mjx.step(made, d), first)
        return last.qpos, last.qvel

    given = tuple(map(jnp.asarray, joint(body, start)))
    run = compiled(jax.vmap(moved), *given, options=vector_width_options())
    return run, lambda found: of_joint(*found)


def runs(body: Any, start: Any) -> dict[str, Run]:
    """All programs by their names, ours first."""
    found = {"`JACOBI[EA]`, `FreeState`": ours(body, start)}
    for integrator in ("RK4", "implicitfast", "Euler"):
        found[f"MuJoCo, {integrator}"] = by_mujoco(body, start, integrator)
        found[f"MJX, {integrator}"] = by_mjx(body, start, integrator)
    return found


def rows(rounds: int = 5) -> Iterator[list[str]]:
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
