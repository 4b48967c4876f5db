"""Derivatives of a loss over ten thousand steps, in fifty digits; `gradient_references.json` keeps them.

    python tests/gradient_references.py [METHOD ...]

computes those of all symmetric methods, or of these, anew, in about two minutes each. The motion is regular: in a
chaotic one derivatives grow exponentially, and rounding with them.
"""

# pyright: reportAttributeAccessIssue=false
# gmpy2 says nothing of its names to a type checker.
import json
import sys
from functools import partial
from pathlib import Path

import gmpy2
import jax
import jax.numpy as jnp
import numpy as np
from cases import METHODS, setup, suited
from fifty_digits import exact, in_fifty_digits

import midlie_jax as ml
from midlie_jax.integrators import schemes
from midlie_jax.integrators.splitting import Splitting

FILE = Path(__file__).with_suffix(".json")
STEPS = 10_000  # of methods with one or two flights a step; of others so many flights
NAMES = [method.name for method in METHODS if method.symmetric]
GROUPS = ("moments", "weight", "momentum", "attitude", "dt")
CASE = setup(moments=[2.0, 2.2, 2.5], weight=0.3)
WEIGHTS = np.array([0.3, -1.1, 0.7, 0.9, -0.4, 0.6, 1.3])
DIFFERENCE = gmpy2.mpfr("1e-25")


def run_of(name):
    """The steps of the run, and how often it is saved."""
    method = ml.method(name)
    flights = sum(kind == schemes.FLIGHT for kind, _ in method.scheme.stages) if isinstance(method, Splitting) else 1
    # Divisible by the hundred steps between the states that an adjoint keeps.
    save_every = STEPS // 4 // (1 if flights <= 2 else flights) // 100 * 100
    return {"steps": 4 * save_every, "save_every": save_every}


def parameters(name):
    """The arguments of `loss`, in the order of `GROUPS`."""
    return np.asarray(suited(name, jnp.asarray(CASE.moments))), CASE.weight, CASE.momentum, CASE.attitude, CASE.dt


def directions():
    """For each group the direction in which it is moved, alone."""
    random = np.random.default_rng(7)
    return [random.uniform(0.5, 1.5, np.shape(getattr(CASE, group))) for group in GROUPS]


def values(name, moments, weight, momentum, attitude, dt, *, axis=(0.0, 0.0, 1.0), adjoint=None, **run):
    """Momentum and attitude of every saved state, (rows, 7)."""
    torque = ml.torques.HeavyTop(weight, axis)
    start = ml.RigidState(momentum, attitude)
    run = run or run_of(name)
    states = ml.integrate(name, ml.RigidBody(moments), torque, start, dt=dt, adjoint=adjoint, **run).states
    return jnp.concatenate([states.momentum, states.attitude], axis=-1)


def total(found):
    """One number that depends on every entry of every saved state, from `values` in any arithmetic."""
    return ((found + found * found) @ WEIGHTS.astype(found.dtype)).sum()


def loss(name, *given, **run):
    return total(values(name, *given, **run))


def reference(name, **run):
    """A function of `parameters` with the derivatives of the loss along `directions`, in fifty digits.

    The differences are over 1e-25 and have 60 digits, of which 35 are those of the derivative. The constants of the
    method are those of float64.
    """
    # SYMMETRIC moves bodies with two equal moments alone; its derivatives are those of the exact flight of any body.
    moves_any_body = name.replace("SYMMETRIC", "JACOBI")
    run = run or run_of(name)
    run_exactly = in_fifty_digits(partial(values, moves_any_body, **run), *parameters(name))

    def exact_loss(*given):
        return total(run_exactly(*given)[0])

    def slopes(given):
        given = [exact(x) for x in given]
        value = exact_loss(*given)
        for k, direction in enumerate(directions()):
            moved = [x + DIFFERENCE * exact(direction) if k == j else x for j, x in enumerate(given)]
            yield (exact_loss(*moved) - value) / DIFFERENCE

    return slopes


def stored():
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def main(names):
    for name in names or NAMES:
        slopes = list(reference(name)(parameters(name)))
        known = stored() | {name: {group: f"{x:.25g}" for group, x in zip(GROUPS, slopes, strict=True)}}
        FILE.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n")
        print(name, *(f"{x:.6g}" for x in slopes), flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(sys.argv[1:])
