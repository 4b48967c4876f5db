"""The `midlie` command as a user sees it: what it prints, writes and draws, and how it fails."""

import csv
import itertools
import os
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
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
from midlie_jax.cli import run as run_command
from midlie_jax.cli.record import Record, save
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
    assert f"default: {DEFAULT}," in " ".join(without_jax("run", "--help").stdout.split())
    assert scenes.scene("P1").method == DEFAULT == ml.diffrax.LieSolver().method.name == ml.methods()[0]


def without_jax(*arguments: str) -> subprocess.CompletedProcess:
    """The command as it is installed, in a process of its own that fails if JAX or NumPy was imported at the end."""
    module, _, name = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["midlie"].partition(
        ":"
    )
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


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["fit", "--help"], 0, "usage: midlie fit "),
        (["run", "P1", "--out", "x.txt"], 2, "midlie: argument --out: cannot write x.txt"),
    ],
)
def test_help_and_refusals_come_without_jax(arguments, code, said):
    outcome = without_jax(*arguments)
    assert outcome.returncode == code, outcome.stderr
    assert (outcome.stderr if code else outcome.stdout).startswith(said)
    assert outcome.stdout.endswith("imported: []\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nowhere"], ["unknown scene 'nowhere'", "P1", "see midlie run --help"]),
        (["run", "p1-tited"], ["unknown scene 'p1-tited'", "Did you mean 'P1-tilted'?"]),
        (["run", "P1", "--method", "nobody"], ["unknown method 'nobody'", "LIEMID[EA]"]),
        (["run", "P1", "--method", "Verlet"], ["moves Particles"]),
        (["run", "P1", "--dt", "0"], ["midlie: dt must be finite and not zero, got 0", "write for example --dt 0.005"]),
        (["run", "P1", "--dt", "1e-60", "--float32"], ["dt must be finite and not zero", "1e-60, in float32"]),
        (["run", "P1", "--dt", "1e-12"], ["1e-12 gives 1.0e+13 steps", "give a larger --dt"]),
        (["run", "P1", "--dt", "small"], ["--dt", "must be a number, got 'small'", "write for example"]),
        (["run", "P1", "--steps", "-3"], ["--steps", "a whole number, at least 1", "write for example 1000 or 1e3"]),
        (["run", "P1", "--steps", "1e30"], ["--steps", "at most 2147483647"]),
        (["run", "P1", "--seed", "-1"], ["--seed", "at least 0"]),
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
        (["chart", "spherical-pendulum", "--methods", "AKW"], ["'AKW' does not support a SymmetricRotor"]),
        (["chart", "rod"], ["'rod' has 21 coupled bodies", "a chart measures one", "midlie run rod"]),
        (["stability", "dimer"], ["needs a rigid body without translation", "'dimer' is a FreeBody"]),
        (["stability", "asymmetric-top", "--methods", "SYMMETRIC[EA]"], ["needs bodies with two equal moments"]),
        (["stability", "pulsed-body"], ["'pulsed-body' has no constant energy"]),
        (["stability", "P1", "--sweeps", "colour"], ["invalid choice: 'colour'"]),
        (["stability", "tumbling-brick", "--sweeps", "spin", "stiffness"], ["no stiffness to vary; it has spin, ani"]),
        (["stability", "P1", "--out", "maps.pdf"], ["must end in .png"]),
        (["view", "run.npz", "--axis", "0"], ["must be e1, e2 or e3", "Python's axis=0, 1, 2 are e1, e2, e3"]),
        (["view", "run.npz", "--size", "100"], ["--size must be given with --out and a .gif"]),
        (["export", "run.npz", "--euler", "ZZX"], ["without equal neighbours"]),
        (["export", "run.npz", "--out", "angles.txt"], ["must end in .csv"]),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments, words):
    """Before anything is printed."""
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
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_run_is_reported_and_run_again_from_its_file(tmp_path, dtype):
    """Every number that the run needs is in the file, and gives the states in the file."""
    path = tmp_path / "run.npz"
    options = [*("--bodies", "3", "--size", "0.02", "--seed", "7"), *("--steps", "60", "--method", "LIEMID[E2]")]
    said = midlie("run", "P1", *options, "--out", path, *(["--float32"] if dtype == "float32" else []))
    assert f"wrote {path}" in said.out
    assert f"3 perturbed bodies, LIEMID[E2], 60 steps of 0.005, {dtype}" in said.out
    seen = said.facts
    # LIEMID[E2] is symplectic of order 1 up to third order in the step: its energy error is seen, and small.
    assert 1e-12 < float(seen["energy error, largest relative"]) < 1e-4
    size, what = seen["momentum error, largest relative"].split(maxsplit=1)
    assert float(size) < 60 * 8 * np.finfo(dtype).eps
    assert "vertical" in what
    assert seen["ok"] == "yes"
    assert float(seen["throughput"].removesuffix("body-steps/s")) > 0
    assert re.fullmatch(r"\S+ s of (processor|wall) time on .+ \(median, ±\d+%\)", seen["run time"])
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
    assert found["momenta"].dtype == found["attitudes"].dtype == found["times"].dtype == dtype
    scale = 50 * 60 * 8 * np.finfo(dtype).eps
    np.testing.assert_allclose(found["momenta"], again.states.momentum, rtol=0, atol=scale)
    np.testing.assert_allclose(found["attitudes"], again.states.attitude, rtol=0, atol=scale)
    np.testing.assert_array_equal(found["times"], again.times)
    np.testing.assert_array_equal(found["ok"], [True] * 3)


