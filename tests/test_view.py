"""Moving pictures: where bodies are in the frames of a GIF or an HTML view, that view in a browser, `midlie view`."""

import contextlib
import html
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import threading
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import assert_one_line, midlie
from pictured import (
    GRAVITY,
    HALF,
    TIMES,
    UPRIGHT,
    apart,
    brick,
    figure_of,
    fleet,
    frames_of,
    spun,
    thrown,
    turning,
)

import midlie_jax as ml
from midlie_jax.plot.model import NOTHING, Around, Panel, around_of, panels, scenes, turnings
from midlie_jax.plot.solids import CORNERS, ball, shape_of
from midlie_jax.plot.style import FEW
from midlie_jax.simulation.saved import saved_path

BRICK, SLIM = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidBody([0.3, 2.0, 2.1])
START = ml.RigidState([0.02, 2.0, 0.01], UPRIGHT)
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
SITES = np.array([[0.0, 0.0, -0.1], [0.2, 0.0, 0.1], [-0.2, 0.0, 0.1]])
FREE = ml.FreeBody(ml.RigidBody([0.02, 0.03, 0.04]), 1.0)


@pytest.fixture(scope="module")
def path():
    return ml.free_motion(BRICK, START, jnp.linspace(0.0, 12.0, 301))


@pytest.fixture(scope="module")
def other():
    """Half as long, of another body."""
    return ml.free_motion(SLIM, START, jnp.linspace(0.0, 6.0, 151))


def matrices(path):
    return np.asarray(ml.so3.to_matrix(path.states.attitude))


def points(trace):
    return np.array([trace[axis] for axis in "xyz"], float).T


# ---- shapes ----

TURN = ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.2, 0.5])))
SOLIDS = [ml.RigidBody(moments) for moments in ([1.0, 2.0, 2.5], [5.0, 5.0, 1.0], [2.0] * 3, [1.0, 1.0, 2.0])]
SOLIDS += [ml.SymmetricRotor(5.0, 1.0), ml.SymmetricRotor(1.0, 2.0), ml.SymmetricRotor(2.0)]
SOLIDS += [ml.TensorBody(TURN @ jnp.diag(BRICK.moments) @ TURN.T)]


@pytest.mark.parametrize("body", SOLIDS, ids=str)
def test_a_solid_has_the_inertia_of_its_body_and_faces_seen_from_outside(body):
    """Up to its size, by the tetrahedra of its faces; 24 sides are a round cylinder to 3 %, and flat bodies have a
    thickness."""
    corners, second = shape_of(body).corners, np.zeros((3, 3))
    for face in shape_of(body).faces:
        for b, c in itertools.pairwise(face[1:]):
            tetrahedron = corners[[face[0], b, c]]
            volume, total = np.linalg.det(tetrahedron), tetrahedron.sum(axis=0)
            assert volume > 0
            second += volume * (tetrahedron.T @ tetrahedron + np.outer(total, total))
    found = np.trace(second) * np.eye(3) - second
    if isinstance(body, ml.SymmetricRotor):
        wanted = np.diag([body.moment, body.moment, body.along or 0.0])
    else:
        wanted = np.asarray(body.tensor if isinstance(body, ml.TensorBody) else jnp.diag(body.moments))
    np.testing.assert_allclose(found / found.max(), wanted / wanted.max(), atol=0.03 if body in SOLIDS[4:7] else 2e-3)


# ---- one body ----


