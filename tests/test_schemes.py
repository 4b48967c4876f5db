"""Every table of coefficients proved: its order, measured on a pendulum pair in extended precision, without JAX.

Then some with flights of rigid bodies: the lower of the two orders, or the scheme's where steps are composed.
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from cases import at, rows, run, setup, true_motion, turn
from scipy.integrate import solve_ivp

import midlie_jax as ml
from midlie_jax import schemes

MASS = np.array([1.0, 1.7], np.longdouble)
PLACE, PUSH = np.array([0.7, -0.4], np.longdouble), np.array([0.3, 0.8], np.longdouble)


def force(u):
    """Minus the gradient of -cos u0 - cos u1 + sin(u0 - u1)/2, far from quadratic."""
    pull = np.cos(u[0] - u[1]) / 2
    return -np.sin(u) - np.array([pull, -pull])


def derivative(u, w):
    """Of the force along w."""
    bend = np.sin(u[0] - u[1]) / 2 * (w[0] - w[1])
    return -np.cos(u) * w + np.array([bend, -bend])


def steps(scheme, count, strength=1, before=(), after=()):
    """All of `count` steps to time 3, with stages to apply once before and after them."""
    h = np.longdouble(3) / count

    def fly(a, m):
        return m[0], m[1] + a * h * m[0] / MASS

    def kick(b, c, m, f):
        return m[0] + b * h * f, m[1]

    def evaluate(c, g, m):
        plain = strength * force(m[1])
        return plain + 2 * g * h * h * strength * derivative(m[1], plain / MASS) if g else plain

    def apply(stages, motion):
        for kind, x in stages:
            motion = fly(x, motion) if kind == schemes.FLIGHT else kick(x, 0, motion, evaluate(0, 0, motion))
        return motion

    motion, kept = apply(before, (PUSH, PLACE)), None
    for _ in range(count):
        motion, kept = schemes.run(scheme, fly, kick, evaluate, motion, kept if scheme.reuses_force else None)
    return np.concatenate(apply(after, motion))


def truth():
    def rate(t, y):
        return np.concatenate([force(y[2:]), y[:2] / MASS.astype(float)])

    start = np.concatenate([PUSH, PLACE]).astype(float)
    return solve_ivp(rate, (0, 3), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


def measured(scheme, order, counts=(24, 48, 96, 192, 384), **options):
    """The slope, with the ends of the runs it is from, where it is the expected one, or else at the smallest steps."""
    for count in counts:
        ends = [steps(scheme, count * factor, **options) for factor in (1, 2, 4)]
        slope = np.log2(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2]))
        if abs(slope - order) < 0.1:
            break
    return slope, ends


@pytest.mark.parametrize("name", schemes.SCHEMES)
def test_order(name):
    """By differences of runs at h, h/2, h/4, which need no other solution."""
    scheme = schemes.SCHEMES[name]
    slope, ends = measured(scheme, scheme.order)
    assert abs(slope - scheme.order) < 0.1, slope
    assert np.linalg.norm(ends[1] - ends[2]) > 1e3 * np.finfo(np.longdouble).eps  # not the slope of rounding
    np.testing.assert_allclose(ends[2].astype(float), truth(), atol=max(1e-11, 2.0 * np.linalg.norm(ends[2] - ends[1])))


@pytest.mark.parametrize("name", schemes.SCHEMES)
def test_coefficients_sum_to_one_and_read_the_same_backwards(name):
    scheme = schemes.SCHEMES[name]
    for kind in (schemes.KICK, schemes.FLIGHT):
        assert sum(c for k, c in scheme.stages if k == kind) == pytest.approx(1, abs=1e-13)
    assert scheme.symmetric == (scheme.order > 1)


def test_takahashi_imada_is_of_order_four_between_its_processors():
    before = schemes.TAKAHASHI_IMADA_PROCESSOR
    after = tuple((kind, -x) for kind, x in reversed(before))
    slope, ends = measured(schemes.TAKAHASHI_IMADA, 4, before=before, after=after)
    assert abs(slope - 4) < 0.1, slope
    np.testing.assert_allclose(ends[2].astype(float), truth(), atol=1e-8)


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


# Each flight and each scheme with the fewest flights that show its order.
ROTATIONS = {
    "SLIEMID[EA]": 2,
    "SLIEMID4[EA]": 2,
    "JACOBI[CHIN4A]": 4,
    "NEARSYM[EA]": 2,
    "DLM[EA]": 2,
    "DLM[TJ4]": 4,
    "DMV[EA]": 2,
    "DMV4[CHIN4A]": 4,
    "SYMMETRIC[TI]": 2,
    "SYMMETRIC[ABA82]": 2,
    "SYMMETRIC[ABA1064]": 4,
    "SYMMETRIC[SRKN11b]": 6,
}
UP = (0.0, 0.0, 1.0)
LEVELS = (2, 4, 8, 16, 32, 64)
P1 = {"moments": [5, 5, 1], "weight": 20, "strength": 0, "momentum": [0, 0, 50], "attitude": turn(0.05, 0, 0)}
TOP = {"moments": [1, 2, 3], "weight": 3, "strength": 0, "momentum": [1.1, -0.7, 4]}
TOP["attitude"] = np.array([0.8, 0.3, -0.4, 0.33]) / np.linalg.norm([0.8, 0.3, -0.4, 0.33])
SCENES = ((P1, 0.4), (TOP, 0.5), ({}, 1.0))  # the last: a torque that depends on time as well


@cache
def end_of(scene, symmetric):
    changes, span = SCENES[scene]
    return [
        part[0]
        for part in true_motion(setup(**{**changes, **symmetric_moments(scene, symmetric)}), np.array([span]), UP)
    ]


def symmetric_moments(scene, symmetric):
    return {"moments": [1.5, 1.5, 2.5]} if symmetric and scene else {}


@pytest.mark.parametrize("name", ROTATIONS)
def test_order_on_a_forced_body(name):
    """Momentum and attitude of three tops, at the smallest steps whose error is far above that of the truth."""
    method, order = ml.method(name), ROTATIONS[name]
    assert (method.name, method.order, method.symmetric) == (name, order, True)
    symmetric = name.startswith("SYMMETRIC")
    starts = [
        setup(**{**changes, **symmetric_moments(scene, symmetric)}, dt=span / count)
        for scene, (changes, span) in enumerate(SCENES)
        for count in LEVELS
    ]
    found = run(name, "float64", rows(*starts), steps=64, axis=UP)
    slopes = []
    for scene in range(len(SCENES)):
        exact = end_of(scene, symmetric)
        first = scene * len(LEVELS)
        assert np.all(found.ok[first + len(LEVELS) - 2 : first + len(LEVELS)])  # the coarsest may turn too far
        states = [at(found.states, first + level, count) for level, count in enumerate(LEVELS)]
        errors = np.array(
            [[np.linalg.norm(s[k] - exact[k]) / np.linalg.norm(exact[k]) for k in (0, 1)] for s in states]
        )
        clear = errors[np.all(errors > 3e-12, axis=1) & found.ok[first : first + len(LEVELS)]]
        slopes += [np.log2(clear[-2] / clear[-1])] if len(clear) > 1 else []
    assert slopes
    assert np.all(np.abs(np.array(slopes) - order) < 0.25), slopes


def test_methods_from_parts():
    by_name = ml.method("SLIEMID4[SRKN6b]")
    assert ml.method("SLIEMID4", "SRKN6b") == by_name
    assert ml.method(ml.flights.SymplecticMidpoint4(), ml.schemes.SRKN6B) == by_name
    assert ml.method("LIEMID", "EA") is ml.method("LIEMID[EA]")
    assert ml.method("linear", "KL8").order == 8
    for bad in ("SLIEMID4[RK4]", "SLIEMID9[EA]", "SLIEMID4"):
        with pytest.raises(ValueError, match=r"unknown method.*FLIGHT\[SCHEME\].*SRKN6b"):
            ml.method(bad)
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
    with pytest.raises(ValueError, match="force gradients needs a torque from a potential"):
        ml.integrate("JACOBI[CHIN4A]", body, drag, start, dt=0.1, steps=1)
