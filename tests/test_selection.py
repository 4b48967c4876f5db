"""What a user learns before a run, from `ml.recommend` and `ml.check`, and after it, from `path.first_bad`."""

import inspect
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import equal_moments, quick, setup, true_motion, whole

import midlie_jax as ml
from midlie_jax.advice import recommend as selection
from midlie_jax.advice import timing
from midlie_jax.advice.recommend import Case, one_direction
from midlie_jax.advice.timing import Stopwatch, Timing, timed, timed_in_turn
from midlie_jax.cli import scenes
from midlie_jax.integrators import limits
from midlie_jax.model import so3
from midlie_jax.model.torques import BodyTorque, Damping, DipoleInField, HeavyTop, Prescribed

CASE = setup(strength=0.0)
BODY = ml.RigidBody(jnp.asarray(CASE.moments))
START = ml.RigidState(jnp.asarray(CASE.momentum), jnp.asarray(CASE.attitude))
AXIS = (0.0, 0.0, 1.0)
TOP = HeavyTop(2.0, AXIS)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("tolerance", "duration"), [(1e-5, 20.0), (0.5, 2.0)])
def test_what_is_recommended_stays_within_the_tolerance(monkeypatch, capsys, tolerance, duration):
    """Over the whole duration asked for, with a step no finer than it must be: one half as long again misses."""
    monkeypatch.setattr(selection, "candidates", lambda *_, **__: ["JACOBI[SRKN6b]", "JACOBI[EA]"])
    found = ml.recommend(BODY, TOP, START, tolerance=tolerance, duration=duration, progress=duration < 3)
    assert ("recommend: JACOBI[SRKN6b] (1 of 2)" in capsys.readouterr().err) == (duration < 3)
    assert found.steps * found.dt == pytest.approx(duration, rel=1e-14)
    assert ml.check(found.method, BODY, TOP, START, dt=found.dt, steps=found.steps).sane
    end = ml.integrate(found.method, BODY, TOP, START, dt=found.dt, steps=found.steps, save_every=found.steps).states
    _, (exact,) = true_motion(CASE, np.array([duration]), lambda t, r: CASE.weight * np.cross(r[2], AXIS))
    error = np.linalg.norm(so3.to_matrix(end.attitude[-1]) - so3.to_matrix(jnp.asarray(exact)))
    assert error <= tolerance
    assert error == pytest.approx(found.error, rel=0.01, abs=tolerance / 30)
    coarser = [t for t in found.tried if t.method == found.method and t.steps < found.steps]
    assert coarser, "a cheaper step was tried"
    assert all(not t.ok or t.error > tolerance for t in coarser if t.steps < found.steps / 1.5)


@pytest.mark.sample(0)
def test_a_free_body_takes_the_largest_step_that_its_flight_reaches():
    found = ml.recommend(BODY, None, START, tolerance=1e-6, duration=30.0)
    assert found.method == "JACOBI[EA]"
    assert found.dt * np.linalg.norm(CASE.momentum / CASE.moments) > 0.5
    assert "reach" in found.note


def test_candidates_fit_the_body_and_the_torque():
    for moments in ([2.0, 2.0, 1.0], [1.0, 2.0, 2.0], [2.0, 1.0, 2.0]):
        names = selection.candidates(ml.RigidBody(jnp.array(moments)), TOP)
        assert all(name.startswith("SYMMETRIC") for name in names)
    assert all(name.startswith("JACOBI") for name in selection.candidates(BODY, TOP))
    assert selection.candidates(BODY, None) == ["JACOBI[EA]"]
    assert selection.candidates(BODY, TOP, reads_momentum=True) == ["JACOBI[EA]"]
    assert "DOP853" in selection.candidates(BODY, TOP, symplectic=False)


@pytest.mark.sample(0)
@pytest.mark.parametrize("coefficient", [1e4, 1e9])
def test_a_stiff_torque_is_called_stiff(coefficient):
    """Where no step is stable, and where one is: then it is limited by that and not by the error."""
    torque = TOP + Damping(coefficient)
    if coefficient > 1e6:
        with pytest.raises(ValueError, match=r"the torque is stiff.*1\.\de\+09 per unit of time.*Kvaerno5"):
            ml.recommend(BODY, torque, START, tolerance=1e-3, duration=1.0)
    else:
        found = ml.recommend(BODY, torque, START, tolerance=1e-3, duration=1.0)
        assert "the torque is stiff: larger steps are unstable" in found.note
        assert found.dt < 3 / coefficient


