"""`ml.stepper` and carries: pure steps under every transformation of JAX, under other parameters, and in loops."""

import subprocess
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import RIGID_FLIGHTS, quick
from jax import export
from path_scenes import STATES, default_method, torque_for

import midlie_jax as ml

BODY, START = ml.RigidBody([5.0, 4.0, 1.0]), ml.RigidState([1.0, 2.0, 9.0], ml.so3.exp(jnp.array([0.3, 0.1, 0.0])))
STEPS, DT = 24, 0.01


def top(weight=20.0):
    return ml.torques.HeavyTop(weight)


def stepper(method="JACOBI[EA]", body=BODY, torque=None, start=START, **options):
    return ml.stepper(method, body, top() if torque is None else torque, start, **{"dt": DT, "t0": 0.0, **options})


def near(found, expected, rtol=1e-12):
    jax.tree.map(partial(np.testing.assert_allclose, rtol=rtol, atol=rtol), found, expected)


def whole(method="JACOBI[EA]", torque=None, start=START, **options):
    run = {"dt": DT, "steps": STEPS, "save_every": None, **options}
    return ml.integrate(method, BODY, top() if torque is None else torque, start, **run)


def scanned(one, carry):
    return jax.lax.scan(lambda c, _: (one.step(c), None), carry, length=STEPS)[0]


def by_while(one, carry):
    return jax.lax.while_loop(lambda c: c.index < STEPS, one.step, carry)


