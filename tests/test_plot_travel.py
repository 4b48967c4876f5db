"""Pictures of bodies that travel, and of tops that are only an axis: every function with every kind of state."""

import contextlib
import inspect
import io
import itertools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from test_view import figure_of, turning

import midlie_jax as ml
from midlie_jax.cli.main import main
from midlie_jax.plot.conservation import kept_by
from midlie_jax.plot.model import Scene, panels
from midlie_jax.plot.solids import CORNERS, shape_of
from midlie_jax.plot.style import ORANGE
from midlie_jax.simulation.saved import saved_path

HALF, MASS = np.array([0.3, 0.2, 0.5]), 4.0  # the half sides of a brick
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
TOP = ml.RigidBody([5.0, 5.0, 1.0])
ROTOR = ml.SymmetricRotor(5.0, 1.0)
GRAVITY = ml.torques.UniformGravity([0.0, 0.0, -9.81])
TIMES = jnp.linspace(0.0, 2.0, 41)


def brick(scale=1.0):
    """A body that travels, with the moments of a brick of known sides."""
    square = (HALF * scale) ** 2
    return ml.FreeBody(ml.RigidBody(MASS / 3 * (square.sum() - square)), MASS)


def thrown(scale=1.0, speed=8.0, steps=40):
    """A brick that is thrown and tumbles."""
    body = brick(scale)
    spin = body.momentum(jnp.array([0.1, 2.0, 0.3]))
    start = ml.FreeState(spin, UPRIGHT, MASS * scale * jnp.array([speed, speed / 8, speed]), [0.0, 0.0, scale])
    force = ml.torques.UniformGravity(scale * GRAVITY.acceleration)
    return ml.integrate("JACOBI[EA]", body, force, start, dt=0.05, steps=steps)


@pytest.fixture(scope="module")
def cases():
    """For each kind of state a body, the torque, and a path."""
    tilted = ml.RigidState([0.0, 0.3, 30.0], ml.so3.exp(jnp.array([0.5, 0.0, 0.0])))
    weight, free_rotor, free_top = ml.torques.HeavyTop(20.0), ml.FreeBody(ROTOR, MASS), ml.FreeBody(TOP, MASS)
    place = ([8.0, 0.0, 32.0], [0.0, 0.0, 1.0])
    top = ml.FreeState(tilted.momentum, tilted.attitude, *place)
    made = {
        "RigidState": ("JACOBI[EA]", TOP, weight, tilted),
        "DirectionState": ("JACOBI[EA]", TOP, weight, ml.DirectionState(tilted.momentum, [0.0, 0.6, 0.8])),
        "MomentumState": ("JACOBI[EA]", TOP, None, ml.MomentumState(tilted.momentum)),
        "AxisState": ("SYMMETRIC[EA]", ROTOR, weight, ml.AxisState.of(tilted)),
        "FreeState": ("JACOBI[EA]", free_top, GRAVITY, top),
        "FreeAxisState": ("SYMMETRIC[EA]", free_rotor, GRAVITY, ml.FreeAxisState.of(top)),
    }
    return {
        name: (body, torque, ml.integrate(method, body, torque, start, dt=0.02, steps=40))
        for name, (method, body, torque, start) in made.items()
    }


KINDS = ("RigidState", "DirectionState", "MomentumState", "AxisState", "FreeState", "FreeAxisState")


def axes_of(**options):
    return Figure(figsize=(6.4, 4.8)).add_subplot(**options)


def height(t, state):
    return state.momentum[0]