def test_frames_are_evenly_spaced_and_the_body_turns_between_saved_states(path):
    shown = turning(BRICK, path, 2, 37, most=100)
    np.testing.assert_allclose(np.diff(shown.times), 12.0 / 36)
    exact = matrices(ml.free_motion(BRICK, START, jnp.asarray(shown.times)))
    np.testing.assert_allclose(shown.tips, exact[:, :, 2], atol=1e-3)  # 0.02 rad turned at a constant rate
    np.testing.assert_allclose(shown.corners, np.einsum("kij,cj->kci", exact, shape_of(BRICK).corners), atol=1e-3)
    np.testing.assert_allclose(shown.momenta, np.tile(shown.momenta[0], (37, 1)), atol=1e-12)
    assert shown.remarks == ()
    back = jax.tree.map(lambda x: x[::-1], (path.times, path.states))
    backward = turning(BRICK, path._replace(times=back[0], states=back[1]), 2, 37, most=100)
    np.testing.assert_allclose(backward.corners[::-1], shown.corners, atol=1e-12)
    spin = ml.RigidState([1.0, 0.0, 50.0], START.attitude)
    fast = ml.free_motion(ml.RigidBody([5.0, 5.0, 1.0]), spin, jnp.arange(9.0))
    shown = turning(ml.RigidBody([5.0, 5.0, 1.0]), fast, 2, 6, most=100)
    assert shown.remarks == ("frames are saved states", "13 turns from frame to frame")
    assert all(np.min(np.linalg.norm(matrices(fast)[:, :, 2] - tip, axis=1)) < 1e-12 for tip in shown.tips)


def test_a_view_shows_the_path_and_loads_nothing(path):
    text = ml.plot.view(BRICK, path, frames=26).html
    plain = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"<script|\b(src|href|srcset|data|action)=|@import|url\(", plain)
    data, _, frames = figure_of(text)
    traces = {trace["name"]: trace for trace in data}
    momenta = np.asarray(ml.observe.spatial_momentum(path.states))
    np.testing.assert_allclose(points(traces["path of e3"]), matrices(path)[:, :, 2], atol=1e-5)
    along = momenta / np.linalg.norm(momenta[0])
    np.testing.assert_allclose(points(traces["path of the angular momentum"]), along, atol=1e-5)
    exact = matrices(ml.free_motion(BRICK, START, jnp.linspace(0.0, 12.0, 26)))  # all of them saved times
    for frame, matrix in zip(frames, exact, strict=True):
        body, axis, momentum = frame["data"]
        assert [data[i]["name"] for i in frame["traces"]] == ["body", "e3 of the body", "angular momentum"]
        np.testing.assert_allclose(points(body), shape_of(BRICK).corners @ matrix.T, atol=1e-5)
        np.testing.assert_allclose(points(axis), [np.zeros(3), matrix[:, 2]], atol=1e-5)
        np.testing.assert_allclose(points(momentum)[1], along[0], atol=1e-5)


# ---- bodies that travel ----


def magnification(remarks):
    found = [re.fullmatch(r"body x ([\d,.e+]+)", remark) for remark in remarks]
    numbers = [float(match[1].replace(",", "")) for match in found if match]
    return numbers[0] if numbers else 1.0


@pytest.mark.parametrize(("speed", "steps"), [(0.5, 8), (8e6, 40)])
def test_the_drawn_body_is_where_it_is_and_as_large_as_the_picture_says(speed, steps):
    """Also in millimetres: the same magnification, and numbers a thousand times as large."""
    body, path, frames = brick(), thrown(speed=speed, steps=steps), steps // 2 + 1
    shown = turning(body, path, 2, frames, most=100)  # every other saved state
    factor = magnification(shown.remarks)
    positions = np.asarray(path.states.position)
    extent = np.max(np.ptp(positions, axis=0))
    rotations = np.asarray(ml.so3.to_matrix(path.states.attitude))[::2]
    for k in range(frames):
        corners = shown.placed(k, shown.corners[k])
        np.testing.assert_allclose(corners.mean(axis=0), positions[2 * k], atol=1e-12 * extent)
        true = CORNERS * HALF @ rotations[k].T
        np.testing.assert_allclose(corners - positions[2 * k], factor * true, atol=1e-6 * factor)
        assert np.all((corners > shown.travel.limits[0]) & (corners < shown.travel.limits[1]))
    assert factor == 1 or 0.04 < factor * np.linalg.norm(HALF) / extent < 0.12  # it can be seen beside its path
    assert (factor > 1) == (steps == 40)
    millimetres = turning(brick(1e3), thrown(scale=1e3, speed=speed, steps=steps), 2, frames, most=100)
    assert magnification(millimetres.remarks) == factor
    corners = [each.placed(4, each.corners[4]) for each in (shown, millimetres)]
    np.testing.assert_allclose(corners[1] / 1000, corners[0], rtol=1e-9, atol=1e-9 * extent)


