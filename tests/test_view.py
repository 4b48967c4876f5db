"""Moving pictures: where bodies are in the frames of a GIF or an HTML view, that view in a browser, `midlie view`."""

import base64
import contextlib
import html
import io
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from html.parser import HTMLParser
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import assert_one_line, benchmark, midlie
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
from PIL import Image

import midlie_jax as ml
from midlie_jax.plot.model import NOTHING, Around, Panel, around_of, grid, panels, scenes, turnings
from midlie_jax.plot.solids import CORNERS, FACES, ball, shape_of
from midlie_jax.plot.style import FEW, SKY, VERMILLION, time_text
from midlie_jax.simulation.saved import saved_path

pictures = benchmark("pictures")
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


# ---- shapes ----


@pytest.mark.parametrize("moments", [[1.0, 2.0, 2.5], [5.0, 5.0, 1.0], [2.0] * 3, [1.0, 1.0, 2.0]])
def test_the_box_has_the_moments_of_the_body(moments):
    """Up to their size; the last is flat, and is drawn a little thicker than it is."""
    half = np.abs(shape_of(ml.RigidBody(moments)).corners).max(axis=0)
    drawn = np.sum(half**2) - half**2
    np.testing.assert_allclose(drawn / drawn.max(), np.array(moments) / max(moments), atol=2e-3)


def test_the_box_of_a_tensor_is_that_of_its_principal_frame_turned():
    turn = ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.2, 0.5])))
    corners = shape_of(ml.TensorBody(turn @ jnp.diag(BRICK.moments) @ turn.T)).corners
    expected = shape_of(BRICK).corners @ np.asarray(turn).T
    assert all(np.min(np.linalg.norm(corners - corner, axis=1)) < 1e-12 for corner in expected)


def test_faces_are_seen_from_outside():
    corners = shape_of(BRICK).corners
    for face in FACES:
        a, b, c, d = corners[list(face)]
        assert np.cross(b - a, c - b) @ (a + c) > 0
        np.testing.assert_allclose(a + c, b + d, atol=1e-15)


@pytest.mark.parametrize("rotor", [ml.SymmetricRotor(5.0, 1.0), ml.SymmetricRotor(1.0, 2.0), ml.SymmetricRotor(2.0)])
def test_the_cylinder_of_a_rotor_has_its_moments(rotor):
    """I3 = r^2 / 2 and I1 = r^2 / 4 + c^2 / 3 for unit mass; what is flat or thin is drawn a little thicker."""
    shape = shape_of(rotor)
    corners = shape.corners * shape.reach / np.linalg.norm(shape.corners, axis=1).max()
    radius, half = np.hypot(*corners[0, :2]), corners[0, 2]
    along = 0.0 if rotor.along is None else rotor.along
    np.testing.assert_allclose(radius**2 / 2, along, atol=4e-3)
    np.testing.assert_allclose(radius**2 / 4 + half**2 / 3, rotor.moment, rtol=2e-3)
    for face in shape.faces:
        a, b, c = shape.corners[list(face[:3])]
        assert np.cross(b - a, c - b) @ shape.corners[list(face)].mean(axis=0) > 0  # seen from outside
    up = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(shape.inside(up), shape.corners[0, 2])


# ---- one body ----


@pytest.mark.sample(0)
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


@pytest.mark.sample(0)
def test_a_fast_body_is_shown_at_saved_states_and_the_picture_says_so():
    fast = ml.free_motion(
        ml.RigidBody([5.0, 5.0, 1.0]), ml.RigidState([1.0, 0.0, 50.0], START.attitude), jnp.arange(9.0)
    )
    shown = turning(ml.RigidBody([5.0, 5.0, 1.0]), fast, 2, 6, most=100)
    assert shown.remarks == ("frames are saved states", "13 turns from frame to frame")
    saved = matrices(fast)[:, :, 2]
    assert all(np.min(np.linalg.norm(saved - tip, axis=1)) < 1e-12 for tip in shown.tips)


