"""Apophis past the Earth: errors and times beside SciPy, and steps that know the perigee: docs/reports/applications.md.

    python benchmarks/flyby.py [--write]

1,000 random phases of the tumbling in one call, from two days before the perigee to two days after. Errors are the
largest angle between the attitude at the end and that by 9,216 steps. Times are processor times on one core.
"""

import math
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, in_turn, main, save, shown
from scipy.integrate import solve_ivp

import midlie_jax as ml

# ---- Apophis in April 2029, with figures on which SciPy's DOP853 at 1e-13 and 128-bit arithmetic agree ----
#
# Units are m and s; moments and momenta are divided by the largest moment. They agree on `ENDS` to 7e-14 (momentum) and
# 3e-13 (attitude).

PAGE = "reports/applications.md"
MU = 3.986004418e14
PERIGEE = 3.8012e7
SPEED = 5840.0  # far out
HALF = 172800.0  # two days before the perigee, and after
HOUR = 3600.0
MOMENTS = (0.61, 0.965, 1.0)
POLE = (-0.3320328728817035, -0.4230418832197608, 0.8430834693954098)
PERIODS = {"precession_period": 27.374 * HOUR, "rotation_period": 262.2 * HOUR}  # arXiv 2604.24566


class End(NamedTuple):
    phases: tuple[float, float]
    momentum_before: tuple[float, float, float]
    attitude_before: tuple[float, float, float, float]
    momentum: tuple[float, float, float]
    attitude: tuple[float, float, float, float]
    energy_ratio: float
    momentum_ratio: float
    pole_moves: float  # degrees


ENDS = (
    End(
        (0.0, 0.0),
        (1.0795914225352256e-5, 0.0, 5.5309298014564986e-5),
        (0.938871334378215, 0.2193186009004722, -0.2645190693280288, -0.021204498196442646),
        (-1.702424446183e-6, 2.086855246945e-5, 3.635641317813e-5),
        (-0.46191130329425, -0.37793186161237, 0.33165396659955, 0.73062377617075),
        1.01003,
        0.74449,
        25.695,
    ),
    End(
        (0.3, 2.0),
        (-2.6147422284640296e-6, 4.397742540836044e-5, 3.5139996988558575e-5),
        (0.485964910515678, 0.17997283124796917, 0.11194500958133247, 0.8478892619852633),
        (1.596837424718e-6, -5.051219440047e-5, 6.850574829313e-5),
        (0.67273504555003, -0.20440630037811, -0.44925818596104, 0.55119207650466),
        1.01299,
        1.51065,
        4.980,
    ),
)


def orbit() -> ml.orbits.KeplerOrbit:
    """The hyperbola, in the frame of perigee, motion at the perigee, and normal; t = 0 at the perigee."""
    return ml.orbits.KeplerOrbit.from_elements(
        mu=MU,
        eccentricity=1 + PERIGEE * SPEED**2 / MU,
        periapsis=PERIGEE,
        time_of_periapsis=0.0,
        inclination=0.0,
        ascending_node=0.0,
        argument_of_periapsis=0.0,
    )


def body() -> ml.RigidBody:
    return ml.RigidBody(jnp.array(MOMENTS))


def torque() -> ml.spacecraft.GravityGradient:
    return ml.spacecraft.GravityGradient(jnp.array(MOMENTS), orbit(), MU)


def start(s: Any, phi: Any) -> ml.RigidState:
    return ml.asteroids.tumbling(body(), **PERIODS, axis="short", pole=jnp.array(POLE), phases=(s, phi), mode="short")


def starts(count: int) -> ml.RigidState:
    phases = np.random.default_rng(2029).uniform(size=(count, 2)) * [1, 2 * np.pi]
    return jax.vmap(start)(*jnp.asarray(phases.T))


def distance(found: Any, right: Any) -> Any:
    found, right = (np.asarray(x) for x in (found, right))
    apart = np.minimum(np.linalg.norm(found - right, axis=-1), np.linalg.norm(found + right, axis=-1))
    return 4 * np.arcsin(np.clip(apart / 2, 0, 1))


