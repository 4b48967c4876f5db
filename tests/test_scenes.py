"""The scenes: published ends and laws of each, the paper's table of errors, and the commands that take any scene."""

import csv
import io
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import half_last_digit, midlie, worst
from laboratory.free_body import free_body

import midlie_jax as ml
from midlie_jax.cli import convergence, scenes
from midlie_jax.cli.oracle import exact_motion
from midlie_jax.cli.scene_forces import Blades
from midlie_jax.model.torques import on_body
from midlie_jax.simulation.saved import saved_path

EXACT = "JACOBI[SRKN14a]"  # to rounding in a thousand steps, free bodies in a hundred


def end_of(name: str, steps: int, duration: float | None = None, method: str = EXACT, pick: int | None = None):
    """Body and state at the end of a scene; with `pick`, under that term of its torque alone."""
    scene = scenes.scene(name)
    torque = scene.torque if pick is None else scene.torque.terms[pick]
    dt = (duration or scene.duration) / steps
    path = ml.integrate(method, scene.body, torque, scene.start, dt=dt, steps=steps, save_every=steps)
    assert path.ok
    return scene.body, jax.tree.map(lambda x: x[-1], path.states)


P1_MOMENTUM = (-0.153091997209136, 0.143264870866601, 50.0)
P1_ROTATION = (
    (-0.880353208246793, 0.471971165950715, -0.0471322314419819),
    (-0.473439184662768, -0.880420266806675, 0.0267486863587099),
    (-0.0288715630929733, 0.0458625370775063, 0.998530450480797),
)
# (scene, steps, duration, published momentum, published column of R, its number). The spin turns P1 by 500 rad and P2
# by 787 rad, so its rounding is that much larger in the angle. The published column of P2 is 1e-13 too short.
ENDS = [
    ("free-asymmetric", 100, 10.0, (1.76596250851821, -0.695464197033089, 0.779554981481871), (), 2),
    ("P1", 1000, 10.0, P1_MOMENTUM, [row[2] for row in P1_ROTATION], 2),
    ("P1-tilted", 1000, 10.0, (-0.825255618261498, 0.772281645922085, 50.0),
     (-0.274864608390022, 0.154741521010720, 0.948949160245105), 2),
    ("P2", 1000, 0.8, (0.001294760157796, 0.008576777914099, 1.376331238882863),
     (0.055504854936289, 0.004308103862570, 0.998449123050047), 2),
    ("bruls-cardona", 1000, 2.0, np.array([0.1222332194973833, 150.0, -5.855624589205458]) * [15.234375, 0.46875,
     15.234375], (-0.150416822745643, -0.724165591636897, -0.673022269560442), 1),
]  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "steps", "duration", "momentum", "column", "which"), ENDS)
def test_published_ends(name, steps, duration, momentum, column, which):
    _, end = end_of(name, steps, duration)
    size = np.linalg.norm(end.momentum)
    assert not len(momentum) or worst(end.momentum, momentum) < 2e-13 * max(size, 1)
    assert not len(column) or worst(ml.so3.to_matrix(end.attitude)[:, which], column) < 1e-12
    if name == "P1-tilted":
        scene = scenes.scene(name)
        assert abs(ml.observe.energy(scene.body, scene.torque, scene.start) - 1269.10672978251) < 5e-12


RATES_OF_RUN_10A = (-1.97989570839746e-5, -0.001080027400090759, -0.0007098670173048437)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "pick"), [("gravity-gradient", None), ("satellite", 0)])
def test_published_rates_of_the_satellite(name, pick):
    """On a known orbit, and with the orbit integrated, without oblateness; as far as NASA agrees with others."""
    body, end = end_of(name, 288, pick=pick)
    assert worst(body.turning.velocity(end.momentum), RATES_OF_RUN_10A) < 2.3e-13


