"""`ml.stepper` and carries: pure steps under every transformation of JAX, under other parameters, and in loops."""

import subprocess
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick
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


WAYS = {
    "while": lambda one, carry: jax.lax.while_loop(lambda c: c.index < STEPS, one.step, carry),
    "advance": lambda one, carry: one.advance(carry, STEPS),
    "checkpoint": lambda one, carry: jax.checkpoint(scanned)(one, carry),
    "reversible": lambda one, carry: one.advance(carry, STEPS, adjoint=ml.adjoints.Reversible()),
    "two parts": lambda one, carry: one.advance(one.advance(carry, 7), carry.index + STEPS - 7),
}


def test_every_loop_over_steps_gives_what_integrate_gives():
    one, path = stepper(), whole()
    for end in quick(lambda one, carry: [way(one, carry) for way in WAYS.values()])(one, one.init()):
        near(one.state(end), path.states)
        assert bool(one.ok(end))
        assert int(end.index) == int(path.carry.index) == STEPS
        assert one.result(end) == ml.RESULTS.successful
        np.testing.assert_allclose(one.time(end), STEPS * DT)


@pytest.mark.sample(0)
@pytest.mark.parametrize("way", ["advance", "reversible"])
def test_derivatives_are_those_of_integrate(way):
    def height(weight, run):
        return jnp.sum(run(weight).attitude ** 3)

    def stepped(weight):
        one = stepper(torque=top(weight))
        return one.state(WAYS[way](one, one.init()))

    expected = quick(jax.grad(partial(height, run=lambda w: whole(torque=top(w)).states)))(20.0)
    np.testing.assert_allclose(quick(jax.grad(partial(height, run=stepped)))(20.0), expected, rtol=1e-10)
    if way == "advance":
        np.testing.assert_allclose(quick(jax.jacfwd(partial(height, run=stepped)))(20.0), expected, rtol=1e-10)


def test_a_batch_of_steppers_is_a_stepper_under_vmap():
    weights = jnp.linspace(10.0, 30.0, 5)
    many = jax.vmap(lambda w: stepper(torque=top(w)))(weights)
    ends = quick(jax.vmap(lambda one: one.state(scanned(one, one.init()))))(many)
    near(jax.tree.map(lambda x: x[3], ends), whole(torque=top(weights[3])).states)


@pytest.mark.sample(1)
@pytest.mark.parametrize("method", ["JACOBI[BAOAB]", "GBS12", "SW"])
def test_a_step_under_another_torque_is_that_of_a_run_under_it(method):
    """Also in a bath, up to the rounding of the noise, which is 1e-8 between a step and a compiled run."""
    bath = ml.baths.Langevin(0.7, 1.3, jax.random.key(0)) if method == "JACOBI[BAOAB]" else None
    one, states = stepper(method, bath=bath), START
    carry = one.init()
    for n, weight in enumerate([20.0, 35.0, 20.0]):
        carry = one.step(carry) if weight == 20 else one.step(carry, torque=top(weight))
        states = whole(method, torque=top(weight), start=states, steps=1, first_step=n, bath=bath).states
        near(one.state(carry), states, 1e-7 if bath else 1e-11)


@pytest.mark.sample(1)
@pytest.mark.parametrize("flight", ["JACOBI", "DLM", "LIEMID"])
def test_a_body_that_changes_keeps_its_momentum_and_the_run_is_of_order_two(flight):
    """I(t) = I0 (1 - 0.1 t) without torque: with the body at the middle of each step."""

    @quick
    def run(steps):
        one = ml.stepper(f"{flight}[EA]", BODY, None, START, dt=1 / steps)

        def step(_, carry):
            middle = one.time(carry) + one.dt / 2
            return one.step(carry, body=ml.RigidBody(BODY.moments * (1 - 0.1 * middle)))

        return one.state(jax.lax.fori_loop(0, jnp.int32(steps), step, one.init()))

    ends = [run(steps) for steps in (40.0, 80.0, 640.0)]
    spatial = [ml.so3.rotate(x.attitude, x.momentum) for x in (START, *ends)]
    for found in spatial[1:] if flight != "LIEMID" else []:
        np.testing.assert_allclose(found, spatial[0], rtol=0, atol=2e-12)
    coarse, fine = (float(jnp.linalg.norm(x.attitude - ends[-1].attitude)) for x in ends[:-1])
    assert coarse / fine > 3.3


