"""The parameters of a fit: each map is one-to-one onto the physical values of its kind."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import turn

from midlie_jax.fitting.parameters import Free, InertiaTensor, Moments, Positive, UnitQuaternion, UnitVector

TENSOR = np.array([[3.0, 0.2, -0.1], [0.2, 2.5, 0.3], [-0.1, 0.3, 1.8]])
PARAMETERS = {
    "moments": Moments([1.0, 2.0, 2.5]),
    "ratios": Moments([1.0, 2.0, 2.5], scale="fixed"),
    "tensor": InertiaTensor(TENSOR),
    "tensor up to a factor": InertiaTensor(TENSOR, scale="fixed"),
    "positive": Positive([0.3, 20.0]),
    "free": Free([[0.5, -2.0], [0.0, 7.0]]),
    "direction": UnitVector([0.6, 0.0, -0.8]),
    "quaternion": UnitQuaternion(turn(0.4, -1.0, 0.3)),
}


def of_a_body(tensor):
    """Whether a tensor is the inertia of masses: the second moments are positive definite."""
    return np.all(np.linalg.eigvalsh(np.trace(tensor) / 2 * np.eye(3) - tensor) > 0)


PHYSICAL = {
    Moments: lambda value: of_a_body(np.diag(value)),
    InertiaTensor: of_a_body,
    Positive: lambda value: np.all(value > 0),
    Free: lambda value: np.all(np.isfinite(value)),
    UnitVector: lambda value: abs(np.linalg.norm(value) - 1) < 1e-12,
    UnitQuaternion: lambda value: abs(np.linalg.norm(value) - 1) < 1e-12,
}


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_is_one_to_one_onto_physical_values(name):
    parameter = PARAMETERS[name]
    np.testing.assert_allclose(parameter.value(parameter.vector()), parameter.initial, rtol=1e-13, atol=1e-14)
    assert len(parameter.unconstrained_labels()) == parameter.vector().size
    assert len(parameter.labels()) == parameter.coordinates(parameter.initial).size
    rng = np.random.default_rng(1)
    for _ in range(20):
        vector = jnp.asarray(rng.uniform(-1.7, 1.7, parameter.vector().shape))
        value = parameter.value(vector)
        assert PHYSICAL[type(parameter)](np.asarray(value))
        if isinstance(parameter, UnitVector):  # the angle from the guess is the length of the vector
            cosine = np.dot(np.asarray(value), np.asarray(parameter.initial))
            np.testing.assert_allclose(cosine, np.cos(np.linalg.norm(vector)), rtol=0, atol=1e-12)
            continue
        again = eqx.tree_at(lambda p: p.initial, parameter, value).vector()
        found = parameter.coordinates(value) if isinstance(parameter, UnitQuaternion) else again
        np.testing.assert_allclose(found, vector, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", ["moments", "ratios", "tensor", "tensor up to a factor"])
def test_moments_far_from_the_guess_are_still_those_of_a_body(name):
    """Moments that cannot be told from a flat body's in float64 may fail the inequality by rounding, but no more."""
    parameter = PARAMETERS[name]
    for seed in range(20):
        vector = jnp.asarray(np.random.default_rng(seed).uniform(-12, 12, parameter.vector().shape))
        value = np.asarray(parameter.value(vector))
        moments = value if value.ndim == 1 else np.linalg.eigvalsh(value)
        assert np.all(moments > 0)
        assert 2 * moments.max() <= moments.sum() * (1 + 1e-14)


def test_a_fixed_scale_keeps_the_sum_of_the_moments():
    vector = jnp.array([0.7, -1.3])
    np.testing.assert_allclose(jnp.sum(PARAMETERS["ratios"].value(vector)), 5.5, rtol=1e-14)
    five = jnp.array([0.7, -1.3, 0.1, 0.2, -0.3])
    tensor = PARAMETERS["tensor up to a factor"].value(five)
    np.testing.assert_allclose(np.trace(tensor), np.trace(TENSOR), rtol=1e-14)


def test_a_direction_changes_at_first_by_the_angle_and_perpendicular_to_the_guess():
    """At the guess, where an optimiser starts, and a little beside it, where the series end."""
    direction = PARAMETERS["direction"]
    guess = np.asarray(direction.initial)
    for at in (np.zeros(2), np.array([0.99e-4, 0.0]), np.array([1.01e-4, 0.0])):
        slopes = np.asarray(jax.jacfwd(direction.value)(jnp.asarray(at)))
        np.testing.assert_allclose(slopes.T @ slopes, np.eye(2), rtol=0, atol=1e-8)
        np.testing.assert_allclose(guess @ slopes, [-np.sin(at[0]), 0], rtol=0, atol=1e-9)
    assert direction.unconstrained_labels() == ["[1]", "[0]"]