@pytest.mark.sample(0)
def test_published_rates_of_the_pulsed_body():
    """Of second order at the switches, so extrapolated; others agree to 2e-16, about the rounding of one run."""
    scene = scenes.scene("pulsed-body")
    momentum = convergence.find_reference(scene, 1440).momentum
    rates = (-0.0007282187220568775, -0.0008332384627087039, -0.0002424925044840342)
    assert worst(np.asarray(scene.axes) @ (momentum / np.asarray(scene.body.moments)), rates) < 4e-16


# After 30 s: rates in deg/s; yaw, pitch and roll in deg; longitude in deg. NESC's simulation 01, and its 04.
RATES = (12.6183907757, -17.3974747619, 31.1195888868)
ANGLES, LONGITUDE = (-4.289355039311268, -3.81965492049295, -56.151307596646866), 5.74552194388e-5
DROPPED = 5.74552213287e-5
TURN = 7.292115e-5  # of the Earth, rad/s


def north_east_down(angle: float) -> np.ndarray:
    """The local axes, as columns, over the equator at an angle from the inertial x axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[0.0, -s, -c], [0.0, c, -s], [1.0, 0.0, 0.0]])


@pytest.mark.sample(0)
def test_published_bricks():
    """The tumbling brick in free fall, and dropped; as far as NASA's runs agree with others."""
    time = 30
    body, end = end_of("tumbling-brick", 100, float(time))
    local = north_east_down(np.deg2rad(LONGITUDE) + TURN * time)
    R = local.T @ north_east_down(0.0) @ np.asarray(ml.so3.to_matrix(end.attitude))
    euler = np.arctan2(R[1, 0], R[0, 0]), -np.arcsin(R[2, 0]), np.arctan2(R[2, 1], R[2, 2])
    assert worst(np.rad2deg(body.velocity(end.momentum)), RATES) < 3.3e-10
    assert worst(np.rad2deg(euler), ANGLES) < 5.6e-9
    body, end = end_of("dropped-brick", 20 * time, float(time), "JACOBI[SRKN6b]")
    north, east, down = np.asarray(end.position)
    assert north == 0
    assert abs(np.rad2deg(np.arctan2(east, -down) - TURN * time) - DROPPED) < 2e-13
    assert worst(np.rad2deg(body.body.velocity(end.momentum)), RATES) < 3.3e-10


# Both pass close to an unstable motion again and again, and each time what was lost to rounding grows a hundredfold.
@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "steps", "tolerance"), [("slow-top", 2000, 2e-8), ("dzhanibekov", 1000, 1e-8)])
def test_unpublished_scenes_match_the_closed_form(name, steps, tolerance):
    body, end = end_of(name, steps)
    scene = scenes.scene(name)
    given = body.moments, scene.start.momentum, scene.start.attitude, [scene.duration]
    momenta, attitudes = exact_motion(*given, weight=20.0) if scene.torque else free_body(*given)
    assert worst(end.momentum, momenta[0]) < tolerance
    assert worst(ml.so3.to_matrix(end.attitude), ml.so3.to_matrix(jnp.asarray(attitudes[0]))) < tolerance


@pytest.mark.sample(0)
def test_known_ends_of_coupled_bodies():
    """The binary to 128-bit arithmetic, and two waters where three programs agree."""
    _, end = end_of("binary-asteroid", 120, 7200.0, "JACOBI[SRKN6b]")
    way = end.position[1] - end.position[0]
    np.testing.assert_allclose(way, [610.415138187088, 1051.62642461140, -0.228068483136136], atol=1e-6)
    _, end = end_of("dimer", 2000, 1.0, "JACOBI[SRKN6b]")
    np.testing.assert_allclose(end.position[1], [0.26902629, -0.07283731, 0.05932941], atol=3e-8)
    np.testing.assert_allclose(end.attitude[1], [0.00491685, 0.90134910, 0.41820523, 0.11247224], atol=3e-7)


