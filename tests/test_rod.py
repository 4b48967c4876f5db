"""Laws of `Rod` and `straight_rod`: the forces of the potential, what they conserve, and known answers of beams."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import midlie_jax as ml

# The cantilever of PyElastica's example: length, radius, density, Young's and shear modulus; the force at its tip.
CANTILEVER = {"length": 3.0, "radius": 0.25, "density": 5000.0, "youngs_modulus": 1e6, "shear_modulus": 1e4}
TIP_FORCE, TIP = 15.0, 0.0677703
SOFT = {"length": 2.0, "radius": 0.1, "density": 5.0, "youngs_modulus": 10.0, "shear_modulus": 4.0}


def straight(elements, clamped=False, **sizes):
    return ml.molecules.straight_rod(
        elements, [0.0, 0.0, 0.0], [0.0, 0.6, 0.8], [1.0, 0.0, 0.0], **(sizes or SOFT), clamped=clamped
    )


def moments_of(body: Any):
    return np.asarray(body.body.moments)


def shaken(start, size, seed=0):
    increment = np.random.default_rng(seed).standard_normal(12 * start.count)
    return start.plus(jnp.asarray(size * increment, start.momentum.dtype))


def varied(rod):
    """The rod with other numbers for each link, and bent and twisted at rest."""
    links, numbers = 5, np.random.default_rng(1)
    stiff = [numbers.uniform(1, 2, (links, 3)) for _ in range(2)]
    at_rest = {name: 0.2 * numbers.standard_normal((links, 3)) for name in ("strain", "curvature")}
    lengths = float(rod.length) * numbers.uniform(0.5, 2, links)
    return ml.molecules.Rod(lengths, *stiff, **at_rest, clamp=rod.clamp)


@pytest.mark.parametrize(("size", "clamped"), [(0.0, True), (1e-9, False), (0.7, True)])
def test_the_wrench_is_minus_the_gradient_of_the_potential(clamped, size):
    _, rod, start = straight(5, clamped)
    state, rod = shaken(start, size), varied(rod)
    found, wanted = jax.jit(lambda s: (rod(0.0, s), ml.torques.FromPotential(rod.potential)(0.0, s)))(state)
    scale = float(jnp.abs(wanted.torque).max())
    np.testing.assert_allclose(found.torque, wanted.torque, rtol=0, atol=1e-13 * scale)
    np.testing.assert_allclose(found.force, wanted.force, rtol=0, atol=1e-13 * scale)


def test_the_potential_is_that_of_the_page():
    body, rod, start = straight(5)
    state, rod = shaken(start, 0.5), varied(rod)
    turns, total = ml.so3.to_matrix(state.attitude), 0.0
    for i, piece in enumerate(rod.length):
        turn = ml.so3.log(ml.so3.multiply(ml.so3.conjugate(state.attitude[i]), state.attitude[i + 1]))
        middle = turns[i] @ ml.so3.to_matrix(ml.so3.exp(turn / 2))
        way = (state.position[i + 1] - state.position[i]) / piece
        strain = middle.T @ way - jnp.array([0.0, 0.0, 1.0]) - rod.strain[i]
        curvature = turn / piece - rod.curvature[i]
        total += piece / 2 * (strain @ (rod.stretch[i] * strain) + curvature @ (rod.bend[i] * curvature))
    assert float(ml.observe.energy(body, rod, state) - ml.observe.kinetic_energy(body, state)) == pytest.approx(
        float(total), rel=1e-13
    )


def test_the_bodies_make_up_the_rod():
    body, rod, start = straight(8, **CANTILEVER)
    r, length = CANTILEVER["radius"], CANTILEVER["length"]
    mass = CANTILEVER["density"] * np.pi * r**2 * length
    assert float(body.mass.sum()) == pytest.approx(mass)
    np.testing.assert_allclose(start.position[-1], length * np.array([0.0, 0.6, 0.8]), rtol=1e-14)
    middle = np.asarray(start.position[4])
    distances = np.sum((np.asarray(start.position) - middle) ** 2, axis=1)
    across = float(np.sum(moments_of(body)[:, 0] + np.asarray(body.mass) * distances))
    assert across == pytest.approx(mass * (3 * r**2 + length**2) / 12, rel=3.1 / 8**2)
    assert float(moments_of(body)[:, 2].sum()) == pytest.approx(mass * r**2 / 2)
    turn = np.asarray(ml.so3.to_matrix(start.attitude[3]))
    np.testing.assert_allclose(turn[:, [0, 2]].T, [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]], atol=1e-15)
    held = straight(8, clamped=True, **CANTILEVER)
    assert rod.clamp is None
    assert held.start.count == 8
    for many, fewer in zip(jax.tree.leaves((body, start)), jax.tree.leaves((held.body, held.start)), strict=True):
        np.testing.assert_array_equal(many[1:], fewer)


def twisting(elements, size):
    """A free rod that flies, turns, bends and twists."""
    body, rod, start = straight(elements)
    along = np.linspace(-1, 1, elements + 1)[:, None]
    momentum = body.momentum(jnp.asarray(size * np.array([0.4, -0.3, 2.0]) * (along + 0.2)))
    linear = body.mass[:, None] * jnp.asarray(size * np.array([0.5, 0.1, -0.2]) * (1 + along**2))
    return body, rod, ml.CoupledState(momentum, start.attitude, linear, start.position)


@pytest.mark.sample(0)
def test_momenta_are_conserved_to_rounding():
    body, rod, start = twisting(12, 1.0)
    path = ml.integrate("JACOBI[EA]", body, rod, start, dt=0.02, steps=400, save_every=100)
    assert bool(path.ok)
    linear, angular = np.sum(np.asarray(path.states.linear), axis=1), np.asarray(path.states.spatial_momentum())
    size = float(jnp.abs(start.linear).sum())
    np.testing.assert_allclose(linear - linear[0], 0, atol=1e-13 * size)
    np.testing.assert_allclose(angular - angular[0], 0, atol=1e-12 * size)
    assert float(jnp.linalg.norm(path.states.attitude[-1] - start.attitude)) > 0.3


def stiffness(rod, start):
    """The second derivative of the potential with turns and places of the bodies, (6 N, 6 N)."""
    count = start.count

    def moved(u):
        turns, places = jnp.split(u.reshape(count, 6), 2, axis=1)
        zeros = jnp.zeros((count, 3))
        return start.plus(jnp.concatenate([zeros, turns, zeros, places], axis=1).ravel())

    return -np.asarray(jax.jit(jax.jacfwd(lambda u: cat(rod(0.0, moved(u)))))(jnp.zeros(6 * count)))


def cat(wrench):
    return jnp.concatenate([wrench.torque, wrench.force], axis=1).ravel()


@pytest.mark.sample(0)
def test_the_cantilever_of_timoshenko():
    errors = []
    for count in (10, 20):
        _, rod, start = straight(count, clamped=True, **CANTILEVER)
        load = np.zeros((count, 6))
        load[-1, 3] = TIP_FORCE  # along x, which is e1
        moved = np.linalg.solve(stiffness(rod, start), load.ravel()).reshape(count, 6)
        errors.append(moved[-1, 3] - TIP)
    assert abs(errors[-1]) < 1e-3 * TIP
    assert abs(errors[1] - (errors[0] - errors[1]) / 3) < 1e-6 * TIP  # of second order, and the limit is TIP


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ml.molecules.Rod(-1.0, jnp.ones(3), jnp.ones(3)), "length must be positive and finite"),
        (lambda: ml.molecules.Rod(1.0, jnp.ones(2), jnp.ones(3)), r"stretch must have shape \(3,\)"),
        (
            lambda: ml.molecules.Rod(1.0, jnp.ones(3), jnp.ones(3), clamp=(jnp.zeros(3), jnp.ones(4))),
            r"clamp\[1\] must be a unit quaternion",
        ),
        (
            lambda: ml.molecules.Rod(jnp.ones(9), jnp.ones(3), jnp.ones(3))(0.0, straight(2)[2]),
            "one for each of 2, got",
        ),
        (
            lambda: straight(3)[1](0.0, ml.RigidState(jnp.zeros(3), jnp.eye(4)[0])),
            "the state is a RigidState; use a CoupledState",
        ),
        (lambda: straight(0), "elements must be a positive Python int"),
        (
            lambda: ml.molecules.straight_rod(2, [0.0, 0, 0], [0, 0, 1.0], [0, 0, 1.0], **SOFT),
            "normal must be at right angles",
        ),
    ],
)
def test_wrong_arguments_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
