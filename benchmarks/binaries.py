"""A Didymos-like binary asteroid, and ten years of its energy and momenta: docs/reports/applications.md.

    python benchmarks/binaries.py [--write]

Processor times on one core.
"""

import time
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import one_core  # noqa: F401
from harness import Table, main

import midlie_jax as ml

# ---- a Didymos-like binary asteroid and its end states, which two formulas and two programs agree on ----
# Inputs are those of an example of GUBAS (A. Davis and D. Scheeres, Icarus 341 (2020) 113439), with a primary that is
# no sphere. The end states were computed with 128-bit arithmetic; a program of the field with a Runge-Kutta method of
# order 7(8) agrees with them to 4e-14 after 7200 s and 7e-12 after a day. SI units; the first body is the primary. In
# `PLANAR` both spin about the normal of the orbit; in `TILTED` they do not.

G = 6.67e-11
MASSES = 532661512390.31647, 4995532430.186578
MOMENTS = (
    (3.0787835416160292e16, 3.162944060573699e16, 3.324873160340355e16),
    (10660065963959.85, 15001746242654.273, 16923273395857.004),
)
DISTANCE, SPEED = 1200.0, 0.175704287113523
SPINS = 0.000772269580528, 0.000146420239261
TURNED = (0.9952465414778341, 0.0870727897926938, 0.0434534024273578, 0.0038016801040236755)
STILL = (1.0, 0.0, 0.0, 0.0)
DAY = 86400.0
PLANAR, TILTED = "planar", "tilted"

BODY = ml.FreeBody(ml.RigidBody(MOMENTS), MASSES)

# Of the second body relative to the first: place r and velocity v; attitudes and body-frame momenta of both.
ENDS = {
    (PLANAR, 2, DAY): {
        "r": (980.803051235500, -710.351238244991, 0.0),
        "v": (0.100188628705883, 0.142641728133657, 0.0),
        "attitude 1": (-0.366338410448161, 0.0, 0.0, 0.930481686563639),
        "momentum 1": (0.0, 0.0, 2.56766142463450e13),
        "attitude 2": (0.945758929661667, 0.0, 0.0, -0.324869276733300),
        "momentum 2": (0.0, 0.0, 1.72217270410698e9),
    },
    (PLANAR, 4, 7200.0): {
        "r": (610.352173214404, 1051.57236010042, 0.0),
        "v": (-0.148030608201876, 0.0905310869595568, 0.0),
        "attitude 2": (0.864396310655008, 0.0, 0.0, 0.502811115754227),
        "momentum 2": (0.0, 0.0, 2.47291799803991e9),
    },
    (TILTED, 2, 7200.0): {
        "r": (610.415138187088, 1051.62642461140, -0.228068483136136),
        "v": (-0.148010814126580, 0.0905519680328020, -5.94542578651945e-5),
        "attitude 1": (-0.936553212991806, 0.00627563749796005, 0.00216622033787954, 0.350462555914560),
        "momentum 1": (1.11430123426129e12, 5.17515843043307e11, 2.56747415997722e13),
        "attitude 2": (0.858263954806452, 0.0959138258149405, 0.00789540664457274, 0.504104338854018),
        "momentum 2": (-8246018.01515668, 95469703.4623182, 2.45817836069964e9),
    },
    (TILTED, 2, DAY): {
        "r": (979.413630350555, -712.348352682980, 1.35993784715507),
        "v": (0.100448347866647, 0.142452282110206, -2.15977949548392e-4),
        "attitude 1": (-0.401053633347264, 0.0225618101279716, -0.0372184557462910, 0.915020073252259),
        "momentum 1": (-5.10118475092291e11, -1.34156800800559e12, 2.56640023603678e13),
        "attitude 2": (0.942391505611015, 0.00951996069922369, 0.0386046415450237, -0.332140485565476),
        "momentum 2": (1.30176999820046e8, 1.78967083200867e8, 1.72396567783982e9),
    },
    (TILTED, 2, 30 * DAY): {"r": (801.965704583790, 980.089094361844, -71.7941133732054)},
}
ENERGY = 9.865976359533238e9  # tilted, degree 2
ANGULAR_MOMENTUM = (1.189041401173986e12, -3.204877180941434e8, 2.672293144147873e13)


def start(kind: str = TILTED) -> ml.CoupledState:
    """The start, with the centre of mass at rest at the origin."""
    a, b = MASSES
    r, p = np.array([DISTANCE, 0, 0]), a * b / (a + b) * np.array([0, SPEED, 0])
    tilted = kind == TILTED
    axes = np.array([[0.05, 0, 1], [0, 0.05, 1]]) if tilted else np.array([[0.0, 0, 1], [0, 0, 1]])
    momentum = np.array(MOMENTS) * np.array(SPINS)[:, None] * axes
    attitude = np.array([STILL, TURNED if tilted else STILL])
    return ml.CoupledState(momentum, attitude, np.stack([-p, p]), np.stack([-b * r, a * r]) / (a + b))


def errors(state: ml.CoupledState, end: dict[str, tuple[float, ...]]) -> dict[str, float]:
    found = as_end(state)
    result = dict[str, float]()
    for name, values in end.items():
        known, here = np.array(values), np.array(found[name])
        signs = (1, -1) if name.startswith("attitude") else (1,)
        result[name] = float(min(np.linalg.norm(sign * here - known) for sign in signs) / np.linalg.norm(known))
    return result


def as_end(state: ml.CoupledState) -> dict[str, tuple[float, ...]]:
    a, b = MASSES
    vectors = {
        "r": state.position[1] - state.position[0],
        "v": state.linear[1] / b - state.linear[0] / a,
        **{f"attitude {i + 1}": state.attitude[i] for i in range(2)},
        **{f"momentum {i + 1}": state.momentum[i] for i in range(2)},
    }
    return {name: tuple(map(float, vector)) for name, vector in vectors.items()}


# ---- ten years: energy and momenta; docs/coming-from/gubas.md has the run time of a day ----

YEARS, STATES = 10, 1000
gravity = ml.asteroids.MutualGravity(G, degree=2)


def long_rows() -> Iterator[list[str]]:
    """Ten years of the known binary, degree 2: the largest relative errors of energy and angular momentum."""
    for method, dt in (("JACOBI[EA]", 300.0), ("JACOBI[SRKN6b]", 600.0), ("JACOBI[SRKN14a]", 600.0), ("GBS12", 900.0)):
        steps = round(YEARS * 365.25 * DAY / dt / STATES) * STATES
        options: Any = {"dt": dt, "steps": steps, "save_every": steps // STATES}
        began = time.process_time()
        path = jax.block_until_ready(ml.integrate(method, BODY, gravity, start(), **options))
        seconds = time.process_time() - began
        energy = np.asarray(ml.observe.energy(BODY, gravity, path))
        spin = np.asarray(ml.observe.spatial_momentum(path.states))
        halves = [f"{np.abs(half / energy[0] - 1).max():.1e}" for half in np.split(energy[1:], 2)]
        lost = np.abs(spin - spin[0]).max() / np.linalg.norm(spin[0])
        yield [f"`{method}`", f"{dt:g}", *halves, f"{lost:.0e}", f"{seconds:.1f}"]


HEADS = ("method", "step, s", "energy, first five years", "last five years", "angular momentum", "seconds")
TABLE = Table("reports/applications.md", "binaries long", HEADS, long_rows)

if __name__ == "__main__":
    main(__doc__, TABLE)
