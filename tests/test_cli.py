"""The `midlie` command as a user sees it: what it prints, writes and draws, and how it fails."""

import csv
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import assert_one_line, midlie
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax._math.euler import euler_angles, matrices_of
from midlie_jax.advice.program import Program
from midlie_jax.cli import convergence, scenes, stability, tables
from midlie_jax.cli.run_chart import store_figure
from midlie_jax.integrators.registry import DEFAULT
from midlie_jax.simulation.saved import saved_path

BROKEN = "SW"
ROOT = Path(__file__).resolve().parent.parent


def test_methods_are_listed_and_described():
    outcome = midlie("methods")
    assert outcome.code == 0
    lines = {name: line for line in outcome.out.splitlines() for name in ml.methods() if line.startswith(f"{name}  ")}
    assert list(lines) == ml.methods()
    assert all(f" {ml.method(name).order} " in line for name, line in lines.items())
    outcome = midlie("methods", "JACOBI[S4]", "RK4")
    assert outcome.code == 0, outcome.err
    made, listed = outcome.out.splitlines()[2:]
    method = ml.method("JACOBI[S4]")
    assert made.split() == ["JACOBI[S4]", "RigidBody", "4", "yes", "yes", str(method.evaluations), "-"]
    assert listed.startswith("RK4")


def test_run_takes_the_method_that_is_recommended():
    """The help of the command has its name in its text, so that it needs no JAX."""
    helped = without_jax("run", "--help").stdout
    assert f"default: {DEFAULT}," in " ".join(helped.split())
    assert helped.endswith("imported: []\n")
    assert scenes.scene("P1").method == DEFAULT == ml.diffrax.LieSolver().method.name == ml.methods()[0]


def without_jax(*arguments: str) -> subprocess.CompletedProcess:
    """The command as it is installed, in a process of its own that fails if JAX or NumPy was imported at the end."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    module, _, name = project["scripts"]["midlie"].partition(":")
    program = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from {module} import {name}
try:
    code = {name}({list(arguments)!r})
except SystemExit as stop:
    code = stop.code
print("imported:", sorted({{"jax", "numpy", "matplotlib"}} & set(sys.modules)))
sys.exit(code)
"""
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)


def test_a_refusal_comes_without_jax():
    outcome = without_jax("run", "P1", "--out", "x.txt")
    assert (outcome.returncode, outcome.stdout) == (2, "imported: []\n")
    assert outcome.stderr.startswith("midlie: argument --out: cannot write x.txt")


