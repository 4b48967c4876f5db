"""docs/coming-from/mujoco.md: a top on a ball joint, alone and a thousand times, in MuJoCo and in MJX."""

from collections.abc import Iterator

import numpy as np

from . import columns, tables
from .alone import Outcome, parts, run
from .compare import Row, agree, both, changed, errors, row, times

TITLE = "MuJoCo"
NEEDS = ("mujoco",)
WITHIN = 2e-6  # three times the error of MuJoCo's RK4 at its step of 1 ms
FURTHER = 3e-3  # the last column is MJX, whose own error this is

_NAME, _VALUES = "mujoco", ("times", "attitude")
_FINE = '"JACOBI[SRKN6b]"', '"GBS12"'  # from the method of the page to that of the reference

# The energy in a run of 1000 s with the steps of the page. The moments are those of the right column.
LONG_LEFT = """
moments = np.array([[0.000654, 0.00072, 0.000366]])
mujoco.mj_resetData(model, data)
data.qpos, data.qvel = tilted, spin
poses, spins = [data.qpos.copy()], [data.qvel.copy()]
for _ in range(1000):
    mujoco.mj_step(model, data, nstep=1000)
    poses.append(data.qpos.copy())
    spins.append(data.qvel.copy())
q, w = np.array(poses), np.array(spins)
height = 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2)
energy = np.sum(moments * w * w, axis=-1) / 2 + 0.3 * 9.81 * 0.04 * height
"""
LONG_RIGHT = """
long = ml.integrate("JACOBI[SRKN6b]", body, torque, start, dt=0.01, steps=100_000, save_every=100)
energy = ml.observe.energy(body, torque, long)
"""
# What a loop in Python pays for each step.
STEP_LEFT = """
for _ in range(200):
    mujoco.mj_step(model, data)
"""
STEP_RIGHT = """
@jax.jit
def step(state):
    return ml.integrate("JACOBI[SRKN6b]", body, torque, state, dt=0.001, steps=1, save_every=None).states

state = start
for _ in range(200):
    state = step(state)
attitude = state.attitude
"""


def rows() -> Iterator[Row]:
    # The other programs go on from those of the page, whose run they do not need.
    left, right = (parts(code)[0] for code in columns(_NAME))
    yield from _alone()
    yield from _together(left, right)
    yield from _at_length(left, right)


def _alone() -> Iterator[Row]:
    theirs, ours = both(_NAME, later=5)
    exact = run(changed(columns(_NAME)[1], _FINE), _VALUES)
    yield from times(theirs, ours)
    yield errors("its error, rad", (theirs, ours), exact)


def _together(left: str, right: str) -> Iterator[Row]:
    """By `rollout` and by MJX."""
    _, *later = tables(_NAME)
    thousand, mapped = ((left + theirs, right + ours) for theirs, ours in later)
    exact = run(changed(thousand[1], _FINE), _VALUES)
    theirs, ours = run(thousand[0], _VALUES), run(thousand[1], _VALUES, 3)
    agree(_NAME, theirs, ours)
    yield row("1000 bodies", theirs.first, ours.later)  # a first run of MuJoCo is as any other
    yield row("their first call, with compiling", theirs.first, ours.first)
    yield errors("their error, rad", (theirs, ours), exact)

    spins = later[0][1].partition("\n\n")[0] + "\n\n"
    theirs, ours = run(mapped[0], _VALUES, 1), run(right + spins + later[1][1], _VALUES, 3)
    yield row("1000 bodies by `vmap`: MJX", theirs.later, ours.later)
    yield row("their first call, with compiling: MJX", theirs.first, ours.first)
    times = exact.values["times"]
    assert np.allclose(theirs.values["times"][0], times)
    yield errors("their error, rad: MJX", (theirs, ours), exact)


def _at_length(left: str, right: str) -> Iterator[Row]:
    """A long run, and many short ones."""
    theirs, ours = run(left + LONG_LEFT, ("energy",)), run(right + LONG_RIGHT, ("energy",), 1)
    yield row("change of the energy in 1000 s, relative", *(_drift(o) for o in (theirs, ours)), form=".1e")
    yield row("the time of these 1000 s", theirs.first, ours.later)
    theirs, ours = run(left + STEP_LEFT, ("tilted",), 3), run(right + STEP_RIGHT, ("attitude",), 3)
    yield row("one step, called from Python", theirs.later / 200, ours.later / 200)


def _drift(outcome: Outcome) -> float:
    energy = outcome.values["energy"]
    return float(abs(energy - energy[0]).max() / abs(energy[0]))
