"""Gradients against fifty digits: of ten thousand steps, and at points where formulas tend to fail.

    python tests/test_gradient_references.py [METHOD ...]

computes those of all symmetric methods, or of these, anew, in about two minutes each, and puts them into
`gradient_references.json`. The motion is regular: in a
chaotic one derivatives grow exponentially, and rounding with them.
"""

# pyright: reportAttributeAccessIssue=false
# gmpy2 says nothing of its names to a type checker.
import json
import sys
from functools import cache, partial
from pathlib import Path

import gmpy2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import METHODS, quick, real, setup, suited, turn, whole
from fifty_digits import exact, in_fifty_digits

import midlie_jax as ml
from midlie_jax.integrators import schemes
from midlie_jax.integrators.splitting import Splitting

FILE = Path(__file__).with_name("gradient_references.json")
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


ADJOINTS = {
    "Checkpointed": ml.adjoints.Checkpointed(),
    "Reversible": ml.adjoints.Reversible(),
    "Forward": ml.adjoints.Forward(),
}
TAKEN = [("SYMMETRIC[EA]", adjoint) for adjoint in ADJOINTS] + [("JACOBI[EA]", "Reversible"), ("SW", "Checkpointed")]
TAKEN.append(("LIEMID[I]", "Forward"))
LEFT = [(name, adjoint) for name in NAMES for adjoint in ADJOINTS if (name, adjoint) not in TAKEN]


def slopes(name, adjoint, given, **run):
    """The derivatives of the loss along `directions`."""
    own = partial(loss, name, adjoint=adjoint, **run)
    moves = [jnp.asarray(m, x.dtype) for m, x in zip(directions(), given, strict=True)]
    if isinstance(adjoint, ml.adjoints.Forward):
        seeds = [tuple(m if i == k else jnp.zeros_like(m) for i, m in enumerate(moves)) for k in range(len(moves))]
        seeds = jax.tree.map(lambda *x: jnp.stack(x), *seeds)
        return jax.vmap(lambda seed: jax.jvp(own, given, seed)[1])(seeds)
    gradient = jax.grad(own, argnums=tuple(range(len(moves))))(*given)
    return jnp.stack([jnp.sum(g * m) for g, m in zip(gradient, moves, strict=True)])


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "adjoint"), [*TAKEN, *whole(*LEFT)])
def test_gradients_of_ten_thousand_steps_equal_fifty_digits(name, adjoint):
    expected = stored()[name]
    given = tuple(map(jnp.asarray, parameters(name)))
    found = quick(partial(slopes, name, ADJOINTS[adjoint]))(given)
    for group, slope in zip(GROUPS, found, strict=True):
        assert abs(slope - float(expected[group])) <= 1e-9 * abs(float(expected[group])), group


SHORT = {"steps": 32, "save_every": 16}
AT_REST = [0.0, 0.0, 0.0]
POINTS = {
    "a generic point": {},
    "no momentum": {"momentum": AT_REST},
    "no torque": {"weight": 0.0},
    "nothing moves": {"momentum": AT_REST, "weight": 0.0},
    "a sphere": {"moments": [2.0, 2.0, 2.0]},
    "two equal moments": {"moments": [2.0, 2.0, 3.5]},
    "attitude of no turn": {"attitude": turn(0.0, 0.0, 0.0)},
    "spin about an axis of symmetry": {"moments": [2.0, 2.0, 3.5], "momentum": [0.0, 0.0, 1.5]},
}
FEW = [("SYMMETRIC[EA]", "Reversible"), ("JACOBI[EA]", "Checkpointed"), ("LIEMID[EA]", "Checkpointed")]
REST = [(name, adjoint) for name in NAMES for adjoint in ADJOINTS if (name, adjoint) not in FEW]


def point(name, changes):
    given = dict(zip(GROUPS, parameters(name), strict=True)) | changes
    given["moments"] = suited(name, np.asarray(given["moments"]))
    return tuple(np.asarray(given[group], np.float64) for group in GROUPS)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "adjoint"), [*FEW, *whole(*REST)])
def test_gradients_equal_fifty_digits_where_formulas_tend_to_fail(name, adjoint):
    points = [point(name, changes) for changes in POINTS.values()]
    batch = tuple(jnp.asarray(np.stack(column)) for column in zip(*points, strict=True))
    found = quick(jax.vmap(partial(slopes, name, ADJOINTS[adjoint], **SHORT)))(batch)
    for label, given, row in zip(POINTS, points, found, strict=True):
        expected = np.array([float(x) for x in exact_slopes(name)(given)])
        assert np.all(abs(row - expected) <= 1e-12 * (1 + abs(expected))), label


@cache
def exact_slopes(name):
    return reference(name, **SHORT)


def test_every_symmetric_method_has_stored_references():
    assert sorted(stored()) == sorted(NAMES)


# A million steps; and a gradient in float32. Regular motions, Lagrange's top.
@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "steps", "bound"), [("float64", 1_000_000, 1e-6), ("float32", 10_000, 1e-3)])
def test_the_gradient_of_a_long_way_back(dtype, steps, bound):
    name = "SYMMETRIC[EA]"
    run = {"steps": steps, "save_every": steps}
    given = tuple(map(jnp.asarray, parameters(name)))
    expected = real(partial(slopes, name, ml.adjoints.Checkpointed(every=1000), **run))(given)
    found = real(partial(slopes, name, ml.adjoints.Reversible(), **run))(tuple(x.astype(dtype) for x in given)).astype(
        float
    )
    assert np.all(abs(found - expected) <= bound * abs(expected))


def main(names):
    for name in names or NAMES:
        slopes = list(reference(name)(parameters(name)))
        known = stored() | {name: {group: f"{x:.25g}" for group, x in zip(GROUPS, slopes, strict=True)}}
        FILE.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n")
        print(name, *(f"{x:.6g}" for x in slopes), flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(sys.argv[1:])