def by_scipy(state: ml.RigidState, tolerance: float) -> np.ndarray:
    """Momentum and attitude at the end, (7,), by DOP853 with the closed form of the orbit, written for speed."""
    e = 1 + PERIGEE * SPEED**2 / MU
    a = PERIGEE / (e - 1)
    rate, side = float(np.sqrt(MU / a**3)), float(np.sqrt(e * e - 1))
    ia, ib, ic = MOMENTS
    asinh, sinh, cosh, sqrt = math.asinh, math.sinh, math.cosh, math.sqrt

    def rates(t: float, y: np.ndarray) -> list[float]:
        p, q, r, w, x, yy, z = y.tolist()
        anomaly = asinh(rate * t / e)
        for _ in range(20):
            change = (e * sinh(anomaly) - anomaly - rate * t) / (e * cosh(anomaly) - 1)
            anomaly -= change
            if abs(change) < 1e-14 * (1 + abs(anomaly)):
                break
        px, py = a * (e - cosh(anomaly)), a * side * sinh(anomaly)
        u = (1 - 2 * (yy * yy + z * z)) * px + 2 * (x * yy + w * z) * py
        v = 2 * (x * yy - w * z) * px + (1 - 2 * (x * x + z * z)) * py
        s = 2 * (x * z + w * yy) * px + 2 * (yy * z - w * x) * py
        square = px * px + py * py
        pull = 3 * MU / (square * square * sqrt(square))
        o, oo, ooo = p / ia, q / ib, r / ic
        return [
            q * ooo - r * oo + pull * (ic - ib) * v * s,
            r * o - p * ooo + pull * (ia - ic) * s * u,
            p * oo - q * o + pull * (ib - ia) * u * v,
            (-x * o - yy * oo - z * ooo) / 2,
            (w * o + yy * ooo - z * oo) / 2,
            (w * oo + z * o - x * ooo) / 2,
            (w * ooo + x * oo - yy * o) / 2,
        ]

    y = np.concatenate([state.momentum, state.attitude])
    scale = np.concatenate([np.full(3, 6e-5), np.ones(4)])
    return solve_ivp(rates, (-HALF, HALF), y, "DOP853", rtol=tolerance, atol=tolerance * scale).y[:, -1]


# ---- what is measured ----

COUNT, BY_SCIPY = 1000, 20  # phases; those that SciPy integrates, one by one, for time and error
LADDER = {"JACOBI[EA]": (1152,), "JACOBI[SRKN6b]": (144, 288, 576, 1152), "GBS12": (192,)}
REFERENCE = 9216  # steps of JACOBI[SRKN6b]
TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
DTS = (600.0, 300.0, 150.0)


def ends(method, steps, starts):
    run = {"dt": 2 * HALF / steps, "steps": steps, "t0": -HALF}
    began = time.process_time()

    def call():
        return jax.block_until_ready(ml.ensemble(method, body(), torque(), starts, **run))

    path = call()
    first = time.process_time() - began
    assert path.ok.all()
    return path, in_turn([call], 6)[0], first


def error_of(path, right):
    return distance(path.states.attitude, right.states.attitude).max()


def constant(starts, right):
    for method, ladder in LADDER.items():
        for steps in ladder:
            path, seconds, first = ends(method, steps, starts)
            cells = f"{error_of(path, right):.1e}", f"{1e6 * seconds / COUNT:.1f}", f"{first:.1f}"
            yield [f"`{method}`", f"{steps}", f"{2 * HALF / steps:.0f}", *cells]
    few = [jax.tree.map(lambda x, n=n: np.asarray(x[n]), starts) for n in range(BY_SCIPY)]
    for tolerance in TOLERANCES:
        began = time.process_time()
        found = np.array([by_scipy(state, tolerance) for state in few])
        seconds = (time.process_time() - began) / BY_SCIPY
        error = distance(found[:, 3:], right.states.attitude[:BY_SCIPY]).max()
        yield [f"SciPy's DOP853, {tolerance:.0e}", "", "", f"{error:.1e}", f"{1e6 * seconds:.0f}", ""]


