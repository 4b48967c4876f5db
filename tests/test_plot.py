"""Pictures of one path: what is drawn lies where the motion is, every name can be read, bad input is named."""

import inspect
import itertools
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from test_bands import contrast

import midlie_jax as ml
from midlie_jax.plot import style
from midlie_jax.plot.curves import polhodes

MOMENTS = np.array([1.0, 2.0, 2.5])
BRICK, TOP, GRAVITY = ml.RigidBody(MOMENTS), ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def axes_of(**options):
    figure = Figure(figsize=(6.4, 4.8))
    FigureCanvasAgg(figure)
    return figure.add_subplot(**options)


@pytest.fixture
def flat():
    return axes_of()


@pytest.fixture
def solid():
    return axes_of(projection="3d")


@pytest.fixture(scope="module")
def free():
    """A body under no torque that turns over."""
    start = ml.RigidState([0.02, 2.0, 0.01], UPRIGHT)
    return ml.free_motion(BRICK, start, jnp.linspace(0.0, 30.0, 601))


@pytest.fixture(scope="module")
def precessing():
    """A top in gravity, in float32."""
    numbers = [jnp.asarray(x, jnp.float32) for x in ([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))]
    top, gravity = jax.tree.map(lambda x: x.astype(jnp.float32), (TOP, GRAVITY))
    return ml.integrate("SYMMETRIC[EA]", top, gravity, ml.RigidState(*numbers), dt=0.01, steps=400, save_every=2)


def failing(path, first_bad):
    """The path as if it had failed there."""
    broken = path.states.momentum.at[first_bad:].set(jnp.nan)
    states = jax.tree.unflatten(jax.tree.structure(path.states), (broken, path.states.attitude))
    return ml.Path(path.times, states, jnp.asarray(False), jnp.asarray(first_bad))


def points_of(axes):
    """All points of the curves on 3-D axes that are drawn on a surface, (n, 3)."""
    from midlie_jax.plot.artists import HalfCurve

    return np.concatenate([np.transpose(line.get_data_3d()) for line in axes.lines if isinstance(line, HalfCurve)])


def texts(axes):
    return [text for text in axes.texts if text.get_text()]


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()] if axes.get_legend() else []


def assert_no_names_collide(axes):
    axes.figure.canvas.draw()
    renderer = axes.figure.canvas.get_renderer()
    # Of the text alone: the extent of an annotation includes its leader.
    extent = {text: text.get_window_extent(renderer) for text in texts(axes)}
    extent |= {text: Text.get_window_extent(text, renderer) for text in texts(axes) if hasattr(text, "arrow_patch")}
    for (one, a), (other, b) in itertools.combinations(extent.items(), 2):
        assert not a.overlaps(b), (one.get_text(), other.get_text())


def test_an_axis_path_lies_on_the_sphere_and_is_that_of_the_attitudes(solid, free):
    tips = ml.plot.axis_path(solid, free, axis=0)
    np.testing.assert_allclose(tips, ml.so3.to_matrix(free.states.attitude)[:, :, 0], atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(points_of(solid), axis=1), 1, atol=1e-12)
    along = np.array([0.6, 0.0, 0.8])
    other = ml.plot.axis_path(solid, free, axis=along, label="bolt", colour=style.VERMILLION)
    np.testing.assert_allclose(other, np.asarray(ml.so3.to_matrix(free.states.attitude)) @ along, atol=1e-14)
    assert {text.get_text() for text in texts(solid)} == {"x", "y", "z"}
    assert legend(solid) == ["e1", "bolt"]


def test_an_axis_path_from_above(flat, precessing):
    tips = ml.plot.axis_path(flat, precessing)
    assert flat.lines[0].get_xydata()[[0, -1]] == pytest.approx(tips[[0, -1], :2])
    assert legend(flat) == ["e3"]
    assert (flat.get_xlabel(), flat.get_ylabel()) == ("x in space  [-]", "y in space  [-]")


