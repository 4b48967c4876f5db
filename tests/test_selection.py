"""That a recommendation keeps its word on the motion it was made for, and says what it cannot do."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import setup, true_motion

import midlie_jax as ml
from midlie_jax.advice import recommend as selection
from midlie_jax.advice.recommend import Case, one_direction
from midlie_jax.model import so3
from midlie_jax.model.torques import BodyTorque, Damping, DipoleInField, HeavyTop

CASE = setup(strength=0.0)
BODY = ml.RigidBody(jnp.asarray(CASE.moments))
START = ml.RigidState(jnp.asarray(CASE.momentum), jnp.asarray(CASE.attitude))
AXIS = (0.0, 0.0, 1.0)
TOP = HeavyTop(2.0, AXIS)


@pytest.fixture
def few(monkeypatch):
    """Two candidates, each compiled in a second."""
    monkeypatch.setattr(selection, "candidates", lambda *_, **__: ["JACOBI[SRKN6b]", "JACOBI[EA]"])


def measured(found, torque, duration):
    """The error of the recommendation as `integrate` runs it, against SciPy's DOP853."""
    end = ml.integrate(found.method, BODY, torque, START, dt=found.dt, steps=found.steps, save_every=found.steps).states
    _, (exact,) = true_motion(CASE, np.array([duration]), lambda t, r: CASE.weight * np.cross(r[2], AXIS))
    return np.linalg.norm(so3.to_matrix(end.attitude[-1]) - so3.to_matrix(jnp.asarray(exact)))


@pytest.mark.sample(0)
@pytest.mark.parametrize(("tolerance", "duration"), [(1e-5, 20.0), (0.5, 2.0)])
def test_what_is_recommended_stays_within_the_tolerance(few, capsys, tolerance, duration):
    """Over the whole duration asked for, with a step no finer than it must be: one half as long again misses."""
    found = ml.recommend(BODY, TOP, START, tolerance=tolerance, duration=duration, progress=duration < 3)
    assert ("recommend: JACOBI[SRKN6b] (1 of 2)" in capsys.readouterr().err) == (duration < 3)
    assert found.steps * found.dt == pytest.approx(duration, rel=1e-14)
    assert ml.check(found.method, BODY, TOP, START, dt=found.dt, steps=found.steps).sane
    error = measured(found, TOP, duration)
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


def changes_its_mind(t, state):
    """Of an attitude another torque than of a direction."""
    return TOP(t, state) * (2.0 if hasattr(state, "attitude") else 1.0)


def test_a_torque_that_reads_one_direction_alone_is_known():
    sideways = DipoleInField(jnp.array([0.3, 0.0, 0.1]), jnp.array([0.0, 2.0, 0.0]))
    for torque, direction in ((TOP + Damping(0.1), (0, 0, 1)), (sideways, (0, 1, 0))):
        found = one_direction(Case(BODY, torque, START, jnp.array(0.3), 2.0, None))
        seen = so3.to_matrix(START.attitude).T @ jnp.array(direction, float)
        np.testing.assert_allclose(found.direction, seen, atol=1e-15)
    for torque in (TOP + sideways, changes_its_mind, None):
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
