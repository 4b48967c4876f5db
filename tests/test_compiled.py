"""What the compiler makes of a step: read from the compiled HLO, so that a lost fusion fails here."""

import re

import diffrax
import jax
import jax.numpy as jnp
import pytest
from cases import METHODS, by_turns, loop_bodies, real, suited

import midlie_jax as ml
from midlie_jax.advice.timing import timed_in_turn
from midlie_jax.integrators.implicit import Implicit, NewmarkBody
from midlie_jax.integrators.runge_kutta import RungeKutta
from midlie_jax.integrators.splitting import Splitting

BATCH = 517  # a number that nothing else in the program has

BODY = (2.0, 3.0, 4.0)


def loops_of(method):
    """How many loops over the batch a step should be.

    A solve and a loop over stages stand between one loop before and one after; see midlie_jax/_math/newton.py.
    """
    if isinstance(method, Splitting):
        ends = 1 if method.scheme.stages[0][0] == ml.schemes.FLIGHT else 1 if method.flight.per_loop > 2 else 2
        return 2 + ends if method.loops else 1
    if isinstance(method, RungeKutta):
        return 2 if method.projects and method.order > 8 else 1
    return 3 if isinstance(method, Implicit) and not isinstance(method, NewmarkBody) else 1


CUT = "DMV", "SLIEMID"  # the flights that solve by pairs of Newton's steps, with a loop for each pair
COUNTED = [m.name for m in METHODS if not isinstance(m, Splitting) or not m.flight.name.startswith(CUT)]


def written_on_arrays(t, state):
    down = ml.so3.to_matrix(state.attitude)[2]
    return 20 * jnp.cross(down, jnp.eye(3, dtype=down.dtype) @ jnp.array([0, 0, 1], down.dtype))


TORQUES = {
    "components": ml.torques.HeavyTop(20.0),
    "arrays": written_on_arrays,
    "potential": ml.torques.FromPotential(lambda t, state: 20 * ml.so3.to_matrix(state.attitude)[2, 2]),
}


def loops(name, torque, dtype):
    """The number of fused loops over the batch in the loop over steps, and the text of the whole program."""

    def run(momentum):
        start = ml.RigidState(momentum, jnp.array([1, 0, 0, 0], dtype))
        return ml.integrate(ml.method(name), ml.RigidBody(jnp.array(BODY, dtype)), torque, start, dt=0.01, steps=7)

    text = real(jax.vmap(run)).lower(jnp.ones((BATCH, 3), dtype)).compile().as_text()
    return max(len(re.findall(rf"\[{BATCH}\].* fusion\(", body)) for body in loop_bodies(text)), text


# What no step may hold: matrix products and calls out of the loop, arrays put together by the way, and the functions
# that cost a CPU more than the rest of the step. (The path itself is put together from the start and the states kept.)
DEAR = r"\b(dot|convolution|custom-call|gather|sine|cosine|tan|power|exponential|log)\("
JOINED = rf"\[{BATCH},\d\]\S* concatenate\("


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "dtype"), by_turns(COUNTED))
def test_a_step_is_as_many_loops_as_it_should_be(name, dtype):
    count, text = loops(name, TORQUES["components"], dtype)
    assert count == loops_of(ml.method(name))
    assert not re.search(f"{DEAR}|{JOINED}", text)


@pytest.mark.sample(0)
@pytest.mark.parametrize("torque", ["arrays", "potential"])
def test_any_way_of_writing_the_torque_gives_one_loop(torque):
    count, text = loops("LIEMID[EA]", TORQUES[torque], jnp.float64)
    assert count == 1
    assert not re.search(f"{DEAR}|{JOINED}", text)


@pytest.mark.sample(0)
def test_a_hessian_is_right_and_repeats_no_work():
    body = ml.RigidBody([5.0, 4.0, 1.0])
    start = ml.RigidState([0.0, 1.0, 50.0], [0.8, 0.6, 0.0, 0.0])

    def loss(weight):
        run = {"dt": 0.01, "steps": 10, "save_every": None}
        states = ml.integrate("LIEMID[EA]", body, ml.torques.HeavyTop(weight), start, **run).states
        return jnp.sum(states.momentum**2) + jnp.sum(states.attitude**3)

    slope, bend = (jax.jit(f(loss)).lower(20.0).compile() for f in (jax.grad, jax.hessian))
    differences = (slope(20.0 + 1e-4) - slope(20.0 - 1e-4)) / 2e-4
    assert abs(bend(20.0) - differences) < 1e-5 * abs(differences)
    lines = [program.as_text().count("\n") for program in (slope, bend)]
    assert lines[1] < 15 * lines[0], lines  # with each loop written out for each of its outputs, 40 times


def spring(stiffness, rotation):
    return jnp.cross(rotation[2], stiffness.reshape(3, 3) @ rotation[2])


def attraction(place, rotation):  # its division ends a loop
    away = rotation.T @ place[:3]
    return jnp.cross(away, place[3:] * away) / jnp.sum(away**2) ** 2.5


PARAMETERS = {
    "number": (jnp.array(20.0), ml.torques.HeavyTop),
    "array": (jnp.linspace(1.0, 2.0, 9), lambda x: lambda t, state: spring(x, ml.so3.to_matrix(state.attitude))),
    "held": (jnp.linspace(1.0, 2.0, 12), lambda x: ml.torques.Held(x.reshape(4, 3), 0.2)),
    "moments": (jnp.ones(3), lambda x: ml.torques.HeavyTop(20.0)),  # and a factor of the moments of the body
    "costly": (jnp.linspace(1.0, 2.0, 6), lambda x: lambda t, state: attraction(x, ml.so3.to_matrix(state.attitude))),
}


def through_diffrax(method, body, torque, start):
    term, solver = ml.diffrax.RigidBodyTerm(body, torque), ml.diffrax.LieSolver(method)
    return diffrax.diffeqsolve(term, solver, 0.0, 0.64, 0.01, start).ys.momentum[-1]


def by_integrate(method, body, torque, start):
    bath = ml.baths.Langevin(1.0, 0.3, jax.random.key(0)) if ml.method(method).random else None
    return ml.integrate(method, body, torque, start, dt=0.01, steps=64, save_every=None, bath=bath).states.momentum


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("method", "parameter", "path"),
    [
        ("JACOBI[SRKN6b]", "number", by_integrate),
        ("GBS12", "number", by_integrate),
        ("DLM[EA]", "array", by_integrate),
        ("RK4", "array", by_integrate),
        ("JACOBI[EA]", "costly", by_integrate),
        ("JACOBI[EA]", "held", by_integrate),
        ("JACOBI[BAOAB]", "moments", by_integrate),
        ("JACOBI[EA]", "array", through_diffrax),
    ],
)
def test_a_gradient_repeats_no_work(method, parameter, path):
    starts = ml.RigidState(jnp.tile(jnp.array([0.0, 1.0, 50.0]), (256, 1)), jnp.tile(jnp.eye(4)[0], (256, 1)))
    moments = suited(method, jnp.array([5.0, 4.0, 1.0]))
    value, torque = PARAMETERS[parameter]

    def loss(x):
        body = ml.RigidBody(moments * x if parameter == "moments" else moments)
        return jnp.sum(jax.vmap(lambda start: path(method, body, torque(x), start))(starts) ** 2)

    programs = [real(function).lower(value).compile() for function in (jax.value_and_grad(loss), loss)]
    runs = [lambda program=program: jax.block_until_ready(program(value)) for program in programs]
    (_, both), (_, alone) = timed_in_turn(runs)
    assert both.seconds < 40 * alone.seconds  # 3 to 16; with repeated work up to 1,900
