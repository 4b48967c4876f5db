"""Pictures on the user's axes: what is drawn lies where the motion is, of every kind of state; bad input is named."""

import contextlib
import inspect
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pictured import GRAVITY, MASS, UPRIGHT, apart, brick

import midlie_jax as ml
from midlie_jax.plot import style
from midlie_jax.plot.artists import HalfCurve
from midlie_jax.plot.conservation import balanced
from midlie_jax.plot.motion import motion_of
from midlie_jax.plot.style import FEW

MOMENTS = np.array([1.0, 2.0, 2.5])
BRICK, TOP, WEIGHT = ml.RigidBody(MOMENTS), ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
ROTOR = ml.SymmetricRotor(5.0, 1.0)


def axes_of(**options):
    figure = Figure(figsize=(6.4, 4.8))
    FigureCanvasAgg(figure)
    return figure.add_subplot(**options)


@pytest.fixture(scope="module")
def free():
    start = ml.RigidState([0.02, 2.0, 0.01], UPRIGHT)
    return quick(lambda start: ml.free_motion(BRICK, start, jnp.linspace(0.0, 30.0, 601)))(start)


def failing(path, first_bad):
    broken = path.states.momentum.at[first_bad:].set(jnp.nan)
    states = jax.tree.unflatten(jax.tree.structure(path.states), (broken, path.states.attitude))
    return ml.Path(path.times, states, jnp.asarray(False), jnp.asarray(first_bad))


def points_of(axes):
    """All points of the curves on 3-D axes that are drawn on a surface, (n, 3)."""
    return np.concatenate([np.transpose(line.get_data_3d()) for line in axes.lines if isinstance(line, HalfCurve)])


def texts(axes):
    return [text for text in axes.texts if text.get_text()]


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()] if axes.get_legend() else []


def test_an_axis_path_lies_on_the_sphere_and_is_that_of_the_attitudes(free):
    solid, flat = axes_of(projection="3d"), axes_of()
    tips = ml.plot.axis_path(solid, free, axis=0)
    np.testing.assert_allclose(tips, ml.so3.to_matrix(free.states.attitude)[:, :, 0], atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(points_of(solid), axis=1), 1, atol=1e-12)
    along = np.array([0.6, 0.0, 0.8])
    other = ml.plot.axis_path(solid, free, axis=along, label="bolt", colour=style.VERMILLION)
    np.testing.assert_allclose(other, np.asarray(ml.so3.to_matrix(free.states.attitude)) @ along, atol=1e-14)
    assert legend(solid) == ["e1", "bolt"]
    tips = ml.plot.axis_path(flat, free)  # from above
    assert flat.lines[0].get_xydata()[[0, -1]] == pytest.approx(tips[[0, -1], :2])


@pytest.mark.parametrize(("kind", "turned"), [("momentum", True), ("velocity", False)])
def test_a_polhode_lies_on_the_ellipsoid_of_its_energy(free, kind, turned):
    """Also of a body in a frame of one's own, whose momenta are turned into its principal frame."""
    solid = axes_of(projection="3d")
    body, path = BRICK, free
    if turned:
        turn = ml.so3.exp(jnp.array([0.3, -0.2, 0.5]))
        matrix = ml.so3.to_matrix(turn)
        body = ml.TensorBody(matrix @ jnp.diag(MOMENTS) @ matrix.T)
        path = path._replace(states=ml.MomentumState(ml.so3.rotate(turn[None], path.states.momentum)))
    points = ml.plot.polhode(solid, body, path, kind=kind)
    weights = 1 / MOMENTS if kind == "momentum" else MOMENTS
    twice = np.sum(np.asarray(free.states.momentum[0]) ** 2 / MOMENTS)
    for drawn in (points, points_of(solid)):
        np.testing.assert_allclose(drawn**2 @ weights, twice, rtol=1e-12)
    known = ml.observe.angular_velocity(BRICK, free.states) if kind == "velocity" else free.states.momentum
    np.testing.assert_allclose(np.abs(points), np.abs(known), atol=1e-10)  # an axis of a tensor may point either way
    faster = path._replace(states=ml.MomentumState(2 * path.states.momentum))
    with pytest.raises(ValueError, match="must have the kinetic energy of the ellipsoid on these axes"):
        ml.plot.polhode(solid, body, faster)