# ---- side by side ----


def test_bodies_side_by_side_have_one_clock_and_each_its_own_motion(path, other):
    both = turnings([Panel("", BRICK, path), Panel("", SLIM, other)], "e2", 25, most=100)
    for shown, alone in zip(both, (turning(BRICK, path, 1, 25, 100), turning(SLIM, other, 1, 13, 100)), strict=True):
        count = len(alone.times)
        np.testing.assert_allclose(both[0].times[:count], alone.times)
        np.testing.assert_allclose(shown.corners[:count], alone.corners, atol=1e-12)
        np.testing.assert_allclose(shown.tips[count - 1 :], np.tile(alone.tips[-1], (26 - count, 1)), atol=1e-12)
        np.testing.assert_allclose(shown.momenta[:count], alone.momenta, atol=1e-12)
    assert [shown.remarks for shown in both] == [(), ("from t = 0 to 6",)]


def test_what_may_be_shown_side_by_side(path, other):
    assert [panel.name for panel in panels(BRICK, {"one": path, "two": other})] == ["one", "two"]
    assert [panel.body for panel in panels([BRICK, SLIM], [path, other])] == [BRICK, SLIM]
    states, ok, bad = jax.tree.map(lambda x: jnp.stack([x] * 2), (path.states, path.ok, path.first_bad))
    bodies = ml.RigidBody(jnp.stack([BRICK.moments, SLIM.moments]))
    (first, second) = panels(bodies, ml.Path(path.times, states, ok, bad))  # as `ensemble` returns it
    assert (first.name, second.name) == ("body 0", "body 1")
    assert isinstance(second.body, ml.RigidBody)
    np.testing.assert_array_equal(second.body.moments, SLIM.moments)
    np.testing.assert_array_equal(second.path.states.momentum, path.states.momentum)
    np.testing.assert_array_equal(second.path.times, path.times)
    coupled, at_rest = apart(3), apart(3, ml.CoupledRigidState)
    assert [panel.name for panel in panels(*at_rest)] == ["body 0", "body 1", "body 2"]
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), coupled[1])
    assert [panel.name for panel in panels(coupled[0], batch)] == ["replica 0", "replica 1"]


def test_a_gif_and_a_view_of_two_show_both(path, other, tmp_path):
    """A planet and a box change the picture of many."""
    pair = [BRICK, SLIM], {"a": path, "b": other}
    file = ml.plot.animate(*pair, tmp_path / "two.gif", frames=3, size=120, title="two", background="#111111")
    frames = frames_of(file)
    height, width = frames[0].shape[:2]
    assert (len(frames), width) == (3, 240)
    for frame in frames:
        orange = (frame[height - 120 :, :, 0] > 120) & (frame[height - 120 :, :, 2] < 60)
        assert min(np.mean(orange[:, :120]), np.mean(orange[:, 120:])) > 0.01
        assert np.max(frame[:3, :3]) < 40  # the background
    go = pytest.importorskip("plotly.graph_objects")
    data, layout, _ = figure_of(ml.plot.view(*pair, axis="e1", frames=13).html)
    go.Figure(data=data, layout=layout)  # raises for what plotly does not know
    assert {trace["scene"] for trace in data} == {"scene", "scene2"}
    assert [note["text"] for note in layout["annotations"]] == ["<b>a</b>", "<b>b</b><br>from t = 0 to 6"]
    options = {"frames": 2, "size": 120, "together": True}
    around = {}, {"planet": 3.0}, {"box": [[0.0] * 3, [6.0] * 3], "points": SITES}
    plain, *others = (frames_of(ml.plot.animate(FREE, fleet(7), file, **options, **more))[0] for more in around)
    assert all(np.mean(np.any(frame != plain, axis=-1)) > 0.02 for frame in others)


