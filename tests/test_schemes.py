"""Every table of coefficients proved: its order, measured on two pendulums in extended precision, without JAX.

Then some with flights of rigid bodies: the lower of the two orders, or the scheme's where steps are composed.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import typed
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax.integrators import schemes
from midlie_jax.integrators.scheme import pendulums


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
    coarse, fine = (pendulums(scheme, count) for count in (192, 384))
    np.testing.assert_allclose(fine.astype(float), truth(), atol=max(1e-11, 2.0 * np.linalg.norm(fine - coarse)))


@pytest.mark.parametrize("name", TABLES)
def test_a_table_reads_the_same_backwards_if_its_order_is_even(name):
    assert schemes.SCHEMES[name].symmetric == (schemes.SCHEMES[name].order > 1)


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
    shifted = tuple(
        (kind, x + (1e-3 if n in (0, len(stages) - 1) else -1e-3 if n in (2, len(stages) - 3) else 0))
        for stages in [schemes.BM4.stages]
        for n, (kind, x) in enumerate(stages)
    )
    with pytest.raises(ValueError, match=r"'shifted' is declared of order 4, but an order of 2\.0 is measured"):
        schemes.Scheme("shifted", 4, shifted)
    assert schemes.Scheme("shifted", 2, shifted).order == 2


@pytest.mark.parametrize("name", schemes.SCHEMES)
def test_a_name_of_the_package_is_taken(name):
    with pytest.raises(ValueError, match="midlie_jax has a scheme of this name; choose another name"):
        replace(schemes.SCHEMES[name])


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
    ],
)
def test_a_table_that_cannot_be_right_is_refused(options, message):
    given = {"name": "made up", "order": 2, "stages": ((K, 0.5), (F, 1.0), (K, 0.5))} | options
    with pytest.raises(ValueError, match="scheme 'made up'.*" + message):
        schemes.Scheme(**given)


@pytest.mark.parametrize("name", ["", "a]", "JACOBI[mine"])
def test_a_name_that_cannot_stand_in_brackets_is_refused(name):
    with pytest.raises(ValueError, match=r"scheme .*name must be text without brackets"):
        schemes.Scheme(name, 2, schemes.EA.stages)


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
        del t
        bend = jnp.cos(state.position[0] - state.position[1]) / 2
        return -jnp.sin(state.position) - jnp.stack([bend, -bend])

    ends = [
        ml.integrate("linear[CHIN4A]", body, pull, start, dt=3 / n, steps=n, save_every=n).states.position[-1]
        for n in (24, 48, 96)
    ]
    assert abs(np.log2(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2])) - 4) < 0.1


def test_force_gradient_refuses_a_torque_of_the_momentum():
    body, start = ml.RigidBody(jnp.ones(3)), ml.RigidState(jnp.ones(3), jnp.array([1.0, 0.0, 0.0, 0.0]))
    drag = ml.torques.VelocityDependent(lambda t, state: -state.momentum)
    with pytest.raises(ValueError, match="must not depend on the momentum under a scheme with force gradients"):
        ml.integrate("JACOBI[CHIN4A]", body, drag, start, dt=0.1, steps=1)


def test_uses_that_type_checkers_accept_run():
    assert typed.names == [*ml.flights.names(), *ml.schemes.names()]
    assert [method.name for method in typed.methods] == ["JACOBI[SRKN6b]", "DLM[EA]"]