# Without the type checker of the tests, which users do not have, and which would refuse the body.
polhode = inspect.unwrap(ml.plot.polhode)
DRAW = {
    "animate": lambda body, torque, path, out: ml.plot.animate(body, path, out / "a.gif", frames=3, size=120),
    "view": lambda body, torque, path, out: ml.plot.view(body, path, frames=3),
    "axis_path": lambda body, torque, path, out: ml.plot.axis_path(axes_of(projection="3d"), path),
    "axis_path from above": lambda body, torque, path, out: ml.plot.axis_path(axes_of(), path),
    "track": lambda body, torque, path, out: ml.plot.track(axes_of(projection="3d"), path, label="a body"),
    "track in a plane": lambda body, torque, path, out: ml.plot.track(axes_of(), path, label="a body"),
    "polhode": lambda body, torque, path, out: polhode(axes_of(projection="3d"), body, path),
    "conserved": lambda body, torque, path, out: ml.plot.conserved(axes_of(), body, torque, path),
    "poincare": lambda body, torque, path, out: ml.plot.poincare(axes_of(), path, height, height, height, direction=0),
}
NO_ATTITUDE = dict.fromkeys(("DirectionState", "MomentumState"), "needs the attitude")
NO_PLACE = {kind: f"must hold positions, got {kind}s" for kind in KINDS if not kind.startswith("Free")}
NOT_IN_BODY = dict.fromkeys(("AxisState", "FreeAxisState"), "must hold momenta in the body frame")
REFUSED = {
    "animate": NO_ATTITUDE,
    "view": NO_ATTITUDE,
    "axis_path": NO_ATTITUDE,
    "axis_path from above": NO_ATTITUDE,
    "track": NO_PLACE,
    "track in a plane": NO_PLACE,
    "polhode": NOT_IN_BODY,
}


@pytest.mark.sample(6)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", DRAW)
def test_every_function_draws_every_kind_of_state_or_says_what_is_missing(cases, tmp_path, name, kind):
    refusal = REFUSED.get(name, {}).get(kind)
    with pytest.raises(ValueError, match=refusal) if refusal else contextlib.nullcontext():
        assert DRAW[name](*cases[kind], tmp_path) is not None
    assert bool(list(tmp_path.iterdir())) == (name == "animate" and not refusal)


@pytest.mark.parametrize("axis", ["e1", [0.6, 0.0, 0.8]])
@pytest.mark.parametrize("kind", ["AxisState", "FreeAxisState"])
def test_an_axis_that_a_state_does_not_know_is_refused(cases, kind, axis):
    body, _, path = cases[kind]
    for draw in (lambda: ml.plot.axis_path(axes_of(), path, axis), lambda: ml.plot.view(body, path, axis=axis)):
        with pytest.raises(ValueError, match=f'axis must be "e3" for a {kind}'):
            draw()


def test_a_body_of_another_kind_is_refused(cases):
    for kind, body in (("FreeState", TOP), ("AxisState", TOP), ("RigidState", brick()), ("FreeAxisState", brick())):
        with pytest.raises(ValueError, match=f"a {kind} belongs to a"):
            ml.plot.view(body, cases[kind][2])


def test_the_path_of_an_axis_is_that_of_the_same_motion_with_an_attitude(cases):
    """Also the axis that moves, at saved times and between them."""
    for kind, other, to_axis in (
        ("RigidState", "AxisState", ml.AxisState.of),
        ("FreeState", "FreeAxisState", ml.FreeAxisState.of),
    ):
        (body, _, path), (rotor, _, _) = cases[kind], cases[other]
        alone = path._replace(states=to_axis(path.states))
        known = ml.plot.axis_path(axes_of(), path)
        np.testing.assert_allclose(ml.plot.axis_path(axes_of(), alone), known, atol=1e-14)
        np.testing.assert_allclose(ml.plot.axis_path(axes_of(), alone, [0, 0, -1.0]), -known, atol=1e-14)
        one, two = turning(body, path, 2, 41, most=100), turning(rotor, alone, 2, 41, most=100)
        np.testing.assert_allclose(two.tips, one.tips, atol=1e-13)
        np.testing.assert_allclose(two.momenta, one.momenta, atol=1e-13)
        between = turning(rotor, alone, 2, 78, most=100)
        np.testing.assert_allclose(np.linalg.norm(between.tips, axis=1), 1, atol=1e-12)