def test_errors_of_energy_and_momentum_are_drawn_as_they_are():
    flat = axes_of()
    start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
    top, gravity, start = jax.tree.map(lambda x: x.astype(jnp.float32), (TOP, WEIGHT, start))
    precessing = ml.integrate("SYMMETRIC[EA]", top, gravity, start, dt=0.01, steps=400, save_every=2)
    found = ml.plot.conserved(flat, top, gravity, precessing)
    states = jax.tree.map(lambda x: x.astype(jnp.float64), precessing.states)
    energy = np.asarray(ml.observe.energy(TOP, WEIGHT, states))
    vertical = np.asarray(ml.observe.spatial_momentum(states))[:, 2]
    np.testing.assert_allclose(found.energy, (energy - energy[0]) / abs(energy[0]), atol=1e-13)
    np.testing.assert_allclose(found.momentum, np.abs(vertical - vertical[0]) / 50.0, atol=1e-13)
    bold = [line for line in flat.lines if line.get_linewidth() == 2.0]
    least = float(np.finfo(np.float32).eps) / 2
    for line, errors in zip(bold, (found.energy, found.momentum), strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.maximum.accumulate(np.maximum(np.abs(errors), least)))
    assert legend(flat) == ["energy", "vertical momentum"]


@pytest.mark.parametrize("direction", [1, 0])
def test_crossings_are_where_the_closed_form_says(direction):
    """A symmetric body: Pi_1 = a cos(r t), Pi_2 = -a sin(r t). The jump of an angle is no crossing."""
    flat = axes_of()
    a, spin, rate = 0.5, 3.0, 3.0 * (1 / 1.0 - 1 / 2.0)
    body, start = ml.RigidBody([2.0, 2.0, 1.0]), ml.MomentumState([a, 0.0, spin])
    path = ml.free_motion(body, start, jnp.linspace(0.01, 30.0, 901))
    found = ml.plot.poincare(
        flat, path, _second, _first, lambda t, state: state.momentum[2] * t, direction=direction, label="body"
    )
    count = np.arange(1, int(30.0 * rate / np.pi) + 1)
    expected = np.pi / rate * {1: count[count % 2 == 1], -1: count[count % 2 == 0], 0: count}[direction]
    np.testing.assert_allclose(found.times, expected, atol=2e-7)  # fourth order: the turn from state to state is 0.05
    np.testing.assert_allclose(np.abs(found.points[:, 0]), a, atol=2e-7)
    np.testing.assert_allclose(found.points[:, 1], spin * expected, atol=1e-6)
    np.testing.assert_allclose(found.states.momentum[:, 1], 0, atol=1e-14)
    np.testing.assert_array_equal(flat.lines[0].get_xydata(), found.points)
    assert legend(flat) == ["body"]
    if not direction:
        found = ml.plot.poincare(flat, path, lambda t, state: jnp.arctan2(*state.momentum[1::-1]), _first, _second)
        assert np.all(found.points[:, 0] > 0)  # at pi, where it jumps, the first component is negative
        nowhere = axes_of()
        assert ml.plot.poincare(nowhere, path, lambda t, state: 1 + t, _first, _first).points.shape == (0, 2)
        assert not legend(nowhere)


def _first(t, state):
    return state.momentum[0]


def _second(t, state):
    return state.momentum[1]


def test_a_failed_run_is_drawn_up_to_there_and_says_so(free):
    """Repeated times, as at the end of `integrate_variable_step`, count once."""
    index = jnp.array([0, 1, 2, 3, 4, 4, 4])
    path = ml.Path(*jax.tree.map(lambda x: x[index], (free.times, free.states)), jnp.asarray(True), jnp.asarray(7))
    assert (len(motion_of(path).times), motion_of(path).failed) == (5, "")
    assert motion_of(path._replace(ok=jnp.asarray(False), first_bad=jnp.asarray(5))).failed == "FAILED after t = 0.2"
    axes = axes_of()
    found = ml.plot.conserved(axes, BRICK, None, failing(free, 200))
    assert len(found.energy) == 200
    assert any("FAILED after t = 9.95" in text.get_text() for text in texts(axes))