MISTAKES = [
    (["run", "p1-tited"], ["unknown scene 'p1-tited'", "did you mean 'P1-tilted'?"]),
    (["run", "P1", "--method", "nobody"], ["unknown method 'nobody'", "LIEMID[EA]"]),
    (["run", "P1", "--method", "Verlet"], ["moves Particles"]),
    (["run", "P1", "--dt", "0"], ["midlie: dt must be finite and not zero, got 0", "write for example --dt 0.005"]),
    (["run", "P1", "--dt", "1e-60", "--float32"], ["dt must be finite and not zero", "1e-60, in float32"]),
    (["run", "P1", "--dt", "1e-12"], ["1e-12 gives 1.0e+13 steps", "give a larger --dt"]),
    (["run", "P1", "--dt", "small"], ["--dt", "must be a number, got 'small'", "write for example"]),
    (["run", "P1", "--steps", "-3"], ["--steps", "a whole number, at least 1", "write for example 1000 or 1e3"]),
    (["run", "P1", "--steps", "1e30"], ["--steps", "at most 2147483647"]),
    (["run", "P1", "--stpes", "3"], ["--stpes", "did you mean --steps?", "see midlie run --help"]),
    (["run", "P1", "P2"], ["unrecognized arguments: P2", "see midlie run --help"]),
    (["run"], ["SCENE", "see midlie run --help"]),
    (["run", "P1", "--out", "no/such/folder/x.npz"], ["cannot write no/such/folder/x.npz", "no such folder"]),
    (["run", "P1", "--out", "x.txt"], ["cannot write x.txt", "must end in .npz or .csv"]),
    (["chart", "--methods", "Verlet"], ["'Verlet' does not support a rigid body"]),
    (["chart", "--levels", "40"], ["40 levels from 500 steps", "use fewer"]),
    (["view", "run.npz", "--axis", "0,0,0"], ["--axis", "must be e1, e2 or e3, or a direction", "'0,0,0'"]),
    (["chrat"], ["unknown command 'chrat'", "did you mean chart?"]),
    ([], ["COMMAND", "see midlie --help"]),
    (["run", "spherical-pendulum", "--method", "AKW"], ["'AKW' moves RigidBody", "is SymmetricRotor"]),
    (["run", "thrown-brick", "--method", "SYMMETRIC[EA]"], ["needs bodies with two equal moments"]),
    (["chart", "rod"], ["'rod' has 21 coupled bodies", "a chart measures one", "midlie run rod"]),
    (["stability", "dimer"], ["needs a rigid body without translation", "'dimer' is a FreeBody"]),
    (["stability", "pulsed-body"], ["'pulsed-body' has no constant energy"]),
    (["stability", "P1", "--sweeps", "colour"], ["invalid choice: 'colour'"]),
    (["stability", "tumbling-brick", "--sweeps", "spin", "stiffness"], ["no stiffness to vary; it has spin, ani"]),
    (["stability", "P1", "--out", "maps.pdf"], ["must end in .png"]),
    (["view", "run.npz", "--axis", "0"], ["must be e1, e2 or e3", "Python's axis=0, 1, 2 are e1, e2, e3"]),
    (["view", "run.npz", "--size", "100"], ["--size must be given with --out and a .gif"]),
    (["export", "run.npz", "--euler", "ZZX"], ["without equal neighbours"]),
    (["export", "run.npz", "--out", "angles.txt"], ["must end in .csv"]),
]


def test_a_mistake_is_one_line_and_exit_code_2():
    for arguments, words in MISTAKES:
        assert_one_line(arguments, words)


@pytest.mark.parametrize(
    ("package", "arguments"), [("tqdm", ["chart"]), ("matplotlib", ["run", "P1", "--plot", "x.png"])]
)
def test_a_missing_extra_is_named_before_anything_is_measured(package, arguments, monkeypatch):
    find_spec = tables.find_spec
    monkeypatch.setattr(tables, "find_spec", lambda name: None if name == package else find_spec(name))
    outcome = midlie(*arguments)
    assert outcome.code == 2
    assert package in outcome.err
    assert "midlie_jax[cli]" in outcome.err
    assert outcome.out == ""


