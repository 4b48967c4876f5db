"""The pages docs/coming-from/*.md: both columns are run as they stand, compared and measured.

    python benchmarks/coming_from.py NAME [--write]     the measured table of docs/coming-from/NAME.md

Times are processor times on one core, in separate processes. A ratio above 1 favours midlie_jax.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import one_core  # noqa: F401
from alone import Outcome, parts, run
from harness import DOCS, Table, main
from laboratory.free_body import free_body

FOLDER = DOCS / "coming-from"
MARK = "measured"
Row = tuple[str, str, str, str]  # what is measured, the other program, midlie_jax, and the first over the second

_TABLE = re.compile(r"^<table>.*?^</table>$", re.MULTILINE | re.DOTALL)
_BLOCK = re.compile(r"^```(py|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Page(NamedTuple):
    """A page, which shows the same run in another program and in this one.

    The left column `needs` these packages; a name in capitals is an environment variable with the folder of a program.
    The quantities with which both end differ by `within` at most, in the last of several tables by `further`.
    """

    title: str
    needs: tuple[str, ...]
    within: float
    rows: Callable[[], Iterator[Row]]
    heads: tuple[str, ...] = ()
    further: float | None = None
    quantities: tuple[str, ...] = ("times", "attitude")


PAGES: dict[str, Page] = {}  # by the names of their files


def missing(name: str) -> list[str]:
    return [need for need in PAGES[name].needs if not (os.environ.get(need) if need.isupper() else find_spec(need))]


def tables(name: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for table in _TABLE.findall((FOLDER / f"{name}.md").read_text()):
        blocks = _BLOCK.findall(table)
        if [language for language, _ in blocks] != ["py", "python"]:
            raise ValueError(f"a table of {name}.md has not one py block and then one python block.")
        found.append((blocks[0][1], blocks[1][1]))
    return found


def columns(name: str) -> tuple[str, str]:
    return tables(name)[0]


def joined(name: str) -> tuple[str, str]:
    """The two programs of all tables of a page, where a later one needs what stands in the first."""
    left, right = ("\n".join(codes) for codes in zip(*tables(name), strict=True))
    return left, right


def changed(code: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        if old not in code:
            raise ValueError(f"{old!r} is not in the program\n{code}")
        code = code.replace(old, new)
    return code


def gap(name: str, theirs: np.ndarray, ours: np.ndarray) -> float:
    """The largest angle between attitudes (w, x, y, z), radians, or the difference relative to the largest value."""
    if theirs.shape != ours.shape:
        raise ValueError(f"{name} has the shape {theirs.shape} on the left and {ours.shape} on the right.")
    if name == "attitude":
        sign = np.sign(np.sum(theirs * ours, axis=-1, keepdims=True))
        return float(np.max(2 * np.linalg.norm(sign * theirs - ours, axis=-1)))
    return float(np.max(np.abs(theirs - ours)) / np.max(np.abs(ours)))


def agree(name: str, theirs: Outcome, ours: Outcome, within: float | None = None) -> None:
    allowed = PAGES[name].within if within is None else within
    for quantity, value in ours.values.items():
        difference = gap(quantity, theirs.values[quantity], value)
        assert difference <= allowed, f"{quantity} of {name} differs by {difference:.1e}, more than {allowed:.1e}"


def both(name: str, later: int = 0, codes: tuple[str, str] | None = None) -> tuple[Outcome, Outcome]:
    left, right = codes or columns(name)
    theirs, ours = (run(code, PAGES[name].quantities, later) for code in (left, right))
    agree(name, theirs, ours)
    return theirs, ours


def row(label: str, theirs: float, ours: float, form: str = "seconds") -> Row:
    left, right = (in_words(value) if form == "seconds" else format(value, form) for value in (theirs, ours))
    ratio = theirs / ours
    return label, left, right, f"{ratio:.0f}" if 10 <= ratio < 1e4 else f"{ratio:.2g}"


def times(theirs: Outcome, ours: Outcome, label: str = "the run above") -> Iterator[Row]:
    yield row(label, theirs.later, ours.later)
    yield row("its first call, with compiling", theirs.first, ours.first)


def error(outcome: Outcome, fine: Outcome, quantity: str = "attitude") -> float:
    return gap(quantity, outcome.values[quantity], fine.values[quantity])


def errors(label: str, both: Iterable[Outcome], fine: Outcome, quantity: str = "attitude", form: str = ".1e") -> Row:
    theirs, ours = (error(outcome, fine, quantity) for outcome in both)
    return row(label, theirs, ours, form)


def in_words(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= 0.995 * size or unit == "µs":
            value = seconds / size
            return f"{value:.2g} {unit}" if value < 99.5 else f"{value:.0f} {unit}"
    raise AssertionError


def as_they_stand(name: str, later: int = 5) -> Iterator[Row]:
    yield from times(*both(name, later))


# ---- diffrax, heyoka and scipy ----

_LEFT_SLOPE = """
def tip(weight):
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field), diffrax.Dopri8(), 0.0, 10.0, 0.02, start, weight, max_steps=501).ys[0, 4]
slope_of = jax.jit(jax.grad(tip), compiler_options={"xla_cpu_prefer_vector_width": 512})

