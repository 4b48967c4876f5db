"""MuJoCo: a body on a ball joint, with gravity on its centre of mass, and MuJoCo's own loop over steps in C.

Body and joint frame are the body frame of this package, so qvel is the angular velocity in the body frame and qpos the
attitude. Gravity is MuJoCo's only torque without a callback in Python; a satellite, which would need a callback, is
left out.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from midlie_jax.cli.scenes import Scene
from midlie_jax.model import torques
from midlie_jax.model.states import RigidState

from .problem import Point, Problem, program

_LEVER = 1e-4  # from the pivot to the centre of mass, with mass 1: so moments about both points differ by only 1e-8
_BODIES = 4  # bodies timed
_LONGEST = 0.5  # seconds of a run of these bodies after which no smaller step is taken


def model(scene: Scene, integrator: str) -> Any:
    """MuJoCo's model of the body."""
    mujoco = program("mujoco")

    weight = 0.0 if scene.torque is None else float(scene.torque.mgl)  # pyright: ignore
    mj_model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option integrator="{integrator}" gravity="0 0 {-weight / _LEVER!r}">
        <flag contact="disable" energy="disable"/></option>
        <worldbody><body><joint type="ball" damping="0" armature="0"/>
        <inertial pos="0 0 {_LEVER!r}" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    # The XML parser would refuse a flat body, whose largest moment is the sum of the others only up to rounding. So the
    # moments are set in the compiled model.
    mj_model.body_inertia[1] = np.asarray(scene.body.moments) - _LEVER**2 * np.array([1.0, 1.0, 0.0])
    mujoco.mj_setConst(mj_model, mujoco.MjData(mj_model))
    return mj_model


def measure(problem: Problem, integrator: str, name: str, evaluations: int) -> Iterator[Point]:
    """Points of an integrator of MuJoCo; none for a torque that MuJoCo does not have."""
    mujoco = program("mujoco")
    rollout = program("mujoco.rollout")

    scene = problem.scene
    if not isinstance(problem.starts, RigidState) or not isinstance(scene.torque, torques.HeavyTop | None):
        return
    mj_model = model(scene, integrator)
    moments = np.asarray(scene.body.moments)
    momenta, attitudes = problem.states[:_BODIES, :3], problem.states[:_BODIES, 3:]
    starts = np.concatenate([np.zeros((_BODIES, 1)), attitudes, momenta / moments], axis=1)
    if mujoco.mj_stateSize(mj_model, mujoco.mjtState.mjSTATE_FULLPHYSICS) != starts.shape[1]:
        raise RuntimeError(
            "this version of MuJoCo has a state other than time, position and velocity; change how `starts` is built."
        )
    steps = max(1, scene.steps // 8)
    data = mujoco.MjData(mj_model)
    # MuJoCo writes warnings to a file in the user's folder. Warnings about coarse steps are expected, so they are off.
    mujoco.set_mju_user_warning(lambda text: None)
    with rollout.Rollout(nthread=0) as loop:
        while True:
            mj_model.opt.timestep = scene.duration / steps

            def run(steps: int = steps) -> np.ndarray:
                states, _ = loop.rollout(mj_model, data, starts, nstep=steps, skip_checks=False)
                ends = np.asarray(states)[:, -1]
                return np.concatenate([moments * ends[:, 5:], ends[:, 1:5]], axis=1)

            ends, timing = problem.timed(run)
            setting = f"step {mj_model.opt.timestep:.2e}"
            yield from problem.point(name, setting, ends, timing, steps, evaluations * steps, _BODIES)
            if timing.seconds > _LONGEST:
                break
            steps *= 2
    mujoco.set_mju_user_warning(None)
