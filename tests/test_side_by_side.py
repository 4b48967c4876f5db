"""Several bodies or methods in one moving picture, a view that shows itself in a notebook, `midlie view` of both."""

import html
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from test_view import BRICK, START, figure_of, frames_of, midlie, turning

import midlie_jax as ml
from midlie_jax.plot.model import Panel, grid, panels, turnings
from midlie_jax.plot.solids import shape_of

SLIM = ml.RigidBody([0.3, 2.0, 2.1])


@pytest.fixture(scope="module")
def path():
    return ml.free_motion(BRICK, START, jnp.linspace(0.0, 6.0, 61))


@pytest.fixture(scope="module")
def other():
    """Half as long, of another body."""
    return ml.free_motion(SLIM, START, jnp.linspace(0.0, 3.0, 31))


@pytest.mark.sample(0)
def test_bodies_side_by_side_have_one_clock_and_each_its_own_motion(path, other):
    both = turnings([Panel("", BRICK, path), Panel("", SLIM, other)], "e2", 13, most=100)
    for shown, alone in zip(both, (turning(BRICK, path, 1, 13, 100), turning(SLIM, other, 1, 7, 100)), strict=True):
        count = len(alone.times)
        np.testing.assert_allclose(both[0].times[:count], alone.times)
        np.testing.assert_allclose(shown.corners[:count], alone.corners, atol=1e-12)
        np.testing.assert_allclose(shown.tips[count - 1 :], np.tile(alone.tips[-1], (14 - count, 1)), atol=1e-12)
        np.testing.assert_allclose(shown.momenta[:count], alone.momenta, atol=1e-12)
    assert [shown.remarks for shown in both] == [(), ("from t = 0 to 3",)]


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


def test_a_background_that_is_no_colour_is_named(path):
    with pytest.raises(ValueError, match=r"background must be a colour of matplotlib, .*got 'snwo'"):
        ml.plot.animate(BRICK, path, "never.gif", background="snwo")


@pytest.mark.sample(0)
def test_a_view_of_two_has_a_scene_for_each(path, other):
    go = pytest.importorskip("plotly.graph_objects")
    shown = ml.plot.view([BRICK, SLIM], {"a": path, "b": other}, axis="e1", frames=7, title="two")
    data, layout, frames = figure_of(shown.html)
    go.Figure(data=data, layout=layout)  # raises for what plotly does not know
    assert {trace["scene"] for trace in data} == {"scene", "scene2"}
    assert [layout[name]["domain"]["x"] for name in ("scene", "scene2")] == [[0, 0.5], [0.5, 1]]
    assert [note["text"] for note in layout["annotations"]] == ["<b>a</b>", "<b>b</b><br>from t = 0 to 3"]
    bodies = [place for place, trace in enumerate(data) if trace["name"] == "body"]
    times = [jnp.arange(7.0), jnp.minimum(jnp.arange(7.0), 3.0)]
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


@pytest.fixture(scope="module")
def runs(path, tmp_path_factory):
    """Two files with the same three bodies, with the names of arrays that `midlie run` gives them."""
    folder = tmp_path_factory.mktemp("runs")
    momenta, attitudes = (np.stack([x] * 3) for x in (path.states.momentum, path.states.attitude))
    for name in ("one", "two"):
        arrays = {"momenta": momenta, "attitudes": attitudes, "times": path.times, "moments": BRICK.moments}
        np.savez(folder / f"{name}.npz", title=name, ok=np.ones(3, bool), **arrays)
    return folder


def test_midlie_view_of_several_bodies_and_runs(runs, tmp_path):
    page = tmp_path / "view.html"
    first, second = runs / "one.npz", runs / "two.npz"
    code, said = midlie("view", first, "--body", 0, 2, "--out", page, "--frames", 5, "--axis", "3,0,4")
    assert code == 0, said
    _, layout, frames = figure_of(page.read_text())
    tip = [frames[0]["data"][1][letter][1] for letter in "xyz"]
    matrix = np.asarray(ml.so3.to_matrix(jnp.asarray(START.attitude)))
    np.testing.assert_allclose(tip, matrix @ [0.6, 0.0, 0.8], atol=1e-5)
    assert [note["text"] for note in layout["annotations"]] == ["<b>body 0</b>", "<b>body 2</b>"]
    assert len(frames) == 5
    code, said = midlie("view", first, second, "--body", 1, "--out", page, "--title", "two")
    assert code == 0, said
    layout = figure_of(page.read_text())[1]
    assert [note["text"] for note in layout["annotations"]] == ["<b>one.npz</b>", "<b>two.npz</b>"]
    assert layout["title"]["text"] == "two"
    options = ["--frames", 3, "--size", 100, "--rate", 5, "--background", "black", "--elevation", 60]
    code, said = midlie("view", first, "--body", 0, 1, "--out", tmp_path / "two.gif", *options)
    assert code == 0, said
    frames = frames_of(tmp_path / "two.gif")
    assert (len(frames), frames[0].shape[:2]) == (3, (100, 200))
    assert np.mean(frames[0]) < 60


@pytest.mark.parametrize("number", ["0", "1", "2", "3"])
def test_an_axis_by_a_number_is_refused(runs, number, tmp_path):
    """The command counted from 1 once and Python counts from 0, so a number could mean another axis than is meant."""
    code, said = midlie("view", runs / "one.npz", "--axis", number, "--out", tmp_path / "view.html")
    assert code == 2
    assert "must be e1, e2 or e3" in said
    assert "Python's axis=0, 1, 2 are e1, e2, e3" in said


def test_options_of_a_gif_do_not_go_with_a_page(runs, tmp_path):
    code, said = midlie("view", runs / "one.npz", "--size", 100, "--out", tmp_path / "view.html")
    assert (code, "--size must be given with --out and a .gif" in said) == (2, True)
