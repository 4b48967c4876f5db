"""What `midlie run` saves and draws: that the files say what ran, and give it back."""

import contextlib
import csv
import io
import re

import numpy as np
import pytest

import midlie_jax as ml
from midlie_jax.cli import run, scenes
from midlie_jax.cli.main import main
from midlie_jax.cli.record import Record, save


def midlie_run(*arguments: str) -> str:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert main(["run", *arguments]) == 0, err.getvalue()
    assert err.getvalue() == ""
    return out.getvalue()


def loaded(path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


@pytest.mark.sample(0)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_run_is_run_again_from_its_file(tmp_path, dtype):
    """Every number that the run needs is in the file, and gives the states in the file."""
    path = tmp_path / "run.npz"
    options = [*("--bodies", "3", "--size", "0.02", "--seed", "7"), *("--steps", "60", "--method", "LIEMID[E2]")]
    said = midlie_run("P1", *options, "--out", str(path), *(["--float32"] if dtype == "float32" else []))
    assert f"wrote {path}" in said
    found = loaded(path)
    text = {name: str(found[name]) for name in found if found[name].dtype.kind == "U" and not found[name].ndim}
    assert text["dtype"] == dtype
    scene = scenes.scene(text["scene"], text["dtype"])
    count, size, seed = int(found["bodies"]), float(found["perturbation_size"]), int(found["perturbation_seed"])
    starts = scenes.perturbed(scene, count, size, seed)
    dt, steps = float(found["dt"]), int(found["steps"])
    assert (count, dt, steps) == (3, float(np.dtype(dtype).type(0.005)), 60)
    again = ml.ensemble(
        text["method"], ml.RigidBody(found["moments"]), scene.torque, starts, dt=dt, steps=steps, save_every=1
    )
    assert found["momenta"].shape == (3, 61, 3)
    assert found["attitudes"].shape == (3, 61, 4)
    assert found["momenta"].dtype == found["attitudes"].dtype == found["times"].dtype == dtype
    scale = 50 * 60 * 8 * np.finfo(dtype).eps
    np.testing.assert_allclose(found["momenta"], again.states.momentum, rtol=0, atol=scale)
    np.testing.assert_allclose(found["attitudes"], again.states.attitude, rtol=0, atol=scale)
    np.testing.assert_array_equal(found["times"], again.times)
    np.testing.assert_array_equal(found["ok"], [True] * 3)


def made_up(name, bodies, dtype="float64") -> Record:
    """A run of five states that never ran."""
    random = np.random.default_rng(0)
    momenta, attitudes = (random.standard_normal((bodies, 5, n)).astype(dtype) for n in (3, 4))
    times = (0.1 * np.arange(5)).astype(dtype)
    return Record(
        *(scenes.scene(name, dtype), "LIEMID[EA]", 0.1, 4, 1e-3, 0, times, momenta, attitudes),
        random.random(bodies) < 0.5,
    )


def test_a_file_names_its_parts_and_where_they_come_from(tmp_path):
    path, made = tmp_path / "run.NPZ", made_up("pulsed-body", 2)
    save(made, str(path))
    found = loaded(path)
    assert list(found["momentum_components"]) == ["momentum_1", "momentum_2", "momentum_3"]
    assert list(found["attitude_components"]) == ["attitude_w", "attitude_x", "attitude_y", "attitude_z"]
    assert "principal axes" in str(found["momentum_frame"])
    assert "scalar first" in str(found["attitude_frame"])
    for name in ("title", "source", "units"):
        assert str(found[name]) == getattr(made.scene, name)
    assert str(found["method"]) == "LIEMID[EA]"
    assert re.match(r"\d+\.\d+", str(found["version"]))
    np.testing.assert_array_equal(found["axes"], made.scene.axes)
    np.testing.assert_array_equal(found["moments"], made.scene.body.moments)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("bodies", [1, 3])
def test_a_csv_has_named_columns_and_gives_back_the_numbers(tmp_path, bodies, dtype):
    path, made = tmp_path / "run.csv", made_up("tumbling-brick", bodies, dtype)
    save(made, str(path))
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    names = [*("body", "time", "momentum_1", "momentum_2", "momentum_3")]
    names += [*("attitude_w", "attitude_x", "attitude_y", "attitude_z", "ok")]
    assert list(lines[0]) == names
    assert len(lines) == bodies * 5
    for line, (body, n) in zip(lines, np.ndindex(bodies, 5), strict=True):
        assert int(line["body"]) == body
        assert int(line["ok"]) == made.ok[body]
        numbers = np.array([line[name] for name in names[1:-1]], dtype)
        np.testing.assert_array_equal(numbers, [made.times[n], *made.momenta[body, n], *made.attitudes[body, n]])


@pytest.mark.sample(0)
def test_a_prime_number_of_steps_keeps_as_many_states(tmp_path):
    """4001 steps have no divisor; the run is made of two parts, and ends where one in one piece does."""
    path = tmp_path / "run.npz"
    midlie_run("free-asymmetric", "--steps", "4001", "--out", str(path))
    found = loaded(path)
    assert len(found["times"]) == 1 + 4001 // 3 + 1
    assert found["times"][-1] == 4001 * 0.01
    scene = scenes.scene("free-asymmetric", "float64")
    whole = ml.integrate("JACOBI[EA]", scene.body, None, scene.start, dt=0.01, steps=4001, save_every=4001)
    np.testing.assert_allclose(found["momenta"][0, -1], whole.states.momentum[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["attitudes"][0, -1], whole.states.attitude[-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("steps", [1, 2, 7, 199, 200, 201, 1009, 2000, 2003, 10**6, 10**9 + 7])
@pytest.mark.parametrize("most", [200, 2000])
def test_states_are_kept_at_every_so_many_steps(steps, most):
    every = run._save_every(steps, 1, most)
    kept = -(-steps // every)
    assert min(steps, most // 2) <= kept <= most
    assert run._save_every(steps, 2**25, most) == steps


@pytest.mark.sample(0)
def test_a_run_that_fails_is_reported_saved_and_drawn(tmp_path):
    npz, png = tmp_path / "run.npz", tmp_path / "run.png"
    said = midlie_run("P1", "--dt", "3", "--steps", "4", "--bodies", "2", "--out", str(npz), "--plot", str(png))
    assert "NO: failed for 2 of 2" in said
    assert not loaded(npz)["ok"].any()
    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert f"wrote {npz}" in said
    assert f"wrote {png}" in said