STEPS = (0.02, 0.01, 0.005, 0.0025)
# |error of Pi|, |error of R| on P1 at T = 10 for the four steps, to two digits.
ERRORS = {
    "LIEMID[E1]": "2.0e-1/5.7e-3  6.5e-2/1.9e-3  1.9e-2/5.4e-4  6.0e-3/1.7e-4",
    "LIEMID[E2]": "1.7e-1/4.8e-3  4.4e-2/1.3e-3  8.8e-3/2.5e-4  1.2e-3/3.6e-5",
    "LIEMID[EA]": "5.4e-2/1.6e-3  1.4e-2/4.0e-4  3.4e-3/1.0e-4  8.5e-4/2.5e-5",
    "LIEMID[I]": "1.9e-1/5.1e-3  5.6e-2/1.5e-3  1.4e-2/3.9e-4  3.5e-3/9.7e-5",
    "SW": "4.8e-2/4.2e-3  2.2e-1/6.1e-3  8.2e-2/2.3e-3  2.1e-2/5.9e-4",
    "AKW": "2.9e-1/1.8e+0  2.4e-1/2.7e+0  3.5e-1/2.7e+0  1.0e-1/9.0e-1",
    "NMB": "2.3e-1/8.0e-2  1.1e-1/2.7e-2  1.4e-1/7.1e-3  3.7e-2/1.2e-3",
}


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ERRORS)
def test_the_table_of_errors(name):
    """Only the finest of the four runs ends at T = 10; the others go beyond."""
    scene = scenes.scene("P1")

    def run(dt):
        return ml.integrate(name, scene.body, scene.torque, scene.start, dt=dt, steps=4000)

    path = jax.jit(jax.vmap(run))(jnp.array(STEPS))
    assert path.ok.all()
    rows, last = np.arange(len(STEPS)), np.rint(10 / np.array(STEPS)).astype(int)
    momenta = np.asarray(path.states.momentum)[rows, last]
    rotations = np.asarray(ml.so3.to_matrix(path.states.attitude[rows, last]))
    of_momenta = np.linalg.norm(momenta - P1_MOMENTUM, axis=-1)
    of_rotations = np.linalg.norm(rotations - np.array(P1_ROTATION), axis=(1, 2))
    for errors, pair in zip(np.transpose([of_momenta, of_rotations]), ERRORS[name].split(), strict=True):
        for error, text in zip(errors, pair.split("/"), strict=True):
            assert abs(error - float(text)) < 0.1 * float(text) + half_last_digit(text)


def test_an_unknown_scene_names_all():
    with pytest.raises(ValueError, match=r"unknown scene 'P3'; choose from P1, .*drift-test\.") as error:
        scenes.scene("P3")
    assert all(name in str(error.value) for name in scenes.scenes())


@pytest.mark.sample(8)
@pytest.mark.parametrize("name", scenes.scenes())
def test_a_scene_is_whole(name):
    dtype = "float32"
    scene = scenes.scene(name, dtype)
    assert scene.name == name
    assert all(text and "\n" not in text for text in (scene.title, scene.source, scene.units))
    arrays = jax.tree.leaves((scene.body, scene.torque, scene.start, scene.axes))
    # A default, such as the pole of an oblate planet, is weakly typed: it takes the dtype of what it meets.
    assert {leaf.dtype for leaf in arrays if not leaf.weak_type} == {jnp.dtype(dtype)}
    assert abs(scene.steps * scene.dt / scene.duration - 1) < 1e-12
    if scene.torque is not None:
        torque = on_body(scene.torque, scene.body)(jnp.zeros((), dtype), scene.start)
        for part in jax.tree.leaves(torque):  # of a body that travels, the torque and the force
            assert part.shape == scene.start.momentum.shape
            assert part.dtype == scene.start.momentum.dtype
            assert jnp.isfinite(part).all()


def test_the_dtype_follows_jax():
    with jax.enable_x64(False):
        assert scenes.scene("P1").start.momentum.dtype == jnp.float32
        with pytest.raises(ValueError, match="float64 is off; turn it on"):
            scenes.scene("P1", "float64")
    with pytest.raises(ValueError, match="must be floating point, got int32"):
        scenes.scene("P1", jnp.int32)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_pulse_is_halved_at_its_switches_however_time_rounds(dtype):
    pulse = scenes.Pulse(jnp.ones(3, dtype), 1000.0, 2000.0)
    k = np.arange(1, 40)[:, None]
    n = jnp.asarray(np.hstack([5 * k - 1, 5 * k, 5 * k + 1, 10 * k - 1, 10 * k, 10 * k + 1]), dtype)
    found = jax.vmap(jax.vmap(pulse))(n * jnp.asarray(200 / k, dtype))
    np.testing.assert_array_equal(found[..., 0], np.tile([0.0, 0.5, 1.0, 1.0, 0.5, 0.0], (39, 1)))