def test_a_view_shows_itself_in_a_notebook_and_writes_no_file_unasked(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shown = ml.plot.view(BRICK, path, frames=2)
    assert not list(tmp_path.iterdir())
    (page,) = re.findall(r'^<iframe srcdoc="([^"]*)" style="[^"]*"></iframe>$', shown._repr_html_())
    assert html.unescape(page) == shown.html
    assert shown.write("now.html").read_text(encoding="utf-8") == shown.html
    assert repr(shown) == "<View of 2 frames, written to now.html>"
    with pytest.raises(ValueError, match=r"file must end in \.html"):
        shown.write("now.pdf")


# ---- `midlie view` ----


@pytest.fixture(scope="module")
def runs(tmp_path_factory, path):
    """Runs of three bodies."""
    pytest.importorskip("zarr")
    folder = tmp_path_factory.mktemp("runs")
    starts = jax.tree.map(lambda x: x[:3], path.states)
    options: Any = {"dt": 0.04, "steps": 20, "save_every": 1, "progress": False}
    for name in ("one.npz", "two.npz", "one.zarr"):
        ml.simulate("JACOBI[EA]", BRICK, None, starts, out=folder / name, **options)
    return folder


def test_midlie_view_of_several_bodies_and_runs(runs, tmp_path, monkeypatch, path):
    opened, page, gif = [], tmp_path / "view.html", tmp_path / "two.gif"
    monkeypatch.setattr("webbrowser.open", opened.append)
    first, second = runs / "one.npz", runs / "two.npz"
    code, said, err = midlie("view", runs / "one.zarr", "--body", 2, "--out", page, "--open")
    assert code == 0, err
    assert f"wrote {page}" in said
    assert opened == [page.as_uri()]
    assert figure_of(page.read_text())[1]["title"]["text"] == "3 bodies moved by JACOBI[EA]; body 2 of 3"
    assert midlie("view", first, "--body", 0, 2, "--out", page, "--frames", 5, "--axis", "3,0,4").code == 0
    _, layout, frames = figure_of(page.read_text())
    np.testing.assert_allclose(points(frames[0]["data"][1])[1], matrices(path)[0] @ [0.6, 0.0, 0.8], atol=1e-5)
    assert [note["text"] for note in layout["annotations"]] == ["<b>body 0</b>", "<b>body 2</b>"]
    assert len(frames) == 5
    assert midlie("view", first, second, "--body", 1, "--out", page, "--title", "two").code == 0
    layout = figure_of(page.read_text())[1]
    assert [note["text"] for note in layout["annotations"]] == ["<b>one.npz</b>", "<b>two.npz</b>"]
    assert layout["title"]["text"] == "two"
    options = ["--frames", 3, "--size", 100, "--rate", 5, "--background", "black", "--elevation", 60]
    assert midlie("view", first, "--body", 0, 1, "--out", gif, *options).code == 0
    assert (len(frames_of(gif)), frames_of(gif)[0].shape[:2]) == (3, (100, 200))
    assert np.mean(frames_of(gif)[0]) < 60


def test_a_body_of_a_saved_run_is_that_of_the_run(runs, path):
    start = jax.tree.map(lambda x: x[2], path.states)
    known = ml.integrate("JACOBI[EA]", BRICK, None, start, dt=0.04, steps=20)
    for name in ("one.npz", "one.zarr"):
        found: Any = saved_path(runs / name, 2)
        np.testing.assert_array_equal(found.body.moments, BRICK.moments)
        np.testing.assert_allclose(found.path.times, known.times)
        for one, other in zip(jax.tree.leaves(found.path.states), jax.tree.leaves(known.states), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
        assert (bool(found.path.ok), int(found.path.first_bad), found.bodies) == (True, 21, 3)


def test_midlie_view_says_what_is_wrong(runs, tmp_path):
    np.savez(tmp_path / "other.npz", heights=np.ones(3))
    (tmp_path / "broken.npz").write_bytes(b"no archive")
    (tmp_path / "empty.zarr").mkdir()
    starts = jax.tree.map(lambda x: x[:2], thrown().states)
    options: Any = {"dt": 0.02, "steps": 4, "save_every": 1, "progress": False}
    options["observe"] = lambda t, state: {"momentum": state.momentum}
    ml.simulate("JACOBI[EA]", brick(), GRAVITY, starts, out=tmp_path / "momenta.npz", **options)
    for run, wrong in (
        (tmp_path / "momenta.npz", "holds no attitude and no linear and no position; it must be a run of FreeSt"),
        (runs / "none.npz", "there is no"),
        (runs / "run.csv", "must be a run that ends in .zarr or .npz"),
        (tmp_path / "other.npz", "holds no momentum and no attitude and no times; it must be a run of RigidStates"),
        (tmp_path / "broken.npz", "cannot be read"),
        (tmp_path / "empty.zarr", "is not the store of a run"),
    ):
        assert_one_line(["view", run, "--out", tmp_path / "view.html"], [wrong])
    assert_one_line(["view", runs / "one.npz", "--body", 3], ["body must be from 0 to 2"])
    assert not (tmp_path / "view.html").exists()


# ---- many bodies in one space ----


def moved(states, position):
    """The states at other places."""
    return ml.FreeState(states.momentum, states.attitude, states.linear, jnp.asarray(position))


def in_one(path, around=NOTHING, frames=3, body=FREE):
    (found,) = scenes(panels(body, path, together=True), 2, frames, 100, around=around, in_one=True)
    return found


def test_coupled_bodies_are_drawn_where_they_are_as_solids_and_as_points():
    body, path = apart(2)
    (shown,) = scenes(panels(body, path), 2, 3, 100)
    assert (len(shown.members), len(set(shown.colours)), shown.few, shown.solid) == (2, 2, True, True)
    assert len({member.travel.size for member in shown.members if member.travel is not None}) == 1  # alike
    for i, corners in enumerate(shown.sites(1)):
        np.testing.assert_allclose(corners.mean(axis=0), path.states.position[10, i], atol=1e-12)
        flat = (corners - corners.mean(axis=0)) @ spun(path, i, 10)
        np.testing.assert_allclose(np.abs(flat), np.abs(flat[:1]).repeat(8, axis=0), atol=1e-12)
    low, high = np.asarray(shown.limits)
    assert np.all(low < np.min(path.states.position, axis=(0, 1)))
    assert np.all(high > np.max(path.states.position, axis=(0, 1)))
    (shown,) = scenes(panels(body, path), 2, 21, 100, SITES)
    assert not shown.solid
    for i, sites in enumerate(shown.sites(5)):
        wanted = np.asarray(path.states.position[5, i]) + SITES @ spun(path, i, 5).T
        np.testing.assert_allclose(sites, wanted, atol=1e-12)
    assert len(shown.sticks(0)) == 4
    single = path._replace(states=path.states.of_body(1))
    (alone,) = scenes(panels(FREE, single), 2, 21, 100, SITES)
    np.testing.assert_allclose(alone.sites(5)[0] - shown.sites(5)[1], 0, atol=1e-12)
    box = [[0.0] * 3, [1.5] * 3]
    for what, way in ((body, path), (FREE, single)):
        (shown,) = scenes(panels(what, way), 2, 9, 100, SITES, around=around_of(box, None, [way]))
        places = np.array([member.travel.centres for member in shown.members])
        assert np.all((places >= 0) & (places <= 1.5))


@pytest.mark.parametrize("count", [2, 37])
def test_bodies_that_travel_are_drawn_in_one_space_where_they_are(count):
    path = fleet(count)
    shown = in_one(path)
    assert [shown.named(i) for i in range(count)] == [f"body {i}" for i in range(count)]
    assert (shown.few, bool(shown.tracks), len(set(shown.colours))) == (count <= FEW, count <= 36, count)
    middles = np.array([corners.mean(axis=0) for corners in shown.sites(1)])
    np.testing.assert_allclose(middles, path.states.position[:, 10], atol=1e-12)
    assert np.all(np.asarray(shown.limits)[0] < np.min(path.states.position, axis=(0, 1)))
    assert len({member.travel.size for member in shown.members}) == 1
    assert shown.remarks == in_one(path, Around(planet=0.5)).remarks
    failed = in_one(path._replace(ok=path.ok.at[1].set(False), first_bad=path.first_bad.at[1].set(9)))
    assert failed.remarks[0] == f"1 of {count} FAILED"
    # Bodies that begin at one place are large enough to be seen.
    near = moved(path.states, path.states.position * 0 + path.states.position[:1] * 1e6)
    size = in_one(path._replace(states=near)).members[0].travel.size
    assert size > 0.02 * np.max(np.ptp(near.position[0], axis=0))


@pytest.mark.parametrize(("wrapped", "low"), [(False, -0.7), (True, 0.0)])
def test_a_periodic_box_holds_all_bodies_wherever_they_went(wrapped, low):
    """Also between saved states on both sides of a wall; a run that brings its positions back looks the same."""
    path = fleet(2, speed=4.0)
    edge, box = 1.4, np.array([[low] * 3, [low + 1.4] * 3])
    positions = np.asarray(path.states.position)
    if wrapped:
        path = path._replace(states=moved(path.states, low + np.mod(positions - low, edge)))
    shown = in_one(path, around_of(box, None, [path]), frames=31)
    for i, member in enumerate(shown.members):
        wanted = np.stack([np.interp(member.times, TIMES, positions[i, :, axis]) for axis in range(3)], axis=1)
        turns = (member.travel.centres - wanted) / edge
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
        assert np.all((member.travel.centres >= box[0] - 1e-12) & (member.travel.centres <= box[1] + 1e-12))
    assert not shown.tracks
    edges = np.array(shown.around.edges)
    np.testing.assert_allclose(np.abs(edges[:, 0] - edges[:, 1]).sum(axis=1), [edge] * 12)


def test_a_planet_hides_what_is_beyond_it_and_is_in_the_picture():
    around, out = Around(planet=2.0), np.array([0.0, 0.6, 0.8])
    across = np.array([0.0, 0.8, -0.6])
    places = np.array([3 * out, -3 * out, -3 * out + 1.9 * across, -3 * out + 2.1 * across])
    np.testing.assert_array_equal(around.hidden(places, out), [False, True, True, False])
    assert not NOTHING.hidden(places, out).any()
    assert np.all(np.abs(in_one(fleet(2), around).limits[0]) > 2.0)
    corners, triangles = ball(2.0)
    volumes = np.linalg.det(corners[triangles]) / 6
    assert np.all(volumes >= -1e-12)  # all seen from outside
    assert 0.95 < volumes.sum() / (4 / 3 * np.pi * 8) < 1


def test_names_are_those_of_the_mapping_and_no_trace_of_many_is_recoloured():
    path = fleet(2)
    times = jnp.stack([jnp.asarray(TIMES)] * 2)
    one, two = (jax.tree.map(lambda x, k=k: x[k], path._replace(times=times)) for k in range(2))
    page = ml.plot.view(FREE, {"EA": one, "RK4": two}, together=True, frames=2).html
    names = [trace["name"] for trace in figure_of(page)[0]]
    assert names == ["path of EA", "path of RK4", "body", "e3 of EA", "e3 of RK4"]
    assert "traces.length ?" in page  # an empty list of traces would mean all of them to plotly


def test_surfaces_are_drawn_by_their_triangles(tmp_path):
    """In a view each body has the shape of its surface, enlarged, in one colour."""
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]])
    surface = ml.Surface(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    pair = apart(2)
    data, _, _ = figure_of(ml.plot.view(*pair, points=[surface, surface.moved([0.0, 0.0, 0.1])], frames=3).html)
    (mesh,) = (trace for trace in data if trace["type"] == "mesh3d")
    assert (len(mesh["x"]), len(mesh["i"]), len(set(mesh["facecolor"]))) == (8, 8, 2)
    sides = np.linalg.norm(points(mesh)[:4, None] - points(mesh)[None, :4], axis=-1)
    exact = np.linalg.norm(corners[:, None] - corners[None], axis=-1)
    ratio = np.sort(sides[sides > 0]) / np.sort(exact[exact > 0])
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-3)
    assert ml.plot.animate(*pair, tmp_path / "pair.gif", points=[surface, surface], frames=2).exists()