WAYS = {
    "scan": scanned,
    "while": by_while,
    "advance": lambda one, carry: one.advance(carry, STEPS),
    "traced": lambda one, carry: one.advance(carry, carry.index + STEPS),
    "checkpoint": lambda one, carry: jax.checkpoint(scanned)(one, carry),
    "reversible": lambda one, carry: one.advance(carry, STEPS, adjoint=ml.adjoints.Reversible()),
    "unrolled": lambda one, carry: jax.lax.scan(lambda c, _: (one.step(c), None), carry, length=STEPS, unroll=2)[0],
    "two parts": lambda one, carry: one.advance(one.advance(carry, 7), STEPS - 7),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_loop_over_steps_gives_what_integrate_gives(way):
    """test_paths.py has the other methods."""
    one, path = stepper(), whole()
    end = quick(WAYS[way])(one, one.init())
    near(one.state(end), path.states)
    assert bool(one.ok(end))
    assert int(end.index) == int(path.carry.index) == STEPS
    assert one.result(end) == ml.RESULTS.successful
    np.testing.assert_allclose(one.time(end), STEPS * DT)


@pytest.mark.sample(1)
@pytest.mark.parametrize("way", ["advance", "while", "reversible"])
def test_derivatives_are_those_of_integrate(way):
    def height(weight, run):
        return jnp.sum(run(weight).attitude ** 3)

    def stepped(weight):
        one = stepper(torque=top(weight))
        return one.state(WAYS[way](one, one.init()))

    expected = jax.grad(partial(height, run=lambda w: whole(torque=top(w)).states))(20.0)
    forward = jax.jvp(partial(height, run=stepped), (20.0,), (1.0,))[1] if way != "reversible" else expected
    np.testing.assert_allclose(forward, expected, rtol=1e-10)
    if way != "while":
        np.testing.assert_allclose(jax.grad(partial(height, run=stepped))(20.0), expected, rtol=1e-10)


def test_a_batch_of_steppers_is_a_stepper_under_vmap():
    weights = jnp.linspace(10.0, 30.0, 5)

    @jax.jit
    @jax.vmap
    def run(weight):
        one = stepper(torque=top(weight))
        return one.state(scanned(one, one.init()))

    many = jax.vmap(lambda w: stepper(torque=top(w)))(weights)
    ends = jax.vmap(lambda one: one.state(scanned(one, one.init())))(many)
    near(ends, run(weights))
    near(jax.tree.map(lambda x: x[3], ends), whole(torque=top(weights[3])).states)


@pytest.mark.sample(1)
@pytest.mark.parametrize("method", ["JACOBI[EA]", "GBS12", "SW"])
def test_a_step_under_another_torque_is_that_of_a_run_under_it(method):
    one, states = stepper(method), START
    carry = one.init()
    for n, weight in enumerate([20.0, 35.0, 20.0, 5.0, 20.0]):
        carry = one.step(carry) if weight == 20 else one.step(carry, torque=top(weight))
        states = whole(method, torque=top(weight), start=states, steps=1, first_step=n).states
        near(one.state(carry), states, 1e-11)


@pytest.mark.sample(1)
@pytest.mark.parametrize("flight", [f for f in RIGID_FLIGHTS if f.moves(jnp.array([5.0, 4.0, 1.0]))], ids=str)
def test_a_body_that_changes_keeps_its_momentum_and_the_run_is_of_order_two(flight):
    """I(t) = I0 (1 - 0.1 t) without torque: with the body at the middle of each step."""

    @quick
    def run(steps):
        one = ml.stepper(f"{flight.name}[EA]", BODY, None, START, dt=1 / steps)

        def step(_, carry):
            middle = one.time(carry) + one.dt / 2
            return one.step(carry, body=ml.RigidBody(BODY.moments * (1 - 0.1 * middle)))

        return one.state(jax.lax.fori_loop(0, jnp.int32(steps), step, one.init()))

    ends = [run(steps) for steps in (40.0, 80.0, 640.0)]
    spatial = [ml.so3.rotate(x.attitude, x.momentum) for x in (START, *ends)]
    for found in spatial[1:] if flight.name != "LIEMID" else []:
        np.testing.assert_allclose(found, spatial[0], rtol=0, atol=2e-12)
    errors = [float(jnp.linalg.norm(x.attitude - ends[-1].attitude)) for x in ends[:-1]]
    assert errors[0] / errors[1] > 3.3


def loop(gain, one, begun, periods=6):
    """A controller that samples every four steps, with a delay of one sample, a memory and a dead zone."""

    def period(state, _):
        carry, applied, memory = state
        rate = BODY.velocity(one.state(carry).momentum)
        memory = 0.5 * memory + rate
        wanted = jnp.where(jnp.abs(rate) > 0.01, -gain * memory, 0.0)
        carry = one.advance(carry, 4, torque=lambda t, state: applied)
        return (carry, wanted, memory), None

    return jax.lax.scan(period, begun, length=periods)[0]


def test_a_gradient_through_a_control_loop_is_that_of_differences():
    one = stepper(torque=lambda t, state: jnp.zeros(3))

    @jax.jit
    def cost(gain):
        carry, _, _ = loop(gain, one, (one.init(), jnp.zeros(3), jnp.zeros(3)))
        return jnp.sum(one.state(carry).momentum ** 2)

    slope = jax.jit(jax.grad(cost))(0.3)
    np.testing.assert_allclose(slope, (cost(0.3001) - cost(0.2999)) / 2e-4, rtol=1e-6)


def test_a_control_loop_resumes_from_a_file_to_the_bit(tmp_path):
    one = stepper(torque=lambda t, state: jnp.zeros(3))
    part = jax.jit(partial(loop, 0.3, one))
    first = part((one.init(), jnp.zeros(3), jnp.zeros(3)))
    eqx.tree_serialise_leaves(tmp_path / "loop.eqx", first)
    read = eqx.tree_deserialise_leaves(tmp_path / "loop.eqx", first)
    jax.tree.map(np.testing.assert_array_equal, part(read), part(first))


def test_failures_are_seen():
    one = stepper(dt=10.0)
    end = one.advance(one.init(), STEPS)
    assert not one.ok(end)
    assert one.result(end) == ml.RESULTS.beyond_reach
    bad = one.init(eqx.tree_at(lambda s: s.momentum, START, jnp.full(3, jnp.nan)))
    assert not one.ok(bad)


def test_a_step_under_another_torque_stays_in_the_bath():
    """Up to the rounding of the noise, which is 1e-8 between a step and a compiled run."""
    bath = ml.baths.Langevin(0.7, 1.3, jax.random.key(0))
    one = ml.stepper("JACOBI[BAOAB]", BODY, top(), START, dt=DT, bath=bath)
    other = ml.torques.HeavyTop(3.0 * one.torque.mgl)
    found = one.state(one.step(one.init(), torque=other))
    expected = ml.integrate("JACOBI[BAOAB]", BODY, other, START, dt=DT, steps=1, save_every=None, bath=bath)
    near(found, expected.states, 1e-7)
    assert not np.allclose(found.momentum, one.state(one.step(one.init())).momentum)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("start", "save_every"), [("not finite", 1), ("failed later", None)])
def test_a_run_that_goes_on_from_a_failed_one_has_failed(start, save_every):
    """In a program, for one body and in an ensemble: none of its states can be trusted. Outside, it is an error."""
    first = eqx.tree_at(lambda s: s.momentum, START, jnp.full(3, jnp.nan)) if start == "not finite" else START
    run = {"dt": 10.0 if start == "failed later" else DT, "steps": 4, "save_every": save_every}

    @jax.jit
    def twice(start, starts):
        carry = ml.ensemble("JACOBI[EA]", BODY, top(), starts, **run).carry
        one = whole(start=whole(start=start, **run).carry, **run)
        return one, ml.ensemble("JACOBI[EA]", BODY, top(), carry, **run)

    one, many = twice(first, jax.tree.map(lambda x, y: jnp.stack([x, y]), first, START))
    assert not one.ok
    assert one.first_bad == many.first_bad[0] == 0
    assert one.result != ml.RESULTS.successful
    assert one.result == jax.tree.map(lambda x: x[0], many.result)
    assert many.ok[1] == (start == "not finite")
    if start == "failed later":
        with pytest.raises(ValueError, match="must be finite"):
            whole(start=whole(**run).carry, **run)