def test_blades_are_the_mean_of_their_pieces():
    """Over a turn and along a blade, by quadrature; the integrands are polynomials and trigonometric polynomials."""
    scene, random = scenes.scene("boomerang"), np.random.default_rng(1)
    a, lift, slope, drag = 0.3, 0.7, 3.0, 0.05
    turn, velocity = random.standard_normal(3) * [5, 5, 90], random.standard_normal(3) * 10
    attitude = np.array([0.5, -0.1, 0.7, -0.5])
    R = np.asarray(ml.so3.to_matrix(jnp.asarray(attitude)))
    state = ml.FreeState.from_velocity(scene.body, turn, attitude, velocity, np.zeros(3))
    found = Blades(*map(jnp.asarray, (0.02, a, lift, slope, drag))).on(scene.body)(0.0, state)
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


# ---- perturbed copies ----


@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "dtype"), [("thrown-brick", "float32"), ("spherical-pendulum", "float64")])
def test_perturbed_copies_are_of_the_kind_of_the_start_and_as_far_from_it_as_said(name, dtype):
    """5997 normal numbers know their deviation to a hundredth; their mean is within four of its deviations of zero."""
    scene, size = scenes.scene(name, dtype), 1e-3
    start, eps, copies = scene.start, float(jnp.finfo(dtype).eps), scenes.perturbed(scene, 2000, size, seed=3)
    for many, one in zip(jax.tree.leaves(copies), jax.tree.leaves(start), strict=True):
        assert (many.dtype, many.shape) == (one.dtype, (2000, *one.shape))
        assert jnp.array_equal(many[0], one)
    assert not jnp.array_equal(scenes.perturbed(scene, 2000, size, seed=4).momentum, copies.momentum)
    if isinstance(start, ml.AxisState):
        assert worst(jnp.sum(copies.axis * copies.momentum, axis=-1), 0.0) < 8 * eps
        return
    assert worst(jnp.linalg.norm(copies.attitude, axis=-1), 1.0) < 4 * eps
    scale = jnp.linalg.norm(start.linear)
    way = scale / scene.body.mass / jnp.linalg.norm(scene.body.velocity(start.momentum))
    for change in (
        (copies.momentum - start.momentum[None]) / jnp.linalg.norm(start.momentum),
        ml.so3.log(ml.so3.multiply(ml.so3.conjugate(start.attitude)[None], copies.attitude)),
        (copies.linear - start.linear[None]) / scale,
        (copies.position - start.position[None]) / way,
    ):
        assert np.std(np.asarray(change)[1:]) == pytest.approx(size, rel=0.04)
        assert abs(np.mean(np.asarray(change)[1:])) < 4 * size / np.sqrt(change.size)


def test_bad_numbers_of_copies_are_named():
    for count, size, message in ((0, 1e-3, "count must be"), (True, 1e-3, "count must be"), (2, -1.0, "size must be")):
        with pytest.raises(ValueError, match=message):
            scenes.perturbed(scenes.scene("P1"), count, size, 0)


# ---- the commands ----


def test_the_scenes_are_listed_and_described():
    outcome = midlie("scenes")
    assert [line.split()[0] for line in outcome.out.splitlines()[2:]] == scenes.scenes()
    told, scene = midlie("scenes", "P1", "satellite").out, scenes.scene("P1")
    assert all(text in told for text in (scene.title, scene.source, scene.units, f"{scene.steps} steps"))
    words = "position at the start", "PointMass(mu", "+ Oblateness(mu", "HeavyTop(mgl = 20., axis = [0., 0., 1.])"
    assert all(word in told for word in words)