@pytest.mark.sample(0)
def test_chart_measures_draws_and_survives_a_broken_method(tmp_path, monkeypatch):
    """Two methods that work and, first, one that does not, on the first half second of the slow top.

    So soon the error of LIEMID[E1] is of first order still; later the terms that grow with time, of second order,
    rule (it is conjugate to a symmetric method). One test, because measuring takes seconds.
    """

    def program(method, *arguments, **options):
        if method.name == BROKEN:
            raise RuntimeError("this one is broken\nand says so at length")
        return Program(method, *arguments, **options)

    short = replace(scenes.scene("slow-top"), duration=0.5)
    monkeypatch.setattr(convergence, "Program", program)
    monkeypatch.setattr(scenes, "scene", lambda name, dtype=None: short)
    png = tmp_path / "figure.png"
    methods = (BROKEN, "LIEMID[EA]", "LIEMID[E1]")
    outcome = midlie("chart", "slow-top", "--out", str(png), "--steps", "64", "--levels", "3", "--methods", *methods)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "Taylor series in 30 digits" in outcome.out
    assert outcome.err == ""  # no progress bar but on a terminal
    assert re.search(r"Processor time, per body in a batch of 256: medians of \d+ rounds.* ±\d+%", outcome.out)
    heads = next(line for line in outcome.out.splitlines() if line.startswith("method"))
    assert "time [s]  +- [%]" in heads

    failed = [line for line in outcome.out.splitlines() if line.startswith(BROKEN)]
    assert len(failed) == 3
    assert all("failed: RuntimeError: this one is broken" in line for line in failed)

    slopes = defaultdict(list)
    for cells in map(str.split, outcome.out.splitlines()):
        if cells and cells[0] in methods and cells[-1] == "yes" and len(cells) == 11:
            slopes[cells[0]] += [float(cells[3]), float(cells[5])]
    # The next term of the error bends the lines by about 0.01 on the first pair of rungs; the table shows two digits.
    assert slopes["LIEMID[EA]"] == pytest.approx([2] * 4, abs=0.021)
    assert slopes["LIEMID[E1]"] == pytest.approx([1] * 4, abs=0.021)

    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert f"wrote {png}" in outcome.out


@pytest.mark.sample(0)
def test_compiled_programs_are_kept_for_the_next_process(tmp_path):
    """In the folder that JAX is told; the second process loads them."""

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
    path, made = tmp_path / "run.csv", made_up("tumbling-brick", 3, "float32")
    save(made, str(path))
    lines = list(csv.DictReader(path.read_text().splitlines()))
    names = ["body", "time", *found["momentum_components"], *found["attitude_components"], "ok"]
    assert list(lines[0]) == names
    assert len(lines) == 3 * 5
    for line, (body, n) in zip(lines, np.ndindex(3, 5), strict=True):
        assert (int(line["body"]), int(line["ok"])) == (body, made.ok[body])
        numbers = np.array([line[name] for name in names[1:-1]], "float32")
        np.testing.assert_array_equal(numbers, [made.times[n], *made.momenta[body, n], *made.attitudes[body, n]])


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


