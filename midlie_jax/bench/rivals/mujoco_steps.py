"""MuJoCo: a ball joint with the body's inertia, its weight by gravity on the centre of mass; its own C loop over steps.

Body and joint frames are ours, so qvel is the angular velocity in the body frame and qpos the attitude. Gravity is the
one torque of MuJoCo that needs no callback in Python; a satellite, whose torque would, is left out.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...model import torques
from ..scenes import Scene
from .problem import Point, Problem, program

_LEVER = 1e-4  # from the pivot to a centre of mass of mass 1: the pivot's moments are then the body's to 1e-8
_BODIES = 4
_LONGEST = 0.5  # seconds for these bodies


def model(scene: Scene, integrator: str) -> Any:
    """The body as MuJoCo's model."""
    mujoco = program("mujoco")

    weight = 0.0 if scene.torque is None else float(scene.torque.weight)  # pyright: ignore
    made = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option integrator="{integrator}" gravity="0 0 {-weight / _LEVER!r}">
        <flag contact="disable" energy="disable"/></option>
        <worldbody><body><joint type="ball" damping="0" armature="0"/>
        <inertial pos="0 0 {_LEVER!r}" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    # Set here, where a flat body, whose moments sum to equality, is not refused for the rounding.
    made.body_inertia[1] = np.asarray(scene.body.moments) - _LEVER**2 * np.array([1.0, 1.0, 0.0])
    mujoco.mj_setConst(made, mujoco.MjData(made))
    return made


def _measure(problem: Problem, integrator: str, name: str, evaluations: int) -> Iterator[Point]:
    mujoco = program("mujoco")
    rollout = program("mujoco.rollout")

    scene = problem.scene
    if scene.torque is not None and not isinstance(scene.torque, torques.HeavyTop):
        return
    made = model(scene, integrator)
    moments = np.asarray(scene.body.moments)
    starts = np.concatenate(
        [np.zeros((_BODIES, 1)), problem.attitude[:_BODIES], problem.momentum[:_BODIES] / moments], axis=1
    )
    if mujoco.mj_stateSize(made, mujoco.mjtState.mjSTATE_FULLPHYSICS) != starts.shape[1]:
        raise RuntimeError("MuJoCo's state is not time, position and velocity; this needs another way to start it.")
    steps = max(1, scene.steps // 8)
    data = mujoco.MjData(made)
    # A step too coarse for it is no news, and would be written to a file in the user's folder.
    mujoco.set_mju_user_warning(lambda text: None)
    with rollout.Rollout(nthread=0) as loop:
        while True:
            made.opt.timestep = scene.duration / steps

            def run(steps: int = steps) -> np.ndarray:
                states, _ = loop.rollout(made, data, starts, nstep=steps, skip_checks=False)
                return np.asarray(states)[:, -1, 1:5]

            ends, timing = problem.timed(run)
            if np.all(np.isfinite(ends)):
                yield Point(
                    name,
                    f"step {made.opt.timestep:.2e}",
                    problem.error(ends),
                    timing.seconds / _BODIES,
                    float("nan") if scene.torque is None else evaluations * steps,
                    steps,
                    timing.spread,
                )
            if timing.seconds > _LONGEST:
                break
            steps *= 2
    mujoco.set_mju_user_warning(None)


def rk4(problem: Problem) -> Iterator[Point]:
    """MuJoCo's Runge-Kutta of order 4; no point where it cannot pose the torque."""
    return _measure(problem, "RK4", "MuJoCo RK4", 4)


def implicitfast(problem: Problem) -> Iterator[Point]:
    """MuJoCo's semi-implicit Euler."""
    return _measure(problem, "implicitfast", "MuJoCo implicitfast", 1)