def test_a_torque_that_reads_one_direction_alone_is_known():
    sideways = DipoleInField(jnp.array([0.3, 0.0, 0.1]), jnp.array([0.0, 2.0, 0.0]))
    for torque, direction in ((TOP + Damping(0.1), (0, 0, 1)), (sideways, (0, 1, 0))):
        found = one_direction(Case(BODY, torque, START, jnp.array(0.3), 2.0, None))
        seen = so3.to_matrix(START.attitude).T @ jnp.array(direction, float)
        np.testing.assert_allclose(found.direction, seen, atol=1e-15)
    for torque in (TOP + sideways, lambda t, s: TOP(t, s) * (2.0 if hasattr(s, "attitude") else 1.0), None):
        assert one_direction(Case(BODY, torque, START, jnp.array(0.3), 2.0, None)) is None


@pytest.mark.sample(0)
def test_a_state_that_takes_less_time_is_named(monkeypatch):
    """Of a Runge-Kutta method, with the time that was measured."""
    monkeypatch.setattr(selection, "candidates", lambda *_, **__: ["GBS8"])
    monkeypatch.setattr(selection, "_WORTH", np.inf)
    found = ml.recommend(BODY, TOP, START, tolerance=1e-4, duration=50.0, symplectic=False)
    assert "on a midlie_jax.DirectionState, the same run is" in found.note


FLYING = {
    "body": ml.FreeBody(BODY, 2.0),
    "start": ml.FreeState(START.momentum, START.attitude, jnp.ones(3), jnp.ones(3)),
}


@pytest.mark.sample(12)
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tolerance": 0.0}, "tolerance must be at least"),
        ({"tolerance": 1e-15}, "above rounding in float64"),
        ({"tolerance": 2.0}, "and at most 1"),
        ({"duration": 0.0}, "duration must not be zero"),
        ({"start": ml.MomentumState(jnp.ones(3))}, "start must be a state with an attitude or an axis"),
        ({"torque": 3.0}, "torque must be None or a callable"),
        ({"body": TOP, "torque": BODY}, "got body HeavyTop; the body comes before the torque"),
        *(({**FLYING, "length": length}, "length must be positive") for length in (-1.0, 1e-400)),
        ({**FLYING, "length": np.inf}, "length must be finite"),
        ({**FLYING, "length": "one"}, "length must be an array of numbers, got str"),
        ({**FLYING, "length": (1.0, 1.0)}, r"length must be a scalar, got shape \(2,\)"),
        ({"torque": BodyTorque(lambda t, state, body: state.momentum / jnp.zeros(3))}, "not finite at the start"),
    ],
)
def test_bad_arguments_are_named(changes, message):
    given = {"body": BODY, "torque": None, "start": START, "tolerance": 1e-3, "duration": 1.0} | changes
    with pytest.raises(ValueError, match=message):
        # The type checkers of the tests stand in front of the package's own checks; users do not have them.
        inspect.unwrap(ml.recommend)(**given)


def test_a_traced_argument_is_refused():
    def seconds(value):
        torque = HeavyTop(value, AXIS)
        return inspect.unwrap(ml.recommend)(BODY, torque, START, tolerance=1e-3, duration=1.0).seconds

    with pytest.raises(ValueError, match="recommend needs concrete numbers, but an argument is traced; call it"):
        jax.jit(seconds)(1.0)


# ---- what `ml.check` says before a run, and `path.first_bad` after it ----

ROUND = ml.RigidBody([1.0, 1.0, 1.2])
OMEGA = 2.0
NEEDLE = DipoleInField(jnp.array([0.0, 0.0, OMEGA**2]), jnp.array([0.0, 0.0, 1.0]))
AT_REST = ml.RigidState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
SPINNING = ml.RigidState([0.0, 0.0, 3.6], ml.so3.exp(jnp.array([0.1, 0.0, 0.0])))
EA = "SYMMETRIC[EA]"  # compiles fastest


@pytest.mark.sample(0)
def test_the_numbers_are_those_of_the_definitions():
    found = ml.check(EA, ROUND, NEEDLE, AT_REST, dt=-0.1)
    assert (found.method, found.dt, found.sane, found.solved) == (EA, -0.1, True, True)
    assert found.turn == 0
    assert found.rate == pytest.approx(OMEGA)
    assert found.stiffness == pytest.approx(0.1 * OMEGA)
    assert found.limit == limits.oscillator_limit(ml.schemes.EA)
    assert found.suggested == pytest.approx(-0.5 * found.limit / OMEGA)
    free = ml.check(EA, ROUND, None, SPINNING, dt=0.1)
    # The flight turns at |Pi| / I1 about the momentum, and slower about the axis.
    assert free.turn == pytest.approx(0.36)
    assert (free.rate, free.resonance, free.harmonic) == (0, np.inf, 0)
    assert free.suggested == pytest.approx(0.8 * free.reach / 3.6)