STATES = {"spherical-pendulum": ml.AxisState, "binary-asteroid": ml.CoupledState}


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", STATES)
def test_every_command_takes_a_scene_of_each_kind(name, tmp_path):
    pytest.importorskip("zarr")
    scene, coupled = scenes.scene(name), STATES[name] is ml.CoupledState
    start = jax.tree.map(lambda x: x[1], scenes.perturbed(scene, 2, 1e-3))
    npz, store, png, table = (tmp_path / f"run.{ending}" for ending in ("npz", "zarr", "png", "csv"))
    run = ("run", name, "--bodies", 2, "--steps", 6, "--out")
    said = midlie(*run, npz, "--plot", png)
    assert said.facts["ok"] == "yes"
    assert ("2 perturbed copies" in said.out) == coupled
    assert midlie(*run, store).code == 0
    outcome = midlie("inspect", store, "--plot", tmp_path / "store.png")
    assert outcome.code == 0, outcome.err
    assert "momentum error, largest relative, of all bodies" in outcome.out
    assert "nan" not in outcome.out
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in (png, tmp_path / "store.png"))
    for file in (npz, store):
        saved = saved_path(file, 1)
        assert (type(saved.body), type(saved.path.states)) == (type(scene.body), STATES[name])
        assert jax.tree.all(jax.tree.map(jnp.array_equal, saved.body, scene.body))
        assert jax.tree.all(jax.tree.map(lambda a, b: jnp.array_equal(a[0], b), saved.path.states, start))
    for ending in ("html", "gif"):
        assert midlie("view", npz, "--body", 1, "--out", tmp_path / f"view.{ending}", "--frames", 3).code == 0
    outcome = midlie("export", npz, "--body", 1)
    if not coupled:
        assert "axis_x" in outcome.out
        assert "holds only the axis of a body, without an angle about it" in midlie("export", npz, "--euler", "ZYX").err
        return
    assert "coupled bodies, but export writes one" in outcome.err
    assert midlie(*run, table).code == 0
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert list(rows[0])[:4] == ["copy", "time", "body", "momentum_1"]
    assert [row["body"] for row in rows] == ["0", "1"] * 14


@pytest.mark.sample(0)
def test_a_store_gives_back_bodies_with_full_tensors(tmp_path):
    pytest.importorskip("zarr")
    scene = scenes.scene("dimer")
    turn = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.5, 0.9]))))
    tensors = np.einsum("ia,na,ja->nij", turn, np.asarray(scene.body.body.moments), turn)
    body = ml.FreeBody(ml.TensorBody(tensors), scene.body.mass)
    start = scenes.perturbed(scene, 2, 1e-3)
    ml.simulate("RK4", body, None, start, dt=scene.dt, steps=2, out=tmp_path / "run.zarr", save_every=1)
    found: Any = saved_path(tmp_path / "run.zarr", 1).body
    frames = np.asarray(ml.so3.to_matrix(found.body.frame))
    again = np.einsum("nia,na,nja->nij", frames, found.body.principal.moments, frames)
    np.testing.assert_allclose(again, tensors, rtol=0, atol=1e-14)


# ---- the references of a chart ----


@pytest.mark.sample(0)
def test_extrapolated_reference_is_as_good_as_it_says(monkeypatch):
    scene = scenes.scene("slow-top")
    exact = convergence.find_reference(scene, 1000)
    monkeypatch.setattr(convergence, "_exact", lambda scene: None)
    found = convergence.find_reference(scene, 1000)
    assert "extrapolation" in found.source
    assert found.uncertainty < 1e-6
    np.testing.assert_allclose(found.attitude, exact.attitude, atol=2 * found.uncertainty)


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
    (coarse, fine), _ = convergence.survey(scene, [method], rungs, reference)
    assert fine.attitude_slope == pytest.approx(2, abs=0.15)
    if name == "thrown-brick":
        assert fine.position_error < 1e-11
    elif name == "boomerang":
        assert coarse.position_error / fine.position_error == pytest.approx(4, rel=0.1)
