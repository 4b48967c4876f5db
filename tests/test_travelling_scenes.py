"""The scenes whose bodies travel, and that of an axis: laws, published numbers, and what the command makes of them.

Each run of the command costs a compilation, so one run of a scene serves all its laws.
"""

import contextlib
import csv
import io
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import worst

import midlie_jax as ml
from midlie_jax.cli import convergence, scenes
from midlie_jax.cli.main import main
from midlie_jax.cli.moving_scenes import Blades
from midlie_jax.simulation.saved import saved_path

NAMES = ["thrown-brick", "dropped-brick", "boomerang", "satellite", "spherical-pendulum"]
TRAVELLING = NAMES[:-1]


def midlie(*arguments) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(map(str, arguments)))
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """What the command says about a scene, by its left column, and the file that it writes; two bodies."""
    folder = tmp_path_factory.mktemp("runs")

    @cache
    def made(name):
        path = folder / f"{name}.npz"
        code, out, err = midlie("run", name, "--bodies", 2, "--out", path)
        assert code == 0, err
        pairs = (line.strip().split("  ", 1) for line in out.splitlines()[1:] if "  " in line.strip())
        return {key: value.strip() for key, value in pairs}, path

    return made


def number(said: str) -> float:
    return float(said.split()[0])


ENERGY = {"thrown-brick": 1e-13, "dropped-brick": 1e-11, "satellite": 1e-6, "spherical-pendulum": 5e-4}


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", NAMES)
def test_a_scene_runs_with_its_method_and_keeps_what_it_should(run, name):
    said, _ = run(name)
    assert said["ok"] == "yes"
    if name in ENERGY:
        assert number(said["energy error, largest relative"]) < ENERGY[name]
        assert number(said["momentum error, largest relative"]) < 1e-13
    else:
        assert said["energy error, largest relative"] == "not defined: Blades has no potential energy"
        assert said["momentum error, largest relative"].startswith("not conserved")
    if name == "thrown-brick":
        assert said["place at the end"] == "30, 0, 5"
        assert number(said["place error, largest relative"]) < 1e-13
        assert number(said["linear momentum error, largest relative"]) == 0
    elif name in TRAVELLING:
        assert said["linear momentum error, largest relative"].startswith("not conserved")
    assert ("place at the end" in said) == (name in TRAVELLING)
    assert ("axis at the end" in said) == (name not in TRAVELLING)


