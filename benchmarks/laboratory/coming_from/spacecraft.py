"""The rows of docs/coming-from/spacecraft.md: first those of Basilisk, then those of Orekit (which needs Java 17)."""

import subprocess
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from ..free_body import free_body
from . import tables
from .alone import parts, run
from .compare import Row, both, changed, error, errors, gap, row, times

TITLE, HEADS = "Basilisk or Orekit", ("Basilisk", "Orekit")
NEEDS = "Basilisk", "orekit_jpype"
WITHIN = 1e-6  # radians: the error of Basilisk's RK4 with steps of 1 s
QUANTITIES = ("times", "attitude", "rates")

_CRAFT = 1000
_IN_ONE_SIMULATION = 100
_LONG = 1e8  # seconds
_JAVA = Path(__file__).with_name("TorqueFreeStates.java")

# Basilisk at its best: variable steps between two states, which a task does not cut shorter.
_BEST = """
from Basilisk.simulation import svIntegrators
best = svIntegrators.svIntegratorRKF78(craft)
best.relTol = best.absTol = 1e-11
craft.setIntegrator(best)
"""
# More craft alike in the same simulation.
_MORE = f"""
others = []
for i in range({_IN_ONE_SIMULATION} - 1):
    other = spacecraft.Spacecraft()
    for name in ("mHub", "IHubPntBc_B", "r_CN_NInit", "v_CN_NInit", "sigma_BNInit", "omega_BN_BInit"):
        setattr(other.hub, name, getattr(craft.hub, name))
    gravity.addBodiesTo(other)
    pull = GravityGradientEffector.GravityGradientEffector()
    pull.addPlanetName(earth.planetName)
    other.addDynamicEffector(pull)
    steps = svIntegrators.svIntegratorRKF78(other)
    steps.relTol = steps.absTol = 1e-11
    other.setIntegrator(steps)
    others.append((other, pull, steps, other.scStateOutMsg.recorder(ns(100.0))))
    for model in (other, pull, others[-1][3]):
        sim.AddModelToTask("step", model)
"""
_STEPS = "dt=25.0, steps=240, save_every=4"
_FINE = "dt=5.0, steps=1200, save_every=20"
# Craft that spin a little faster, one after the other.
_ENSEMBLE = f"""
faster = jnp.linspace(1.0, 1.1, {_CRAFT})[:, None]
starts = ml.FreeState(
    faster * start.momentum, *(jnp.stack([x] * {_CRAFT}) for x in (start.attitude, start.linear, start.position))
)

path = ml.ensemble("JACOBI[SRKN14a]", craft, gravity, starts, {_STEPS})
attitude = path.states.attitude[0]
"""
_FREE_CRAFT = f"""
faster = jnp.linspace(1.0, 1.1, {_CRAFT})[:, None]
starts = ml.RigidState(faster * start.momentum, jnp.stack([turn] * {_CRAFT}))
states = jax.jit(jax.vmap(lambda one: ml.free_motion(body, one, times).states))

attitude = states(starts).attitude[0]
"""
_STATES = 20_000  # of one craft
_FREE_STATES = f"""
times = jnp.linspace(0.0, 6000.0, {_STATES})

attitude = ml.free_motion(body, start, times).states.attitude
"""


def rows() -> Iterator[Row]:
    basilisk, orekit = tables("spacecraft")
    yield from _basilisk(*basilisk)
    yield from _orekit(*orekit)


def _basilisk(left: str, right: str) -> Iterator[Row]:
    theirs, ours = both("spacecraft", later=5)
    fine = run(changed(right, (_STEPS, _FINE)), QUANTITIES)
    yield from times(theirs, ours, "Basilisk, the run above")
    yield errors("its largest error, rad", (theirs, ours), fine, form=".0e")
    start = "\nsim.InitializeSimulation"
    best = changed(left, ("ns(1.0)", "ns(100.0)"), ("\nlog =", _BEST + "\nlog ="))
    one = run(best, QUANTITIES, later=5)
    many = run(changed(best, (start, _MORE + start)), QUANTITIES, later=1)
    thousand = run(parts(right)[0] + _ENSEMBLE, ("attitude",), later=5)
    theirs_off, *ours_off = (error(found, fine) for found in (one, ours, thousand))
    if max(ours_off) > theirs_off:
        raise RuntimeError(f"The error is {ours_off}, that of Basilisk {theirs_off:.1e}.")
    yield row("Basilisk at its best: one craft", one.later, ours.later)
    yield row("each of many craft", many.later / _IN_ONE_SIMULATION, thousand.later / _CRAFT)
    yield row("their largest error, rad", theirs_off, ours_off[0], ".0e")


def _orekit(left: str, right: str) -> Iterator[Row]:
    theirs, ours = both("spacecraft", later=20, codes=(left, right))
    yield from times(theirs, ours, "Orekit, the run above, through Python")
    states = ours.values["times"].size
    thousand = run(right + _FREE_CRAFT, ("attitude",), later=10)
    table = run(right + _FREE_STATES, ("attitude",), later=20)
    here = thousand.later / (_CRAFT * states), table.later / _STATES
    yield row(f"Orekit in Java: {_CRAFT} craft, {states} states of each, a state", _java(100, states), here[0])
    yield row(f"Orekit in Java: one craft, {_STATES} states, a state", _java(1, _STATES), here[1])
    for end in ("6000.0", f"{_LONG:.0f}.0"):
        found = [run(changed(code, ("6000.0", end)), QUANTITIES).values for code in (left, right)]
        _, exact = free_body([80.0, 100.0, 120.0], [0.08, -1.0, 3.6], [0.8, 0.36, -0.48, 0.0], found[0]["times"])
        theirs_off, ours_off = (gap("attitude", values["attitude"], exact) for values in found)
        yield row(f"largest error of the free motion within {float(end):.0e} s, rad", theirs_off, ours_off, ".0e")


def _java(craft: int, states: int) -> float:
    """Seconds of a state in Java itself, when its compiler has done its work."""
    spec = find_spec("orekit_jpype")
    if spec is None or spec.origin is None:
        raise RuntimeError("orekit_jpype is not installed.")
    jars = Path(spec.origin).parent / "jars" / "*"
    command = ["java", "-XX:+UseSerialGC", "-cp", str(jars), str(_JAVA), str(craft), str(states)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return 1e-9 * float(done.stdout.split()[0])
