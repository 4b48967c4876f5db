"""Force gradients from a displaced torque: what they need, how far they are from gradients, and what a step keeps."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import travel_cases
from cases import benchmark, epsilon, quick

import midlie_jax as ml
from midlie_jax.integrators import schemes
from midlie_jax.integrators.system import System

structure = benchmark("claims")

NAMES = [scheme.name for scheme in schemes.SCHEMES.values() if scheme.displaced]
BODY = ml.RigidBody([1.0, 2.0, 2.5])
TORQUE = ml.torques.HeavyTop(2.0, (0.48, 0.6, 0.64))
START = ml.RigidState([1.0, 0.8, -1.3], [0.5, 0.5, -0.5, 0.5])


@jax.custom_jvp
def without_derivative(vertical):
    return 2.0 * jnp.cross(vertical, jnp.array([0.48, 0.6, 0.64]))


@without_derivative.defjvp
def _refused(primals, tangents):
    raise NotImplementedError("this torque has no derivative")


def opaque(t, state):
    del t
    return without_derivative(ml.so3.to_matrix(state.attitude)[2])


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", NAMES)
def test_no_derivative_of_the_torque_is_taken(name):
    """A torque that refuses to be differentiated is stepped as any other; a scheme with gradients cannot."""
    run = {"dt": 0.05, "steps": 8, "save_every": 8}
    with pytest.raises(NotImplementedError, match="no derivative"):
        ml.integrate("JACOBI[CHIN4A]", BODY, opaque, START, **run)
    found, same = (ml.integrate(f"JACOBI[{name}]", BODY, torque, START, **run) for torque in (opaque, TORQUE))
    np.testing.assert_allclose(found.states.momentum, same.states.momentum, atol=1e-14)


@pytest.mark.parametrize("name", NAMES)
def test_a_torque_that_reads_the_momentum_is_refused(name):
    with pytest.raises(ValueError, match="must not depend on the momentum under a scheme with force gradients"):
        ml.integrate(f"JACOBI[{name}]", BODY, TORQUE + ml.torques.Damping(0.1), START, dt=0.1, steps=1)


DIRECTION = ml.DirectionState(START.momentum, ml.so3.to_matrix(START.attitude)[2])
SYSTEMS = {
    "attitude": (BODY, TORQUE, START),
    "direction": (BODY, TORQUE, DIRECTION),
    "compensated": (BODY, TORQUE, ml.CompensatedState(START.momentum, START.attitude)),
    "tensor": (ml.TensorBody(travel_cases.TENSOR), TORQUE, START),
    "particles": (
        ml.Particles(jnp.array([1.0, 1.7])),
        lambda t, state: -jnp.sin(state.position) - jnp.cos(state.position[::-1]),
        ml.ParticleState(momentum=jnp.array([0.3, 0.8]), position=jnp.array([0.7, -0.4])),
    ),
    **{
        f"moving, {kind}": (of.body("float64"), travel_cases.forced(1.3), travel_cases.start(kind))
        for kind, of in travel_cases.KINDS.items()
        if kind in ("free", "two")
    },
}


@pytest.mark.sample(4)
@pytest.mark.parametrize("kind", SYSTEMS)
def test_it_is_the_gradient_to_first_order(kind):
    """The force itself at weight zero; and for half the weight a quarter of the difference."""
    body, torque, state = SYSTEMS[kind]
    t = jnp.array(0.3)
    system = System.of(body, torque, state, t)
    motion = system.motion(state)

    @quick
    def forces(weight):
        return system.gradient_force(t, weight, motion), system.displaced_force(t, weight, motion)

    def numbers(tree):
        return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(tree)])

    gaps = []
    for weight in (0.01, 0.005):
        exact, found = map(numbers, forces(weight))
        gaps.append(np.linalg.norm(found - exact) / np.linalg.norm(exact - numbers(forces(0.0)[0])))
    assert gaps[1] < 0.1, gaps
    assert abs(np.log2(gaps[0] / gaps[1]) - 1) < 0.1, gaps  # relative to the gradient, which halves, too
    np.testing.assert_allclose(*map(numbers, forces(0.0)), atol=1e-14)


@cache
def step_of(name):
    def step(momentum, attitude, h):
        path = ml.integrate(name, BODY, TORQUE, ml.RigidState(momentum, attitude), dt=h, steps=1, save_every=1)
        return path.states.momentum[-1], path.states.attitude[-1]

    return quick(jax.vmap(step, (0, 0, None)))


def defect(name, h):
    around = structure.neighbours(np.asarray(START.momentum), np.asarray(START.attitude))
    momentum, attitude = step_of(name)(around.momentum, around.attitude, h)
    matrix = structure.derivative(ml.RigidState(momentum, attitude))
    return structure.symplectic_defect(matrix, START.momentum, momentum[0])


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", NAMES)
def test_the_symplectic_defect_of_a_step_is_of_fifth_order(name):
    """A kick h b T is off a potential's by h b times the square of the displacement, of order h^2."""
    found = [defect(f"JACOBI[{name}]", h) for h in (0.1, 0.05)]
    assert not ml.method(f"JACOBI[{name}]").symplectic
    assert abs(np.log2(found[0] / found[1]) - 5) < 0.3, found
    assert defect("JACOBI[CHIN4A]", 0.4) < 1e-11


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), list(zip(NAMES, ["float64", "float32"] * len(NAMES), strict=False)))
def test_the_momentum_about_the_vertical_is_kept(name, dtype):
    """To rounding, as under the torque itself, because the displaced torque is turned back."""
    steps, start = 1000, jax.tree.map(lambda x: x.astype(dtype), START)
    torque, body = jax.tree.map(lambda x: jnp.asarray(x, dtype), (TORQUE, BODY))
    path = ml.integrate(f"JACOBI[{name}]", body, torque, start, dt=0.1, steps=steps, save_every=10)
    states = jax.tree.map(lambda x: x.astype("float64"), path.states)
    vertical = np.asarray(ml.so3.rotate(states.attitude, states.momentum))[:, 2]
    assert np.abs(vertical - vertical[0]).max() < 16 * np.sqrt(steps) * epsilon(dtype)