@pytest.mark.sample(0)
def test_a_gif_has_the_frames_that_were_asked_for_each_another(path, tmp_path):
    file = ml.plot.animate(BRICK, path, tmp_path / "brick.gif", frames=12, rate=10.0, size=200, background="#111111")
    with Image.open(file) as picture:
        assert (getattr(picture, "n_frames", 1), picture.size, picture.info["duration"], picture.info["loop"]) == (
            12,
            (200, 200),
            100,
            0,
        )
    frames = frames_of(file)
    assert all(np.mean(np.any(a != b, axis=-1)) > 0.02 for a, b in itertools.pairwise(frames))
    orange = [(f[..., 0] > 120) & (f[..., 2] < 60) for f in frames]  # the box, and next to nothing else
    assert all(0.03 < np.mean(seen) < 0.5 for seen in orange)
    assert all(np.max(f[:3, :3]) < 40 for f in frames)  # the background


@pytest.fixture(scope="module")
def page(path, tmp_path_factory):
    return ml.plot.view(BRICK, path, tmp_path_factory.mktemp("view") / "view.html", frames=26, title="a brick").file


class Loads(HTMLParser):
    """What the elements of a page load."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        self.found += [
            (tag, name, value) for name, value in attrs if name in ("src", "href", "srcset", "data", "action")
        ]


def test_a_view_shows_the_path_and_loads_nothing(page, path):
    text = page.read_text(encoding="utf-8")
    loads = Loads()
    loads.feed(text)
    assert loads.found == []
    assert not re.search(r"@import|url\(\s*['\"]?https?:", text[: text.index("<script")])
    data, layout, frames = figure_of(text)
    traces = {trace["name"]: trace for trace in data}

    def points(trace):
        return np.array([trace[axis] for axis in "xyz"], float).T

    momenta = np.asarray(ml.observe.spatial_momentum(path.states))
    np.testing.assert_allclose(points(traces["path of e3"]), matrices(path)[:, :, 2], atol=1e-5)
    np.testing.assert_allclose(
        points(traces["path of the angular momentum"]), momenta / np.linalg.norm(momenta[0]), atol=1e-5
    )
    exact = matrices(ml.free_motion(BRICK, START, jnp.linspace(0.0, 12.0, 26)))  # all of them saved times
    assert len(frames) == len(layout["sliders"][0]["steps"]) == 26
    for frame, matrix in zip(frames, exact, strict=True):
        body, axis, momentum = frame["data"]
        assert [data[i]["name"] for i in frame["traces"]] == ["body", "e3 of the body", "angular momentum"]
        np.testing.assert_allclose(points(body), shape_of(BRICK).corners @ matrix.T, atol=1e-5)
        np.testing.assert_allclose(points(axis), [np.zeros(3), matrix[:, 2]], atol=1e-5)
        np.testing.assert_allclose(points(momentum)[1], momenta[0] / np.linalg.norm(momenta[0]), atol=1e-5)
    assert [buttons["label"] for buttons in layout["updatemenus"][0]["buttons"]] == ["play", "pause"]
    assert layout["title"]["text"] == "a brick"


# Without a network, by a software renderer; the time that the page sees runs as fast as it can.
HEADLESS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
    "--window-size=900,700", "--virtual-time-budget=8000", "--host-resolver-rules=MAP * ~NOTFOUND",
    "--enable-logging=stderr", "--v=0", "--force-device-scale-factor=1",
)  # fmt: skip


# ---- bodies that travel ----


def magnification(remarks):
    found = [re.fullmatch(r"body x ([\d,.e+]+)", remark) for remark in remarks]
    numbers = [float(match[1].replace(",", "")) for match in found if match]
    return numbers[0] if numbers else 1.0


@pytest.mark.sample(1)
@pytest.mark.parametrize(("speed", "steps"), [(0.5, 8), (8.0, 40), (800.0, 40), (8e6, 40)])
def test_the_drawn_body_is_where_it_is_and_as_large_as_the_picture_says(speed, steps):
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


def test_the_unit_of_length_does_not_matter():
    """Path and body in millimetres: the same magnification, and numbers a thousand times as large."""
    metres, millimetres = (turning(brick(s), thrown(scale=s, speed=80.0), 2, 9, most=100) for s in (1.0, 1000.0))
    assert magnification(metres.remarks) == magnification(millimetres.remarks) > 1
    corners = [shown.placed(4, shown.corners[4]) for shown in (metres, millimetres)]
    np.testing.assert_allclose(corners[1] / 1000, corners[0], rtol=1e-9, atol=1e-9)


def test_a_view_holds_the_track_and_the_body_on_it(tmp_path):
    path = thrown(speed=8e6)
    file = ml.plot.view(brick(), path, tmp_path / "view.html", frames=21, title="far").file
    data, layout, frames = figure_of(file.read_text(encoding="utf-8"))
    traces = {trace["name"]: np.array([trace[axis] for axis in "xyz"], float).T for trace in data}
    positions = np.asarray(path.states.position)
    extent = np.max(np.ptp(positions, axis=0))
    np.testing.assert_allclose(traces["path of the centre of mass"], positions, atol=1e-5 * extent)
    for frame, position in zip(frames, positions[::2], strict=True):
        corners = np.array([frame["data"][0][axis] for axis in "xyz"], float).T
        np.testing.assert_allclose(corners.mean(axis=0), position, atol=1e-5 * extent)
    assert re.fullmatch(r"far<br>body x [\d,]+", layout["title"]["text"])
    axes = [layout["scene"][f"{letter}axis"] for letter in "xyz"]
    spans = np.array([axis["range"][1] - axis["range"][0] for axis in axes])
    sides = np.array([layout["scene"]["aspectratio"][letter] for letter in "xyz"])
    np.testing.assert_allclose(sides / spans, sides[0] / spans[0])  # one scale
    assert [axis["title"]["text"] for axis in axes] == ["x [length]", "y [length]", "z [length]"]


@pytest.mark.sample(0)
def test_a_rotation_is_drawn_as_that_of_a_body_that_does_not_travel():
    """A body at rest in space is the same picture to the last bit; one that travels turns alike, and on one polhode."""
    body, times = brick(), jnp.linspace(0.0, 2.0, 41)
    path = ml.free_motion(body.body, ml.RigidState(body.momentum(jnp.array([0.1, 2.0, 0.3])), UPRIGHT), times)
    rest = jnp.zeros((41, 3))
    for travelled in (0.0, 1e-3, 1.0):
        states = ml.FreeState(path.states.momentum, path.states.attitude, rest, rest.at[:, 0].add(travelled * times))
        one = turning(body, path._replace(states=states), 2, 9, most=100)
        other = turning(body.body, path, 2, 9, most=100)
        assert (one.travel is None) == (travelled < 0.01)
        for a, b in zip(one[:8], other[:8], strict=True):
            np.testing.assert_array_equal(a[0] if isinstance(a, tuple) else a, b[0] if isinstance(b, tuple) else b)


# ---- side by side ----


@pytest.mark.sample(0)
def test_bodies_side_by_side_have_one_clock_and_each_its_own_motion(path, other):
    both = turnings([Panel("", BRICK, path), Panel("", SLIM, other)], "e2", 25, most=100)
    for shown, alone in zip(both, (turning(BRICK, path, 1, 25, 100), turning(SLIM, other, 1, 13, 100)), strict=True):
        count = len(alone.times)
        np.testing.assert_allclose(both[0].times[:count], alone.times)
        np.testing.assert_allclose(shown.corners[:count], alone.corners, atol=1e-12)
        np.testing.assert_allclose(shown.tips[count - 1 :], np.tile(alone.tips[-1], (26 - count, 1)), atol=1e-12)
        np.testing.assert_allclose(shown.momenta[:count], alone.momenta, atol=1e-12)
    assert [shown.remarks for shown in both] == [(), ("from t = 0 to 6",)]


def test_forward_and_backward_do_not_go_side_by_side(path):
    back = path._replace(times=-path.times)
    with pytest.raises(ValueError, match="all go forward in time, or all backward"):
        ml.plot.animate(BRICK, [path, back], "never.gif")


def batch(path, count):
    """As `ensemble` returns it: times that are shared."""
    states, ok, bad = jax.tree.map(lambda x: jnp.stack([x] * count), (path.states, path.ok, path.first_bad))
    return ml.Path(path.times, states, ok, bad)


def test_what_may_be_shown_side_by_side(path, other):
    names = [panel.name for panel in panels(BRICK, {"one": path, "two": other})]
    assert names == ["one", "two"]
    assert [panel.body for panel in panels([BRICK, SLIM], [path, other])] == [BRICK, SLIM]
    bodies = ml.RigidBody(jnp.stack([BRICK.moments, SLIM.moments]))
    (first, second) = panels(bodies, batch(path, 2))
    assert (first.name, second.name) == ("body 0", "body 1")
    assert isinstance(second.body, ml.RigidBody)
    np.testing.assert_array_equal(second.body.moments, SLIM.moments)
    np.testing.assert_array_equal(second.path.states.momentum, path.states.momentum)
    np.testing.assert_array_equal(second.path.times, path.times)
    assert [panel.name for panel in panels(BRICK, path)] == [""]
    assert [grid(count) for count in (1, 2, 4, 5, 12)] == [(1, 1), (1, 2), (1, 4), (2, 3), (3, 4)]


@pytest.mark.parametrize(
    ("body", "many", "message"),
    [
        (BRICK, [], "path must hold at least one path, got none"),
        (BRICK, 13, "path must hold at most 12 paths, got 13"),
        ([BRICK], 2, r"body must be one body, or one for each of the 2 paths, got 1"),
    ],
)
def test_what_may_not_is_said(path, body, many, message):
    with pytest.raises(ValueError, match=message):
        panels(body, batch(path, many) if many else many)


def test_a_gif_of_two_shows_both(path, other, tmp_path):
    file = ml.plot.animate(
        [BRICK, SLIM], {"a": path, "b": other}, tmp_path / "two.gif", frames=3, size=120, title="two"
    )
    alone = ml.plot.animate(BRICK, path, tmp_path / "one.gif", frames=3, size=120)
    with Image.open(file) as picture:
        width, height = picture.size
    assert width == 240
    assert height > 120  # the title has room of its own
    for both, one in zip(frames_of(file), frames_of(alone), strict=True):
        halves = [both[height - 120 :, :120], both[height - 120 :, 120:]]
        orange = [(f[..., 0] > 120) & (f[..., 2] < 60) for f in (*halves, one)]
        assert np.mean(orange[0] ^ orange[2]) < 0.01  # the first is as it is alone, but for the palette
        assert np.mean(orange[1]) > 0.01
        assert np.mean(orange[0] ^ orange[1]) > 0.01


@pytest.mark.sample(0)
def test_a_view_of_two_has_a_scene_for_each(path, other):
    go = pytest.importorskip("plotly.graph_objects")
    shown = ml.plot.view([BRICK, SLIM], {"a": path, "b": other}, axis="e1", frames=13, title="two")
    data, layout, frames = figure_of(shown.html)
    go.Figure(data=data, layout=layout)  # raises for what plotly does not know
    assert {trace["scene"] for trace in data} == {"scene", "scene2"}
    assert [layout[name]["domain"]["x"] for name in ("scene", "scene2")] == [[0, 0.5], [0.5, 1]]
    assert [note["text"] for note in layout["annotations"]] == ["<b>a</b>", "<b>b</b><br>from t = 0 to 6"]
    bodies = [place for place, trace in enumerate(data) if trace["name"] == "body"]
    times = [jnp.arange(13.0), jnp.minimum(jnp.arange(13.0), 6.0)]
    exact = [ml.free_motion(moving, START, t) for moving, t in zip((BRICK, SLIM), times, strict=True)]
    for k, frame in enumerate(frames):
        moved = dict(zip(frame["traces"], frame["data"], strict=True))
        for place, moving, motion in zip(bodies, (BRICK, SLIM), exact, strict=True):
            points = np.array([moved[place][letter] for letter in "xyz"]).T
            matrix = np.asarray(ml.so3.to_matrix(motion.states.attitude[k]))
            np.testing.assert_allclose(points, shape_of(moving).corners @ matrix.T, atol=1e-5)
    assert sum(trace.get("showlegend", True) for trace in data if trace["name"].startswith("path")) == 2


def test_a_view_shows_itself_in_a_notebook_and_writes_no_file_unasked(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shown = ml.plot.view(BRICK, path, frames=2)
    assert not list(tmp_path.iterdir())
    assert shown.file is None
    frame = shown._repr_html_()
    (page,) = re.findall(r'^<iframe srcdoc="([^"]*)" style="[^"]*"></iframe>$', frame)
    assert html.unescape(page) == shown.html
    assert figure_of(shown.html)[2]
    assert shown.write("now.html").read_text(encoding="utf-8") == shown.html
    assert (shown.file, repr(shown)) == (tmp_path.__class__("now.html"), "<View of 2 frames, written to now.html>")
    with pytest.raises(ValueError, match=r"file must end in \.html"):
        shown.write("now.pdf")


# ---- `midlie view` ----


@pytest.fixture(scope="module")
def runs(tmp_path_factory, path):
    """Two runs of three bodies."""
    folder = tmp_path_factory.mktemp("runs")
    starts = jax.tree.map(lambda x: x[:3], path.states)
    for name in ("one.npz", "two.npz", "one.zarr"):
        pytest.importorskip("zarr")
        ml.simulate(
            "JACOBI[EA]", BRICK, None, starts, out=folder / name, dt=0.04, steps=20, save_every=1, progress=False
        )
    return folder


@pytest.mark.sample(0)
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
    tip = [frames[0]["data"][1][letter][1] for letter in "xyz"]
    np.testing.assert_allclose(tip, matrices(path)[0] @ [0.6, 0.0, 0.8], atol=1e-5)
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


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["one.npz", "one.zarr"])
def test_a_body_of_a_saved_run_is_that_of_the_run(runs, name, path):
    found, start = saved_path(runs / name, 2), jax.tree.map(lambda x: x[2], path.states)
    known = ml.integrate("JACOBI[EA]", BRICK, None, start, dt=0.04, steps=20)
    assert isinstance(found.body, ml.RigidBody)
    np.testing.assert_array_equal(found.body.moments, BRICK.moments)
    np.testing.assert_allclose(found.path.times, known.times)
    for one, other in zip(jax.tree.leaves(found.path.states), jax.tree.leaves(known.states), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert (bool(found.path.ok), int(found.path.first_bad), found.bodies) == (True, 21, 3)


def test_midlie_view_says_what_is_wrong(runs, tmp_path):
    np.savez(tmp_path / "other.npz", heights=np.ones(3))
    (tmp_path / "broken.npz").write_bytes(b"no archive")
    (tmp_path / "empty.zarr").mkdir()

    def heights(t, state):
        return {"momentum": state.momentum}

    starts = jax.tree.map(lambda x: x[:2], thrown().states)
    options: Any = {"dt": 0.02, "steps": 4, "save_every": 1, "observe": heights, "progress": False}
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


@pytest.mark.sample(0)
def test_bodies_that_stay_have_a_panel_each():
    body, path = apart(3, ml.CoupledRigidState)
    shown = panels(body, path)
    assert [panel.name for panel in shown] == ["body 0", "body 1", "body 2"]
    assert all(together.limits is None for together in scenes(shown, 2, 3, 100))
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), apart(3)[1])
    assert [panel.name for panel in panels(apart(3)[0], batch)] == ["replica 0", "replica 1"]


@pytest.mark.sample(2)
@pytest.mark.parametrize("count", [2, FEW + 1, 37])
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


def test_bodies_that_begin_at_one_place_are_large_enough_to_be_seen():
    path = fleet(3)
    states = moved(path.states, path.states.position * 0 + path.states.position[:1] * 1e6)
    shown = in_one(path._replace(states=states))
    assert shown.members[0].travel.size > 0.02 * np.max(np.ptp(states.position[0], axis=0))


def test_names_are_those_of_the_mapping():
    path = fleet(2)
    one, two = (
        jax.tree.map(lambda x, k=k: x[k], path._replace(times=jnp.stack([jnp.asarray(TIMES)] * 2))) for k in range(2)
    )
    data = figure_of(ml.plot.view(FREE, {"EA": one, "RK4": two}, together=True, frames=2).html)[0]
    assert [trace["name"] for trace in data] == ["path of EA", "path of RK4", "body", "e3 of EA", "e3 of RK4"]


def test_a_body_that_fails_is_counted():
    path = fleet(3)
    shown = in_one(path._replace(ok=path.ok.at[1].set(False), first_bad=path.first_bad.at[1].set(9)))
    assert shown.remarks[0] == "1 of 3 FAILED"


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("low", [0.0, -0.7])
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
    assert np.all(np.asarray(shown.limits) * [[1], [-1]] < box * [[1], [-1]])
    edges = np.array(shown.around.edges)
    assert edges.shape == (12, 2, 3)
    np.testing.assert_allclose(np.abs(edges[:, 0] - edges[:, 1]).sum(axis=1), edge)


def test_coupled_bodies_and_single_ones_have_boxes_too():
    body, path = apart(2)
    box = [[0.0] * 3, [1.5] * 3]
    for what, moved in ((body, path), (FREE, path._replace(states=path.states.of_body(1)))):
        (shown,) = scenes(panels(what, moved), 2, 9, 100, SITES, around=around_of(box, None, [moved]))
        places = np.array([member.travel.centres for member in shown.members])
        assert np.all((places >= 0) & (places <= 1.5))


def test_a_planet_hides_what_is_beyond_it_and_is_in_the_picture():
    around, out = Around(planet=2.0), np.array([0.0, 0.6, 0.8])
    across = np.array([0.0, 0.8, -0.6])
    points = np.array([3 * out, -3 * out, -3 * out + 1.9 * across, -3 * out + 2.1 * across])
    np.testing.assert_array_equal(around.hidden(points, out), [False, True, True, False])
    assert not NOTHING.hidden(points, out).any()
    assert np.all(np.abs(in_one(fleet(2), around).limits[0]) > 2.0)
    corners, triangles = ball(2.0)
    a, b, c = np.moveaxis(corners[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    assert np.all(np.sum(normals * (a + b + c), axis=1) >= -1e-12)  # all seen from outside
    volume = np.sum(normals * a) / 6
    assert 0.95 < volume / (4 / 3 * np.pi * 8) < 1


@pytest.mark.sample(0)
def test_a_gif_with_a_planet_and_one_with_a_box_show_them(tmp_path):
    options = {"frames": 2, "size": 160, "together": True}
    plain = frames_of(ml.plot.animate(FREE, fleet(7), tmp_path / "a.gif", **options))[0]
    planet = frames_of(ml.plot.animate(FREE, fleet(7), tmp_path / "b.gif", planet=3.0, **options))[0]
    box = [[0.0] * 3, [6.0] * 3]
    walls = frames_of(ml.plot.animate(FREE, fleet(7), tmp_path / "c.gif", box=box, points=SITES, **options))[0]
    pale = [np.mean(np.all(np.abs(f - [0x9F, 0xB4, 0xC4]) < 12, axis=-1)) for f in (plain, planet)]
    assert pale[0] < 0.001 < 0.03 < pale[1]
    assert np.mean(np.any(walls != plain, axis=-1)) > 0.02


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


WRONG = {
    "frames": (lambda: ml.plot.animate(BRICK, spinning(), frames=401), "frames must be at most 400, got 401"),
    "one frame": (lambda: ml.plot.animate(BRICK, spinning(), frames=1), "frames must be at least 2"),
    "size": (lambda: ml.plot.animate(BRICK, spinning(), size=10), "size must be between 64 and 2000 pixels, got 10"),
    "rate": (lambda: ml.plot.animate(BRICK, spinning(), rate=100.0), "rate must be above 0 and at most 50"),
    "ending": (lambda: ml.plot.animate(BRICK, spinning(), "a.mp4"), "file must end in .gif, got 'a.mp4'"),
    "another ending": (lambda: ml.plot.view(BRICK, spinning(), "a.pdf"), r"file must end in \.html"),
    "background": (lambda: ml.plot.animate(BRICK, spinning(), background="snwo"), "a colour of matplotlib, .*'snwo'"),
    "backward": (
        lambda: ml.plot.animate(BRICK, [spinning(), spinning()._replace(times=-spinning().times)]),
        "all go forward in time, or all backward",
    ),
    "no path": (lambda: panels(BRICK, []), "path must hold at least one path, got none"),
    "one body": (lambda: panels([BRICK], [spinning()] * 2), "one body, or one for each of the 2 paths, got 1"),
    "coupled": (lambda: ml.plot.animate(*apart(2), together=True), "drawn together without it"),
    "at rest": (lambda: ml.plot.animate(BRICK, spinning(), together=True), "RigidState, which has no position"),
    "no place": (lambda: ml.plot.animate(BRICK, spinning(), planet=1.0), "planet must be left out without positions"),
    "box": (lambda: around_of(1.2, None, [fleet(2)]), r"\[\[0, 0, 0\], \[L, L, L\]\], for example"),
    "corners": (lambda: ml.plot.animate(FREE, fleet(2), box=[[1.0] * 3, [0.0] * 3]), "least corner first"),
    "planet": (lambda: ml.plot.animate(FREE, fleet(2), planet=-1.0), "planet must be the radius"),
    "body": (lambda: ml.plot.animate(BRICK, fleet(2), together=True), "a FreeState belongs to a FreeBody, but body is"),
    "body of a view": (lambda: ml.plot.view(BRICK, fleet(2), together=True), "a FreeState belongs to a FreeBody"),
    "body and planet": (lambda: ml.plot.animate(BRICK, fleet(1), planet=1.0), "a FreeState belongs to a FreeBody"),
    "coupled body": (lambda: ml.plot.animate(BRICK, apart(2)[1]), "a CoupledState belongs to a FreeBody"),
    "many": (lambda: ml.plot.animate(FREE, fleet(13)), "at most 12 paths, got 13. Choose .*together=True"),
    "too many": (lambda: ml.plot.animate(FREE, fleet(501), together=True), "at most 500 paths, got 501"),
    "many at rest": (lambda: ml.plot.animate(*apart(13, ml.CoupledRigidState)), "at most 12 paths, got 13"),
    "several at rest": (
        lambda: ml.plot.view(*twice(*apart(2, ml.CoupledRigidState))),
        "path must be one path, got several of CoupledRigidStates",
    ),
    "points": (lambda: ml.plot.animate(*apart(2), points=np.ones(3)), r"points must be \(a, 3\)"),
    "NaN": (lambda: ml.plot.animate(*apart(2), points=np.nan * SITES), "points must be finite"),
    "panels": (lambda: ml.plot.animate(*apart(2), points=ml.Surface.box([1.0, 2.0, 3.0])), "drawn by its triangles"),
    "no mass": (lambda: ml.plot.animate(*apart(2, ml.CoupledRigidState), points=SITES), "body must be a FreeBody"),
}


def twice(body, path):
    return body, {"one": path, "again": path}


def spinning():
    """A body that turns in one place."""
    path = fleet(1)
    states = ml.RigidState(path.states.momentum[0], path.states.attitude[0])
    return ml.Path(path.times, states, path.ok[0], path.first_bad[0], path.result[0])


@pytest.mark.parametrize(("show", "message"), WRONG.values(), ids=WRONG.keys())
def test_what_cannot_be_drawn_is_named_and_nothing_is_written(show, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        show()
    assert not list(tmp_path.iterdir())


def test_times_on_pictures_are_short():
    assert [time_text(t) for t in (0.0, 1.23456, 9999.4, 43210.4, -43210.0, 1e9)] == [
        "0", "1.235", "9999", "43,210", "-43,210", "1e+09",
    ]  # fmt: skip


def test_a_page_recolours_no_trace_of_many_bodies():
    """An empty list of traces would mean all of them to plotly."""
    page = ml.plot.view(FREE, fleet(2), together=True, frames=2).html
    assert ".then(() => some({'line.color': blue, 'marker.color': blue}, []))" in page
    assert "traces.length ?" in page


# What a reader does: plays, stops, and sets the middle of the slider. What is then drawn goes to the console.
READER = """<script>
const until = (done, then) => {
  const again = setInterval(() => { if (done()) { clearInterval(again); then(); } }, 20);
};
const click = (name) => document.querySelectorAll('.updatemenu-button')[name === 'play' ? 0 : 1]
  .dispatchEvent(new MouseEvent('click', {bubbles: true}));
