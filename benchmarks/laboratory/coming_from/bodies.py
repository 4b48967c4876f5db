"""The rows of docs/coming-from/mujoco.md (a top, alone and a thousand times) and molecular-dynamics.md (a cluster)."""

from collections.abc import Iterator

import numpy as np

from .alone import Outcome, parts, run
from .compare import PAGES, Page, Row, agree, both, changed, columns, errors, row, tables, times

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


def _mujoco() -> Iterator[Row]:
    # The other programs continue those of the page, whose run they do not need.
    left, right = (parts(code)[0] for code in columns("mujoco"))
    yield from _alone()
    yield from _together(left, right)
    yield from _at_length(left, right)


def _alone() -> Iterator[Row]:
    theirs, ours = both("mujoco", later=5)
    exact = run(changed(columns("mujoco")[1], _FINE))
    yield from times(theirs, ours)
    yield errors("its error, rad", (theirs, ours), exact)


def _together(left: str, right: str) -> Iterator[Row]:
    """By `rollout` and by MJX."""
    _, *later = tables("mujoco")
    thousand, mapped = ((left + theirs, right + ours) for theirs, ours in later)
    exact = run(changed(thousand[1], _FINE))
    theirs, ours = run(thousand[0]), run(thousand[1], later=3)
    agree("mujoco", theirs, ours)
    yield row("1000 bodies", theirs.first, ours.later)  # a first run of MuJoCo is as any other
    yield row("their first call, with compiling", theirs.first, ours.first)
    yield errors("their error, rad", (theirs, ours), exact)

    spins = later[0][1].partition("\n\n")[0] + "\n\n"
    theirs, ours = run(mapped[0], later=1), run(right + spins + later[1][1], later=3)
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


_PROGRAMS = ("jax-md", "LAMMPS")  # the left columns
_SITES = ("times", "sites")

_OWN = """
one, two = jnp.triu_indices(N, 1)
def force(body, **_):
    s = rigid_body.union_to_points(body, shape)[0].reshape(N, 3, 3)
    d = s[one][:, :, None] - s[two][:, None]
    sixth = jnp.sum(d * d, axis=-1) ** -3
    return 4 * jnp.sum(sixth * sixth - sixth)
"""
_PAIRS = "force = rigid_body.point_energy(pairs, shape)\n"
_REPLICAS = "shifts = 0.05 * jax.random.normal(jax.random.key(1), (100, N, 3))\n"
_THEIR_REPLICAS = f"""
{_REPLICAS}
def begun(shift):
    moved = rigid_body.RigidBody(corners + shift, bodies.orientation)
    return init(jax.random.key(0), moved, 0.0, mass=shape.mass())

states, many = jax.vmap(begun)(shifts), jax.jit(jax.vmap(run))

sites = many(states)
"""
_OUR_REPLICAS = f"""
{_REPLICAS}
starts = jax.vmap(lambda shift: ml.CoupledState(rest, q, rest, corners + shift))(shifts)

path = ml.ensemble("JACOBI[EA]", body, force, starts, dt=2.0**-9, steps=1024, save_every=32)
sites = jax.jit(ml.molecules.sites)(path.states, places)
"""


def programs() -> list[tuple[str, str]]:
    """The left and the right program of each table; the right one of LAMMPS continues that of jax-md."""
    left, right = columns("molecular-dynamics")
    lammps, later = tables("molecular-dynamics")[1]
    return [(left, right), (lammps, parts(right)[0] + later)]


def _molecules() -> Iterator[Row]:
    pairs = programs()
    exact = run(changed(pairs[0][1], ("JACOBI[EA]", "GBS12")), _SITES)
    for program, (left, right) in zip(_PROGRAMS, pairs, strict=True):
        theirs, ours = run(left, _SITES), run(right, _SITES, 7)
        agree("molecular-dynamics", theirs, ours)
        # Repeated runs of LAMMPS continue from the last one, so they are timed separately.
        yield row(f"the run above: {program}", run(left, _SITES, 7).later, ours.later)
        yield row(f"its first call, with compiling: {program}", theirs.first, ours.first)
        yield errors(f"its error: {program}", (theirs, ours), exact, "sites")
        if program == "jax-md":
            with_ours = changed(left, (_PAIRS, _OWN))
            own = run(with_ours, _SITES, 7)
            agree("molecular-dynamics", own, ours)
            yield row("the run above: jax-md, with the pair energy of the right", own.later, ours.later)
            theirs, ours = (
                run(parts(code)[0] + more, ("sites",), 2)
                for code, more in ((with_ours, _THEIR_REPLICAS), (right, _OUR_REPLICAS))
            )
            agree("molecular-dynamics", theirs, ours)
            yield row("100 clusters at once: jax-md, with that energy", theirs.later, ours.later)
        left, right = (changed(code, ("n, N = 2, 8", "n, N = 4, 64")) for code in (left, right))
        theirs, ours = (run(code, _SITES, 1).later for code in (left, right))
        yield row(f"64 molecules: {program}", theirs, ours)


# Three times the error of MuJoCo's RK4 at its step of 1 ms; in the last column MJX has the error `further`.
PAGES["mujoco"] = Page("MuJoCo", ("mujoco",), 2e-6, _mujoco, further=3e-3)
# The error of order 2 at this step, relative to the largest coordinate; all programs share it.
PAGES["molecular-dynamics"] = Page(
    "jax-md or LAMMPS", ("jax_md", "lammps"), 1e-3, _molecules, _PROGRAMS, quantities=_SITES
)