BAND_TIMES = np.linspace(0.0, 4.0, 30)
VALUES = np.random.default_rng(0).normal(size=(200, 1)) * np.sin(BAND_TIMES) + 0.01 * np.arange(200)[:, None]


# The type checkers of the tests stand in front of the package's own checks; users do not have them.
bare = SimpleNamespace(
    **{name: inspect.unwrap(getattr(ml.plot, name)) for name in ("axis_path", "polhode", "poincare", "conserved")}
)
WRONG = [
    (lambda axes, p: bare.axis_path(axes, p._replace(times=0 * p.times)), "times of path must differ"),
    (lambda axes, p: bare.axis_path(axes, p, axis=[1.0, 1.0, 0.0]), r"axis must .*got \[1.0, 1.0, 0.0\]"),
    (lambda axes, p: bare.poincare(axes, p, lambda t, s: s.momentum, _first, _first), "section.* must be one real num"),
    (lambda axes, p: bare.poincare(axes, p, _second, _first, _first, direction=2), "direction must be 1, -1 or 0, got"),
    (lambda axes, p: bare.axis_path(axes, "path"), "path must be a path of a rigid body .*got str"),
    (lambda axes, p: bare.axis_path(axes, p._replace(states=p.times)), "Integrate without observe="),
    (lambda axes, p: bare.axis_path(axes, jax.tree.map(lambda x: x[None], p)), r"must be of one body.*\(1, 601, 3\)"),
    (lambda axes, p: bare.axis_path(axes, failing(p, 1)), "path must have 2 good states, got 1"),
    (lambda axes, p: bare.axis_path(axes, p, axis=3), "axis must be .*its index 0, 1 or 2, .*got 3"),
    (lambda axes, p: bare.axis_path(axes, p, axis="3"), "must be \"e1\", .*got '3'"),
    (lambda axes, p: bare.polhode(axes_of(), BRICK, p), 'add_subplot.projection="3d"'),
    (lambda axes, p: bare.polhode(axes, BRICK, p, kind="spin"), "kind must be one of momentum, velocity"),
    (lambda axes, p: bare.polhode(axes, ml.Particles(1.0), p), "body must be a RigidBody"),
    (lambda axes, p: bare.polhode(axes, ml.RigidBody(np.ones((2, 3))), p), r"one body .*got \(2, 3\)"),
    (lambda axes, p: bare.poincare(axes, p, 0.0, _first, _first), "section must be a function of"),
    (lambda axes, p: bare.conserved(axes, ml.Particles(1.0), None, p), "belongs to a RigidBody"),
    (lambda axes, p: bare.polhode(axes, *apart(2)), r"path._replace\(states=path.states.of_body\(i"),
    (lambda axes, p: bare.axis_path(axes, apart(FEW + 1)[1]), "path must hold at most 6 bodies, got 7"),
    (lambda axes, p: ml.plot.bands(axes, BAND_TIMES, VALUES.T), r"values \(bodies, n\), got \(30,\) and \(30, 200\)"),
    (lambda axes, p: ml.plot.bands(axes, BAND_TIMES, "values"), "must be arrays of numbers, got an array .* and str"),
    (lambda axes, p: ml.plot.bands(axes, BAND_TIMES[::-1], VALUES), "times must ascend and be finite. Sort"),
    (lambda axes, p: ml.plot.bands(axes, BAND_TIMES, VALUES * np.nan), "finite row, got none in 200 rows.*first_bad"),
    (lambda axes, p: ml.plot.bands(axes, BAND_TIMES, VALUES, levels=(50.0, 90.0)), "levels must be fractions .*90.0"),
    (lambda axes, p: bare.axis_path(axes, p._replace(states=ml.AxisState.of(p.states)), "e1"), 'must be "e3" for a A'),
    (lambda axes, p: ml.plot.view(brick(), p), "a RigidState belongs to a"),
]


def test_bad_input_is_named(free):
    solid = axes_of(projection="3d")
    for draw, message in WRONG:
        with pytest.raises(ValueError, match=message):
            draw(solid, free)
    assert not solid.lines


