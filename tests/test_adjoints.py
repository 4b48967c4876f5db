"""The choices of `adjoint=`: what each costs in memory, and its limits; test_paths.py has the derivatives."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import test_gradient_references as references
from cases import loop_bodies, quick, real, setup, suited

import midlie_jax as ml
from midlie_jax.drivers import derivatives

CASE = setup()


def parameters(name, dtype="float64"):
    values = (suited(name, jnp.asarray(CASE.moments)), CASE.weight, CASE.momentum, CASE.attitude, CASE.dt)
    return tuple(jnp.asarray(value, dtype) for value in values)


def loss(name, adjoint, parameters, steps=48, save_every=16, axis=(0.48, 0.6, 0.64)):
    run = {"steps": steps, "save_every": save_every}
    return references.loss(name, *parameters, adjoint=adjoint, axis=axis, **run)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "bound"), [("float64", 4e-9), ("float32", 1.4e-3)])
def test_the_way_back_between_two_kept_states_is_right_to_the_stated_bound(dtype, bound):
    """Of tops that turn by up to a radian a step, over the longest distance that `Reversible` takes by itself."""
    steps = derivatives._FARTHEST[dtype]
    spins = jnp.linspace(0.2, 1.0, 64).astype(dtype)

    def there_and_back(spin):
        body, torque = ml.RigidBody(jnp.array([2.0, 2.0, 1.2], dtype)), ml.torques.HeavyTop(jnp.asarray(0.01, dtype))
        start = ml.RigidState(jnp.array([0.3, 0.2, 1.2], dtype) * spin, ml.so3.exp(jnp.array([0.5, 0.2, 0.0], dtype)))
        run = {"steps": steps, "save_every": steps}
        there = ml.integrate("SYMMETRIC[EA]", body, torque, start, dt=jnp.asarray(0.95, dtype), **run)
        end = jax.tree.map(lambda x: x[-1], there.states)
        back = ml.integrate("SYMMETRIC[EA]", body, torque, end, dt=jnp.asarray(-0.95, dtype), **run)
        pair = (back.states.attitude[-1].astype(float), start.attitude.astype(float))
        return ml.so3.log(ml.so3.multiply(ml.so3.conjugate(pair[1]), pair[0])), there.ok & back.ok

    turns, ok = real(jax.vmap(there_and_back))(spins)
    assert jnp.all(ok)
    assert jnp.linalg.norm(turns, axis=1).max() <= bound


@pytest.mark.sample(0)
def test_memory_of_the_way_back_does_not_grow_with_the_steps():
    def memory(adjoint, steps):
        gradient = jax.grad(partial(loss, "SYMMETRIC[EA]", adjoint, steps=steps, save_every=steps))
        return quick(gradient).lower(parameters("SYMMETRIC[EA]")).compile().memory_analysis().temp_size_in_bytes

    least = memory(ml.adjoints.Reversible(), 1600)
    assert memory(ml.adjoints.Reversible(), 160_000) <= 1.1 * least
    every_step = memory(ml.adjoints.Checkpointed(every=1), 160_000)
    assert every_step >= 50 * least
    assert memory(ml.adjoints.Checkpointed(every=400), 160_000) <= every_step / 50
    # By default a state of ten numbers every 100 steps, and the seven that each step between two of them needs.
    assert memory(ml.adjoints.Checkpointed(), 160_000) <= every_step / 30
    assert memory(ml.adjoints.Checkpointed(), 1024) == memory(ml.adjoints.Checkpointed(every=1), 1024)
    assert memory(ml.adjoints.Checkpointed(), 1600) < memory(ml.adjoints.Checkpointed(every=1), 1600)


@pytest.mark.parametrize(("save_every", "every"), [(1024, 64), (2000, 100), (103, 103), (7, 1), (10_007, 1), (8, 8)])
def test_the_steps_between_two_kept_states_divide_those_between_two_saved_ones(save_every, every):
    """Of a state of ten numbers, in a long run; a run of 1024 steps keeps all states."""
    assert derivatives._every(save_every, 20_000, 10) == every
    assert derivatives._every(save_every, 1024, 10) == 1


@pytest.mark.sample(0)
def test_seven_numbers_are_kept_of_a_step_that_begins_with_a_kick():
    """Momentum and attitude; neither the force of the last step nor the momentum before the kick."""

    def memory(steps):
        def end(momentum):
            given = parameters("SYMMETRIC[EA]")
            return loss(
                "SYMMETRIC[EA]", ml.adjoints.Checkpointed(every=1), (*given[:2], momentum, *given[3:]), steps, steps
            )

        momentum = jnp.asarray(CASE.momentum)
        return quick(jax.grad(end)).lower(momentum).compile().memory_analysis().temp_size_in_bytes

    numbers = (memory(32_000) - memory(16_000)) / 16_000 / 8
    assert numbers <= 7.6  # with the index of the step, an integer of four bytes


@pytest.mark.sample(0)
@pytest.mark.parametrize("adjoint", [ml.adjoints.Checkpointed(every=8), ml.adjoints.Reversible()])
def test_a_shared_parameter_has_the_sum_of_the_derivatives_of_all_bodies(adjoint):
    """First and second; of a top whose torque has a component that is always zero."""
    momenta = jnp.asarray(CASE.momentum * np.linspace(0.9, 1.1, 5)[:, None])
    given = parameters("SYMMETRIC[EA]")

    def one(weight, momentum):
        parts = (jnp.asarray([2.0, 2.0, 2.5]), weight, momentum, *given[3:])
        return loss("SYMMETRIC[EA]", adjoint, parts, steps=32, save_every=16, axis=(0.0, 0.0, 1.0))

    def of_all(weight):
        return jnp.sum(jax.vmap(one, (None, 0))(weight, momenta))

    def derivatives(function):
        return lambda *arguments: (jax.grad(function)(*arguments), jax.grad(jax.grad(function))(*arguments))

    shared = quick(derivatives(of_all))(given[1])
    each_body = quick(jax.vmap(derivatives(one), (None, 0)))(given[1], momenta)
    for found, parts in zip(shared, each_body, strict=True):
        assert jnp.max(jnp.abs(parts)) > 1e-4
        assert abs(found - jnp.sum(parts)) <= 1e-12 * jnp.sum(jnp.abs(parts))


def damping(t, state):
    del t
    return -0.1 * state.momentum


@pytest.mark.parametrize(
    ("method", "torque", "adjoint", "message"),
    [
        ("RK4", None, ml.adjoints.Reversible(), "RK4 is not one"),
        ("JACOBI[EA]", damping, ml.adjoints.Reversible(), "does not read the momentum"),
        ("JACOBI[EA]", None, ml.adjoints.Reversible(every=5), r"save_every \(16\) must be divisible by every \(5\)"),
        ("JACOBI[EA]", None, ml.adjoints.Checkpointed(every=3), r"save_every \(16\) must be divisible by every \(3\)"),
    ],
)
def test_what_has_no_derivative_is_refused(method, torque, adjoint, message):
    start = ml.RigidState(jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    run = {"dt": 0.01, "steps": 32, "save_every": 16, "adjoint": adjoint}
    with pytest.raises(ValueError, match=message):
        ml.integrate(method, ml.RigidBody([1.0, 2.0, 2.5]), torque, start, **run)


@pytest.mark.parametrize("every", [0, -1, True])
@pytest.mark.parametrize("adjoint", [ml.adjoints.Checkpointed, ml.adjoints.Reversible])
def test_every_is_a_positive_integer(adjoint, every):
    with pytest.raises(ValueError, match="every must be a positive"):
        adjoint(every=every)


@pytest.mark.sample(0)
def test_forward_mode_alone_refuses_reverse_mode():
    with pytest.raises(ValueError, match="has no reverse derivative"):
        jax.grad(partial(loss, "SYMMETRIC[EA]", ml.adjoints.Forward()))(parameters("SYMMETRIC[EA]"))


BATCH = 1003  # a number that nothing else in the program has
SUN = jnp.array([1.0, 0.0, 0.0])
SIDEWAYS = jnp.array([0.0, 1.1, 0.0])
SURFACE = ml.Surface.ellipsoid([3.0, 2.0, 1.0], 80)
TORQUES = {
    "an orbit": lambda mu: ml.spacecraft.GravityGradient(None, ml.orbits.KeplerOrbit(SUN, SIDEWAYS, mu), mu),
    "facets": lambda flux: ml.asteroids.Sunlight(SURFACE, SUN, flux, 0.3, 0.3, 0.2),
    "a bath": lambda number: ml.torques.HeavyTop(number),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("kind", TORQUES)
def test_a_run_computes_nothing_anew_for_each_body_that_all_share(kind):
    """Without a derivative its program is that of a run that has no reverse derivative."""

    def end(adjoint, number, momentum):
        method, body = "JACOBI[BAOAB]" if kind == "a bath" else "JACOBI[EA]", ml.RigidBody([1.0, 1.8, 2.3])
        start = ml.RigidState(momentum, jnp.asarray(CASE.attitude))
        run = {"dt": 0.05, "steps": 8, "save_every": 8, "adjoint": adjoint}
        if kind == "a bath":
            run["bath"] = ml.baths.Langevin(number, number, jax.random.key(0))
        return ml.integrate(method, body, TORQUES[kind](number), start, **run).states.momentum[-1]

    def size(adjoint):
        run = real(jax.vmap(partial(end, adjoint), (None, 0)))
        program = run.lower(jnp.asarray(0.3), jnp.ones((BATCH, 3))).compile()
        return program.as_text().count(f"[{BATCH}"), program.memory_analysis().temp_size_in_bytes

    assert size(ml.adjoints.Checkpointed()) == size(ml.adjoints.Forward())


@pytest.mark.sample(0)
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize(("name", "loops"), [("SYMMETRIC[EA]", 1), ("JACOBI[EA]", 2)])
def test_the_reverse_derivative_of_a_step_is_few_loops(name, loops, shared):
    """Without those that only add up what a step contributes to the derivatives of parameters.

    A long flight has its own loop, so that gradients by many parameters do not repeat it. The same holds for parameters
    that all bodies share.
    """
    moments, weight, _, *rest = parameters(name)

    def end(parts, momentum):
        return loss(name, ml.adjoints.Checkpointed(), (*parts, momentum, *rest), steps=8, save_every=8)

    def of_each(momenta):
        return jax.vmap(jax.grad(end), (None, 0))((moments, weight), momenta)

    def of_all(momenta):
        return jax.grad(lambda parts: jnp.sum(jax.vmap(end, (None, 0))(parts, momenta)))((moments, weight))

    momenta = jnp.asarray(CASE.momentum * np.linspace(0.9, 1.1, BATCH)[:, None])
    text = real(of_all if shared else of_each).lower(momenta).compile().as_text()
    assert not any(re.search(rf" = f64\[\]\S* .*(fusion|reduce)\(.*{BATCH}", body) for body in loop_bodies(text))
    fused = [re.findall(rf"%([a-z_]+)_fusion\S* = .*\[{BATCH}\].* fusion\(", body) for body in loop_bodies(text)]
    assert max(fusions.count("broadcast_reduce") for fusions in fused) <= 2 * loops
    # What is not: sums, and copies of kept states.
    others = {"broadcast_reduce", "add_add", "bitcast_dynamic-update-slice"}
    assert max(len([name for name in fusions if name not in others]) for fusions in fused) <= 6