@pytest.mark.sample(0)
def test_each_reason_is_named():
    def why(torque, state, dt):
        found = ml.check(EA, ROUND, torque, state, dt=dt)
        assert not found.sane
        assert "NOT sane" in str(found)
        assert ml.check(EA, ROUND, torque, state, dt=found.suggested * (1 - 1e-6)).sane
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
    together = ml.check(EA, ROUND, HeavyTop(weights), states, dt=0.05)

    def alone(i, dt):
        return ml.check(EA, ROUND, HeavyTop(weights[i]), jax.tree.map(lambda x: x[i], states), dt=dt)

    each = [alone(i, 0.05) for i in range(3)]
    for name in ("turn", "rate", "stiffness"):
        assert getattr(together, name) == pytest.approx(max(getattr(one, name) for one in each))
    # The longest step of the worst body, or somewhat less where that step is in a resonance of another body.
    longest = min(one.suggested for one in each)
    assert 0.9 * longest <= together.suggested <= longest * (1 + 1e-6)
    assert all(alone(i, together.suggested * (1 - 1e-6)).sane for i in range(3))


@pytest.mark.sample(0)
def test_decay_and_what_is_not_finite():
    damped = ml.check(EA, ROUND, Damping(jnp.array(6.0)), SPINNING, dt=0.05)
    assert np.isnan(damped.energy_error)
    assert damped.rate == pytest.approx(6.0)
    assert damped.limit == limits.decay_limit(ml.schemes.EA)
    broken = ml.check(EA, ROUND, lambda t, state: state.momentum / 0, SPINNING, dt=0.05)
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
    found = ml.check(EA, ROUND, HeavyTop(5.0), state, dt=0.2, steps=400)
    assert found.sane
    assert found.judged == "attitude"
    run = {"steps": 200, "save_every": 2}
    coarse = ml.integrate(EA, ROUND, HeavyTop(5.0), state, dt=0.2, **run).states.attitude
    fine = ml.integrate("GBS12", ROUND, HeavyTop(5.0), state, dt=0.2, **run).states.attitude
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


def test_bad_arguments_of_check_are_named():
    good = {"method": EA, "body": ROUND, "torque": NEEDLE, "start": SPINNING, "dt": 0.1}
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


@pytest.mark.sample(0)
def test_the_first_bad_state_is_the_first_that_an_infinite_momentum_or_a_failed_flight_reaches():
    """The kick at 1.1 ends step 11, and the flight of step 12 is the first that fails."""

    def path_of(torque, save_every, start=SPINNING):
        return quick(lambda s: ml.integrate(EA, ROUND, torque, s, dt=0.1, steps=20, save_every=save_every))(start)

    for size, step, save_every in ((1e3, 12, 1), (1e3, 12, 10), (jnp.nan, 11, 4)):
        path = path_of(lambda t, state, size=size: jnp.where(t > 1.05, size, 0.0) * jnp.ones(3), save_every)
        assert not path.ok
        assert path.first_bad == -(-step // save_every)
    good = path_of(None, 4)
    assert good.ok
    assert good.first_bad == len(good.times) == 6
    assert path_of(None, 4, jax.tree.map(lambda x: x * jnp.nan, SPINNING)).first_bad == 0


# ---- the clock, the median and the spread behind every table of times, under clocks that are made up ----


class Machine:
    """Two clocks that go on by one at every reading; the wall's by `busy` times as much, both by `slow` times."""

    busy = slow = 1.0
    wall = processor = 0.0

    def perf_counter(self) -> float:
        self.wall += self.busy * self.slow
        return self.wall

    def process_time(self) -> float:
        self.processor += self.slow
        return self.processor


@pytest.fixture
def machine(monkeypatch):
    made = Machine()
    monkeypatch.setattr(time, "perf_counter", made.perf_counter)
    monkeypatch.setattr(time, "process_time", made.process_time)
    return made


def test_a_timing_is_the_median_of_alternate_runs_and_half_the_middle_half(machine):
    """While the second round is measured the processor is slow by half."""
    watch, turns = Stopwatch(), []
    watch.laps = [10.0, 1.0, 2.0, 3.0, 4.0]
    assert watch.timing() == Timing(3.0, pytest.approx((4 - 2) / 2 / 3))

    def run(name):
        turns.append(name)
        machine.slow = 1.5 if 2 < len(turns) <= 4 else 1.0
        return name

    found = timed_in_turn([lambda: run("a"), lambda: run("b")], least=6, most=6)
    assert turns == ["a", "b"] * 6
    assert [(result, timed.seconds) for result, timed in found] == [("a", 1.0), ("b", 1.0)]


def test_the_clock_is_the_processors_on_the_cpu_and_the_walls_where_an_accelerator_works(machine, monkeypatch):
    machine.busy = 5.0
    assert timed(lambda: None)[1].seconds == 1.0
    for cores, clock in ((1, "processor time"), (2, "wall time")):
        monkeypatch.setattr(timing, "cores", lambda cores=cores: cores)
        assert timing.user_clock().name == clock
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert timed(lambda: None)[1].seconds == 5.0