# ---- ensembles ----


def test_bands_are_quantiles():
    flat = axes_of()
    found = ml.plot.bands(flat, BAND_TIMES, VALUES, levels=(0.5, 0.9))
    np.testing.assert_allclose(flat.lines[0].get_xydata().T, [BAND_TIMES, np.median(VALUES, axis=0)])
    assert (found.bodies, found.failed) == (200, 0)
    assert len(flat.collections) == 2
    for level, drawn in zip((0.9, 0.5), flat.collections, strict=True):
        low, high = np.quantile(VALUES, [(1 - level) / 2, (1 + level) / 2], axis=0)
        np.testing.assert_allclose(found.edges[level], [low, high])
        corners = drawn.get_paths()[0].vertices
        assert (corners[:, 1].min(), corners[:, 1].max()) == pytest.approx((low.min(), high.max()))
    # Failed bodies are left out and counted.
    broken = np.concatenate([VALUES[:50], np.full((3, 30), np.nan), VALUES[50:]])
    failing = ml.plot.bands(flat, BAND_TIMES, broken, label="tops")
    np.testing.assert_array_equal(failing.median, found.median)
    assert "tops, 200 bodies, 3 failed and left out" in legend(flat)


# ---- every kind of state ----


@pytest.fixture(scope="module")
def cases():
    turning = ml.RigidState([0.0, 0.3, 30.0], ml.so3.exp(jnp.array([0.5, 0.0, 0.0])))
    start = ml.FreeState(turning.momentum, turning.attitude, [8.0, 0.0, 32.0], [0.0, 0.0, 1.0])
    flying, run = ml.FreeBody(TOP, MASS), {"dt": 0.02, "steps": 40}
    top = ml.integrate("JACOBI[EA]", TOP, WEIGHT, turning, **run)
    thrown = ml.integrate("JACOBI[EA]", flying, GRAVITY, start, **run)
    momenta, third = top.states.momentum, ml.so3.to_matrix(top.states.attitude)[:, 2]
    return {
        "RigidState": (TOP, WEIGHT, top),
        "DirectionState": (TOP, WEIGHT, top._replace(states=ml.DirectionState(momenta, third))),
        "MomentumState": (TOP, None, ml.free_motion(TOP, ml.MomentumState(momenta[0]), top.times)),
        "AxisState": (ROTOR, WEIGHT, top._replace(states=ml.AxisState.of(top.states))),
        "FreeState": (flying, GRAVITY, thrown),
        "FreeAxisState": (
            ml.FreeBody(ROTOR, MASS),
            GRAVITY,
            thrown._replace(states=ml.FreeAxisState.of(thrown.states)),
        ),
    }


KINDS = ("RigidState", "DirectionState", "MomentumState", "AxisState", "FreeState", "FreeAxisState")
DRAW = {
    "animate": lambda body, torque, path, out: ml.plot.animate(body, path, out / "a.gif", frames=3, size=120),
    "view": lambda body, torque, path, out: ml.plot.view(body, path, frames=3),
    "axis_path": lambda body, torque, path, out: ml.plot.axis_path(axes_of(projection="3d"), path),
    "track": lambda body, torque, path, out: ml.plot.track(axes_of(projection="3d"), path, label="a body"),
    "polhode": lambda body, torque, path, out: bare.polhode(axes_of(projection="3d"), body, path),
    "conserved": lambda body, torque, path, out: ml.plot.conserved(axes_of(), body, torque, path),
    "poincare": lambda body, torque, path, out: ml.plot.poincare(axes_of(), path, _first, _first, _first, direction=0),
}
NO_ATTITUDE = dict.fromkeys(("DirectionState", "MomentumState"), "needs the attitude")
NO_PLACE = {kind: f"must hold positions, got {kind}s" for kind in KINDS if not kind.startswith("Free")}
NOT_IN_BODY = dict.fromkeys(("AxisState", "FreeAxisState"), "must hold momenta in the body frame")
REFUSED = dict.fromkeys(("animate", "view", "axis_path"), NO_ATTITUDE) | {"track": NO_PLACE, "polhode": NOT_IN_BODY}


