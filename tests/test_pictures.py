"""Scenes with many bodies: one space about a planet, a periodic box, and the pages of docs/pictures.md in a browser."""

import base64
import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark
from PIL import Image
from test_plot_coupled import SITES
from test_plot_coupled import apart as coupled
from test_view import BRICK, BROWSER, HEADLESS, figure_of, frames_of

import midlie_jax as ml
from midlie_jax.plot.model import NOTHING, Around, around_of, panels
from midlie_jax.plot.model import scenes as scenes_of
from midlie_jax.plot.solids import ball
from midlie_jax.plot.style import FEW, time_text

pictures = benchmark("pictures")
TIMES = jnp.linspace(0.0, 2.0, 21)
BODY = ml.FreeBody(ml.RigidBody([0.02, 0.03, 0.04]), 1.0)
OTHER_BODY = "a FreeState belongs to a FreeBody, but body is RigidBody"


def fleet(count, speed=1.0):
    """Bodies that turn about e3, each on a straight line: the exact motion, as `ensemble` returns it."""
    places, rates = np.stack(3 * [np.arange(count, dtype=float)], axis=1), np.linspace(0.5, 1.0, count)
    ways = np.tile([speed, -0.5 * speed, 0.0], (count, 1))
    angle = rates[:, None] * np.asarray(TIMES) / 2
    states = ml.FreeState(
        momentum=jnp.asarray(np.stack([0 * angle, 0 * angle, 0.04 * rates[:, None] + 0 * angle], axis=-1)),
        attitude=jnp.asarray(np.stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)], axis=-1)),
        linear=jnp.asarray(np.broadcast_to(ways[:, None], (*angle.shape, 3))),
        position=jnp.asarray(places[:, None] + np.asarray(TIMES)[:, None] * ways[:, None]),
    )
    return ml.Path(TIMES, states, jnp.ones(count, bool), jnp.full(count, 21), jnp.zeros(count, int))


def moved(states, position):
    """The states at other places."""
    return ml.FreeState(states.momentum, states.attitude, states.linear, jnp.asarray(position))


def in_one(path, around=NOTHING, frames=3, body=BODY):
    (found,) = scenes_of(panels(body, path, together=True), 2, frames, 100, around=around, in_one=True)
    return found


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
    one, two = (jax.tree.map(lambda x, k=k: x[k], path._replace(times=jnp.stack([TIMES] * 2))) for k in range(2))
    data = figure_of(ml.plot.view(BODY, {"EA": one, "RK4": two}, together=True, frames=2).html)[0]
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
    body, path = coupled(2)
    box = [[0.0] * 3, [1.5] * 3]
    for what, moved in ((body, path), (BODY, path._replace(states=path.states.of_body(1)))):
        (shown,) = scenes_of(panels(what, moved), 2, 9, 100, SITES, around=around_of(box, None, [moved]))
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
    plain = frames_of(ml.plot.animate(BODY, fleet(7), tmp_path / "a.gif", **options))[0]
    planet = frames_of(ml.plot.animate(BODY, fleet(7), tmp_path / "b.gif", planet=3.0, **options))[0]
    box = [[0.0] * 3, [6.0] * 3]
    walls = frames_of(ml.plot.animate(BODY, fleet(7), tmp_path / "c.gif", box=box, points=SITES, **options))[0]
    pale = [np.mean(np.all(np.abs(f - [0x9F, 0xB4, 0xC4]) < 12, axis=-1)) for f in (plain, planet)]
    assert pale[0] < 0.001 < 0.03 < pale[1]
    assert np.mean(np.any(walls != plain, axis=-1)) > 0.02


@pytest.mark.parametrize(
    ("show", "message"),
    [
        (lambda file: ml.plot.animate(*coupled(2), file, together=True), "drawn together without it"),
        (lambda file: ml.plot.animate(BRICK, spun(), file, together=True), "RigidState, which has no position"),
        (lambda file: ml.plot.animate(BRICK, spun(), file, planet=1.0), "planet must be left out without positions"),
        (lambda file: around_of(1.2, None, [fleet(2)]), r"\[\[0, 0, 0\], \[L, L, L\]\], for example"),
        (lambda file: ml.plot.animate(BODY, fleet(2), file, box=[[1.0] * 3, [0.0] * 3]), "least corner first"),
        (lambda file: ml.plot.animate(BODY, fleet(2), file, planet=-1.0), "planet must be the radius"),
        (lambda file: ml.plot.animate(BRICK, fleet(2), file, together=True), OTHER_BODY),
        (lambda _: ml.plot.view(BRICK, fleet(2), together=True), OTHER_BODY),
        (lambda file: ml.plot.animate(BRICK, fleet(1), file, planet=1.0), OTHER_BODY),
        (lambda file: ml.plot.animate(BRICK, coupled(2)[1], file), "a CoupledState belongs to a FreeBody"),
        (lambda file: ml.plot.animate(BODY, fleet(13), file), "at most 12 paths, got 13. Choose .*together=True"),
        (lambda file: ml.plot.animate(BODY, fleet(501), file, together=True), "at most 500 paths, got 501"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_in_one_space_is_refused(show, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        show(tmp_path / "never.gif")
    assert not list(tmp_path.iterdir())


def spun():
    """A body that turns in one place."""
    path = fleet(1)
    states = ml.RigidState(path.states.momentum[0], path.states.attitude[0])
    return ml.Path(TIMES, states, path.ok[0], path.first_bad[0], path.result[0])


def test_times_on_pictures_are_short():
    assert [time_text(t) for t in (0.0, 1.23456, 9999.4, 43210.4, -43210.0, 1e9)] == [
        "0", "1.235", "9999", "43,210", "-43,210", "1e+09",
    ]  # fmt: skip


def test_a_page_recolours_no_trace_of_many_bodies():
    """An empty list of traces would mean all of them to plotly."""
    page = ml.plot.view(BODY, fleet(2), together=True, frames=2).html
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
def scenes(tmp_path_factory):
    """The files of all scenes, drawn in a process of its own: as a reader runs the code of the page."""
    folder = tmp_path_factory.mktemp("scenes")
    command = [sys.executable, pictures.__file__, *TRACES, "--folder", folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.sample(0)
@pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome is installed, in which the pages could be opened")
@pytest.mark.parametrize(("name", "dark"), [("binary", 1), ("waters", 0), ("fleet", 1), ("methods", 0)])
def test_the_page_of_a_scene_plays_in_a_browser(name, dark, scenes, tmp_path):
    """The code of docs/pictures.md, opened, played and set to another time, without an error on the console."""
    assert (scenes / f"{name}.gif").stat().st_size < 150_000
    read = tmp_path / "read.html"
    text = (scenes / f"{name}.html").read_text(encoding="utf-8")
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