WRONG = [
    (lambda: ml.plot.animate(BRICK, spinning(), frames=401), "frames must be at most 400, got 401"),
    (lambda: ml.plot.animate(BRICK, spinning(), frames=1), "frames must be at least 2"),
    (lambda: ml.plot.animate(BRICK, spinning(), size=10), "size must be between 64 and 2000 pixels, got 10"),
    (lambda: ml.plot.animate(BRICK, spinning(), rate=100.0), "rate must be above 0 and at most 50"),
    (lambda: ml.plot.animate(BRICK, spinning(), "a.mp4"), "file must end in .gif, got 'a.mp4'"),
    (lambda: ml.plot.view(BRICK, spinning(), "a.pdf"), r"file must end in \.html"),
    (lambda: ml.plot.animate(BRICK, spinning(), background="snwo"), "a colour of matplotlib, .*'snwo'"),
    (
        lambda: ml.plot.animate(BRICK, [spinning(), spinning()._replace(times=-spinning().times)]),
        "all go forward in time, or all backward",
    ),
    (lambda: panels(BRICK, []), "path must hold at least one path, got none"),
    (lambda: panels([BRICK], [spinning()] * 2), "one body, or one for each of the 2 paths, got 1"),
    (lambda: ml.plot.animate(*apart(2), together=True), "drawn together without it"),
    (lambda: ml.plot.animate(BRICK, spinning(), together=True), "RigidState, which has no position"),
    (lambda: ml.plot.animate(BRICK, spinning(), planet=1.0), "planet must be left out without positions"),
    (lambda: around_of(1.2, None, [fleet(2)]), r"\[\[0, 0, 0\], \[L, L, L\]\], for example"),
    (lambda: ml.plot.animate(FREE, fleet(2), box=[[1.0] * 3, [0.0] * 3]), "least corner first"),
    (lambda: ml.plot.animate(FREE, fleet(2), planet=-1.0), "planet must be the radius"),
    (lambda: ml.plot.animate(BRICK, fleet(2), together=True), "a FreeState belongs to a FreeBody, but body is"),
    (lambda: ml.plot.animate(BRICK, apart(2)[1]), "a CoupledState belongs to a FreeBody"),
    (lambda: ml.plot.animate(FREE, fleet(13)), "at most 12 paths, got 13. Choose .*together=True"),
    (lambda: ml.plot.animate(FREE, fleet(501), together=True), "at most 500 paths, got 501"),
    (lambda: ml.plot.animate(*apart(13, ml.CoupledRigidState)), "at most 12 paths, got 13"),
    (
        lambda: ml.plot.view(*twice(*apart(2, ml.CoupledRigidState))),
        "path must be one path, got several of CoupledRigidStates",
    ),
    (lambda: ml.plot.animate(*apart(2), points=np.ones(3)), r"points must be \(a, 3\)"),
    (lambda: ml.plot.animate(*apart(2), points=np.nan * SITES), "points must be finite"),
    (lambda: ml.plot.animate(*apart(2), points=ml.Surface.box([1.0, 2.0, 3.0])), "drawn by its triangles"),
    (lambda: ml.plot.animate(*apart(2, ml.CoupledRigidState), points=SITES), "body must be a FreeBody"),
]


