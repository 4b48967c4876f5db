"""That a recommendation keeps its word on the motion it was made for, and says what it cannot do."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import setup, true_motion

import midlie_jax as ml
from midlie_jax import selection, so3
from midlie_jax.torques import HeavyTop, VelocityDependent

CASE = setup(strength=0.0)
BODY = ml.RigidBody(jnp.asarray(CASE.moments))
START = ml.RigidState(jnp.asarray(CASE.momentum), jnp.asarray(CASE.attitude))
AXIS = (0.0, 0.0, 1.0)


def test_what_is_recommended_stays_within_the_tolerance(monkeypatch):
    """Run as told, against SciPy's DOP853; and it is the quickest of those that did."""
    monkeypatch.setattr(selection, "candidates", lambda *_: ["DLM[EA]", "JACOBI[SRKN6b]"])
    torque, tolerance, duration = HeavyTop(2.0, AXIS), 1e-5, 2.0
    found = ml.recommend(BODY, torque, START, tolerance, duration=duration)
    steps = round(duration / found.dt)
    assert abs(steps * found.dt - duration) < 1e-12
    end = ml.integrate(found.method, BODY, torque, START, dt=found.dt, steps=steps, save_every=steps).states
    _, (exact,) = true_motion(CASE, np.array([duration]), AXIS)
    error = np.linalg.norm(so3.to_matrix(end.attitude[-1]) - so3.to_matrix(jnp.asarray(exact)))
    assert error <= tolerance
    assert 0.1 * error <= found.error <= 10 * error
    assert {row.method for row in found.tried} == {"DLM[EA]", "JACOBI[SRKN6b]"}
    with pytest.raises(ValueError, match="too small to be judged"):
        ml.recommend(BODY, torque, START, 1e-16, duration=duration)


def test_candidates_fit_the_body_and_the_torque():
    top = HeavyTop(2.0, AXIS)
    symmetric, ball = ml.RigidBody(jnp.array([2.0, 2.0, 1.0])), ml.RigidBody(jnp.array([1.0, 2.0, 2.0]))
    assert all(n.startswith(("SYMMETRIC", "DLM")) for n in selection.candidates(symmetric, top))
    assert not any(n.startswith("SYMMETRIC") for n in selection.candidates(ball, top))
    assert selection.candidates(BODY, None) == ["JACOBI[EA]"]
    assert selection.candidates(BODY, top + VelocityDependent(lambda t, s: -s.momentum)) == ["JACOBI[EA]", "DLM[EA]"]
    assert "DOP853" in selection.candidates(BODY, top, symplectic=False)


@pytest.mark.parametrize(
    ("state", "tolerance", "message"),
    [
        (START, 0.0, "tolerance must be positive"),
        (START, float("nan"), "tolerance must be positive"),
        (ml.RigidState(jnp.zeros(3), START.attitude), 1e-3, "at rest at the start: give a duration"),
    ],
)
def test_bad_arguments_are_named(state, tolerance, message):
    with pytest.raises(ValueError, match=message):
        ml.recommend(BODY, None, state, tolerance)
