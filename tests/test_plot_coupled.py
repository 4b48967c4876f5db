"""Pictures of bodies that act on each other: all in one picture, each where it is, or a refusal with the cure."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from test_view import figure_of

import midlie_jax as ml
from midlie_jax.plot.conservation import add_up_to_zero, balanced, kept_by
from midlie_jax.plot.model import panels, scenes
from midlie_jax.plot.style import FEW, SKY, VERMILLION, colours_of

TIMES = np.linspace(0.0, 2.0, 21)
SITES = np.array([[0.0, 0.0, -0.1], [0.2, 0.0, 0.1], [-0.2, 0.0, 0.1]])
GRAVITY = ml.torques.UniformGravity([0.0, 0.0, -9.81])


def apart(count, kind=ml.CoupledState):
    """Bodies that spin about e3, each at its rate, and fly apart: the exact motion without forces."""
    body = ml.FreeBody(ml.RigidBody(np.tile([0.02, 0.03, 0.04], (count, 1))), np.ones(count))
    rates, places = np.linspace(0.5, 1.0, count), np.stack(3 * [np.arange(count, dtype=float)], axis=1)
    speeds = places - places.mean(axis=0) + 0.1
    angle = TIMES[:, None] * rates / 2
    attitudes = np.stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)], axis=-1)
    spins = np.stack([0 * rates, 0 * rates, 0.04 * rates], axis=-1)
    arrays = {
        "momentum": np.broadcast_to(spins, (len(TIMES), count, 3)),
        "attitude": attitudes,
        "linear": np.broadcast_to(speeds, (len(TIMES), count, 3)),
        "position": places + TIMES[:, None, None] * speeds,
    }
    named = [arrays[name] for name in kind.described()]
    path = ml.Path(jnp.asarray(TIMES), kind(*named), jnp.asarray(True), jnp.asarray(len(TIMES)), jnp.asarray(0))
    return body if kind is ml.CoupledState else body.body, path


def named(body, path):
    return body, {"one": path, "again": path}


def spun(path, i, k):
    return np.asarray(ml.so3.to_matrix(path.states.attitude[k, i]))


def test_all_bodies_are_drawn_where_they_are():
    body, path = apart(2)
    (shown,) = scenes(panels(body, path), 2, 3, 100)
    assert (len(shown.members), len(set(shown.colours)), shown.few, shown.solid) == (2, 2, True, True)
    sizes = {member.travel.size for member in shown.members if member.travel is not None}
    assert len(sizes) == 1  # they are alike, and drawn alike
    for i, corners in enumerate(shown.sites(1)):
        np.testing.assert_allclose(corners.mean(axis=0), path.states.position[10, i], atol=1e-12)
        flat = (corners - corners.mean(axis=0)) @ spun(path, i, 10)
        np.testing.assert_allclose(np.abs(flat), np.abs(flat[:1]).repeat(8, axis=0), atol=1e-12)
    low, high = np.asarray(shown.limits)
    assert np.all(low < np.min(path.states.position, axis=(0, 1)))
    assert np.all(high > np.max(path.states.position, axis=(0, 1)))


@pytest.mark.sample(0)
def test_a_rod_is_drawn_as_bodies_that_touch():
    body, _, start = ml.molecules.straight_rod(
        9, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0],
        length=3.0, radius=0.1, density=1.0, youngs_modulus=10.0,
    )  # fmt: skip
    moved = ml.CoupledState(start.momentum, start.attitude, start.linear, start.position + 9.0)
    states = jax.tree.map(lambda *x: jnp.stack(x), start, moved)
    path = ml.Path(jnp.arange(2.0), states, jnp.asarray(True), jnp.asarray(2), jnp.asarray(0))
    (shown,) = scenes(panels(body, path), 2, 2, 100)
    heights = np.array([[corners[:, 2].min(), corners[:, 2].max()] for corners in shown.sites(0)])
    np.testing.assert_allclose(heights[1:, 0], heights[:-1, 1], atol=1e-12)
    assert not shown.few
    assert len(set(shown.colours)) == 10


@pytest.mark.sample(0)
def test_points_are_drawn_in_place_of_solids():
    body, path = apart(2)
    (shown,) = scenes(panels(body, path), 2, 21, 100, SITES)
    assert not shown.solid
    for i, sites in enumerate(shown.sites(5)):
        wanted = np.asarray(path.states.position[5, i]) + SITES @ spun(path, i, 5).T
        np.testing.assert_allclose(sites, wanted, atol=1e-12)
    assert len(shown.sticks(0)) == 4
    (many,) = scenes(panels(*apart(FEW + 1)), 2, 2, 100, SITES)
    assert many.styles_of_sites(3.0, 2.0)[0][:3] == [VERMILLION, SKY, SKY]
    single = ml.FreeBody(ml.RigidBody([0.02, 0.03, 0.04]), 1.0), path._replace(states=path.states.of_body(1))
    (alone,) = scenes(panels(*single), 2, 21, 100, SITES)
    np.testing.assert_allclose(alone.sites(5)[0] - shown.sites(5)[1], 0, atol=1e-12)


@pytest.mark.sample(1)
@pytest.mark.parametrize("points", [None, SITES])
def test_files_show_them(points, tmp_path):
    body, path = apart(2)
    options: dict[str, Any] = {"frames": 3, "points": points}
    with Image.open(ml.plot.animate(body, path, tmp_path / "two.gif", size=160, **options)) as picture:
        assert (getattr(picture, "n_frames", 1), picture.size) == (3, (160, 160))
    data = figure_of(ml.plot.view(body, path, **options).html)[0]
    names = [trace["name"] for trace in data]
    assert names[:2] == ["path of body 0", "path of body 1"]
    if points is None:
        assert len(data[2]["x"]) == 16
        assert names[3:] == ["e3 of body 0", "e3 of body 1"]
    else:
        assert len(data[2]["x"]) == 6
        assert names[3:] == ["bonds"]


@pytest.mark.sample(0)
def test_bodies_that_stay_have_a_panel_each():
    body, path = apart(3, ml.CoupledRigidState)
    shown = panels(body, path)
    assert [panel.name for panel in shown] == ["body 0", "body 1", "body 2"]
    assert all(together.limits is None for together in scenes(shown, 2, 3, 100))
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), apart(3)[1])
    assert [panel.name for panel in panels(apart(3)[0], batch)] == ["replica 0", "replica 1"]


def test_tracks_and_axes_of_all():
    figure, (_, path) = Figure(), apart(2)
    plain, solid = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    np.testing.assert_array_equal(ml.plot.track(plain, path), path.states.position)
    assert {line.get_color() for line in plain.lines} == set(colours_of(2))
    tips = ml.plot.axis_path(solid, path, "e1")
    np.testing.assert_allclose(tips[7, 1], spun(path, 1, 7)[:, 0], atol=1e-12)
    figure.canvas.draw()


def test_the_sums_of_the_momenta_are_conserved():
    body, path = apart(2)
    axes = Figure().add_subplot()
    found = ml.plot.conserved(axes, body, None, path)
    assert max(float(np.abs(each).max()) for each in found[1:] if each is not None) < 1e-14
    pull = ml.torques.FromPotential(lambda t, s: 3 * jnp.sum((s.position[0] - s.position[1]) ** 2))
    assert balanced(body, pull, TIMES, path.states)
    assert not balanced(body, pull + ml.torques.OnEach(GRAVITY), TIMES, path.states)
    # The bodies do not follow the pull, but all that counts is kept.
    pulled = ml.plot.conserved(Figure().add_subplot(), body, pull, path)
    assert pulled.momentum is not None
    assert pulled.linear is not None
    assert float(np.abs(pulled.linear).max()) < 1e-14


def test_what_conserves_the_momentum_is_known():
    assert kept_by(ml.asteroids.MutualGravity(1.0)) == kept_by(None)
    along: Any = kept_by(ml.torques.OnEach(GRAVITY))
    assert along.letter == "g"
    assert add_up_to_zero(np.array([[[1.0, 2.0, 3.0], [-1.0, -2.0, -3.0]]]))
    assert not add_up_to_zero(np.array([[[1.0, 2.0, 3.0], [-1.0, -2.0, -3.1]]]))


@pytest.mark.sample(0)
def test_a_section_of_coupled_bodies():
    _, path = apart(2)
    found = ml.plot.poincare(
        Figure().add_subplot(), path,
        lambda t, s: s.position[0, 0] + 0.35, lambda t, s: s.position[1, 1], lambda t, s: s.momentum[1, 2],
        direction=0,
    )  # fmt: skip
    when = -0.35 / float(path.states.linear[0, 0, 0])
    np.testing.assert_allclose(found.times, [when], rtol=1e-12)
    np.testing.assert_allclose(found.states.attitude[0, 1, 3], np.sin(when / 2), atol=1e-5)


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda axes: ml.plot.polhode(axes, *apart(2)), "path._replace(states=path.states.of_body(i))"),
        (lambda axes: ml.plot.axis_path(axes, apart(FEW + 1)[1]), "path must hold at most 6 bodies, got 7"),
        (lambda axes: ml.plot.animate(*apart(13, ml.CoupledRigidState)), "path must hold at most 12 paths, got 13"),
        (lambda axes: ml.plot.animate(*apart(2), points=np.ones(3)), "points must be (a, 3)"),
        (lambda axes: ml.plot.animate(*apart(2), points=np.nan * SITES), "points must be finite"),
        (lambda axes: ml.plot.animate(*apart(2), points=ml.Surface.box([1.0, 2.0, 3.0])), "drawn by its triangles"),
        (
            lambda axes: ml.plot.view(*named(*apart(2, ml.CoupledRigidState))),
            "path must be one path, got several of CoupledRigidStates",
        ),
        (lambda axes: ml.plot.animate(*apart(2, ml.CoupledRigidState), points=SITES), "body must be a FreeBody"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_cure(draw, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        draw(Figure().add_subplot(projection="3d"))


def test_surfaces_are_drawn_by_their_triangles(tmp_path):
    """In a view each body has the shape of its surface, enlarged, in one colour."""
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]])
    surface = ml.Surface(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    body, path = apart(2)
    view = ml.plot.view(body, path, tmp_path / "pair.html", points=[surface, surface.moved([0.0, 0.0, 0.1])], frames=3)
    (mesh,) = (trace for trace in view._figure["data"] if trace["type"] == "mesh3d")
    assert (len(mesh["x"]), len(mesh["i"]), len(set(mesh["facecolor"]))) == (8, 8, 2)
    drawn = np.stack([mesh[axis] for axis in "xyz"], axis=1)[:4]
    sides = np.linalg.norm(drawn[:, None] - drawn[None], axis=-1)
    exact = np.linalg.norm(corners[:, None] - corners[None], axis=-1)
    ratio = np.sort(sides[sides > 0]) / np.sort(exact[exact > 0])
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-3)
    assert ml.plot.animate(body, path, tmp_path / "pair.gif", points=[surface, surface], frames=2).exists()
