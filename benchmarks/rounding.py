"""Measures how rounding errors grow over many steps without torque, for docs/reports/rounding.md.

    python benchmarks/rounding.py [--steps 1000000] [--write]

A free flight conserves the spatial momentum R Pi, the length of Pi and, if it is exact, the energy, up to rounding.
Each figure is the root mean square over 16 bodies of the relative change of one of these, in units of eps times the
square root of the number of steps, for the worst of six angles per step, 1e-5 to 1 radian. If a figure is the same for
any number of steps, rounding errors grow as a random walk.
"""

import argparse

import jax
import numpy as np
from laboratory.free_bodies import TURNS, free_bodies, spatial_momentum
from pages import link, part, put, save

import midlie_jax as ml
from midlie_jax.advice.timing import pin
from midlie_jax.methods.flights import FLIGHTS

jax.config.update("jax_enable_x64", True)
pin()

BEGIN, END = "<!-- rounding -->", "<!-- /rounding -->"
BODIES = 16
STATES = {"float64": ml.RigidState, "float32": ml.CompensatedState}
QUANTITIES = ("R Pi", "length of Pi", "energy")


def constants(flight, dtype, steps):
    """The figure for each of QUANTITIES; None for the energy of a flight that does not conserve it."""
    inputs = free_bodies(flight.equal_moments, dtype, count=BODIES, seed=2)

    def run(moments, momentum, attitude, dt):
        start = STATES[dtype](momentum, attitude)
        method, body = ml.method(flight, "E1"), ml.RigidBody(moments)
        return ml.integrate(method, body, None, start, dt=dt, steps=steps, save_every=steps)

    path = jax.jit(jax.vmap(run))(*inputs)
    if not path.ok.all():
        raise RuntimeError(f"{flight.name} failed: a solve did not succeed, or a number is not finite.")
    moments, momentum, attitude, *low = (
        np.asarray(x, np.longdouble) for x in (inputs[0], *jax.tree.leaves(path.states))
    )
    if low:
        momentum, attitude = momentum + low[0], attitude + low[1]
    space, square = spatial_momentum(attitude, momentum), np.sum(momentum**2, axis=-1)
    energy = np.sum(momentum**2 / moments[:, None], axis=-1)
    changes = (
        np.linalg.norm(space[:, 1] - space[:, 0], axis=-1) / np.sqrt(square[:, 0]),
        np.sqrt(square[:, 1] / square[:, 0]) - 1,
        energy[:, 1] / energy[:, 0] - 1 if flight.order is None else None,
    )
    unit = np.finfo(dtype).eps * steps**0.5
    return [None if c is None else float(worst(c / unit)) for c in changes]


def worst(change):
    return np.sqrt(np.mean(change.reshape(len(TURNS), BODIES) ** 2, axis=1)).max()


ABOUT = """
`python benchmarks/rounding.py --write` measures free bodies over {steps:.0e} steps of 1e-5 to 1 rad. The table has the
relative change of the conserved quantities (root mean square of 16 bodies), for the worst of six angles per step. The
unit is eps times the square root of the number of steps. A value of 0.5 is an error of 1.1e-13 after a million steps
in float64, and of 6.0e-5 in float32. Flights that do not conserve the energy have no entry. The runs
in float32 start from a `CompensatedState`, because ordinary sums are biased below 3e-4 rad per step.
"""


KEY = ("JACOBI", "SYMMETRIC", "SLIEMID4", "DLM", "LIEMID")


def table(steps):
    heads = [f"{q}, {d}" for d in ("float64", "float32") for q in QUANTITIES]
    lines = ["| flight | " + " | ".join(heads) + " |", "|---" * 7 + "|"]
    print("\n".join(lines), flush=True)
    for flight in (flight for flight in FLIGHTS.values() if flight.body is ml.RigidBody):
        figures = [c for dtype in ("float64", "float32") for c in constants(flight, dtype, steps)]
        lines.append(f"| `{flight.name}` | " + " | ".join("" if c is None else f"{c:.2f}" for c in figures) + " |")
        print(lines[-1], flush=True)
    return lines


def write(lines, steps):
    """Puts the whole table into its data file, and what is measured and the rows of `KEY` into the page."""
    save("rounding", lines)
    rows = part(lines, lambda row: row[0].strip("`") in KEY)
    put("reports/rounding.md", BEGIN, END, [ABOUT.format(steps=steps), *rows, "", link("rounding"), ""])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--write", action="store_true")
    chosen = parser.parse_args()
    measured = table(chosen.steps)
    if chosen.write:
        write(measured, chosen.steps)
