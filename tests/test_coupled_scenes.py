"""The scenes of coupled bodies: known ends and numbers, and every command that takes a scene or its file."""

import csv
import io
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_travelling_scenes import midlie

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.cli.moving_scenes import WATER
from midlie_jax.simulation.saved import saved_path

NAMES = ["binary-asteroid", "dimer", "rod"]


def end_of(name, method, steps, duration):
    scene = scenes.scene(name)
    path = ml.integrate(method, scene.body, scene.torque, scene.start, dt=duration / steps, steps=steps)
    assert bool(path.ok)
    return path.states


@pytest.mark.sample(0)
def test_the_binary_asteroid_ends_where_it_is_known_to():
    found = end_of("binary-asteroid", "JACOBI[SRKN6b]", 120, 7200.0)
    way = found.position[-1, 1] - found.position[-1, 0]
    np.testing.assert_allclose(way, [610.415138187088, 1051.62642461140, -0.228068483136136], atol=1e-6)
    attitude = [0.858263954806452, 0.0959138258149405, 0.00789540664457274, 0.504104338854018]
    np.testing.assert_allclose(found.attitude[-1, 1], attitude, atol=1e-9)


@pytest.mark.sample(0)
def test_the_two_waters_end_where_three_programs_agree():
    found = end_of("dimer", "JACOBI[SRKN6b]", 2000, 1.0)
    np.testing.assert_allclose(found.position[-1, 1], [0.26902629, -0.07283731, 0.05932941], atol=3e-8)
    attitude = [0.00491685, 0.90134910, 0.41820523, 0.11247224]
    np.testing.assert_allclose(found.attitude[-1, 1], attitude, atol=3e-7)


def test_the_energy_and_the_moments_of_water():
    scene = scenes.scene("dimer")
    potential = ml.observe.energy(scene.body, scene.torque, scene.start) - ml.observe.kinetic_energy(
        scene.body, scene.start
    )
    assert float(potential) == pytest.approx(-14.1713118855, rel=3e-9)  # its angle has ten digits
    np.testing.assert_allclose(WATER.moments, [0.00596800338, 0.01940800337, 0.01343999999], rtol=1e-7)


@pytest.mark.sample(0)
def test_copies_are_of_the_kind_of_the_start_and_near_it():
    for name in NAMES:
        scene = scenes.scene(name)
        copies = scenes.perturbed(scene, 3, 1e-3, seed=1)
        assert type(copies) is type(scene.start)
        for many, one in zip(jax.tree.leaves(copies), jax.tree.leaves(scene.start), strict=True):
            assert jnp.array_equal(many[0], one)
            assert many.shape == (3, *one.shape)
            assert 0 < float(jnp.abs(many[2] - one).max()) < 0.01 * float(jnp.abs(one).max())


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("dimer") / "run.npz"
    code, out, err = midlie("run", "dimer", "--steps", 30, "--bodies", 2, "--out", path)
    assert code == 0, err
    assert "2 perturbed copies of 2 coupled bodies" in out
    assert "place of body 1 at the end" in out
    return path


@pytest.mark.sample(0)
def test_a_file_gives_back_the_bodies(file):
    saved, scene = saved_path(file, 1), scenes.scene("dimer")
    body: Any = saved.body
    assert saved.bodies == 2
    assert isinstance(saved.path.states, ml.CoupledState)
    np.testing.assert_array_equal(body.body.moments, scene.body.body.moments)
    np.testing.assert_array_equal(body.mass, scene.body.mass)
    start = jax.tree.map(lambda x: x[1], scenes.perturbed(scene, 2, 1e-3))
    assert jax.tree.all(jax.tree.map(lambda a, b: jnp.array_equal(a[0], b), saved.path.states, start))