def twice(body, path):
    return body, {"one": path, "again": path}


def spinning():
    """A body that turns in one place."""
    path = fleet(1)
    states = ml.RigidState(path.states.momentum[0], path.states.attitude[0])
    return ml.Path(path.times, states, path.ok[0], path.first_bad[0], path.result[0])


@pytest.mark.parametrize(("show", "message"), WRONG)
def test_what_cannot_be_drawn_is_named_and_nothing_is_written(show, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        show()
    assert not list(tmp_path.iterdir())


# A reader plays the page and stops it. What was shown then goes to the console.
READER = """<script>
const again = setInterval(() => {
  if (!document.body.dataset.drawn) return;
  clearInterval(again);
  const gd = document.getElementById('midlie-view'), [play, pause] = document.querySelectorAll('.updatemenu-button');
  const click = (button) => button.dispatchEvent(new MouseEvent('click', {bubbles: true}));
  const shown = [], traces = gd.data.length, paper = gd._fullLayout.paper_bgcolor;
  gd.on('plotly_animatingframe', (frame) => {
    if (shown.push(Number(frame.name)) !== 4) return;
    click(pause);
    setTimeout(() => console.log('TOLD' + JSON.stringify({
      shown, traces, paper, active: gd._fullLayout.sliders[0].active, drawn: Array.from(gd.data[traces - 1].x)
    })), 500);
  });
  click(play);
}, 20);
</script>"""
# Without a network, by a software renderer.
HEADLESS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--window-size=900,700", "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr", "--v=0",
    "--remote-debugging-port=0",
)  # fmt: skip


