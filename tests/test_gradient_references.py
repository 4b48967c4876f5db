"""Gradients against fifty digits: of long runs, and at points where formulas tend to fail."""

from functools import cache, partial

import gradient_references as references
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick, real, suited, turn, whole

import midlie_jax as ml

GROUPS = references.GROUPS
ADJOINTS = {"Checkpointed": ml.Checkpointed(every=4), "Reversible": ml.Reversible(), "Forward": ml.Forward()}
TAKEN = [("SYMMETRIC[EA]", adjoint) for adjoint in ADJOINTS] + [("JACOBI[EA]", "Reversible"), ("SW", "Checkpointed")]
LEFT = [(name, adjoint) for name in references.NAMES for adjoint in ADJOINTS if (name, adjoint) not in TAKEN]


def slopes(name, adjoint, given, **run):
    """The derivatives of the loss along the directions of the references."""
    loss = partial(references.loss, name, adjoint=adjoint, **run)
    moves = [jnp.asarray(m, x.dtype) for m, x in zip(references.directions(), given, strict=True)]
    if isinstance(adjoint, ml.Forward):
        seeds = [tuple(m if i == k else jnp.zeros_like(m) for i, m in enumerate(moves)) for k in range(len(moves))]
        seeds = jax.tree.map(lambda *x: jnp.stack(x), *seeds)
        return jax.vmap(lambda seed: jax.jvp(loss, given, seed)[1])(seeds)
    gradient = jax.grad(loss, argnums=tuple(range(len(moves))))(*given)
    return jnp.stack([jnp.sum(g * m) for g, m in zip(gradient, moves, strict=True)])


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "adjoint"), [*TAKEN, *whole(*LEFT)])
def test_gradients_of_ten_thousand_steps_equal_fifty_digits(name, adjoint):
    expected = references.stored()[name]
    given = tuple(map(jnp.asarray, references.parameters(name)))
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
REST = [(name, adjoint) for name in references.NAMES for adjoint in ADJOINTS if (name, adjoint) not in FEW]


def point(name, changes):
    given = dict(zip(GROUPS, references.parameters(name), strict=True)) | changes
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
    return references.reference(name, **SHORT)


def test_every_symmetric_method_has_stored_references():
    assert sorted(references.stored()) == sorted(references.NAMES)


# A million steps; and a gradient in float32. Regular motions, Lagrange's top.
@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "steps", "bound"), [("float64", 1_000_000, 1e-6), ("float32", 10_000, 1e-3)])
def test_the_gradient_of_a_long_way_back(dtype, steps, bound):
    name = "SYMMETRIC[EA]"
    run = {"steps": steps, "save_every": steps}
    given = tuple(map(jnp.asarray, references.parameters(name)))
    expected = real(partial(slopes, name, ml.Checkpointed(every=1000), **run))(given)
    found = real(partial(slopes, name, ml.Reversible(), **run))(tuple(x.astype(dtype) for x in given)).astype(float)
    assert np.all(abs(found - expected) <= bound * abs(expected))
