"""What every kind of state has beside its motion: increments, sizes of differences, and what files say of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from path_scenes import STATES

import midlie_jax as ml

RNG = np.random.default_rng(4)


def some(kind, *batch):
    """States at random."""

    def unit(size):
        values = RNG.normal(size=(*batch, size))
        return jnp.asarray(values / np.linalg.norm(values, axis=-1, keepdims=True))

    momentum = jnp.asarray(RNG.normal(size=(*batch, 3)))
    pose = {ml.MomentumState: (), ml.DirectionState: (unit(3),), ml.ParticleState: (momentum[::-1],)}
    return kind(momentum, *pose.get(kind, (unit(4),)))


KINDS = [ml.MomentumState, ml.DirectionState, ml.RigidState, ml.CompensatedState]


def same(one, other):
    """Whether two states are, up to the sign of a quaternion and to rounding."""
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        sign = jnp.sign(jnp.sum(x * y, axis=-1, keepdims=True)) if x.shape[-1] == 4 else 1
        np.testing.assert_allclose(x, jnp.where(sign == 0, 1, sign) * y, atol=2e-14)


@pytest.mark.parametrize(("kind", "batch"), [*zip(KINDS, [(), (6,), (2, 3), ()], strict=True)])
def test_an_increment_leads_from_one_state_to_the_other(kind, batch):
    one, other = some(kind, *batch), some(kind, *batch)
    same(other.plus(one.minus(other)), one)
    increment = jnp.asarray(RNG.normal(size=one.minus(other).shape)) * 0.9
    np.testing.assert_allclose(one.plus(increment).minus(one), increment, atol=1e-13)
    same(one.plus(jnp.zeros_like(increment)), one)


def test_particles_have_increments_of_all_their_numbers():
    one, other = some(ml.ParticleState, 2), some(ml.ParticleState, 2)
    assert one.minus(other).shape == (12,)
    same(other.plus(one.minus(other)), one)


@pytest.mark.parametrize("kind", KINDS)
def test_the_size_of_a_small_difference_is_that_of_the_increment(kind):
    """Of a quaternion twice its change; in radians."""
    one = some(kind)
    increment = jnp.asarray(RNG.normal(size=one.minus(one).shape)) * 1e-6
    difference = jax.tree.map(jnp.subtract, one.plus(increment), one)
    momentum, angle = difference.kind.sizes(difference)
    assert momentum == pytest.approx(float(jnp.linalg.norm(increment[:3])), rel=1e-4)
    assert angle == pytest.approx(float(jnp.linalg.norm(increment[3:])), rel=1e-4)


@pytest.mark.parametrize("state", [name for name, (body, _) in STATES.items() if not isinstance(body, ml.spins.Spins)])
def test_a_state_from_velocities_has_these_velocities(state):
    body, start = STATES[state]
    first, *others = (getattr(start, field.name) for field in dataclasses.fields(start))
    if isinstance(start, ml.AxisState | ml.FreeAxisState):
        first = first - jnp.sum(first * start.axis, axis=-1, keepdims=True) * start.axis
    velocity = body.turning.velocity(first)
    if start.kind.rotation is not None:
        others[1] = others[1] / jnp.asarray(body.mass)[..., None]
    made = type(start).from_velocity(body, velocity, *others)
    expected = [first, *(getattr(start, field.name) for field in dataclasses.fields(start)[1:])]
    for field, value in zip(dataclasses.fields(start), expected, strict=True):
        np.testing.assert_allclose(getattr(made, field.name), value, rtol=1e-13, atol=1e-13)


def test_a_spin_needs_its_moment():
    axis, velocity = [0.0, 0.6, 0.8], jnp.array([0.3, -0.2, 1.5])
    with pytest.raises(ValueError, match="velocity has a part along the axis"):
        ml.AxisState.from_velocity(ml.SymmetricRotor(2.0), velocity, axis)
    made = ml.AxisState.from_velocity(ml.SymmetricRotor(2.0, 0.5), velocity, axis)
    along = jnp.sum(velocity * jnp.array(axis)) * jnp.array(axis)
    np.testing.assert_allclose(made.momentum, 2.0 * (velocity - along) + 0.5 * along, rtol=1e-14)
    with pytest.raises(ValueError, match="body must be a SymmetricRotor"):
        ml.AxisState.from_velocity(ml.RigidBody([2.0, 2.0, 0.5]), velocity, axis)
    with pytest.raises(ValueError, match="body must be"):
        ml.spins.SpinState.from_velocity(ml.RigidBody([1.0, 2.0, 2.5]), jnp.ones(3))


def test_joined_bodies_are_the_body_of_all_their_points():
    """Bodies made of point masses, joined in any position and attitude: the same as all points at once."""
    rng = np.random.default_rng(3)
    parts, masses, places = [], [], []
    for _ in range(3):
        mass, points = rng.uniform(1, 2, 5), rng.normal(size=(5, 3))
        points -= mass @ points / mass.sum()
        tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, points, strict=True))
        attitude, position = ml.so3.exp(jnp.asarray(rng.normal(size=3))), rng.normal(size=3)
        parts.append((ml.TensorBody(tensor), mass.sum(), position, attitude))
        masses.append(mass)
        places.append(points @ np.asarray(ml.so3.to_matrix(attitude)).T + position)
    parts.append((None, 1.7, [0.3, -1.0, 2.0]))
    mass, points = np.append(np.concatenate(masses), 1.7), np.concatenate([*places, [[0.3, -1.0, 2.0]]])
    body, centre = ml.FreeBody.joined(parts)
    assert isinstance(body.body, ml.TensorBody)
    np.testing.assert_allclose(centre, mass @ points / mass.sum(), rtol=1e-12)
    points = points - np.asarray(centre)
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, points, strict=True))
    np.testing.assert_allclose(body.body.tensor, tensor, rtol=1e-12, atol=1e-12)
    with pytest.raises(ValueError, match=r"parts\[0\] must begin with"):
        ml.FreeBody.joined([(ml.SymmetricRotor(1.0), 1.0, [0.0, 0.0, 0.0])])
    for wrong in ([], [(None, 1.0)]):
        with pytest.raises(ValueError, match="parts must be one or more"):
            ml.FreeBody.joined(wrong)
