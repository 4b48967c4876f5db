"""Every table of coefficients proved: its order, measured on two pendulums in extended precision, without JAX.

And force gradients: from a displaced torque they need no derivative, and are the gradient to first order.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import test_travel
import typed
from cases import benchmark, quick
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax.integrators import schemes
from midlie_jax.integrators.scheme import pendulums
from midlie_jax.integrators.system import System


def truth():
    """Momenta and angles of the pendulums at the end, by another program."""

    def rate(t, y):
        p, u = y[:2], y[2:]
        pull = np.cos(u[0] - u[1]) / 2
        return np.concatenate([-np.sin(u) - [pull, -pull], p / [1.0, 1.7]])

    return solve_ivp(rate, (0, 3), [0.3, 0.8, 0.7, -0.4], "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


# Those with a heat bath are in tests/test_heat.py.
TABLES = [name for name, scheme in schemes.SCHEMES.items() if not scheme.random]


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", TABLES)
def test_order(name):
    scheme = schemes.SCHEMES[name]
    assert abs(schemes.measured_order(scheme) - scheme.order) < 0.1
    assert scheme.symmetric == (scheme.order > 1)
    coarse, fine = (pendulums(scheme, count) for count in (192, 384))
    np.testing.assert_allclose(fine.astype(float), truth(), atol=max(1e-11, 2.0 * np.linalg.norm(fine - coarse)))


def test_takahashi_imada_is_of_order_four_between_its_processors():
    before = schemes.TAKAHASHI_IMADA_PROCESSOR
    after = tuple((kind, -x) for kind, x in reversed(before))
    processor = {"before": before, "after": after}
    assert abs(schemes.measured_order(schemes.TAKAHASHI_IMADA, **processor) - 4) < 0.1
    end = pendulums(schemes.TAKAHASHI_IMADA, 384, **processor)
    np.testing.assert_allclose(end.astype(float), truth(), atol=1e-8)


@pytest.mark.sample(0)
def test_a_table_whose_digits_are_wrong_is_refused():
    """Declared of order 4, and consistent with order 2 by its sums."""
    stages = schemes.BM4.stages
    moves = {0: 1e-3, 2: -1e-3, len(stages) - 3: -1e-3, len(stages) - 1: 1e-3}
    shifted = tuple((kind, x + moves.get(n, 0)) for n, (kind, x) in enumerate(stages))
    with pytest.raises(ValueError, match=r"'shifted' is declared of order 4, but an order of 2\.0 is measured"):
        schemes.Scheme("shifted", 4, shifted)
    assert schemes.Scheme("shifted", 2, shifted).order == 2


def test_a_name_of_the_package_is_taken():
    with pytest.raises(ValueError, match="midlie_jax has a scheme of this name; choose another name"):
        replace(schemes.SCHEMES["EA"])


K, F = schemes.KICK, schemes.FLIGHT


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stages": ((K, 0.6), (F, 1.0), (K, 0.5))}, "coefficients of its kicks must sum to 1, got 1.1"),
        ({"stages": ((K, 1.0), (F, 1.0))}, "declared of order 2, but an order of 1.0 is measured"),
        ({"order": 4}, "declared of order 4, but an order of 2.0 is measured"),
        ({"gradients": (np.nan, 0.0)}, "an order of nan is measured"),
        ({"small": 4}, "has small=4, but its kicks do not integrate polynomials of degree 3"),
        (
            {"stages": schemes.BM4.stages, "order": 4, "composed": True},
            "declared composed, but its kicks are not half the sum of the adjacent flights",
        ),
        ({"stages": ((K, 0.5), ("flies", 1.0), (K, 0.5))}, "must be made of 'kick', 'flight' and 'bath'"),
        ({"stages": ((K, 1.0),)}, "must be made of 'kick', 'flight' and 'bath', got 'kick'"),
        ({"gradients": (0.1,)}, "2 kicks and 1 gradients"),
        ({"displaced": True, "gradients": (0.0, 0.0)}, "no gradients to replace by a displaced torque"),
        ({"order": 0}, "order must be a positive integer"),
        ({"name": "a]"}, "name must be text without brackets"),
        ({"name": np.array(0.1)}, "name must be text without brackets"),
    ],
)
def test_a_table_that_cannot_be_right_is_refused(options, message, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    given = {"name": "made up", "order": 2, "stages": ((K, 0.5), (F, 1.0), (K, 0.5))} | options
    with pytest.raises(ValueError, match="scheme .*" + message):
        schemes.Scheme(**given)


@pytest.mark.parametrize("name", [name for name, scheme in schemes.SCHEMES.items() if scheme.small])
def test_order_where_forces_are_small(name):
    """To first order in the force a scheme is a quadrature of it along the free motion, exact to this degree."""
    scheme = schemes.SCHEMES[name]
    time, rule = 0.0, []
    for kind, x in scheme.stages:
        time += x if kind == schemes.FLIGHT else 0
        rule += [(x, time)] if kind == schemes.KICK else []
    defects = [abs(sum(b * c**k for b, c in rule) - 1 / (k + 1)) for k in range(scheme.small + 1)]
    assert max(defects[:-1]) < 1e-15
    assert defects[-1] > 1e-7


def test_methods_from_parts():
    by_name = ml.method("SLIEMID4[SRKN6b]")
    assert ml.method("SLIEMID4", "SRKN6b") == by_name
    assert ml.method(ml.flights.SymplecticMidpoint4(), ml.schemes.SRKN6B) == by_name
    assert ml.method("LIEMID", "EA") is ml.method("LIEMID[EA]")
    assert ml.method("linear", "KL8").order == 8
    with pytest.raises(ValueError, match="unknown scheme 'RK4'"):
        ml.method("DLM", "RK4")


def test_force_gradient_of_particles():
    """With a full mass matrix, on which the direction of the derivative depends."""
    body = ml.Particles(jnp.array([[1.0, 0.3], [0.3, 1.7]]))
    start = ml.ParticleState(jnp.array([0.3, 0.8]), jnp.array([0.7, -0.4]))

    def pull(t, state):
        bend = jnp.cos(state.position[0] - state.position[1]) / 2
        return -jnp.sin(state.position) - jnp.stack([bend, -bend])

    ends = [
        ml.integrate("linear[CHIN4A]", body, pull, start, dt=3 / n, steps=n, save_every=n).states.position[-1]
        for n in (24, 48, 96)
    ]
    assert abs(np.log2(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2])) - 4) < 0.1


@pytest.mark.parametrize("scheme", ["CHIN4A", *(s.name for s in schemes.SCHEMES.values() if s.displaced)])
def test_force_gradient_refuses_a_torque_of_the_momentum(scheme):
    body, start = ml.RigidBody(jnp.ones(3)), ml.RigidState(jnp.ones(3), jnp.array([1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="must not depend on the momentum under a scheme with force gradients"):
        ml.integrate(f"JACOBI[{scheme}]", body, ml.torques.Damping(0.1), start, dt=0.1, steps=1)


def test_uses_that_type_checkers_accept_run():
    assert typed.names == [*ml.flights.names(), *ml.schemes.names()]
    assert [method.name for method in typed.methods] == ["JACOBI[SRKN6b]", "DLM[EA]"]


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


SYSTEMS = {
    "attitude": (BODY, TORQUE, START),
    "direction": (BODY, TORQUE, ml.DirectionState(START.momentum, ml.so3.to_matrix(START.attitude)[2])),
    "compensated": (BODY, TORQUE, ml.CompensatedState(START.momentum, START.attitude)),
    "tensor": (ml.TensorBody(test_travel.TENSOR), TORQUE, START),
    "particles": (
        ml.Particles(jnp.array([1.0, 1.7])),
        lambda t, state: -jnp.sin(state.position) - jnp.cos(state.position[::-1]),
        ml.ParticleState(momentum=jnp.array([0.3, 0.8]), position=jnp.array([0.7, -0.4])),
    ),
    **{
        f"moving, {kind}": (of.body("float64"), test_travel.forced(1.3), test_travel.start(kind))
        for kind, of in test_travel.KINDS.items()
        if kind in ("free", "two")
    },
}


@pytest.mark.sample(2)
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
