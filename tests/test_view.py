"""Moving pictures: where bodies are in the frames of a GIF or an HTML view, that view in a browser, `midlie view`."""

import contextlib
import html
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
from cases import assert_one_line, midlie, quick
from pictured import GRAVITY, UPRIGHT, apart, brick, fleet, thrown
from PIL import Image, ImageSequence

import midlie_jax as ml
from midlie_jax.plot.model import around_of, panels
from midlie_jax.plot.solids import shape_of

BRICK, SLIM = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidBody([0.3, 2.0, 2.1])
START = ml.RigidState([0.02, 2.0, 0.01], UPRIGHT)
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
SITES = np.array([[0.0, 0.0, -0.1], [0.2, 0.0, 0.1], [-0.2, 0.0, 0.1]])
FREE = ml.FreeBody(ml.RigidBody([0.02, 0.03, 0.04]), 1.0)


@pytest.fixture(scope="module")
def path():
    return quick(lambda start: ml.free_motion(BRICK, start, jnp.linspace(0.0, 12.0, 301)))(START)


def matrices(path):
    return np.asarray(ml.so3.to_matrix(path.states.attitude))


def frames_of(file):
    with Image.open(file) as picture:
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(picture)]


def figure_of(page):
    decoder, call = json.JSONDecoder(), page.rindex("Plotly.newPlot(")
    data, end = decoder.raw_decode(page, page.index("[", call))
    layout, _ = decoder.raw_decode(page, page.index("{", end))
    frames, _ = decoder.raw_decode(page, page.index("[", page.index("Plotly.addFrames(", end)))
    return data, layout, frames


def points(trace):
    return np.array([trace[axis] for axis in "xyz"], float).T


# ---- one body ----


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


# ---- side by side ----


def test_what_may_be_shown_side_by_side(path):
    states, ok, bad = jax.tree.map(lambda x: jnp.stack([x] * 2), (path.states, path.ok, path.first_bad))
    bodies = ml.RigidBody(jnp.stack([BRICK.moments, SLIM.moments]))
    (first, second) = panels(bodies, ml.Path(path.times, states, ok, bad))  # as `ensemble` returns it
    assert (first.name, second.name) == ("body 0", "body 1")
    np.testing.assert_array_equal(second.body.moments, SLIM.moments)
    np.testing.assert_array_equal(second.path.states.momentum, path.states.momentum)
    coupled, at_rest = apart(3), apart(3, ml.CoupledRigidState)
    assert [panel.name for panel in panels(*at_rest)] == ["body 0", "body 1", "body 2"]
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), coupled[1])
    assert [panel.name for panel in panels(coupled[0], batch)] == ["replica 0", "replica 1"]


def test_a_gif_and_a_view_of_two_show_both(path, tmp_path):
    pair = [BRICK, SLIM], {"a": path, "b": ml.free_motion(SLIM, START, jnp.linspace(0.0, 6.0, 151))}
    file = ml.plot.animate(*pair, tmp_path / "two.gif", frames=3, size=120, title="two", background="#111111")
    frames = frames_of(file)
    assert (len(frames), frames[0].shape[1]) == (3, 240)
    go = pytest.importorskip("plotly.graph_objects")
    data, layout, _ = figure_of(ml.plot.view(*pair, axis="e1", frames=13).html)
    go.Figure(data=data, layout=layout)  # raises for what plotly does not know
    assert {trace["scene"] for trace in data} == {"scene", "scene2"}
    assert [note["text"] for note in layout["annotations"]] == ["<b>a</b>", "<b>b</b><br>from t = 0 to 6"]
    options = {"frames": 2, "size": 120, "together": True}
    solid = ml.Surface(np.eye(4)[:, 1:], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert ml.plot.animate(*apart(2), file, points=[solid] * 2, frames=2).exists()
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
    options = ["--frames", 3, "--size", 100, "--rate", 5, "--background", "black", "--elevation", 60]
    assert midlie("view", first, "--body", 0, 1, "--out", gif, *options).code == 0
    assert (len(frames_of(gif)), frames_of(gif)[0].shape[:2]) == (3, (100, 200))


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


# ---- what cannot be drawn ----


WRONG = [
    (lambda: ml.plot.animate(BRICK, spinning(), frames=401), "frames must be at most 400, got 401"),
    (lambda: ml.plot.animate(BRICK, spinning(), frames=1), "frames must be at least 2"),
    (lambda: ml.plot.animate(BRICK, spinning(), size=10), "size must be between 64 and 2000 pixels, got 10"),
    (lambda: ml.plot.animate(BRICK, spinning(), rate=100.0), "rate must be above 0 and at most 50"),
    (lambda: ml.plot.animate(BRICK, spinning(), "a.mp4"), "file must end in .gif, got 'a.mp4'"),
    (lambda: ml.plot.view(BRICK, spinning(), "a.pdf"), r"file must end in \.html"),
    (lambda: ml.plot.animate(BRICK, spinning(), background="snwo"), "a colour of matplotlib, .*'snwo'"),
    (lambda: ml.plot.animate(BRICK, [spinning(), spinning(-1)]), "all go forward in time, or all backward"),
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
    (lambda: ml.plot.view(*twice(*apart(2, ml.CoupledRigidState))), "must be one path, got several of CoupledRig"),
    (lambda: ml.plot.animate(*apart(2), points=np.ones(3)), r"points must be \(a, 3\)"),
    (lambda: ml.plot.animate(*apart(2), points=np.nan * SITES), "points must be finite"),
    (lambda: ml.plot.animate(*apart(2), points=ml.Surface.box([1.0, 2.0, 3.0])), "drawn by its triangles"),
    (lambda: ml.plot.animate(*apart(2, ml.CoupledRigidState), points=SITES), "body must be a FreeBody"),
]


def twice(body, path):
    return body, {"one": path, "again": path}


def spinning(sign=1):
    """A body that turns in one place."""
    path = fleet(1)
    states = ml.RigidState(path.states.momentum[0], path.states.attitude[0])
    return ml.Path(sign * path.times, states, path.ok[0], path.first_bad[0], path.result[0])


def test_what_cannot_be_drawn_is_named_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for show, message in WRONG:
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
