"""What a user learns before a run, from `ml.check`, and after it, from `path.first_bad`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import equal_moments, quick, whole

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.integrators import limits
from midlie_jax.model.torques import Damping, DipoleInField, HeavyTop, Prescribed

BODY = ml.RigidBody([1.0, 1.0, 1.2])
OMEGA = 2.0
NEEDLE = DipoleInField(jnp.array([0.0, 0.0, OMEGA**2]), jnp.array([0.0, 0.0, 1.0]))
AT_REST = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
SPINNING = ml.RigidState([0.0, 0.0, 3.6], ml.so3.exp(jnp.array([0.1, 0.0, 0.0])))
EA = "SYMMETRIC[EA]"  # compiles fastest


@pytest.mark.sample(0)
def test_the_numbers_are_those_of_the_definitions():
    found = ml.check(EA, BODY, NEEDLE, AT_REST, dt=-0.1)
    assert (found.method, found.dt, found.sane, found.solved) == (EA, -0.1, True, True)
    assert found.turn == 0
    assert found.rate == pytest.approx(OMEGA)
    assert found.stiffness == pytest.approx(0.1 * OMEGA)
    assert found.limit == limits.oscillator_limit(ml.schemes.EA)
    assert found.suggested == pytest.approx(-0.5 * found.limit / OMEGA)
    free = ml.check(EA, BODY, None, SPINNING, dt=0.1)
    # The flight turns at |Pi| / I1 about the momentum, and slower about the axis.
    assert free.turn == pytest.approx(0.36)
    assert (free.rate, free.resonance, free.harmonic) == (0, np.inf, 0)
    assert free.suggested == pytest.approx(0.8 * free.reach / 3.6)


@pytest.mark.sample(0)
def test_each_reason_is_named():
    def why(torque, state, dt):
        found = ml.check(EA, BODY, torque, state, dt=dt)
        assert not found.sane
        assert "NOT sane" in str(found)
        assert ml.check(EA, BODY, torque, state, dt=found.suggested * (1 - 1e-6)).sane
        return found

    turns = why(None, SPINNING, 1.4)
    assert turns.turn > turns.reach
    assert not turns.solved
    assert "FAILS" in str(turns)
    stiff = why(NEEDLE, AT_REST, 1.2)
    assert stiff.stiffness > stiff.limit
    assert stiff.solved
    # Six steps a turn of the nutation, in a field whose width catches it.
    resonant = why(HeavyTop(1.0), SPINNING, np.pi / 3 / 3.4)
    assert resonant.resonant
    assert resonant.harmonic == 3
    assert resonant.resonance == pytest.approx(3.6 / (1 + 0.1) * 1.1 / 3.4, rel=0.1)
    assert "within the width of the resonance at 6" in str(resonant)


@pytest.mark.sample(0)
def test_a_batch_is_judged_by_its_worst_body():
    momenta = jnp.array([[0.0, 0.0, 1.0], [0.5, 0.0, 3.0], [0.0, 2.0, 0.0]])
    states = ml.RigidState(momenta, jnp.tile(SPINNING.attitude, (3, 1)))
    weights = jnp.array([5.0, 1.0, 0.2])
    together = ml.check(EA, BODY, HeavyTop(weights), states, dt=0.05)

    def alone(i, dt):
        return ml.check(EA, BODY, HeavyTop(weights[i]), jax.tree.map(lambda x: x[i], states), dt=dt)

    each = [alone(i, 0.05) for i in range(3)]
    for name in ("turn", "rate", "stiffness"):
        assert getattr(together, name) == pytest.approx(max(getattr(one, name) for one in each))
    # The longest step of the worst body, or somewhat less where that step is in a resonance of another body.
    longest = min(one.suggested for one in each)
    assert 0.9 * longest <= together.suggested <= longest * (1 + 1e-6)
    assert all(alone(i, together.suggested * (1 - 1e-6)).sane for i in range(3))


@pytest.mark.sample(0)
def test_decay_and_what_is_not_finite():
    damped = ml.check(EA, BODY, Damping(jnp.array(6.0)), SPINNING, dt=0.05)
    assert np.isnan(damped.energy_error)
    assert damped.rate == pytest.approx(6.0)
    assert damped.limit == limits.decay_limit(ml.schemes.EA)
    broken = ml.check(EA, BODY, lambda t, state: state.momentum / 0, SPINNING, dt=0.05)
    assert not broken.sane
    assert broken.suggested == 0
    assert "not finite" in str(broken)


AT_REST_TILTED = ml.RigidState([0.0, 0.0, 0.0], ml.so3.exp(jnp.array([0.5, 0.2, 0.0])))
FALLING = (ml.RigidBody([1.0, 2.0, 2.5]), HeavyTop(1.0), AT_REST_TILTED)  # a top at rest that falls and tumbles
SLOW = scenes.scene("slow-top")


@pytest.mark.sample(0)
@pytest.mark.parametrize(
    ("name", "system", "dt"),
    [
        ("LIEMID[I]", (SLOW.body, SLOW.torque, SLOW.start), 0.05),
        ("LIEMID[E2]", FALLING, 0.5),
        *whole(*[(m, FALLING, 0.5) for m in ml.methods()[:12] if not equal_moments(m)]),
    ],
)
def test_the_suggested_step_was_tried(name, system, dt):
    """Over as many steps as the trial no solve fails, and the energy stays near that of the start."""
    body, torque, start = system
    found = ml.check(name, body, torque, start, dt=dt)
    assert found.suggested > 0
    path = ml.integrate(name, body, torque, start, dt=found.suggested, steps=10_000, save_every=10)
    assert path.ok
    energies, kinetic = ml.observe.energy(body, torque, path), ml.observe.kinetic_energy(body, path.states)
    scale = kinetic[0] + jnp.ptp(energies - kinetic)
    assert jnp.max(jnp.abs(energies - energies[0])) <= 0.6 * scale
    assert ml.check(name, body, torque, start, dt=found.suggested).sane


PUSH = jnp.array([0.0, 0.0, 5.0])
TABLE = jnp.asarray(np.random.default_rng(0).normal(size=(100, 3)))
IN_TIME = {  # a torque, and whether it jumps where steps of 1/8 or 0.1 do not know it
    "short pulses": (Prescribed(lambda t: jnp.where(t % 3 < 0.02, PUSH, 0 * PUSH)), 0.1, True),
    "at ends of steps": (Prescribed(lambda t: jnp.where((t % 1 > 0) & (t % 1 < 0.5), PUSH, 0 * PUSH)), 1 / 8, True),
    "a wrench": (lambda t, state: ml.torques.Wrench(0 * PUSH, jnp.where(t % 3 < 0.02, PUSH, 0 * PUSH)), 0.1, True),
    "pulses": (ml.torques.Pulses(3.0 * np.arange(9), 0.02, PUSH), 0.1, False),
    "controls": (ml.torques.Held(TABLE, 1 / 8) + HeavyTop(1.0), 1 / 8, False),
    "both": (ml.torques.Held(TABLE, 0.1) + Prescribed(lambda t: jnp.where(t % 3 < 0.02, 200.0, 0.0) * PUSH), 0.1, True),
}


@pytest.mark.parametrize("case", IN_TIME)
@pytest.mark.sample(1)
def test_jumps_of_a_torque_in_time_are_found(case):
    torque, dt, jumps = IN_TIME[case]
    one = ml.RigidBody([1e4, 1e4, 1.2e4])
    start = SPINNING
    if case == "a wrench":
        one, start = ml.FreeBody(one, 1.0), ml.FreeState(*start.parts(), *2 * [jnp.zeros(3)])
    found = ml.check(EA, one, torque, start, dt=dt, steps=200)
    assert found.solved
    assert (found.jump_error > 0.05) == jumps
    assert found.sane != jumps
    assert ("torques.Pulses or Held" in str(found)) == jumps
    if case == "short pulses":  # one step reads a pulse, or none; both edges are in one step of 5 widths
        assert found.jump_error == pytest.approx(2.5, rel=0.5)


@pytest.mark.sample(0)
def test_a_torque_of_rounding_errors_does_not_jump():
    """The gravity gradient on a symmetric body whose axis is normal to the plane of its orbit."""
    orbit = ml.orbits.CircularOrbit([7e6, 0.0, 0.0], [0.0, 1.0, 0.0], 3.986e14)
    start = ml.RigidState([0.0, 0.01, 8.0], [1.0, 0.0, 0.0, 0.0])
    gradient = ml.spacecraft.GravityGradient(None, orbit, 3.986e14)
    found = ml.check(EA, ml.RigidBody([80.0, 80.0, 120.0]), gradient, start, dt=2.0)
    assert found.jump_error == 0
    assert found.sane


@pytest.mark.sample(0)
def test_the_verdict_is_not_about_accuracy_and_the_error_is_said():
    """The error of a top that nutates: mostly that of a phase, found by the order and half the step."""
    state = ml.RigidState([0.0, 0.3, 3.6], ml.so3.exp(jnp.array([0.1, 0.0, 0.0])))
    found = ml.check(EA, BODY, HeavyTop(5.0), state, dt=0.2, steps=400)
    assert found.sane
    assert found.judged == "attitude"
    run = {"steps": 200, "save_every": 2}
    coarse = ml.integrate(EA, BODY, HeavyTop(5.0), state, dt=0.2, **run).states.attitude
    fine = ml.integrate("GBS12", BODY, HeavyTop(5.0), state, dt=0.2, **run).states.attitude
    true = jnp.max(jnp.linalg.norm(ml.so3.log(ml.so3.multiply(ml.so3.conjugate(fine), coarse)), axis=-1))
    assert found.error == pytest.approx(float(true), rel=0.3)
    assert "not judged by the verdict; the error is about" in str(found)


@pytest.mark.sample(0)
def test_a_step_that_loses_the_energy_is_not_sane():
    """RK4 below its stability limit damps a motion, a little in each step."""
    body, torque, start = FALLING
    found = ml.check("RK4", body, torque, start, dt=0.8)
    assert found.solved
    assert found.energy_error > 0.5
    assert not found.sane
    assert 0 < found.suggested < 0.8
    assert ml.check("RK4", body, torque, start, dt=0.8, steps=20).energy_error < 0.5


def test_bad_arguments_are_named():
    good = {"method": EA, "body": BODY, "torque": NEEDLE, "start": SPINNING, "dt": 0.1}
    for options, words in (
        ({"dt": 0.0}, "dt must be finite and not zero"),
        ({"dt": jnp.ones(3)}, "dt must be a scalar"),
        ({"method": "Verlet"}, "method 'Verlet' moves Particles, but body is RigidBody"),
        ({"start": jax.tree.map(lambda x: jnp.tile(x, (2, 2, 1)), SPINNING)}, "one leading axis"),
        ({"steps": 0}, "steps must be a positive"),
        ({"body": ml.RigidBody([[1.0, 1.0, 1.2]] * 3)}, "body"),
    ):
        with pytest.raises(ValueError, match=words):
            ml.check(**good | options)
    with pytest.raises(ValueError, match="an argument is traced"):
        jax.jit(lambda dt: ml.check(**good | {"dt": dt}).turn)(0.1)


def later(size):
    """A torque of this size from time 1.05 on."""
    return lambda t, state: jnp.where(t > 1.05, size, 0.0).astype(t.dtype) * jnp.ones_like(state.momentum)


@pytest.mark.sample(0)
def test_the_first_bad_state_is_the_first_that_an_infinite_momentum_or_a_failed_flight_reaches():
    """The kick at 1.1 ends step 11, and the flight of step 12 is the first that fails."""

    def path_of(torque, save_every, start=SPINNING):
        return quick(lambda s: ml.integrate(EA, BODY, torque, s, dt=0.1, steps=20, save_every=save_every))(start)

    for size, step, save_every in ((1e3, 12, 1), (1e3, 12, 10), (jnp.nan, 11, 4)):
        path = path_of(later(size), save_every)
        assert not path.ok
        assert path.first_bad == -(-step // save_every)
    good = path_of(None, 4)
    assert good.ok
    assert good.first_bad == len(good.times) == 6
    assert path_of(None, 4, jax.tree.map(lambda x: x * jnp.nan, SPINNING)).first_bad == 0
