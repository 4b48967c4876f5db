"""The rows of docs/coming-from/gubas.md, and of spacecraft.md: Basilisk, then Orekit (which needs Java 17).

The environment variable GUBAS names a folder with GUBAS's scripts, the files of its example, and the program, made by

    g++ -std=c++11 -O3 -march=native -DARMA_NO_DEBUG hou_cpp.cpp -o hou_cpp_final -larmadillo

and, for NumPy 2, with its scripts changed as the page says. Its times are those of one binary; its errors are measured
against a far finer run of this library, with which its own errors fall to 4e-10.
"""

import subprocess
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from ..free_body import free_body
from .alone import Outcome, parts, run
from .compare import PAGES, Page, Row, both, changed, columns, error, errors, gap, row, tables, times

_POSES = ("times", "position", "attitude")

_DAY_STEPS = "dt=600.0, steps=144, save_every=6"
_DAY_FINE = "dt=200.0, steps=432, save_every=18"
# RK 7(8) has its own times, so that only the end is read; then the program alone, without the scripts.
_END = """
subprocess.run([sys.executable, "hou_shell_cfg.py"], check=True)
end = np.fromfile("output_x/x_out.bin").reshape(-1, 30)[-1]
A = end[12:21].reshape(3, 3)
turned = Rotation.from_matrix(np.stack([A, A @ end[21:30].reshape(3, 3)]))
attitude = turned.as_quat(scalar_first=True)

subprocess.run(["./hou_cpp_final"], check=True)
"""
# A thousand binaries that spin a little faster, one after the other.
_MANY = """
faster = jnp.linspace(1.0, 1.1, 1000)[:, None, None]
starts = ml.CoupledState(
    faster * start.momentum, *(jnp.stack([x] * 1000) for x in (start.attitude, start.linear, start.position))
)

path = ml.ensemble("JACOBI[SRKN14a]", pair, gravity, starts, dt=86400.0 / STEPS, steps=STEPS)
attitude = path.states.attitude[0]
"""
COUNT = 1000


class _Case(NamedTuple):
    """A degree of the gravity, a tolerance of RK 7(8), and steps a day with which our error is not larger."""

    degree: int
    tolerance: float
    steps: int


_CASES = _Case(2, 1e-10, 54), _Case(4, 1e-10, 54)


def _gubas() -> Iterator[Row]:
    left, right = columns("gubas")
    theirs, ours = both("gubas", later=3)
    yield from times(theirs, ours)
    fine = run(changed(right, (_DAY_STEPS, _DAY_FINE)), _POSES)
    yield errors("largest error of the attitudes, rad", (theirs, ours), fine, form=".0e")
    for case in _CASES:
        yield from _at_equal_error(left, right, case)


def _at_equal_error(left: str, right: str, case: _Case) -> Iterator[Row]:
    right = changed(right, ("degree=2", f"degree={case.degree}"))
    fine = _end(run(changed(right, (_DAY_STEPS, _DAY_FINE)), _POSES))
    theirs = run(_runge_kutta(left, case), ("attitude",), later=3)
    steps = f"dt={86400.0 / case.steps}, steps={case.steps}, save_every={case.steps}"
    ours = run(changed(right, (_DAY_STEPS, steps)), _POSES, later=20)
    many = run(parts(right)[0] + changed(_MANY, ("STEPS", str(case.steps))), ("attitude",), later=3)
    theirs_off, *ours_off = (error(found, fine) for found in (theirs, _end(ours), many))
    if max(ours_off) > theirs_off:
        raise RuntimeError(f"With {case.steps} steps a day the error is {ours_off}, that of GUBAS {theirs_off:.1e}.")
    named = f"degree {case.degree}, RK 7(8) at {case.tolerance:g}"
    yield row(f"{named}: one binary", theirs.later, ours.later)
    yield row(f"{named}: each of {COUNT}", theirs.later, many.later / COUNT)
    yield row(f"{named}: largest error after the day, rad", theirs_off, ours_off[0], ".0e")


def _runge_kutta(left: str, case: _Case) -> str:
    """The left column with RK 7(8) and another degree, without the tables that GUBAS's scripts write."""
    settings = left.partition("\nsubprocess.run")[0]
    changes = (
        ('Truncation Order": 2', f'Truncation Order": {case.degree}'),
        ('"Integrator Flag": 2', f'"Integrator Flag": 3, "Absolute Tolerance": {case.tolerance}'),
        ('"Output Settings": {', '"Output Settings": {"Post Processing": 0,'),
    )
    return changed(settings, *changes) + _END


def _end(found: Outcome) -> Outcome:
    return found._replace(values={"attitude": found.values["attitude"][-1]})


_RATES = ("times", "attitude", "rates")

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


def _spacecraft() -> Iterator[Row]:
    basilisk, orekit = tables("spacecraft")
    yield from _basilisk(*basilisk)
    yield from _orekit(*orekit)


def _basilisk(left: str, right: str) -> Iterator[Row]:
    theirs, ours = both("spacecraft", later=5)
    fine = run(changed(right, (_STEPS, _FINE)), _RATES)
    yield from times(theirs, ours, "Basilisk, the run above")
    yield errors("its largest error, rad", (theirs, ours), fine, form=".0e")
    start = "\nsim.InitializeSimulation"
    best = changed(left, ("ns(1.0)", "ns(100.0)"), ("\nlog =", _BEST + "\nlog ="))
    one = run(best, _RATES, later=5)
    many = run(changed(best, (start, _MORE + start)), _RATES, later=1)
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
        found = [run(changed(code, ("6000.0", end)), _RATES).values for code in (left, right)]
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


# What LGVI with steps of 30 s is off after a day, radians; and the error of Basilisk's RK4 with steps of 1 s.
PAGES["gubas"] = Page("GUBAS", ("GUBAS", "scipy"), 1e-2, _gubas, quantities=_POSES)
_NEEDS = "Basilisk", "orekit_jpype"
PAGES["spacecraft"] = Page("Basilisk or Orekit", _NEEDS, 1e-6, _spacecraft, ("Basilisk", "Orekit"), quantities=_RATES)