def loop(gain, *, one, begun, periods=6):
    """A controller that samples every four steps, with a delay of one sample, a memory and a dead zone."""

    def period(state, _):
        carry, applied, memory = state
        rate = BODY.velocity(one.state(carry).momentum)
        memory = 0.5 * memory + rate
        wanted = jnp.where(jnp.abs(rate) > 0.01, -gain * memory, 0.0)
        carry = one.advance(carry, 4, torque=lambda t, state: applied)
        return (carry, wanted, memory), None

    return jax.lax.scan(period, begun, length=periods)[0]


def test_a_control_loop_has_a_gradient_and_resumes_from_a_file_to_the_bit(tmp_path):
    one = stepper(torque=lambda t, state: jnp.zeros(3))
    begun = one.init(), jnp.zeros(3), jnp.zeros(3)
    part = jax.jit(partial(loop, one=one))

    @jax.jit
    def cost(gain):
        return jnp.sum(one.state(part(gain, begun=begun)[0]).momentum ** 2)

    slope = jax.jit(jax.grad(cost))(0.3)
    np.testing.assert_allclose(slope, (cost(0.3001) - cost(0.2999)) / 2e-4, rtol=1e-6)
    first = part(0.3, begun=begun)
    eqx.tree_serialise_leaves(tmp_path / "loop.eqx", first)
    read = eqx.tree_deserialise_leaves(tmp_path / "loop.eqx", first)
    jax.tree.map(np.testing.assert_array_equal, part(0.3, begun=read), part(0.3, begun=first))


def test_failures_are_seen():
    one = stepper(dt=10.0)
    end = one.advance(one.init(), STEPS)
    assert not one.ok(end)
    assert one.result(end) == ml.RESULTS.beyond_reach
    bad = one.init(eqx.tree_at(lambda s: s.momentum, START, jnp.full(3, jnp.nan)))
    assert not one.ok(bad)


@pytest.mark.sample(0)
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


def test_arguments_that_do_not_fit_are_refused():
    one, carry = stepper(), stepper().init()
    for count in (0, -1):  # a number that is traced may be any: no steps are taken
        jax.tree.map(np.testing.assert_array_equal, one.advance(carry, jnp.asarray(count)), carry)
    counts = 0, True, jnp.asarray(2.5), jnp.arange(2)
    for call, message in (
        (lambda: one.step(carry, torque=BODY), "torque must have the structure"),
        (lambda: one.step(carry, torque=top(jnp.float32(3))), "torque must have the shapes and dtypes"),
        (lambda: one.init(ml.AxisState([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])), "start must have the structure"),
        *((partial(one.advance, carry, steps), "steps must be a positive") for steps in counts),
        (lambda: whole(start=carry, first_step=3), "first_step must be left out"),
        (lambda: whole("RK4", start=carry), "Carry of the same method"),
        (lambda: stepper(dt=0.0), "dt must be finite and not zero"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.sample(1)
@pytest.mark.parametrize("state", ["free", "spins", "particles", "compensated", "two axes"])
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
import sys, pathlib, jax, jax.export
jax.config.update("jax_enable_x64", True)
import midlie_jax as ml
ml.register_for_export()
run = jax.export.deserialize(pathlib.Path(sys.argv[1]).read_bytes())
pull = ml.spacecraft.GravityGradient(None, ml.orbits.CircularOrbit([2.0, 0.0, 0.0], [0.0, 0.6, 0.8], 1.0), 1.0)
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
    command = [sys.executable, "-c", LOADED, str(tmp_path / "run")]
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