@pytest.mark.sample(0)
def test_a_rotation_is_drawn_as_that_of_a_body_that_does_not_travel():
    """A body at rest in space is the same picture to the last bit; one that travels turns alike, and on one polhode."""
    body = brick()
    path = ml.free_motion(body.body, ml.RigidState(body.momentum(jnp.array([0.1, 2.0, 0.3])), UPRIGHT), TIMES)
    rest = jnp.zeros((41, 3))
    for travelled in (0.0, 1e-3, 1.0):
        states = ml.FreeState(path.states.momentum, path.states.attitude, rest, rest.at[:, 0].add(travelled * TIMES))
        one = turning(body, path._replace(states=states), 2, 9, most=100)
        other = turning(body.body, path, 2, 9, most=100)
        assert (one.travel is None) == (travelled < 0.01)
        for a, b in zip(one[:8], other[:8], strict=True):
            np.testing.assert_array_equal(a[0] if isinstance(a, tuple) else a, b[0] if isinstance(b, tuple) else b)
        drawn = [
            ml.plot.polhode(axes_of(projection="3d"), *moving)
            for moving in ((body, path._replace(states=states)), (body.body, path))
        ]
        np.testing.assert_array_equal(*drawn)


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


@pytest.mark.parametrize(("speed", "steps", "title"), [(8.0, 40, ""), (8e6, 40, "far"), (80.0, 330, "long")])
def test_names_and_numbers_are_inside_the_picture_and_apart(monkeypatch, speed, steps, title):
    from midlie_jax.plot.animate import _Movie

    found, draw = {}, Text.draw

    def seen(text, renderer):
        """Where a text is when it is drawn; matplotlib moves the numbers at 3-D axes again afterwards."""
        draw(text, renderer)
        if text.get_text() and text.get_visible():
            box, angle = text.get_window_extent(renderer), np.radians(text.get_rotation())
            along = np.hypot(box.width, box.height) / 2 * np.array([np.cos(angle), np.sin(angle)])
            line = (box.min + box.max) / 2 + np.linspace(-1, 1, 41)[:, None] * along
            found[text.get_text(), box.bounds] = (box, line)

    monkeypatch.setattr(Text, "draw", seen)
    shown = turning(brick(), thrown(speed=speed, steps=steps), 2, 3, most=9)
    movie = _Movie([""], [Scene((shown,), (ORANGE,))], 320, (22.0, -55.0), ("white", False), title)
    found.clear()
    movie.frame(1)
    assert len(found) > 8
    page = movie.figure.bbox
    assert all(page.x0 <= box.x0 < box.x1 <= page.x1 and page.y0 <= box.y0 for box, _ in found.values())
    for one, other in itertools.combinations(found, 2):
        gaps = found[one][1][:, None] - found[other][1]
        assert np.min(np.linalg.norm(gaps, axis=-1)) > 4, (one, other)  # pixels, between the middles of two lines


@pytest.mark.sample(0)
def test_bodies_of_an_ensemble_are_told_apart():
    """A batch of bodies that travel, with masses of their own."""
    one: Any = brick().body
    moments = np.stack([one.moments, 2 * one.moments])
    bodies = ml.FreeBody(ml.RigidBody(moments), np.array([MASS, 2 * MASS]))
    start = jax.tree.map(lambda x: jnp.stack([x[0], x[0]]), thrown().states)
    path = ml.ensemble("JACOBI[EA]", bodies, GRAVITY, start, dt=0.05, steps=8, save_every=1)
    shown = panels(bodies, path)
    assert [panel.name for panel in shown] == ["body 0", "body 1"]
    assert [float(panel.body.mass) for panel in shown] == [MASS, 2 * MASS]
    ml.plot.view(bodies, path, frames=3)