@pytest.mark.sample(6)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", DRAW)
def test_every_function_draws_every_kind_of_state_or_says_what_is_missing(cases, tmp_path, name, kind):
    refusal = REFUSED.get(name, {}).get(kind)
    with pytest.raises(ValueError, match=refusal) if refusal else contextlib.nullcontext():
        assert DRAW[name](*cases[kind], tmp_path) is not None
    assert bool(list(tmp_path.iterdir())) == (name == "animate" and not refusal)


# ---- what is conserved ----

MU = ml.torques.PointMass(1.0)
FLAT = ml.torques.Oblateness(1.0, 0.5, 0.1, [0.6, 0.0, 0.8])
UP = ml.torques.HeavyTop(0.5)
FORCES = {
    "gravity": (GRAVITY, "total momentum along gravity", False),
    "point mass": (MU, "total angular momentum", False),
    "oblate": (MU + FLAT, "total momentum along the pole", False),
    "torque alone": (UP, "vertical total momentum", True),
    "dipole": (ml.torques.DipoleInField([0.1, 0.0, 0.3], [1.0, 2.0, 0.0]), "total momentum along the field", True),
    "gravity and point mass": (GRAVITY + MU, "total momentum along gravity", False),
    "gravity across": (ml.torques.UniformGravity([1.0, 0.0, 0.0]) + UP, None, False),
    "thrust": (ml.spacecraft.Thrust([0.1, 0.0, 0.0], [0.0, 0.1, 0.0]), ValueError, False),
    "drag": (ml.torques.Drag([0.0, 0.0, 0.1], 0.1, 1.0), ValueError, False),
}


@pytest.mark.sample(2)
@pytest.mark.parametrize(("torque", "momentum", "linear"), FORCES.values(), ids=FORCES.keys())
def test_what_is_said_to_be_conserved_is_conserved(torque, momentum, linear):
    """Steps of RK4 so small that rounding is the error."""
    body = brick()
    start = ml.FreeState(body.momentum(jnp.array([0.5, 2.0, 0.3])), UPRIGHT, [0.5, 3.0, 1.5], [1.5, 0.2, -0.3])
    path = ml.integrate("RK4", body, torque, start, dt=5e-4, steps=100)
    if momentum is ValueError:
        with pytest.raises(ValueError, match="nothing is conserved"):
            ml.plot.conserved(axes_of(), body, torque, path)
        return
    axes = axes_of()
    found = ml.plot.conserved(axes, body, torque, path)
    assert np.max(np.abs(found.energy)) < 1e-12
    assert (found.linear is not None, found.momentum is not None) == (linear, momentum is not None)
    for errors in (found.momentum, found.linear):
        assert errors is None or np.max(errors) < 1e-12
    missing = "total angular momentum not conserved: torque or force changes it"
    assert (missing in [text.get_text() for text in texts(axes)]) == (momentum is None)
    names = {line.get_label() for line in axes.lines if line.get_linewidth() == 2.0}
    assert names == {"energy"} | ({momentum} if momentum else set()) | ({"linear momentum"} if linear else set())


def test_the_sums_of_the_momenta_of_coupled_bodies_are_conserved():
    body, path = apart(2)
    pull = ml.torques.FromPotential(lambda t, s: 3 * jnp.sum((s.position[0] - s.position[1]) ** 2))
    assert balanced(body, pull, np.asarray(path.times), path.states)
    assert not balanced(body, pull + ml.torques.OnEach(GRAVITY), np.asarray(path.times), path.states)
    # The bodies do not follow the pull, but both sums are conserved.
    for torque in (None, pull):
        found = ml.plot.conserved(axes_of(), body, torque, path)
        assert max(float(np.abs(each).max()) for each in (found.momentum, found.linear)) < 1e-14


def test_tracks_and_axes_of_coupled_bodies():
    _, coupled = apart(2)
    np.testing.assert_array_equal(ml.plot.track(axes_of(), coupled), coupled.states.position)
    tips = ml.plot.axis_path(axes_of(projection="3d"), coupled, "e1")
    np.testing.assert_allclose(tips, ml.so3.to_matrix(coupled.states.attitude)[..., 0], atol=1e-12)