until(() => document.body.dataset.drawn, () => {
  const gd = document.getElementById('midlie-view'), last = gd.data.length - 1, shown = [];
  const active = () => gd._fullLayout.sliders[0].active, drawn = () => Array.from(gd.data[last].x);
  const told = {traces: last + 1, paper: gd._fullLayout.paper_bgcolor, start: drawn()};
  gd.on('plotly_animatingframe', (frame) => shown.push(Number(frame.name)));
  click('play');
  until(() => shown.length > 3, () => {
    click('pause');
    setTimeout(() => {
      told.played = shown.slice();
      const rail = document.querySelector('.slider-rail-touch-rect'), at = rail.getBoundingClientRect();
      const middle = {clientX: at.x + at.width / 2, clientY: at.y + at.height / 2, bubbles: true};
      rail.dispatchEvent(new MouseEvent('mousedown', middle));
      gd.dispatchEvent(new MouseEvent('mouseup', middle));
      until(() => shown.length > told.played.length, () => setTimeout(() => {
        Object.assign(told, {active: active(), after: shown.slice(told.played.length), end: drawn()});
        Plotly.toImage(gd, {width: 450, height: 350}).then((picture) => {
          console.log('TOLD' + JSON.stringify({...told, picture}));
        });
      }, 500));
    }, 500);
  });
});
</script>"""
TRACES = {"binary": 5, "waters": 3, "fleet": 3, "methods": 3 * 7}  # bodies and bonds, arrows, paths, box, planet


def told_by(page, folder, *options):
    """What the reader of a page tells, and the lines of the console; in real time, in which frames are drawn."""
    real = [option for option in HEADLESS if "virtual-time" not in option]
    command = [BROWSER, *real, *options, "--remote-debugging-port=0", f"--user-data-dir={folder}", page.as_uri()]
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


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files of all scenes, drawn in a process of its own: as a reader runs the code of the page."""
    folder = tmp_path_factory.mktemp("scenes")
    command = [sys.executable, pictures.__file__, *TRACES, "--folder", folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.sample(0)
@pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome is installed, in which the pages could be opened")
@pytest.mark.parametrize(("name", "dark"), [("binary", 1), ("waters", 0), ("fleet", 1), ("methods", 0)])
def test_the_page_of_a_scene_plays_in_a_browser(name, dark, files, tmp_path):
    """The code of docs/pictures.md, opened, played and set to another time, without an error on the console."""
    assert (files / f"{name}.gif").stat().st_size < 150_000
    read = tmp_path / "read.html"
    text = (files / f"{name}.html").read_text(encoding="utf-8")
    assert len(text) < 10e6
    read.write_text(text.replace("</body>", READER + "</body>"), encoding="utf-8")
    told, console = told_by(read, tmp_path / "profile", f"--blink-settings=preferredColorScheme={1 - dark}")
    assert not [line for line in console if re.search("error|failed|ERR_", line, re.IGNORECASE)], console
    data, _, frames = figure_of(text)
    assert told["traces"] == len(data) == TRACES[name]
    assert told["paper"] == ("#111111" if dark else "#ffffff")
    assert told["played"] == list(range(len(told["played"])))
    assert told["after"] == [told["active"]]  # nothing plays on
    assert abs(told["active"] - len(frames) / 2) < 0.1 * len(frames)
    for where, frame in ((told["start"], frames[0]), (told["end"], frames[told["active"]])):
        assert where == frame["data"][-1]["x"]
    with Image.open(io.BytesIO(base64.b64decode(told["picture"].partition(",")[2]))) as picture:
        seen = np.asarray(picture.convert("RGB")).astype(int)
    ground = np.array([0x11] * 3 if dark else [0xFF] * 3)
    assert 0.02 < np.mean(np.any(np.abs(seen - ground) > 40, axis=-1)) < 0.5