def test_a_track_is_the_positions_on_one_scale_in_the_plane_where_it_is_longest():
    path = thrown()
    axes = axes_of()
    positions = ml.plot.track(axes, path, label="a brick")
    np.testing.assert_array_equal(positions, path.states.position)
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), positions[:, [0, 2]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x  [length]", "z  [length]")
    side = path._replace(states=ml.FreeState.made(path.states.turning, path.states.linear, positions[:, [1, 0, 2]]))
    ml.plot.track(axes, side)  # longest in yz, but drawn in the plane of the first
    np.testing.assert_array_equal(axes.lines[2].get_xydata(), positions[:, [1, 2]])
    solid = axes_of(projection="3d")
    ml.plot.track(solid, path)
    ml.plot.track(solid, side, label="aside")
    limits = np.array([solid.get_xlim(), solid.get_ylim(), solid.get_zlim()])
    spans = np.ptp(limits, axis=1)
    np.testing.assert_allclose(solid.get_box_aspect() / spans, (solid.get_box_aspect() / spans)[0])
    both = np.concatenate([positions, positions[:, [1, 0, 2]]])
    assert np.all((both > limits[:, 0]) & (both < limits[:, 1]))


MU = ml.torques.PointMass(1.0)
FLAT = ml.torques.Oblateness(1.0, 0.5, 0.1, [0.6, 0.0, 0.8])
OTHER = ml.torques.Oblateness(1.0, 0.5, 0.1, [0.0, 0.6, 0.8])
UP = ml.torques.HeavyTop(0.5)
FORCES = {
    "none": (None, "total angular momentum", True),
    "gravity": (GRAVITY, "total momentum along gravity", False),
    "point mass": (MU, "total angular momentum", False),
    "oblate": (MU + FLAT, "total momentum along the pole", False),
    "torque alone": (UP, "vertical total momentum", True),
    "dipole": (ml.torques.DipoleInField([0.1, 0.0, 0.3], [1.0, 2.0, 0.0]), "total momentum along the field", True),
    "gravity and torque": (GRAVITY + UP, "total momentum along gravity", False),
    "gravity and point mass": (GRAVITY + MU, "total momentum along gravity", False),
    "gravity across": (ml.torques.UniformGravity([1.0, 0.0, 0.0]) + UP, None, False),
    "thrust": (ml.spacecraft.Thrust([0.1, 0.0, 0.0], [0.0, 0.1, 0.0]), ValueError, False),
    "drag": (ml.torques.Drag([0.0, 0.0, 0.1], 0.1, 1.0), ValueError, False),
}


@pytest.mark.sample(2)
@pytest.mark.parametrize(("torque", "momentum", "linear"), FORCES.values(), ids=FORCES.keys())
def test_what_is_said_to_be_conserved_is_conserved(torque, momentum, linear):
    """The methods conserve the momenta that the exact motion does, up to rounding."""
    body = brick()
    start = ml.FreeState(body.momentum(jnp.array([0.5, 2.0, 0.3])), UPRIGHT, [0.5, 3.0, 1.5], [1.5, 0.2, -0.3])
    path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
    if momentum is ValueError:
        with pytest.raises(ValueError, match="nothing is conserved"):
            ml.plot.conserved(axes_of(), body, torque, path)
        return
    axes = axes_of()
    found = ml.plot.conserved(axes, body, torque, path)
    assert np.max(np.abs(found.energy)) < 1e-3
    assert (found.linear is not None, found.momentum is not None) == (linear, momentum is not None)
    for errors in (found.momentum, found.linear):
        assert errors is None or np.max(errors) < 1e-12
    names = {line.get_label() for line in axes.lines if line.get_linewidth() == 2.0}
    assert names == {"energy"} | ({momentum} if momentum else set()) | ({"linear momentum"} if linear else set())


def test_a_sum_of_forces_keeps_what_each_of_them_keeps():
    for torque in (MU + FLAT + OTHER, GRAVITY + FLAT, MU + ml.spacecraft.Thrust([0.1, 0.0, 0.0], [0.0, 0.1, 0.0])):
        assert kept_by(torque) is None
        assert kept_by(torque + torque) is None
    assert kept_by(MU + MU) == kept_by(None)
    both: Any = kept_by(FLAT + MU + FLAT)
    assert both.which == "component along the pole"


def test_an_axis_keeps_what_a_body_with_an_attitude_keeps(cases):
    found = ml.plot.conserved(axes_of(), *cases["AxisState"])
    assert np.max(found.momentum) < 1e-13
    start = jax.tree.map(lambda x: x[0], cases["AxisState"][2].states)
    free = ml.integrate("SYMMETRIC[EA]", ROTOR, None, start, dt=0.1, steps=9)
    assert np.max(ml.plot.conserved(axes_of(), ROTOR, None, free).momentum) < 1e-13


def test_crossings_of_a_place():
    """A ball thrown upwards falls through its first height after 2 v / g."""
    path = thrown()

    def above(t, state):
        return state.position[2] - 1.5

    found = ml.plot.poincare(axes_of(), path, above, lambda t, s: s.position[0], height, direction=-1)
    fall = (8 + np.sqrt(64 - 2 * 9.81 * 0.5)) / 9.81
    np.testing.assert_allclose(found.times, [fall], atol=1e-9)
    np.testing.assert_allclose(found.points[0, 0], 8 * fall, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.states.attitude, axis=1), 1, atol=1e-12)