slope = slope_of(20.0)
"""
_RIGHT_SLOPE = """
def tip(weight):
    torque = ml.torques.HeavyTop(weight)
    return ml.integrate("SYMMETRIC[SRKN6b]", body, torque, start, dt=0.1, steps=100, save_every=None).states.attitude[1]
slope_of = jax.jit(jax.grad(tip))

slope = slope_of(20.0)
"""


def _diffrax() -> Iterator[Row]:
    left, right = columns("diffrax")
    finer = (
        ("10.0, 101)", "10.0, 401)"),
        ("max_steps=100", "max_steps=400"),
        ("SRKN6b", "SRKN14a"),
        ("steps=1,", "steps=4,"),
    )
    fine = run(changed(right, *finer))
    agree("diffrax", run(changed(left, ("1e-10", "1e-13"))), fine, within=1e-9)
    yield from as_they_stand("diffrax", 20)
    ends = [run(code) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, fine)
    thousand = joined("diffrax")
    theirs, ours = both("diffrax", 5, thousand)
    yield row("a thousand tops", theirs.later, ours.later)
    finer = ("dt=0.1, steps=100", "dt=0.025, steps=400"), ('SRKN6b]", body, torque', 'SRKN14a]", body, torque')
    yield errors("largest error of the thousand, rad", [theirs, ours], run(changed(thousand[1], *finer)))
    theirs, ours = (
        run(parts(code)[0] + slope, ("slope",), 20) for code, slope in ((left, _LEFT_SLOPE), (right, _RIGHT_SLOPE))
    )
    agree("diffrax", theirs, ours, within=1e-5)
    yield from times(theirs, ours, "the derivative of a run")


_WIDTHS = (1, 2, 4)
# From the asymmetric body to the fast top, and to the methods that fit it.
_TOP_LEFT = (("1.0, 2.0, 3.0, 3.0", "5.0, 5.0, 1.0, 20.0"), ("[1.1, -0.35, 4.0 / 3", "[0.0, 0.0, 50.0"))
_TOP_RIGHT = (
    ("[1.0, 2.0, 3.0]", "[5.0, 5.0, 1.0]"),
    ("HeavyTop(3.0)", "HeavyTop(20.0)"),
    ("[1.1, -0.35, 4.0 / 3]", "[0.0, 0.0, 50.0]"),
    ("PGBS12", "SYMMETRIC[SRKN14a]"),
    ("dt=0.2, steps=50", "dt=0.1, steps=100"),
)


def _heyoka() -> Iterator[Row]:
    left, right = columns("heyoka")
    yield from as_they_stand("heyoka")
    ends = [run(code) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, _finest(left))
    left, right = joined("heyoka")
    yield from _many("1024 bodies", left, right)
    yield from _many("1024 fast tops", changed(left, *_TOP_LEFT), changed(right, *_TOP_RIGHT))


def _many(label: str, left: str, right: str) -> Iterator[Row]:
    built = [run(changed(left, ("width = 1 *", f"width = {n} *")), later=20) for n in _WIDTHS]
    theirs, ours = min(built, key=lambda found: found.later), run(right, later=20)
    agree("heyoka", theirs, ours)
    yield row(label, theirs.later, ours.later)
    yield errors(f"largest error of the {label}, rad", [theirs, ours], _finest(left))


def _finest(code: str) -> Outcome:
    return run(re.sub(r"tol=1e-\d+", "tol=1e-16", code))


_FINER = 2  # steps of the reference for one of the page
# What the long run asks besides: the largest change of the energy, and of the length of the quaternion.
_ENERGY_LEFT = """
p, q, r, x, y, z, w = run.y
tip = w * w + z * z - x * x - y * y
energy = (A * p * p + B * q * q + C * r * r) / 2 + weight * tip / (run.y[3:] ** 2).sum(0)
"""
_ENERGY_RIGHT = """
energy = ml.observe.energy(body, torque, path)
"""


def _scipy() -> Iterator[Row]:
    left, right = columns("scipy")
    yield from as_they_stand("scipy")
    finer = f"dt={0.1 / _FINER}, steps={200 * _FINER}, save_every={_FINER}"
    fine = run(changed(right, ("dt=0.1, steps=200", finer)))
    finest = run(changed(left, ("1e-9", "3e-14")))
    agree("scipy", finest, fine, within=1e-10)
    ends = [run(code) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, fine)
    thousand = joined("scipy")
    theirs, ours = both("scipy", 3, thousand)
    yield row("a thousand bodies", theirs.later, ours.later)
    fine = run(changed(thousand[1], ("dt=0.4, steps=50", f"dt={0.4 / 8}, steps={50 * 8}")))
    yield errors("largest error of the thousand, rad", [theirs, ours], fine)
    left = changed(left, ("20.0", "2000.0")) + _ENERGY_LEFT
    right = changed(right, ("steps=200", "steps=20000, save_every=100")) + _ENERGY_RIGHT
    theirs, ours = (run(code, ("attitude", "energy")).values for code in (left, right))
    changes = _change(theirs["energy"]), _change(ours["energy"])
    yield row("change of the energy in 2000 s, of m g l = 2", changes[0], changes[1], ".1e")
    lengths = _length(theirs["attitude"]), _length(ours["attitude"])
    yield row("change of the quaternion's length in 2000 s", lengths[0], lengths[1], ".1e")


def _change(energy: np.ndarray) -> float:
    return float(np.max(np.abs(energy - energy[0])))


def _length(attitude: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.norm(attitude, axis=-1) - 1)))


PAGES["diffrax"] = Page("diffrax", ("diffrax",), 1e-6, _diffrax)  # radians
PAGES["heyoka"] = Page("heyoka", ("heyoka",), 1e-8, _heyoka)
PAGES["scipy"] = Page("SciPy", ("scipy",), 1e-6, _scipy)


# ---- mujoco: a top, alone and a thousand times ----

_FINER_METHOD = '"JACOBI[SRKN6b]"', '"GBS12"'  # from the method of the page to that of the reference

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
    theirs, ours = both("mujoco", later=5)
    exact = run(changed(columns("mujoco")[1], _FINER_METHOD))
    yield from times(theirs, ours)
    yield errors("its error, rad", (theirs, ours), exact)
    _, *later = tables("mujoco")
    thousand, mapped = ((left + theirs, right + ours) for theirs, ours in later)
    exact = run(changed(thousand[1], _FINER_METHOD))
    theirs, ours = run(thousand[0]), run(thousand[1], later=3)
    agree("mujoco", theirs, ours)
    yield row("1000 bodies", theirs.first, ours.later)  # a first run of MuJoCo is as any other
    yield row("their first call, with compiling", theirs.first, ours.first)
    yield errors("their error, rad", (theirs, ours), exact)

    spins = later[0][1].partition("\n\n")[0] + "\n\n"
    theirs, ours = run(mapped[0], later=1), run(right + spins + later[1][1], later=3)
    yield row("1000 bodies by `vmap`: MJX", theirs.later, ours.later)
    yield row("their first call, with compiling: MJX", theirs.first, ours.first)
    assert np.allclose(theirs.values["times"][0], exact.values["times"])
    yield errors("their error, rad: MJX", (theirs, ours), exact)
    theirs, ours = run(left + LONG_LEFT, ("energy",)), run(right + LONG_RIGHT, ("energy",), 1)
    yield row("change of the energy in 1000 s, relative", *(_drift(o) for o in (theirs, ours)), form=".1e")
    yield row("the time of these 1000 s", theirs.first, ours.later)
    theirs, ours = run(left + STEP_LEFT, ("tilted",), 3), run(right + STEP_RIGHT, ("attitude",), 3)
    yield row("one step, called from Python", theirs.later / 200, ours.later / 200)


def _drift(outcome: Outcome) -> float:
    energy = outcome.values["energy"]
    return float(abs(energy - energy[0]).max() / abs(energy[0]))


# ---- molecular dynamics: a cluster ----

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


# ---- gubas ----
#
# The environment variable GUBAS names a folder with GUBAS's scripts, the files of its example, and the program, made by
#
#     g++ -std=c++11 -O3 -march=native -DARMA_NO_DEBUG hou_cpp.cpp -o hou_cpp_final -larmadillo
#
# and, for NumPy 2, with its scripts changed as the page says. Its times are those of one binary; its errors are
# measured against a far finer run of this library, with which its own errors fall to 4e-10.

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


_TOLERANCE, _STEPS_A_DAY = 1e-10, 54  # of RK 7(8), and of ours, with which our error is not larger


def _gubas() -> Iterator[Row]:
    left, right = columns("gubas")
    theirs, ours = both("gubas", later=3)
    yield from times(theirs, ours)
    fine = run(changed(right, (_DAY_STEPS, _DAY_FINE)), _POSES)
    yield errors("largest error of the attitudes, rad", (theirs, ours), fine, form=".0e")
    for degree in (2, 4):
        yield from _at_equal_error(left, right, degree)


def _at_equal_error(left: str, right: str, degree: int) -> Iterator[Row]:
    right = changed(right, ("degree=2", f"degree={degree}"))
    fine = _end(run(changed(right, (_DAY_STEPS, _DAY_FINE)), _POSES))
    theirs = run(_runge_kutta(left, degree), ("attitude",), later=3)
    steps = f"dt={86400.0 / _STEPS_A_DAY}, steps={_STEPS_A_DAY}, save_every={_STEPS_A_DAY}"
    ours = run(changed(right, (_DAY_STEPS, steps)), _POSES, later=20)
    many = run(parts(right)[0] + changed(_MANY, ("STEPS", str(_STEPS_A_DAY))), ("attitude",), later=3)
    theirs_off, *ours_off = (error(found, fine) for found in (theirs, _end(ours), many))
    if max(ours_off) > theirs_off:
        raise RuntimeError(f"With {_STEPS_A_DAY} steps a day the error is {ours_off}, that of GUBAS {theirs_off:.1e}.")
    named = f"degree {degree}, RK 7(8) at {_TOLERANCE:g}"
    yield row(f"{named}: one binary", theirs.later, ours.later)
    yield row(f"{named}: each of {COUNT}", theirs.later, many.later / COUNT)
    yield row(f"{named}: largest error after the day, rad", theirs_off, ours_off[0], ".0e")


def _runge_kutta(left: str, degree: int) -> str:
    settings = left.partition("\nsubprocess.run")[0]
    changes = (
        ('Truncation Order": 2', f'Truncation Order": {degree}'),
        ('"Integrator Flag": 2', f'"Integrator Flag": 3, "Absolute Tolerance": {_TOLERANCE}'),
        ('"Output Settings": {', '"Output Settings": {"Post Processing": 0,'),
    )
    return changed(settings, *changes) + _END


def _end(found: Outcome) -> Outcome:
    return found._replace(values={"attitude": found.values["attitude"][-1]})


# ---- spacecraft: Basilisk, then Orekit (which needs Java 17) ----

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


def measure(name: str, options: Any) -> None:
    if absent := missing(name):
        sys.exit(f"the left column needs {' and '.join(absent)}, which is not installed.")
    heads = "one core", PAGES[name].title, "midlie_jax", "ratio"
    Table(f"coming-from/{name}.md", MARK, heads, PAGES[name].rows).show(options.write)


if __name__ == "__main__":
    main(__doc__, {name: partial(measure, name) for name in sorted(PAGES)})