def compared(rows):
    """At the error of each row of SciPy: the fastest row of this package with an error as small."""
    own = [(row[0], row[1], float(row[3]), float(row[4])) for row in rows if not row[0].startswith("SciPy")]
    for row in rows:
        if row[0].startswith("SciPy"):
            fast = [one for one in own if one[2] <= float(row[3])]
            if fast:
                name, steps, error, micro = min(fast, key=lambda one: one[3])
                yield [row[0], row[3], name, steps, f"{error:.1e}", f"{float(row[4]) / micro:.0f}"]


def adaptive(starts, right):
    density = ml.densities.OrbitalDistance(orbit(), PERIGEE)

    run = {"density": density, "steps": 1024, "save_every": None, "t0": -HALF, "t1": HALF}
    case = ("JACOBI[SRKN6b]", body(), torque())
    many = jax.jit(jax.vmap(lambda state, dt: ml.integrate_variable_step(*case, state, dt=dt, **run), (0, None)))
    for dt in DTS:
        path = many(starts, jnp.asarray(dt))
        assert path.ok.all()
        (own,) = in_turn([lambda: many(starts, jnp.asarray(dt))], 4)  # noqa: B023  (called here)
        taken = int(path.taken.max())
        same, constant_seconds, _ = ends("JACOBI[SRKN6b]", taken, starts)
        errors = f"{error_of(path, right):.1e}", f"{error_of(same, right):.1e}"
        yield [f"{dt:.0f}", f"{taken}", *errors, *(f"{1e6 * x / COUNT:.1f}" for x in (own, constant_seconds))]


def outcome(starts, right):
    before, after = (ml.asteroids.tumble(body(), states) for states in (starts, right.states))
    moved = np.degrees(np.arccos(np.clip(np.sum(np.asarray(before.pole) * np.asarray(after.pole), axis=-1), -1, 1)))
    rate = np.asarray(after.effective_rate / before.effective_rate)
    for what, values in (
        ("pole moves by, degrees", moved),
        ("effective rate after / before", rate),
        ("energy ratio after", np.asarray(after.energy_ratio)),
    ):
        yield [what, *(f"{np.quantile(values, q):.3g}" for q in (0, 0.05, 0.5, 0.95, 1))]
    yield ["pole moves by 10 degrees or more", f"{100 * np.mean(moved >= 10):.0f} %", "", "", "", ""]


TABLES = {
    "ratio": Table(
        *(PAGE, "flyby ratio", ["at the error of", "error, rad", "", "steps", "error, rad", "times faster"]),
        data="flyby-ratio",
        columns=(0, 1, 2, 4, 5),
    ),
    "adaptive": Table(
        *(PAGE, "flyby adaptive"),
        ["dt, s", "steps", "error, rad", "the same number of constant steps", "µs per body", "µs, constant"],
    ),
    "outcome": Table(PAGE, "flyby outcome", ["", "least", "5 %", "50 %", "95 %", "most"]),
}


def whole(options):
    begun = jax.jit(starts, static_argnums=0)(COUNT)
    right, seconds, first = ends("JACOBI[SRKN6b]", REFERENCE, begun)
    print(f"reference: {seconds:.1f} s, first call {first:.1f} s", flush=True)
    rows = list(constant(begun, right))
    lines = shown(["", "steps", "step, s", "error, rad", "µs per body", "first call, s"], rows)
    if options.write:
        save("flyby-constant-steps", lines)
    TABLES["ratio"].show(options.write, compared(rows))
    TABLES["adaptive"].show(options.write, adaptive(begun, right))
    TABLES["outcome"].show(options.write, outcome(begun, right))


if __name__ == "__main__":
    main(__doc__, whole)