@cache
def path_of(name, method, steps, keep=60, pick=None):
    """The path of a scene; with `pick`, under that term of its torque alone."""
    scene = scenes.scene(name)
    torque = scene.torque if pick is None else scene.torque.terms[pick]

    def integrated(start):
        options = {"dt": scene.duration / steps, "steps": steps, "save_every": steps // keep}
        return ml.integrate(method, scene.body, torque, start, **options)

    path = jax.jit(integrated)(scene.start)
    assert path.ok
    return path


# (time, longitude in deg), NESC's simulation 04; simulation 01 differs from it by 2e-12 at most.
LONGITUDES = [(10, 2.12654133805e-6), (20, 1.70166180963e-5), (30, 5.74552213287e-5)]


@pytest.mark.sample(0)
@pytest.mark.parametrize(("time", "longitude"), LONGITUDES)
def test_published_places_of_the_dropped_brick(time, longitude):
    path = path_of("dropped-brick", "JACOBI[SRKN6b]", 600)
    north, east, down = np.asarray(path.states.position)[2 * time]
    assert path.times[2 * time] == pytest.approx(time)
    assert north == 0
    assert abs(np.rad2deg(np.arctan2(east, -down) - 7.292115e-5 * time) - longitude) < 2e-13


@pytest.mark.sample(0)
def test_published_rates_of_the_dropped_brick():
    path = path_of("dropped-brick", "JACOBI[SRKN6b]", 600)
    rates = np.rad2deg(path.states.momentum[-1] / scenes.scene("dropped-brick").body.body.moments)
    assert worst(rates, (12.6183907757, -17.3974747619, 31.1195888868)) < 3.3e-10


@pytest.mark.sample(0)
def test_published_rates_of_the_satellite_without_oblateness():
    """The orbit is then the ellipse of the published case; the body is so small that it does not change it."""
    path = path_of("satellite", "JACOBI[SRKN6b]", 2880, pick=0)
    rates = np.asarray(path.states.momentum[-1] / scenes.scene("satellite").body.body.moments)
    assert worst(rates, (-1.97989570839746e-5, -0.001080027400090759, -0.0007098670173048437)) < 2.3e-13


@pytest.mark.sample(0)
def test_the_node_of_the_satellite_turns_as_oblateness_turns_it():
    """By -3/2 n J2 (radius/a)^2 cos i; what J2 does within a revolution averages out in the fit."""
    scene, path = scenes.scene("satellite"), path_of("satellite", "JACOBI[SRKN6b]", 2880, 480)
    planet = scene.torque.terms[1]
    x, v = np.asarray(path.states.position), np.asarray(path.states.linear) / 1000
    L = np.cross(x, v)
    node = np.unwrap(np.arctan2(L[:, 0], -L[:, 1]))
    mu = float(planet.mu)
    a = np.mean(1 / (2 / np.linalg.norm(x, axis=1) - np.sum(v**2, axis=1) / mu))
    cosine = np.mean(L[:, 2] / np.linalg.norm(L, axis=1))
    expected = -1.5 * np.sqrt(mu / a**3) * float(planet.j2) * (float(planet.radius) / a) ** 2 * cosine
    assert np.polyfit(np.asarray(path.times), node, 1)[0] == pytest.approx(expected, rel=0.03)


def test_the_pendulum_swings_between_the_heights_that_its_energy_allows():
    scene, path = (
        scenes.scene("spherical-pendulum"),
        path_of("spherical-pendulum", "SYMMETRIC[SRKN6b]", 2000, 2000),
    )
    axis, momentum = np.asarray(path.states.axis), np.asarray(path.states.momentum)
    start, weight = scene.start, float(scene.torque.mgl)
    energy, vertical = float(ml.observe.energy(scene.body, scene.torque, start)), float(start.momentum[2])
    # 2 (E - w z)(1 - z^2) = pi_z^2, for a moment of 1
    roots = np.sort(np.roots([2 * weight, -2 * energy, -2 * weight, 2 * energy - vertical**2]).real)
    assert axis[:, 2].min() == pytest.approx(roots[0], abs=1e-4)  # between two states
    assert axis[:, 2].max() == pytest.approx(roots[1], abs=1e-6)
    assert worst(np.sum(axis * momentum, axis=1), 0.0) < 1e-13
    assert worst(np.linalg.norm(axis, axis=1), 1.0) < 1e-15


@pytest.mark.sample(0)
def test_the_boomerang_turns_left_loses_energy_and_comes_back():
    scene, path = scenes.scene("boomerang"), path_of("boomerang", "JACOBI[EA]", 2000, 50)
    place = np.asarray(path.states.position)
    away = np.linalg.norm(place - place[0], axis=1)
    assert away.max() > 12
    assert away[-1] < 5
    assert place[1:, 1].min() > 0
    assert place[:, 2].min() > 0
    fall = ml.torques.UniformGravity(jnp.array([0.0, 0.0, -9.81]))
    energies = np.asarray(ml.observe.energy(scene.body, fall, path))
    assert energies[-1] < 0.6 * energies[0]


def test_blades_are_the_mean_of_their_pieces():
    """Over a turn and along a blade, by quadrature; the integrands are polynomials and trigonometric polynomials."""
    scene, random = scenes.scene("boomerang"), np.random.default_rng(1)
    blades = Blades(*map(jnp.asarray, (0.02, 0.3, 0.7, 3.0, 0.05)))
    a, lift, slope, drag = 0.3, 0.7, 3.0, 0.05
    moments, mass = np.asarray(scene.body.body.moments), 0.1
    turn, velocity = random.standard_normal(3) * [5, 5, 90], random.standard_normal(3) * 10
    attitude = random.standard_normal(4)
    attitude /= np.linalg.norm(attitude)
    R = np.asarray(ml.so3.to_matrix(jnp.asarray(attitude)))
    state = ml.FreeState(*map(jnp.asarray, (moments * turn, attitude, mass * velocity, np.zeros(3))))
    found = blades.on(scene.body)(0.0, state)
    v, n = R.T @ velocity, np.array([0.0, 0.0, 1.0])
    nodes, weights = np.polynomial.legendre.leggauss(6)
    force, torque = np.zeros(3), np.zeros(3)
    for angle in np.arange(12) * np.pi / 6:
        arm = np.array([np.cos(angle), np.sin(angle), 0.0])
        ahead = np.cross(n, arm)
        for r, w in zip((nodes + 1) * a / 2, weights * a / 2 / 12, strict=True):
            U, W = turn[2] * r + v @ ahead, v @ n + r * np.cross(turn, arm) @ n
            piece = 0.02 / a * w * (U * (lift * U - slope * W) * n - drag * U**2 * ahead)
            force, torque = force + piece, torque + np.cross(r * arm, piece)
    np.testing.assert_allclose(found.torque, torque, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.force, R @ force, rtol=1e-12)


@pytest.mark.sample(0)
def test_a_ball_that_falls_in_air_reaches_its_terminal_speed():
    """v = v_t tanh(g t / v_t), with v_t^2 = 2 m g / (density area)."""
    mass, g, density, area = 0.5, 9.81, 1.2, 0.05
    ball = ml.FreeBody(ml.RigidBody([1e-3] * 3), mass)
    air = ml.torques.Drag([0.0, 0.0, 0.0], area, density) + ml.torques.UniformGravity([0.0, 0.0, -g])
    start = ml.FreeState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    path = ml.integrate("GBS12", ball, air, start, dt=0.05, steps=200, save_every=10)
    terminal = np.sqrt(2 * mass * g / (density * area))
    speed = -np.asarray(path.states.linear)[:, 2] / mass
    np.testing.assert_allclose(speed, terminal * np.tanh(g * np.asarray(path.times) / terminal), atol=1e-12)
    assert speed[-1] == pytest.approx(terminal, rel=1e-4)


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", NAMES)
def test_perturbed_copies_are_of_the_kind_of_the_start(name):
    scene, size = scenes.scene(name), 1e-3
    copies = scenes.perturbed(scene, 1000, size, seed=2)
    assert type(copies) is type(scene.start)
    for many, one in zip(jax.tree.leaves(copies), jax.tree.leaves(scene.start), strict=True):
        assert jnp.array_equal(many[0], one)
    if name == "spherical-pendulum":
        assert worst(jnp.sum(copies.axis * copies.momentum, axis=-1), 0.0) < 1e-15
        assert worst(jnp.linalg.norm(copies.axis, axis=-1), 1.0) < 1e-15
        return
    scale = float(jnp.linalg.norm(scene.start.linear))
    turn = float(jnp.linalg.norm(scene.body.velocity(scene.start.momentum)))
    for name, unit in (("linear", scale), ("position", scale / float(scene.body.mass) / turn)):
        pushes = np.asarray(getattr(copies, name) - getattr(scene.start, name)[None])[1:] / unit
        assert abs(pushes.std() / size - 1) < 0.05


@pytest.mark.sample(0)
def test_a_file_gives_back_the_body_that_travels(run):
    _, file = run("satellite")
    saved, scene = saved_path(file, 1), scenes.scene("satellite")
    assert isinstance(saved.body, ml.FreeBody)
    assert saved.body.mass == 1000
    start = jax.tree.map(lambda x: x[1], scenes.perturbed(scene, 2, 1e-3))
    assert jax.tree.all(jax.tree.map(lambda a, b: jnp.array_equal(a[0], b), saved.path.states, start))
    code, out, err = midlie("export", file, "--body", 1)
    rows = list(csv.DictReader(io.StringIO(out)))
    assert code == 0, err
    assert list(rows[0])[-3:] == ["position_x", "position_y", "position_z"]
    assert float(rows[-1]["position_z"]) == saved.path.states.position[-1, 2]


@pytest.mark.sample(0)
def test_a_file_gives_back_the_axis(run):
    _, file = run("spherical-pendulum")
    saved = saved_path(file)
    assert isinstance(saved.body, ml.SymmetricRotor)
    assert isinstance(saved.path.states, ml.AxisState)
    _, out, _ = midlie("export", file)
    assert out.splitlines()[0] == "time,axis_x,axis_y,axis_z"
    code, _, err = midlie("export", file, "--euler", "ZYX")
    assert (code, err.count("\n")) == (2, 1)
    assert "holds only the axis of a body, without an angle about it" in err


@pytest.mark.sample(0)
def test_a_table_names_the_columns_of_the_state(tmp_path):
    path = tmp_path / "run.csv"
    assert midlie("run", "spherical-pendulum", "--steps", 3, "--out", path)[0] == 0
    heads = path.read_text().splitlines()[0].split(",")
    assert heads == [*("body", "time"), *(f"{n}_{x}" for n in ("momentum", "axis") for x in "xyz"), "ok"]


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["thrown-brick", "spherical-pendulum"])
def test_a_store_says_what_it_holds_and_is_drawn(name, tmp_path):
    zarr = pytest.importorskip("zarr")
    store, png = tmp_path / "run.zarr", tmp_path / "run.png"
    code, _, err = midlie("run", name, "--bodies", 3, "--steps", 20, "--out", store)
    assert code == 0, err
    root = zarr.open_group(str(store), mode="r")
    for field, (dims, about) in type(scenes.scene(name).start).described().items():
        assert root[field].metadata.dimension_names == ("body", "time", *dims)
        assert root[field].attrs["units"] == about["units"]
    code, out, err = midlie("inspect", store, "--plot", png)
    assert code == 0, err
    assert "momentum error, largest relative, of all bodies" in out
    assert ("linear momentum error" in out) == (name in TRAVELLING)
    assert png.read_bytes().startswith(b"\x89PNG")
    saved = saved_path(store, 2)
    assert type(saved.body) is type(scenes.scene(name).body)
    assert type(saved.path.states) is type(scenes.scene(name).start)