@pytest.mark.sample(0)
def test_a_run_is_reported_and_run_again_from_its_file(tmp_path):
    path = tmp_path / "run.npz"
    options = [*("--bodies", "3", "--size", "0.02", "--seed", "7"), *("--steps", "60", "--method", "LIEMID[E2]")]
    said = midlie("run", "P1", *options, "--out", path, "--float32")
    assert f"wrote {path}" in said.out
    assert "3 perturbed bodies, LIEMID[E2], 60 steps of 0.005, float32" in said.out
    seen = said.facts
    # LIEMID[E2] is symplectic of order 1 up to third order in the step: its energy error is seen, and small.
    assert 1e-12 < float(seen["energy error, largest relative"]) < 1e-4
    size, what = seen["momentum error, largest relative"].split(maxsplit=1)
    assert float(size) < 60 * 8 * np.finfo("float32").eps
    assert "vertical" in what
    assert seen["ok"] == "yes"
    assert float(seen["throughput"].removesuffix("body-steps/s")) > 0
    assert re.fullmatch(r"\S+ s of (processor|wall) time on .+ \(median, ±\d+%\)", seen["run time"])
    found = loaded(path)
    assert "principal axes" in str(found["momentum_frame"])
    assert "scalar first" in str(found["attitude_frame"])
    text = {name: str(found[name]) for name in found if found[name].dtype.kind == "U" and not found[name].ndim}
    assert text["dtype"] == "float32"
    scene = scenes.scene(text["scene"], text["dtype"])
    assert [text[name] for name in ("title", "source", "units")] == [scene.title, scene.source, scene.units]
    count, size, seed = int(found["bodies"]), float(found["perturbation_size"]), int(found["perturbation_seed"])
    starts = scenes.perturbed(scene, count, size, seed)
    dt, steps = float(found["dt"]), int(found["steps"])
    assert (count, dt, steps) == (3, float(np.float32(0.005)), 60)
    again = ml.ensemble(
        text["method"], ml.RigidBody(found["moments"]), scene.torque, starts, dt=dt, steps=steps, save_every=1
    )
    assert found["momenta"].shape == (3, 61, 3)
    assert found["momenta"].dtype == found["attitudes"].dtype == found["times"].dtype == "float32"
    scale = 50 * 60 * 8 * np.finfo("float32").eps
    np.testing.assert_allclose(found["momenta"], again.states.momentum, rtol=0, atol=scale)
    np.testing.assert_allclose(found["attitudes"], again.states.attitude, rtol=0, atol=scale)
    np.testing.assert_array_equal(found["times"], again.times)
    np.testing.assert_array_equal(found["ok"], [True] * 3)


@pytest.mark.sample(0)
def test_chart_measures_draws_and_survives_a_broken_method(tmp_path, monkeypatch):
    def program(method, *arguments, **options):
        if method.name == BROKEN:
            raise RuntimeError("this one is broken\nand says so at length")
        return Program(method, *arguments, **options)

    short = replace(scenes.scene("slow-top"), duration=0.5)
    monkeypatch.setattr(convergence, "Program", program)
    monkeypatch.setattr(scenes, "scene", lambda name, dtype=None: short)
    png = tmp_path / "figure.png"
    sizes = "--steps", 64, "--levels", 3
    outcome = midlie("chart", "slow-top", "--out", png, *sizes, "--methods", BROKEN, "LIEMID[EA]")
    assert outcome.code == 0, outcome.out + outcome.err
    assert "Taylor series in 30 digits" in outcome.out
    assert outcome.err == ""  # no progress bar but on a terminal
    assert re.search(r"Processor time, per body in a batch of 256: medians of \d+ rounds.* ±\d+%", outcome.out)
    heads = next(line for line in outcome.out.splitlines() if line.startswith("method"))
    assert "time [s]  +- [%]" in heads
    failed = [line for line in outcome.out.splitlines() if line.startswith(BROKEN)]
    assert len(failed) == 3
    assert all("failed: RuntimeError: this one is broken" in line for line in failed)
    assert len([line for line in outcome.out.splitlines() if re.match(r"LIEMID\[EA\] .* yes", line)]) == 3
    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert f"wrote {png}" in outcome.out


@pytest.mark.sample(0)
def test_compiled_programs_are_kept_for_the_next_process(tmp_path):
    def run() -> tuple[int, str]:
        env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "JAX_LOG_COMPILES": "1"}
        command = [sys.executable, "-m", "midlie_jax", "run", "P1", "--steps", "7", "--out", str(tmp_path / "run.npz")]
        found = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
        return len(list(tmp_path.glob("cache/midlie_jax/*/*-cache"))), found.stderr

    kept, _ = run()
    _, log = run()
    assert kept > 0
    assert "Persistent compilation cache hit" in log


# ---- what a run saves ----