@pytest.mark.parametrize("most", [200, 2000])
def test_states_are_kept_at_every_so_many_steps(most):
    for steps in (1, 2, 7, 199, 200, 201, 1009, 2000, 2003, 10**6, 10**9 + 7):
        every = run_command._save_every(steps, 1, most)
        assert min(steps, most // 2) <= -(-steps // every) <= most
        assert run_command._save_every(steps, 2**25, most) == steps


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


SEQUENCES = ["".join(s) for s in itertools.product("XYZ", repeat=3) if s[1] not in (s[0], s[2])]


NEAREST = np.array([0.0, 1e-15, 1e-12, 1e-9, 9e-8, 1e-7, 3e-7, 1e-6, 1e-5, 1e-3])  # to the pole, radians


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_angles_near_the_poles_give_the_rotation_back(sequence):
    """Near a pole, rounding changes the first angle much; the three angles together still give the rotation.

    Of rounded matrices and of quaternions, in float32 and float64; by SciPy.
    """
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


def start(bodies):
    return ml.RigidState(
        jnp.tile(jnp.array([0.1, 0.3, 3.0]), (bodies, 1)) * jnp.arange(1.0, bodies + 1)[:, None],
        jnp.tile(jnp.eye(4)[0], (bodies, 1)),
    )


def simulated(out, **options):
    given = {"dt": 0.1, "steps": 10, "save_every": 2, "progress": False, **options}
    return ml.simulate("SYMMETRIC[EA]", ml.RigidBody([2.0, 2.0, 1.0]), None, start(3), out=out, **given)


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


OBSERVED = {
    "states": ({}, ["attitude w", "attitude x", "attitude y", "attitude z", "momentum 1", "momentum 2", "momentum 3"]),
    "histogram": (
        {"observe": ml.observe.Histogram(ml.observe.energy, [0.0, 1.0, 9.0])},
        ["observed 1", "observed 2"],
    ),
    "spectrum": ({"observe": ml.observe.Spectrum(ml.observe.energy, 5)}, ["density", "error", "number"]),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("observed", OBSERVED)
def test_any_store_is_drawn(tmp_path, observed):
    options, titles = OBSERVED[observed]
    result = simulated(tmp_path / "run.zarr", **options)
    figure = store_figure(ml.simulation.inspect(result.out))
    assert [axes.get_title(loc="left") for axes in figure.axes] == titles
    assert len(figure.axes[0].lines) == (1 if observed in ("histogram", "spectrum") else 3)
    points = 3 if observed == "spectrum" else 6
    assert all(len(line.get_xdata()) == points for axes in figure.axes for line in axes.lines)
    assert figure.axes[0].get_xlabel() == ("Frequency" if observed == "spectrum" else "Time t")
    if observed == "histogram":
        picture = tmp_path / "run.png"
        code, _, _ = midlie("inspect", result.out, "--plot", picture)
        assert (code, picture.stat().st_size > 5000) == (0, True)


@pytest.mark.sample(1)
@pytest.mark.parametrize("ending", ["zarr", "npz"])
def test_a_run_goes_on_from_the_last_states_of_another(run, tmp_path, ending):
    """With the same bits and times; the start and the end alone are saved unless more is asked for."""
    one = simulated(tmp_path / f"one.{ending}", steps=4, save_every=None)
    states = one.states()
    assert isinstance(states, ml.RigidState)
    assert states.momentum.shape == (3, 2, 3)
    last = jax.tree.map(lambda x: x[:, -1], states)
    body = ml.RigidBody([2.0, 2.0, 1.0])
    rest = {"dt": 0.1, "steps": 6, "first_step": 4, "save_every": 2, "progress": False}
    two = ml.simulate("SYMMETRIC[EA]", body, None, last, out=tmp_path / f"two.{ending}", **rest)
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
    found = {line.kind: line.steps for line in stability.lines(method, scene, field)}
    np.testing.assert_allclose(found["stability"], 2 / field.values, rtol=2e-3)
    np.testing.assert_allclose(found["reach"], method.reach / 0.6)


@pytest.mark.parametrize("name", ["asymmetric-top", "tumbling-brick"])
def test_sweeps_pass_through_the_scene_and_keep_bodies_real(name):
    scene = scenes.scene(name)
    moments, momentum = np.asarray(scene.body.moments), np.asarray(scene.start.momentum)
    steps, sweeps = stability.sweeps(scene, 9)
    assert len(steps) == 9
    expected = ["spin", "anisotropy", "stiffness"] if scene.torque else ["spin", "anisotropy"]
    assert [sweep.name for sweep in sweeps] == expected
    for sweep in sweeps:
        assert sweep.values[0] < sweep.own
        ml.RigidBody(sweep.moments)  # raises for a body that is not real
        velocity = sweep.momenta / sweep.moments
        along = np.cross(velocity, momentum / moments)
        np.testing.assert_allclose(along, 0, atol=1e-12 * np.abs(velocity).max() * np.abs(momentum / moments).max())
    spin, shape = sweeps[:2]
    np.testing.assert_allclose(np.linalg.norm(spin.momenta / moments, axis=1), spin.values)
    np.testing.assert_allclose(shape.moments[0], moments.mean())
    np.testing.assert_allclose(np.ptp(shape.moments, axis=1), shape.values * np.ptp(moments), atol=1e-12)