def test_arcs_between_far_points_stay_on_the_sphere():
    from midlie_jax.plot.artists import along_arcs

    points = np.random.default_rng(0).normal(size=(6, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    arcs = along_arcs(np.concatenate([points, points[-1:], -points[-1:]]))
    np.testing.assert_allclose(np.linalg.norm(arcs, axis=1), 1, atol=1e-12)
    steps = np.linalg.norm(np.diff(arcs, axis=0), axis=1)
    assert np.max(np.sort(steps)[:-1]) < np.radians(2.01)  # but for the jump to the opposite point, which has no arc
    assert all(np.min(np.linalg.norm(arcs - point, axis=1)) < 1e-12 for point in points)


@pytest.mark.parametrize("kind", ["momentum", "velocity"])
@pytest.mark.parametrize("turned", [False, True], ids=["principal", "tensor"])
def test_a_polhode_lies_on_the_ellipsoid_of_its_energy(solid, free, kind, turned):
    """Also of a body in a frame of one's own, whose momenta are turned into its principal frame."""
    body, path = BRICK, free
    if turned:
        turn = ml.so3.exp(jnp.array([0.3, -0.2, 0.5]))
        matrix = ml.so3.to_matrix(turn)
        body = ml.TensorBody(matrix @ jnp.diag(MOMENTS) @ matrix.T)
        path = path._replace(states=ml.MomentumState(ml.so3.rotate(turn[None], path.states.momentum)))
    points = ml.plot.polhode(solid, body, path, kind=kind)
    squares = points**2 / MOMENTS if kind == "momentum" else points**2 * MOMENTS
    twice = np.sum(np.asarray(free.states.momentum[0]) ** 2 / MOMENTS)
    np.testing.assert_allclose(np.sum(squares, axis=1), twice, rtol=1e-12)
    drawn = points_of(solid)
    weights = 1 / MOMENTS if kind == "momentum" else MOMENTS
    np.testing.assert_allclose(drawn**2 @ weights, twice, rtol=1e-12)
    known = ml.observe.angular_velocity(BRICK, free.states) if kind == "velocity" else free.states.momentum
    np.testing.assert_allclose(np.abs(points), np.abs(known), atol=1e-10)  # an axis of a tensor may point either way
    assert_no_names_collide(solid)


@pytest.mark.parametrize("moments", [[1.0, 2.0, 2.5], [2.5, 1.0, 2.0], [5.0, 5.0, 1.0], [1.0, 1.5, 1.5], [2.0] * 3])
def test_the_other_polhodes_have_one_energy_and_one_momentum_each(moments):
    moments = np.array(moments)
    found = polhodes(moments)
    assert len(found) == {3: 14, 2: 6, 1: 0}[len(set(moments))]
    for u, bold in found:
        np.testing.assert_allclose(np.sum(u**2, axis=1), 1, atol=1e-12)
        squares = u**2 @ moments
        np.testing.assert_allclose(squares, squares[0], rtol=1e-12)
        assert bold == (abs(squares[0] - np.median(moments)) < 1e-12)


def drawn_part(half):
    """Which points of a curve are drawn."""
    drawn = []
    half.set_data = lambda x, y: (drawn.append(np.isfinite(x)), type(half).set_data(half, x, y))
    half.draw(half.axes.figure.canvas.get_renderer())
    return drawn[0]


def test_what_faces_the_viewer_is_drawn_in_front():
    """From whichever side: the front half of a great circle that is seen at an angle, and the back half behind."""
    from midlie_jax.plot.artists import draw_curve, draw_ellipsoid

    angle = np.linspace(0, 2 * np.pi, 361)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    for azimuth in (0.0, 90.0, 200.0):
        axes = axes_of(projection="3d")
        draw_ellipsoid(axes, np.ones(3))
        axes.view_init(20.0, azimuth)
        axes.figure.canvas.draw()  # sets the projection
        seen = [drawn_part(half) for half in draw_curve(axes, circle, np.ones(3), color="black")]
        towards = np.cos(angle - np.radians(azimuth))
        clear = np.abs(towards) > 0.05
        np.testing.assert_array_equal(np.stack(seen)[:, clear], np.stack([towards < 0, towards > 0])[:, clear])


def test_errors_of_energy_and_momentum_are_drawn_as_they_are(flat, precessing):
    found = ml.plot.conserved(flat, *jax.tree.map(lambda x: x.astype(jnp.float32), (TOP, GRAVITY)), precessing)
    states = jax.tree.map(lambda x: x.astype(jnp.float64), precessing.states)
    energy = np.asarray(ml.observe.energy(TOP, GRAVITY, states))
    vertical = np.asarray(ml.observe.spatial_momentum(states))[:, 2]
    np.testing.assert_allclose(found.energy, (energy - energy[0]) / abs(energy[0]), atol=1e-13)
    np.testing.assert_allclose(found.momentum, np.abs(vertical - vertical[0]) / 50.0, atol=1e-13)
    bold = [line for line in flat.lines if line.get_linewidth() == 2.0]
    least = float(np.finfo(np.float32).eps) / 2
    for line, errors in zip(bold, (found.energy, found.momentum), strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.maximum.accumulate(np.maximum(np.abs(errors), least)))
    assert legend(flat) == ["energy", "vertical momentum"]
    ml.plot.conserved(flat, TOP, GRAVITY, precessing._replace(states=states), label="again")
    assert_no_names_collide(flat)


def test_what_is_not_conserved_is_said_and_not_drawn(flat, free):
    damped = ml.torques.VelocityDependent(lambda t, state: -0.1 * state.momentum)
    with pytest.raises(ValueError, match=r"nothing is conserved: kinetic energy: .*spatial momentum: not conserved"):
        ml.plot.conserved(flat, BRICK, damped, free)
    dragged = ml.torques.FromPotential(lambda t, state: state.attitude[0])
    found = ml.plot.conserved(flat, BRICK, dragged, free)
    assert found.momentum is None
    assert "spatial momentum not conserved: the torque changes it" in [text.get_text() for text in texts(flat)]
    assert len(flat.lines) == 2
    momenta = free._replace(states=ml.MomentumState(free.states.momentum))
    found = ml.plot.conserved(axes_of(), BRICK, None, momenta)
    assert np.max(np.abs(found.momentum)) < 1e-12


@pytest.mark.sample(1)
@pytest.mark.parametrize("direction", [1, -1, 0])
def test_crossings_are_where_the_closed_form_says(flat, direction):
    """A symmetric body under no torque: Pi_1 = a cos(r t), Pi_2 = -a sin(r t) with r = Pi_3 (1/I3 - 1/I1)."""
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


def _first(t, state):
    return state.momentum[0]


def _second(t, state):
    return state.momentum[1]


def test_the_jump_of_an_angle_is_no_crossing(flat):
    path = ml.free_motion(
        ml.RigidBody([2.0, 2.0, 1.0]), ml.MomentumState([0.5, 0.0, 3.0]), jnp.linspace(0.01, 30.0, 301)
    )

    def angle(t, state):
        return jnp.arctan2(state.momentum[1], state.momentum[0])

    found = ml.plot.poincare(flat, path, angle, _first, _second, direction=0)
    assert np.all(found.points[:, 0] > 0)  # at pi, where it jumps, the first component is negative
    assert len(found.times) in (7, 8)


def test_a_path_without_crossings_draws_none(flat, free):
    found = ml.plot.poincare(flat, free, lambda t, state: 1.0 + t, _first, _second, label="nothing")
    assert found.points.shape == (0, 2)
    assert not legend(flat)


def draw_all(path, label=""):
    """Every picture of a path, on axes of its own."""
    solid, flat, ellipsoid, errors, section = (
        axes_of(**o) for o in ({"projection": "3d"}, {}, {"projection": "3d"}, {}, {})
    )
    ml.plot.axis_path(solid, path)
    ml.plot.axis_path(flat, path)
    ml.plot.polhode(ellipsoid, BRICK, path)
    ml.plot.conserved(errors, BRICK, None, path)
    ml.plot.poincare(section, path, _second, _first, _first)
    return solid, flat, ellipsoid, errors, section


def test_a_failed_run_is_drawn_up_to_there_and_says_so(free):
    """To the last bit as the part before."""
    part = jax.tree.map(lambda x: x[:200], (free.times, free.states))
    whole = ml.Path(*part, jnp.asarray(True), jnp.asarray(200))
    for axes, expected in zip(draw_all(failing(free, 200)), draw_all(whole), strict=True):
        said = [text.get_text() for text in texts(axes)]
        assert any("FAILED after t = 9.95" in text for text in said), said
        for one, other in zip(axes.lines, expected.lines, strict=True):
            np.testing.assert_array_equal(one.get_xydata(), other.get_xydata())
        assert_no_names_collide(axes)


def test_repeated_times_are_drawn_once(flat, free):
    """As those at the end of `integrate_variable_step` are."""
    from midlie_jax.plot.motion import motion_of

    index = jnp.array([0, 1, 2, 3, 4, 4, 4])
    states = jax.tree.map(lambda x: x[index], free.states)
    path = ml.VariableStepPath(
        free.times[index], states, jnp.asarray(True), jnp.asarray(7), None, free.times[index], jnp.asarray(4)
    )
    found = motion_of(path)
    assert (len(found.times), found.failed) == (5, "")
    assert motion_of(path._replace(ok=jnp.asarray(False), first_bad=jnp.asarray(5))).failed == "FAILED after t = 0.2"


def batch_of(path):
    return jax.tree.map(lambda x: jnp.stack([x, x]), path._replace(times=path.times))


SPINS = ml.MomentumState(jnp.ones((601, 3)))
# The type checkers of the tests stand in front of the package's own checks; users do not have them.
bare = SimpleNamespace(
    **{name: inspect.unwrap(getattr(ml.plot, name)) for name in ("axis_path", "polhode", "poincare", "conserved")}
)
WRONG = {
    "no path": (lambda axes, p: bare.axis_path(axes, "path"), "path must be a path of a rigid body .*got str"),
    "crossings": (
        lambda axes, p: bare.axis_path(axes, ml.plot.Crossings(p.times, p.states, p.times)),
        "path must be a path of a rigid body .*got Crossings",
    ),
    "observed": (lambda axes, p: bare.axis_path(axes, p._replace(states=p.times)), "Integrate without observe="),
    "several observed": (
        lambda axes, p: bare.axis_path(axes, p._replace(states=(p.times, p.times))),
        "got Path that holds tuple. Integrate without observe=",
    ),
    "batch": (lambda axes, p: bare.axis_path(axes, batch_of(p)), r"path must be of one body.*\(2, 601, 3\)"),
    "no attitude": (lambda axes, p: bare.axis_path(axes, p._replace(states=SPINS)), "needs the attitude"),
    "all bad": (lambda axes, p: bare.axis_path(axes, failing(p, 1)), "path must have 2 good states, got 1"),
    "one time": (
        lambda axes, p: bare.axis_path(axes, p._replace(times=0 * p.times)),
        "times of path must differ",
    ),
    "axis": (lambda axes, p: bare.axis_path(axes, p, axis=3), "axis must be .*its index 0, 1 or 2, .*got 3"),
    "axis by a number from 1": (lambda axes, p: bare.axis_path(axes, p, axis="3"), "must be \"e1\", .*got '3'"),
    "not unit": (
        lambda axes, p: bare.axis_path(axes, p, axis=[1.0, 1.0, 0.0]),
        r"axis must .*got \[1.0, 1.0, 0.0\]",
    ),
    "flat axes": (lambda axes, p: bare.polhode(axes_of(), BRICK, p), 'add_subplot.projection="3d"'),
    "kind": (lambda axes, p: bare.polhode(axes, BRICK, p, kind="spin"), "kind must be one of momentum, velocity"),
    "particles": (lambda axes, p: bare.polhode(axes, ml.Particles(1.0), p), "body must be a RigidBody"),
    "bodies": (lambda axes, p: bare.polhode(axes, ml.RigidBody(np.ones((2, 3))), p), r"one body .*got \(2, 3\)"),
    "no function": (lambda axes, p: bare.poincare(axes, p, 0.0, _first, _first), "section must be a function of"),
    "vector": (
        lambda axes, p: bare.poincare(axes, p, lambda t, s: s.momentum, _first, _first),
        r"section\(t, state\) must be one real number, got an array of shape \(601, 3\)",
    ),
    "direction": (
        lambda axes, p: bare.poincare(axes, p, _second, _first, _first, direction=2),
        "direction must be 1, -1 or 0, got 2",
    ),
    "other body": (lambda axes, p: bare.conserved(axes, ml.Particles(1.0), None, p), "belongs to a RigidBody"),
}


@pytest.mark.parametrize(("draw", "message"), WRONG.values(), ids=WRONG.keys())
def test_bad_input_is_named(solid, free, draw, message):
    with pytest.raises(ValueError, match=message):
        draw(solid, free)
    assert not solid.lines


def test_an_ellipsoid_of_another_energy_is_refused(solid, free):
    ml.plot.polhode(solid, BRICK, free)
    faster = free._replace(states=ml.MomentumState(2 * free.states.momentum))
    with pytest.raises(ValueError, match="must have the kinetic energy of the ellipsoid on these axes"):
        ml.plot.polhode(solid, BRICK, faster)


def test_light_and_dark(free):
    """Text has the colour of the axis labels, whatever the style, and lines stand out from white and from black."""
    for options in ({}, {"projection": "3d"}):
        axes = axes_of(**options)
        axes.xaxis.label.set_color("#fedcba")
        ml.plot.axis_path(axes, failing(free, 300))
        assert {to_rgb(text.get_color()) for text in (*texts(axes), *axes.get_legend().get_texts())} == {
            to_rgb("#fedcba")
        }
    for colour in (style.BLUE, style.VERMILLION, style.GREEN, style.GREY):
        assert all(contrast(to_rgb(colour), background) > 3 for background in ("white", "black"))


def test_the_package_imports_neither_matplotlib_nor_plotly():
    code = (
        "import sys, midlie_jax as ml; print('midlie_jax.plot' in sys.modules); ml.plot.view; "
        "print(*('matplotlib' in sys.modules, 'plotly' in sys.modules, 'PIL' in sys.modules))"
    )
    root = Path(__file__).resolve().parent.parent
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root).stdout
    assert said.split() == ["False"] * 4