def told_by(page, *options):
    """What the reader of a page tells, and the lines of the console; in real time, in which frames are drawn."""
    command = [BROWSER, *HEADLESS, *options, f"--user-data-dir={page.parent / 'profile'}", page.as_uri()]
    lines = []
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as browser:
        limit = threading.Timer(200, os.killpg, (browser.pid, signal.SIGKILL))
        limit.start()
        try:
            for line in browser.stderr or ():
                lines += [line] if "CONSOLE" in line else []
                if "TOLD" in line:
                    break
        finally:
            limit.cancel()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(browser.pid, signal.SIGKILL)
    assert lines, "the page says nothing"
    assert "TOLD" in lines[-1], lines
    return json.JSONDecoder().raw_decode(lines[-1].partition("TOLD")[2])[0], lines[:-1]


@pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome is installed, in which the pages could be opened")
@pytest.mark.parametrize("dark", [0, 1])
def test_a_page_plays_and_stops_in_a_browser(dark, path, tmp_path):
    """One body, and many in one space, without an error on the console."""
    view = ml.plot.view(FREE, fleet(2), together=True, frames=20) if dark else ml.plot.view(BRICK, path, frames=20)
    (tmp_path / "read.html").write_text(view.html.replace("</body>", READER + "</body>"), encoding="utf-8")
    told, console = told_by(tmp_path / "read.html", f"--blink-settings=preferredColorScheme={1 - dark}")
    assert not [line for line in console if re.search("error|failed|ERR_", line, re.IGNORECASE)], console
    data, _, frames = figure_of(view.html)
    assert told["traces"] == len(data)
    assert told["paper"] == ("#111111" if dark else "#ffffff")
    assert told["shown"] == list(range(len(told["shown"])))  # and it plays on no further
    assert told["active"] == told["shown"][-1] < 10
    assert told["drawn"] == frames[told["active"]]["data"][-1]["x"]