@pytest.mark.sample(0)
def test_a_store_gives_back_bodies_with_full_tensors(tmp_path):
    pytest.importorskip("zarr")
    scene = scenes.scene("dimer")
    turn = np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.array([0.3, -0.5, 0.9]))))
    tensors = np.einsum("ia,na,ja->nij", turn, np.asarray(scene.body.body.moments), turn)
    body = ml.FreeBody(ml.TensorBody(tensors), scene.body.mass)
    start = scenes.perturbed(scene, 2, 1e-3)
    ml.simulate(scene.method, body, scene.torque, start, dt=scene.dt, steps=2, out=tmp_path / "run.zarr", save_every=1)
    found: Any = saved_path(tmp_path / "run.zarr", 1).body
    frames = np.asarray(ml.so3.to_matrix(found.body.frame))
    again = np.einsum("nia,na,nja->nij", frames, found.body.principal.moments, frames)
    np.testing.assert_allclose(again, tensors, rtol=0, atol=1e-14)


@pytest.mark.sample(0)
def test_a_file_is_looked_at(file, tmp_path):
    picture = tmp_path / "view.gif"
    code, _, err = midlie("view", file, "--body", 1, "--out", picture, "--frames", 3)
    assert code == 0, err
    assert picture.read_bytes().startswith(b"GIF")
    code, _, err = midlie("export", file)
    assert (code, err.count("\n")) == (2, 1)
    assert "holds 2 coupled bodies, but export writes one" in err


@pytest.mark.sample(0)
def test_a_table_has_a_line_for_each_body(tmp_path):
    path = tmp_path / "run.csv"
    assert midlie("run", "dimer", "--steps", 2, "--out", path)[0] == 0
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    assert list(rows[0])[:4] == ["copy", "time", "body", "momentum_1"]
    assert [(row["copy"], row["body"]) for row in rows] == 3 * [("0", "0"), ("0", "1")]
    assert float(rows[1]["position_x"]) == 0.28


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["dimer", "rod"])
def test_a_store_says_what_it_holds_and_is_drawn(name, tmp_path):
    pytest.importorskip("zarr")
    store, png = tmp_path / "run.zarr", tmp_path / "run.png"
    code, _, err = midlie("run", name, "--bodies", 2, "--steps", 6, "--out", store)
    assert code == 0, err
    code, out, err = midlie("inspect", store, "--plot", png)
    assert code == 0, err
    assert "linear momentum error, largest relative, of all bodies" in out
    assert "nan" not in out
    assert png.read_bytes().startswith(b"\x89PNG")
    assert type(saved_path(store, 1).path.states) is ml.CoupledState


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", ["rod", "binary-asteroid"])
def test_a_run_is_drawn(name, tmp_path):
    from midlie_jax.cli.record import Record
    from midlie_jax.cli.run_chart import run_figure

    scene = scenes.scene(name)
    path = ml.integrate(
        scene.method, scene.body, scene.torque, scene.start, dt=scene.dt, steps=20, save_every=4
    )  # fmt: skip
    path = jax.tree.map(lambda x: jnp.asarray(x)[None], path)
    figure = run_figure(Record.of(scene, scene.method, scene.dt, 20, 0.0, 0, path))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert "Error of the total angular momentum" in titles
    assert "Error of the linear momentum" in titles
    track = next(axes for axes in figure.axes if axes.get_title(loc="left").startswith("Path of the centre"))
    assert len({line.get_color() for line in track.lines}) == scene.start.count


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["chart", "rod"], ["'rod' has 21 coupled bodies", "a chart measures one", "midlie run rod"]),
        (["stability", "dimer"], ["needs a rigid body without translation", "'dimer' is a FreeBody"]),
        (["run", "dimer", "--method", "AKW"], ["'AKW' moves RigidBody", "FreeBody"]),
    ],
)
def test_what_cannot_be_is_said_in_one_line(arguments, words):
    code, _, err = midlie(*arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert all(word in err for word in words), err


def test_the_scenes_are_described():
    code, out, err = midlie("scenes", *NAMES)
    assert code == 0, err
    assert all(text in out for text in ("MutualGravity(G = 6.67e-11", "Rod(length = 0.1", "Waters()"))
    assert all(len(line) < 250 for line in out.splitlines())
