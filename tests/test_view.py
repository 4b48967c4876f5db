"""Moving pictures: the frames of a GIF, the data of an HTML view, that view in a browser, and `midlie view`."""

import contextlib
import io
import itertools
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image, ImageSequence

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.cli.main import main
from midlie_jax.plot.model import Panel, turnings
from midlie_jax.plot.solids import FACES, shape_of
from midlie_jax.simulation.saved import saved_path

BRICK = ml.RigidBody([1.0, 2.0, 2.5])
START = ml.RigidState([0.02, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


def turning(body, path, axis, frames, most):
    """One body at the times of the frames."""
    return turnings([Panel("", body, path)], axis, frames, most)[0]


@pytest.fixture(scope="module")
def path():
    return ml.free_motion(BRICK, START, jnp.linspace(0.0, 12.0, 301))


def matrices(path):
    return np.asarray(ml.so3.to_matrix(path.states.attitude))


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


def frames_of(file):
    with Image.open(file) as picture:
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(picture)]


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


@pytest.mark.sample(0)
def test_the_default_gif_is_small(path, tmp_path):
    file = ml.plot.animate(BRICK, path, tmp_path / "brick.gif")
    assert file.stat().st_size < 400_000
    assert len(frames_of(file)) == 72


def figure_of(page):
    """Data, layout and frames, as the page gives them to plotly."""
    decoder, found = json.JSONDecoder(), []
    call = page.rindex("Plotly.newPlot(")
    place = page.index("[", call)
    data, end = decoder.raw_decode(page, place)
    found.append(data)
    layout, _ = decoder.raw_decode(page, page.index("{", end))
    frames, _ = decoder.raw_decode(page, page.index("[", page.index("Plotly.addFrames(", end)))
    return (*found, layout, frames)


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


def opened(page, picture, folder, *options):
    """A screenshot of the page, (height, width, 3), and what the browser wrote on its console."""
    command = [BROWSER, *HEADLESS, *options, f"--user-data-dir={folder}", f"--screenshot={picture}", page.as_uri()]
    said = subprocess.run(command, capture_output=True, text=True, timeout=240, check=True).stderr
    return np.asarray(Image.open(picture).convert("RGB")).astype(int), re.findall(r"CONSOLE[:(].*", said)


@pytest.mark.sample(0)
@pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome is installed, in which the view could be opened")
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_a_view_in_a_browser(page, tmp_path, dark):
    """The body is seen, on a page of the colour that the browser is set to, and nothing is wrong on the console."""
    options = ["--blink-settings=preferredColorScheme=0"] if dark else ["--blink-settings=preferredColorScheme=1"]
    seen, console = opened(page, tmp_path / "view.png", tmp_path / "profile", *options)
    assert not [line for line in console if re.search("error|failed|ERR_", line, re.IGNORECASE)], console
    ground = np.array([0x11] * 3 if dark else [0xFF] * 3)
    assert np.mean(np.all(np.abs(seen - ground) < 3, axis=-1)) > 0.5
    hue = seen - seen.min(axis=-1, keepdims=True)
    orange = (hue[..., 0] > 150) & (hue[..., 1] > 80) & (hue[..., 2] == 0)
    pale_blue = (hue[..., 0] == 0) & (hue[..., 2] > 20) & (hue[..., 2] < 50)
    blue, sky = (np.all(np.abs(seen - colour) < 3, axis=-1) for colour in ([0x00, 0x72, 0xB2], [0x56, 0xB4, 0xE9]))
    assert np.mean(orange) > 0.003, "one side of the box"
    assert np.mean(pale_blue) > 0.01, "another side of the box"
    assert np.mean(sky if dark else blue) > 0.001, "the axis and its path"
    assert not np.any(blue if dark else sky), "the axis or its path in the colour of the other page"


def midlie(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*map(str, arguments)])
    return code, out.getvalue() + err.getvalue()


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One run of three bodies, as `midlie run` and `simulate` write it."""
    folder = tmp_path_factory.mktemp("runs")
    code, said = midlie("run", "tumbling-brick", "--bodies", 3, "--steps", 20, "--out", folder / "command.npz")
    assert code == 0, said
    scene = scenes.scene("tumbling-brick")
    starts = scenes.perturbed(scene, 3, 1e-3)
    for name in ("simulate.npz", "simulate.zarr"):
        ml.simulate(
            "JACOBI[EA]",
            scene.body,
            None,
            starts,
            out=folder / name,
            dt=scene.dt,
            steps=20,
            save_every=1,
            progress=False,
        )
    return folder


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["command.npz", "simulate.npz", "simulate.zarr"])
@pytest.mark.parametrize("body", [0, 2])
def test_a_body_of_a_saved_run_is_that_of_the_run(runs, name, body):
    scene = scenes.scene("tumbling-brick")
    start = jax.tree.map(lambda x: x[body], scenes.perturbed(scene, 3, 1e-3))
    found = saved_path(runs / name, body)
    path = ml.integrate("JACOBI[EA]", scene.body, None, start, dt=scene.dt, steps=20)
    assert isinstance(found.body, ml.RigidBody)
    assert isinstance(scene.body, ml.RigidBody)
    np.testing.assert_array_equal(found.body.moments, scene.body.moments)
    np.testing.assert_allclose(found.path.times, path.times)
    for one, other in zip(jax.tree.leaves(found.path.states), jax.tree.leaves(path.states), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert (bool(found.path.ok), int(found.path.first_bad), found.bodies) == (True, 21, 3)


@pytest.mark.sample(0)
def test_midlie_view_writes_what_is_asked_for(runs, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = tmp_path / "view.html"
    code, said = midlie("view", runs / "simulate.zarr", "--body", 2, "--out", page, "--open")
    assert code == 0, said
    assert f"wrote {page}" in said
    assert opened == [page.as_uri()]
    assert figure_of(page.read_text())[1]["title"]["text"] == "3 bodies moved by JACOBI[EA]; body 2 of 3"
    code, said = midlie("view", runs / "command.npz", "--out", tmp_path / "view.gif", "--axis", "e1")
    assert code == 0, said
    assert len(frames_of(tmp_path / "view.gif")) == 72


def test_midlie_view_says_what_is_wrong(runs, tmp_path):
    np.savez(tmp_path / "other.npz", heights=np.ones(3))
    (tmp_path / "broken.npz").write_bytes(b"no archive")
    (tmp_path / "empty.zarr").mkdir()
    for run, wrong in (
        (runs / "none.npz", "there is no"),
        (runs / "run.csv", "must be a run that ends in .zarr or .npz"),
        (tmp_path / "other.npz", "holds no momentum and no attitude and no times; it must be a run of RigidStates"),
        (tmp_path / "broken.npz", "cannot be read"),
        (tmp_path / "empty.zarr", "is not the store of a run"),
    ):
        code, said = midlie("view", run, "--out", tmp_path / "view.html")
        assert (code, said.count("\n")) == (2, 1), said
        assert wrong in said
    code, said = midlie("view", runs / "command.npz", "--body", 3, "--out", tmp_path / "view.html")
    assert (code, "body must be from 0 to 2" in said) == (2, True), said
    assert not (tmp_path / "view.html").exists()


@pytest.mark.sample(0)
def test_a_run_that_failed_is_shown_up_to_there(tmp_path):
    """The step is far too large for the implicit method, which fails at once or soon."""
    file = tmp_path / "failed.npz"
    midlie("run", "P1", "--dt", 3, "--steps", 4, "--method", "LIEMID[EA]", "--out", file)
    with np.load(file) as saved:
        assert not saved["ok"][0]
        first_bad = int(saved["first_bad"][0])
    found = saved_path(file)
    assert (bool(found.path.ok), int(found.path.first_bad)) == (False, first_bad)


WRONG = {
    "frames": ({"frames": 401}, "frames must be at most 400, got 401"),
    "one frame": ({"frames": 1}, "frames must be at least 2"),
    "size": ({"size": 10}, "size must be between 64 and 2000 pixels, got 10"),
    "rate": ({"rate": 100.0}, "rate must be above 0 and at most 50"),
    "ending": ({"file": "brick.mp4"}, "file must end in .gif, got 'brick.mp4'"),
}


@pytest.mark.parametrize(("options", "message"), WRONG.values(), ids=WRONG.keys())
def test_bad_input_is_named(path, options, message):
    with pytest.raises(ValueError, match=message):
        ml.plot.animate(BRICK, path, **options)


def test_a_state_without_attitude_is_refused(path, tmp_path):
    spins = path._replace(states=ml.MomentumState(path.states.momentum))
    for show, name in ((ml.plot.animate, "a.gif"), (ml.plot.view, "a.html")):
        with pytest.raises(ValueError, match="needs the attitude, which MomentumState does not have; use a RigidState"):
            show(BRICK, spins, tmp_path / name)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"file must end in \.html"):
        ml.plot.view(BRICK, path, tmp_path / "a.pdf")
