"""What every kind of state has beside its motion: increments, sizes of differences, and what files say of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

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


@pytest.mark.sample(3)
@pytest.mark.parametrize("batch", [(), (6,), (2, 3)])
@pytest.mark.parametrize("kind", KINDS)
def test_an_increment_leads_from_one_state_to_the_other(kind, batch):
    one, other = some(kind, *batch), some(kind, *batch)
    same(other.plus(one.minus(other)), one)
    increment = jnp.asarray(RNG.normal(size=one.minus(other).shape)) * 0.9
    np.testing.assert_allclose(one.plus(increment).minus(one), increment, atol=1e-13)
    same(one.plus(jnp.zeros_like(increment)), one)


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", KINDS)
def test_increments_have_derivatives_at_zero(kind):
    """Where every fit by multiple shooting begins."""
    one = some(kind)
    zero = jnp.zeros_like(one.minus(one))
    found = jax.jacfwd(lambda increment: one.plus(increment).minus(one))(zero)
    np.testing.assert_allclose(found, np.eye(len(zero)), atol=1e-12)


def test_opposite_directions_are_half_a_turn_apart():
    one = some(ml.DirectionState, 4)
    other = ml.DirectionState(one.momentum, -one.direction)
    increment = other.minus(one)
    np.testing.assert_allclose(jnp.linalg.norm(increment[:, 3:], axis=-1), np.pi, atol=1e-12)
    same(one.plus(increment), other)


def test_particles_have_increments_of_all_their_numbers():
    one = ml.ParticleState(jnp.ones((2, 3)), jnp.zeros((2, 3)))
    other = ml.ParticleState(jnp.zeros((2, 3)), jnp.arange(6.0).reshape(2, 3))
    assert one.minus(other).shape == (12,)
    same(other.plus(one.minus(other)), one)


@pytest.mark.parametrize("kind", KINDS)
def test_the_size_of_a_small_difference_is_that_of_the_increment(kind):
    """Of a quaternion twice its change; in radians."""
    one = some(kind)
    increment = jnp.asarray(RNG.normal(size=one.minus(one).shape)) * 1e-6
    difference = jax.tree.map(jnp.subtract, one.plus(increment), one)
    momentum, angle = difference.sizes()
    assert momentum == pytest.approx(float(jnp.linalg.norm(increment[:3])), rel=1e-4)
    assert angle == pytest.approx(float(jnp.linalg.norm(increment[3:])), rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_lengths_are_restored_and_nothing_else_is_changed(kind):
    one = some(kind, 5)
    longer = jax.tree.map(lambda x: x * 1.1, one)
    again = longer.normalised()
    np.testing.assert_array_equal(again.momentum, longer.momentum)
    for x, y in zip(jax.tree.leaves(again)[1:2], jax.tree.leaves(one)[1:2], strict=True):
        np.testing.assert_allclose(x, y, atol=1e-15)


@pytest.mark.parametrize("kind", [*KINDS, ml.ParticleState])
def test_files_say_what_each_array_is(kind):
    described = kind.described()
    assert list(described) == [field.name for field in dataclasses.fields(kind)]
    assert all({"long_name", "units", "frame"} <= attributes.keys() for _, attributes in described.values())