def test_no_steps_are_taken_for_a_number_that_is_not_positive():
    one = stepper()
    for count in (0, -1):
        jax.tree.map(np.testing.assert_array_equal, one.advance(one.init(), jnp.asarray(count)), one.init())


def test_arguments_that_do_not_fit_are_refused():
    one, carry = stepper(), stepper().init()
    with pytest.raises(ValueError, match="torque must have the structure"):
        one.step(carry, torque=BODY)
    with pytest.raises(ValueError, match="torque must have the shapes and dtypes"):
        one.step(carry, torque=top(jnp.float32(3)))
    with pytest.raises(ValueError, match="start must have the structure"):
        one.init(ml.AxisState([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]))
    for steps in (0, True, jnp.asarray(2.5), jnp.arange(2)):
        with pytest.raises(ValueError, match="steps must be a positive"):
            one.advance(carry, steps)
    with pytest.raises(ValueError, match="first_step must be left out"):
        whole(start=carry, first_step=3)
    with pytest.raises(ValueError, match="Carry of the same method"):
        whole("RK4", start=carry)
    with pytest.raises(ValueError, match="dt must be finite and not zero"):
        stepper(dt=0.0)


def test_many_bodies_stay_in_vectors_in_a_program_of_the_user():
    """XLA leaves alone a loop with a sort; few bodies are faster without one."""

    def sorts(count, slope):
        starts = jax.tree.map(lambda x: jnp.stack([x] * count), START)

        def energy(starts):
            return jnp.sum(jax.vmap(lambda start: whole(start=start).states.momentum)(starts) ** 2)

        return jax.jit(jax.grad(energy) if slope else energy).lower(starts).as_text().count("stablehlo.sort")

    assert sorts(64, True) > sorts(64, False) > 0
    assert sorts(2, True) == sorts(2, False) == 0


@pytest.mark.sample(6)
@pytest.mark.parametrize("state", STATES)
def test_carries_paths_and_states_of_every_kind_are_exported(state):
    body, start = STATES[state]
    method, torque = default_method(state), torque_for(state)
    ml.register_for_export(*[type(x) for x in (torque, body) if isinstance(x, eqx.Module)])
    one = ml.stepper(method, body, torque, start, dt=DT)
    path = jax.eval_shape(partial(ml.integrate, method, body, torque, start, dt=DT, steps=2))
    value = one.init(), body, path, start
    stored = export.export(jax.jit(lambda x: x))(value).serialize()
    assert export.deserialize(stored).in_tree == jax.tree.structure(((value,), {}))


LOADED = """
import sys, pathlib, jax
jax.config.update("jax_enable_x64", True)
import midlie_jax as ml
ml.register_for_export()
run = jax.export.deserialize(pathlib.Path(sys.argv[1]).read_bytes())
orbit = ml.orbits.CircularOrbit([2.0, 0.0, 0.0], [0.0, 0.6, 0.8], 1.0)
pull = ml.spacecraft.GravityGradient(None, orbit, 1.0)
path = run.call(ml.RigidBody([5.0, 4.0, 1.0]), pull, ml.RigidState([1.0, 2.0, 9.0], [1.0, 0.0, 0.0, 0.0]))
print(bool(path.ok), path.result == ml.RESULTS.successful, path.states.momentum.tolist())
"""


@pytest.mark.sample(0)
def test_an_exported_run_has_the_same_bits_in_another_process(tmp_path):
    ml.register_for_export()
    run = jax.jit(lambda body, torque, start: ml.integrate("JACOBI[EA]", body, torque, start, dt=DT, steps=4))
    start = ml.RigidState([1.0, 2.0, 9.0], [1.0, 0.0, 0.0, 0.0])
    pull = ml.spacecraft.GravityGradient(None, ml.orbits.CircularOrbit([2.0, 0.0, 0.0], [0.0, 0.6, 0.8], 1.0), 1.0)
    (tmp_path / "run").write_bytes(export.export(run)(BODY, pull, start).serialize())
    script = "import jax.export\n" + LOADED
    command = [sys.executable, "-c", script, str(tmp_path / "run")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert printed == f"True True {run(BODY, pull, start).states.momentum.tolist()}"


class WithFunction(eqx.Module):
    size: jax.Array
    function: object = eqx.field(static=True)


def test_what_cannot_be_exported_is_refused():
    with pytest.raises(TypeError, match="classes must be Equinox modules"):
        ml.register_for_export(dict)
    ml.register_for_export(WithFunction)
    with pytest.raises(ValueError, match="static field must be"):
        export.export(jax.jit(lambda own: own.size))(WithFunction(jnp.ones(3), jnp.sin)).serialize()