def loaded(path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


@pytest.mark.sample(0)
def test_a_prime_number_of_steps_keeps_as_many_states(tmp_path):
    """4001 steps have no divisor; the run is made of two parts, and ends where the closed form does."""
    path = tmp_path / "run.npz"
    assert midlie("run", "free-asymmetric", "--steps", 4001, "--out", path).code == 0
    found = loaded(path)
    assert len(found["times"]) == 1 + 4001 // 3 + 1
    assert found["times"][-1] == 4001 * 0.01
    scene = scenes.scene("free-asymmetric", "float64")
    end = ml.free_motion(scene.body, scene.start, found["times"][-1:]).states
    np.testing.assert_allclose(found["momenta"][0, -1], end.momentum[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["attitudes"][0, -1], end.attitude[0], rtol=0, atol=1e-12)


@pytest.mark.sample(0)
def test_a_run_that_fails_is_reported_saved_and_drawn(tmp_path):
    npz, png = tmp_path / "run.npz", tmp_path / "run.png"
    said = midlie("run", "pulsed-body", "--dt", 1e6, "--steps", 4, "--bodies", 2, "--out", npz, "--plot", png)
    assert said.facts["ok"].startswith("NO: failed for 2 of 2")
    assert "no potential" in said.facts["energy error, largest relative"]
    assert "not conserved" in said.facts["momentum error, largest relative"]
    found = loaded(npz)
    assert not found["ok"].any()
    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert all(f"wrote {file}" in said.out for file in (npz, png))
    path = saved_path(npz).path
    assert (bool(path.ok), int(path.first_bad)) == (False, found["first_bad"][0])


# ---- attitudes as Euler angles ----


NEAREST = np.array([0.0, 1e-15, 1e-12, 1e-9, 9e-8, 1e-7, 3e-7, 1e-6, 1e-5, 1e-3])  # to the pole, radians


@pytest.mark.parametrize("sequence", ["ZYX", "XZX", "YXZ"])
def test_euler_angles_near_the_poles_give_the_rotation_back(sequence):
    """By SciPy, of rounded matrices and of quaternions: the first angle alone may change much."""
    angles = np.random.default_rng(1).uniform(-3, 3, (20, 2, len(NEAREST), 3))
    low, high = (0, np.pi) if sequence[0] == sequence[2] else (-np.pi / 2, np.pi / 2)
    angles[..., 1] = np.stack([low + NEAREST, high - NEAREST])
    rotations = Rotation.from_euler(sequence, angles.reshape(-1, 3))
    for dtype in (np.float32, np.float64):
        given = rotations.as_quat(scalar_first=True).astype(dtype)
        whole = Rotation.from_quat(given.astype(float), scalar_first=True).as_matrix()
        for matrices, wanted in ((matrices_of(given), whole), (rotations.as_matrix().astype(dtype),) * 2):
            found, _ = euler_angles(matrices, sequence)
            rebuilt = Rotation.from_euler(sequence, found.astype(float)).as_matrix()
            np.testing.assert_allclose(rebuilt, wanted, atol=8 * np.finfo(matrices.dtype).eps)
    _, locked = euler_angles(rotations.as_matrix(), sequence)
    assert locked[:: len(NEAREST)].all()
    assert not locked[len(NEAREST) - 1 :: len(NEAREST)].any()


# ---- stores ----


def simulated(out, **options):
    momenta = jnp.array([0.1, 0.3, 3.0])[None] * jnp.arange(1.0, 4.0)[:, None]
    start = ml.RigidState(momenta, jnp.tile(jnp.eye(4)[0], (3, 1)))
    given = {"dt": 0.1, "steps": 10, "save_every": 2, "progress": False, **options}
    return ml.simulate("SYMMETRIC[EA]", ml.RigidBody([2.0, 2.0, 1.0]), None, start, out=out, **given)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("run") / "run.zarr")


def test_export_writes_time_and_attitude(run, tmp_path):
    opened = run.open()
    code, out, _ = midlie("export", run.out, "--body", 2, "--csv")
    lines = list(csv.reader(out.splitlines()))
    assert (code, lines[0]) == (0, ["time", "attitude_w", "attitude_x", "attitude_y", "attitude_z"])
    table = np.array(lines[1:], float)
    np.testing.assert_array_equal(table[:, 0], opened.time)
    np.testing.assert_array_equal(table[:, 1:], opened.attitude[2])
    for options, unit, scale in (((), "deg", np.pi / 180), (("--radians",), "rad", 1.0)):
        file = tmp_path / "angles.csv"
        code, out, _ = midlie("export", run.out, "--euler", "ZYX", "--out", file, *options)
        assert (code, f"wrote {file}: 6 attitudes of body 0" in out) == (0, True)
        lines = list(csv.reader(file.read_text().splitlines()))
        assert lines[0] == ["time", f"euler_1_Z [{unit}]", f"euler_2_Y [{unit}]", f"euler_3_X [{unit}]"]
        angles = scale * np.array(lines[1:], float)[:, 1:]
        matrices = np.asarray(ml.so3.to_matrix(jnp.asarray(opened.attitude[0].values)))
        np.testing.assert_allclose(Rotation.from_euler("ZYX", angles).as_matrix(), matrices, atol=1e-12)
    assert_one_line(["export", run.out, "--body", 3], ["body must be from 0 to 2"])


@pytest.mark.sample(0)
def test_any_store_is_drawn(tmp_path):
    histogram, spectrum = (
        ml.observe.Histogram(ml.observe.energy, [0.0, 1.0, 9.0]),
        ml.observe.Spectrum(ml.observe.energy, 5),
    )
    for k, (observe, panels) in enumerate(((None, 7), (histogram, 2), (spectrum, 3))):
        result = simulated(tmp_path / f"run{k}.zarr", observe=observe)
        assert len(store_figure(ml.simulation.inspect(result.out)).axes) == panels
    assert midlie("inspect", result.out, "--plot", tmp_path / "run.png").code == 0


@pytest.mark.sample(0)
def test_a_run_goes_on_from_the_last_states_of_another(run, tmp_path):
    """With the same bits and times; the start and the end alone are saved unless more is asked for."""
    one = simulated(tmp_path / "one.npz", steps=4, save_every=None)
    states = one.states()
    assert isinstance(states, ml.RigidState)
    assert states.momentum.shape == (3, 2, 3)
    last = jax.tree.map(lambda x: x[:, -1], states)
    body = ml.RigidBody([2.0, 2.0, 1.0])
    rest = {"dt": 0.1, "steps": 6, "first_step": 4, "save_every": 2, "progress": False}
    two = ml.simulate("SYMMETRIC[EA]", body, None, last, out=tmp_path / "two.npz", **rest)
    whole = run.states()
    for one, other in zip(jax.tree.leaves(two.states()), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(one, other[:, 2:])
    np.testing.assert_array_equal(two.open()["time"], run.open().time[2:])
    seen = simulated(tmp_path / "seen.zarr", steps=2, observe=ml.observe.angular_velocity)
    with pytest.raises(ValueError, match="holds no states"):
        seen.states()


# ---- maps of stability ----


@pytest.mark.sample(0)
def test_maps_of_stability_are_measured_and_drawn(tmp_path):
    png = tmp_path / "maps.png"
    run = ("stability", "compass", "--methods", "SYMMETRIC[EA]", "--out", png, "--grid")
    code, out, err = midlie(*run, 3, "--steps", 100)
    assert (code, err) == (0, "")
    assert [line.split()[:2] for line in out.splitlines()[2:5]] == [
        ["SYMMETRIC[EA]", name] for name in ("spin", "anisotropy", "stiffness")
    ]
    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert f"wrote {png}" in out
    scene, method = scenes.scene("compass"), ml.method("SYMMETRIC[EA]")
    _, (_, _, field) = stability.sweeps(scene, 5)
    found = dict(stability.lines(method, scene, field))
    np.testing.assert_allclose(found["stability"], 2 / field.values, rtol=2e-3)
    np.testing.assert_allclose(found["reach"], method.reach / 0.6)