@pytest.mark.sample(0)
def test_a_flight_has_its_path_on_the_chart():
    from midlie_jax.cli.record import Record
    from midlie_jax.cli.run_chart import run_figure

    scene = scenes.scene("thrown-brick")
    path = jax.tree.map(lambda x: jnp.asarray(x)[None], path_of("thrown-brick", "JACOBI[EA]", 400, 50))
    figure = run_figure(Record.of(scene, "JACOBI[EA]", 0.005, 400, 0.0, 0, path))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert "Path of the centre of mass, seen along y" in titles
    assert "Error of the linear momentum" in titles


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        *(
            (
                ["run", "spherical-pendulum", "--method", method],
                [f"method {method!r} moves RigidBody", "body is SymmetricRotor"],
            )
            for method in ("JACOBI[EA]", "AKW", "SW", "NMB", "PGBS12")
        ),
        (["run", "boomerang", "--method", "AKW"], ["'AKW' moves RigidBody", "FreeBody"]),
        (["run", "thrown-brick", "--method", "SYMMETRIC[EA]"], ["needs bodies with two equal moments"]),
        (["chart", "spherical-pendulum", "--methods", "AKW"], ["'AKW' does not support a SymmetricRotor"]),
        (["stability", "boomerang"], ["needs a rigid body without translation", "'boomerang' is a FreeBody"]),
        (["stability", "spherical-pendulum"], ["'spherical-pendulum' is a SymmetricRotor"]),
    ],
)
def test_what_cannot_be_is_said_in_one_line(arguments, words):
    code, _, err = midlie(*arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert all(word in err for word in words), err


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("name", "method", "source"),
    [
        ("spherical-pendulum", "SYMMETRIC[EA]", "Taylor series"),
        ("thrown-brick", "LIEMID[EA]", "Taylor series in 30 digits, and the parabola"),
        ("boomerang", "SYMMETRIC[EA]", "solution by GBS12"),
    ],
)
def test_errors_are_measured_against_an_end_that_is_known(name, method, source):
    scene = scenes.scene(name)
    rungs = [400, 800]
    reference = convergence.find_reference(scene, rungs[-1])
    assert source in reference.source
    assert reference.uncertainty < 1e-11
    coarse, fine = convergence.measure(scene, [method], rungs, reference)
    assert fine.ok
    assert fine.attitude_slope == pytest.approx(2, abs=0.15)
    if name == "thrown-brick":
        assert fine.position_error < 1e-11
    elif name == "boomerang":
        assert coarse.position_error / fine.position_error == pytest.approx(4, rel=0.1)
    else:
        assert np.isnan(fine.position_error)


def test_the_scenes_are_described_with_their_mass_and_place():
    code, out, err = midlie("scenes", "satellite", "spherical-pendulum")
    assert code == 0, err
    assert all(text in out for text in ("mass", "1000.", "position at the start", "PointMass(mu", "+ Oblateness(mu"))
    assert all(text in out for text in ("moment across the axis", "axis at the start", "SYMMETRIC[EA]"))