@pytest.mark.sample(0)
@pytest.mark.parametrize("ending", ["npz", "zarr"])
@pytest.mark.parametrize("kind", ["AxisState", "FreeState", "FreeAxisState"])
def test_a_saved_run_is_read_and_shown(cases, tmp_path, kind, ending):
    body, torque, path = cases[kind]
    method = "JACOBI[EA]" if kind == "FreeState" else "SYMMETRIC[EA]"
    starts = jax.tree.map(lambda x: jnp.stack([x[0], x[1]]), path.states)
    file = tmp_path / f"run.{ending}"
    ml.simulate(method, body, torque, starts, out=file, dt=0.02, steps=8, save_every=1, progress=False)
    found = saved_path(file, 0)
    assert type(found.path.states) is type(path.states)
    for one, other in zip(jax.tree.leaves(found.path.states), jax.tree.leaves(path.states), strict=True):
        np.testing.assert_allclose(one, other[:9], atol=1e-12)
    assert jax.tree.structure(found.body) == jax.tree.structure(body)
    for one, other in zip(jax.tree.leaves(found.body), jax.tree.leaves(body), strict=True):
        np.testing.assert_allclose(one, other)
    assert said(0, "view", file, "--body", 0, 1, "--out", tmp_path / "view.html").endswith("MB)\n")
    columns = said(0, "export", file).splitlines()[0]
    assert ("axis_x" in columns) == ("Axis" in kind)
    assert ("position_x" in columns) == ("Free" in kind)


@pytest.mark.sample(0)
def test_a_saved_run_without_places_is_refused(cases, tmp_path):
    body, torque, path = cases["FreeState"]
    starts = jax.tree.map(lambda x: x[:2], path.states)

    def momentum(t, state):
        return {"momentum": state.momentum}

    file, timing = tmp_path / "run.npz", {"dt": 0.02, "steps": 4, "save_every": 1}
    ml.simulate("JACOBI[EA]", body, torque, starts, out=file, observe=momentum, progress=False, **timing)
    with pytest.raises(ValueError, match="holds no attitude and no linear and no position; it must be a run of FreeSt"):
        saved_path(file)


def said(code, *arguments):
    """What the command writes, if it ends with this code."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        assert main([*map(str, arguments)]) == code, out.getvalue()
    return out.getvalue()
