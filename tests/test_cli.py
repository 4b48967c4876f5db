"""The `midlie` command as a user sees it: what it prints, what it writes, how it fails; and the charts' numbers."""

import contextlib
import io
import math
import os
import re
import struct
import subprocess
import sys
import tomllib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import midlie_jax as ml
from midlie_jax.advice.program import Program
from midlie_jax.cli import convergence, scenes, tables
from midlie_jax.cli.main import main, read
from midlie_jax.integrators.registry import DEFAULT

BROKEN = "SW"
ROOT = Path(__file__).resolve().parent.parent


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


def midlie(*arguments: str) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(arguments)
    return Outcome(code, out.getvalue(), err.getvalue())


def test_methods_lists_every_method_with_its_order():
    outcome = midlie("methods")
    assert outcome.code == 0
    lines = {name: line for line in outcome.out.splitlines() for name in ml.methods() if line.startswith(f"{name}  ")}
    assert list(lines) == ml.methods()
    assert all(f" {ml.method(name).order} " in line for name, line in lines.items())


def test_run_takes_the_method_that_is_recommended():
    """The command knows its name by itself, so that its help needs no JAX."""
    assert read(["run", "P1"]).method == DEFAULT == ml.diffrax.LieSolver().method.name == ml.methods()[0]


def test_scenes_lists_every_scene():
    outcome = midlie("scenes")
    assert outcome.code == 0
    assert [line.split()[0] for line in outcome.out.splitlines()[2:]] == scenes.scenes()


def test_methods_and_scenes_that_are_named_are_described():
    outcome = midlie("methods", "JACOBI[S4]", "RK4")
    assert outcome.code == 0, outcome.err
    made, listed = outcome.out.splitlines()[2:]
    method = ml.method("JACOBI[S4]")
    assert made.split() == ["JACOBI[S4]", "RigidBody", "4", "yes", "yes", str(method.evaluations), "-"]
    assert listed.startswith("RK4")
    outcome = midlie("scenes", "P1", "gravity-gradient")
    assert outcome.code == 0, outcome.err
    scene = scenes.scene("P1")
    told = outcome.out.partition("\n\n")[0]
    assert "[5., 5., 1.]" in told
    assert "HeavyTop(mgl = 20., axis = [0., 0., 1.])" in told
    assert f"{scene.dt:g} and {scene.duration:g}: {scene.steps} steps" in told
    assert all(text in told for text in (scene.title, scene.source, scene.units))
    assert "kg, m, s" in outcome.out


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
    "arguments", [["--help"], *([name, "--help"] for name in ("chart", "run", "methods", "scenes"))]
)
def test_help_comes_without_jax(arguments):
    outcome = without_jax(*arguments)
    assert outcome.returncode == 0, outcome.stderr
    assert f"usage: midlie{' ' + arguments[0] if len(arguments) > 1 else ''} " in outcome.stdout
    assert outcome.stdout.endswith("imported: []\n")


@pytest.mark.parametrize(
    "arguments", [[], ["chrat"], ["run", "P1", "--steps", "many"], ["run", "P1", "--out", "x.txt"]]
)
def test_a_wrong_line_is_refused_without_jax(arguments):
    outcome = without_jax(*arguments)
    assert outcome.returncode == 2
    assert outcome.stderr.startswith("midlie: ")
    assert outcome.stdout == "imported: []\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nowhere"], ["unknown scene 'nowhere'", "P1", "see midlie run --help"]),
        (["run", "p1-tited"], ["unknown scene 'p1-tited'", "Did you mean 'P1-tilted'?"]),
        (["run", "P1", "--method", "nobody"], ["unknown method 'nobody'", "LIEMID[EA]"]),
        (["run", "P1", "--method", "Verlet"], ["moves Particles"]),
        (["run", "P1", "--dt", "0"], ["midlie: dt must be finite and not zero, got 0", "write for example --dt 0.005"]),
        (["run", "P1", "--dt", "nan"], ["midlie: dt must be finite and not zero, got nan"]),
        (["run", "P1", "--dt", "1e-60", "--float32"], ["dt must be finite and not zero", "1e-60, in float32"]),
        (["run", "P1", "--dt", "1e300", "--float32"], ["dt must be finite and not zero", "got inf (from 1e+300"]),
        (["run", "P1", "--dt", "1e-12"], ["1e-12 gives 1.0e+13 steps", "give a larger --dt"]),
        (["run", "P1", "--dt", "small"], ["--dt", "must be a number, got 'small'", "write for example"]),
        (["run", "P1", "--steps", "-3"], ["--steps", "a whole number, at least 1", "write for example 1000 or 1e3"]),
        (["run", "P1", "--steps", "many"], ["--steps", "'many'", "write for example 1000", "see midlie run --help"]),
        (["run", "P1", "--steps", "1.5"], ["--steps", "a whole number", "'1.5'"]),
        (["run", "P1", "--steps", "inf"], ["--steps", "a whole number", "'inf'"]),
        (["run", "P1", "--steps", "1e30"], ["--steps", "at most 2147483647"]),
        (["run", "P1", "--bodies", "0"], ["--bodies", "at least 1"]),
        (["run", "P1", "--seed", "-1"], ["--seed", "at least 0"]),
        (["run", "P1", "--stpes", "3"], ["--stpes", "did you mean --steps?", "see midlie run --help"]),
        (["run", "P1", "P2"], ["unrecognized arguments: P2", "see midlie run --help"]),
        (["run"], ["SCENE", "see midlie run --help"]),
        (["run", "P1", "--out", "no/such/folder/x.npz"], ["cannot write no/such/folder/x.npz", "no such folder"]),
        (["run", "P1", "--out", "x.txt"], ["cannot write x.txt", "must end in .npz or .csv"]),
        (["run", "P1", "--plot", "x.pdf"], ["cannot write x.pdf", "must end in .png"]),
        (["run", "P1", "--plot", "no/such/folder/x.png"], ["cannot write no/such/folder/x.png", "no such folder"]),
        (["chart", "nowhere"], ["unknown scene 'nowhere'"]),
        (["chart", "--methods", "nobody"], ["unknown method 'nobody'"]),
        (["chart", "--methods", "Verlet"], ["'Verlet' does not support a rigid body"]),
        (["chart", "--out", "no/such/folder/x.png"], ["no such folder"]),
        (["chart", "--out", "x.svg"], ["must end in .png", "see midlie chart --help"]),
        (["chart", "--levels", "40"], ["40 levels from 500 steps", "use fewer"]),
        (["chart", "--level", "no"], ["--levels", "a whole number", "see midlie chart --help"]),
        (["view", "run.npz", "--axis", "0,0,0"], ["--axis", "must be e1, e2 or e3, or a direction", "'0,0,0'"]),
        (["methods", "all"], ["unknown method 'all'", "see midlie methods --help"]),
        (["scenes", "p1-tited"], ["unknown scene 'p1-tited'", "Did you mean 'P1-tilted'?"]),
        (["chart", "P1", "--rivals"], ["unrecognized arguments: --rivals", "see midlie chart --help"]),
        (["paint"], ["paint", "chart", "see midlie --help"]),
        (["chrat"], ["unknown command 'chrat'", "did you mean chart?"]),
        ([], ["COMMAND", "see midlie --help"]),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments, words):
    outcome = midlie(*arguments)
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("midlie: ")
    assert outcome.err.count("\n") == 1
    for word in words:
        assert word in outcome.err


@pytest.mark.parametrize(
    ("package", "arguments"),
    [
        *((package, ["chart"]) for package in ("matplotlib", "tqdm")),
        ("matplotlib", ["run", "P1", "--plot", "x.png"]),
    ],
)
def test_a_missing_extra_is_named_before_anything_is_measured(package, arguments, monkeypatch):
    find_spec = tables.find_spec
    monkeypatch.setattr(tables, "find_spec", lambda name: None if name == package else find_spec(name))
    outcome = midlie(*arguments)
    assert outcome.code == 2
    assert package in outcome.err
    assert "midlie_jax[cli]" in outcome.err
    assert outcome.out == ""


def facts(outcome: Outcome) -> dict[str, str]:
    """What `run` prints, by its left column."""
    assert outcome.code == 0, outcome.err
    pairs = (line.strip().split("  ", 1) for line in outcome.out.splitlines()[1:])
    return {name: value.strip() for name, value in pairs}


@pytest.mark.sample(0)
def test_run_reports_the_conservation_laws_of_a_batch_of_tops():
    outcome = midlie("run", "P1", "--bodies", "3", "--steps", "1e2", "--dt", "0.01", "--method", "LIEMID[E2]")
    seen = facts(outcome)
    assert "3 perturbed bodies, LIEMID[E2], 100 steps of 0.01, float64" in outcome.out
    # LIEMID[E2] is symplectic of order 1 up to third order in the step: its energy error is seen, and small.
    assert 1e-12 < float(seen["energy error, largest relative"]) < 1e-4
    size, what = seen["momentum error, largest relative"].split(maxsplit=1)
    assert float(size) < 100 * 8 * np.finfo(float).eps
    assert "vertical" in what
    assert seen["ok"] == "yes"
    assert seen["throughput"].endswith("body-steps/s")
    assert float(seen["throughput"].split()[0]) > 0
    assert re.fullmatch(r"\S+ s of (processor|wall) time on .+ \(median, ±\d+%\)", seen["run time"])


@pytest.mark.sample(0)
def test_run_of_a_free_body_keeps_all_of_the_spatial_momentum():
    seen = facts(midlie("run", "tumbling-brick", "--steps", "50"))
    size, what = seen["momentum error, largest relative"].split(maxsplit=1)
    assert float(size) < 50 * 8 * np.finfo(float).eps
    assert "all of it" in what


@pytest.mark.sample(0)
def test_run_in_single_precision_says_what_is_not_conserved():
    outcome = midlie("run", "pulsed-body", "--steps", "30", "--float32", "--method", "LIEMID[E1]")
    seen = facts(outcome)
    assert "float32" in outcome.out
    assert "no potential" in seen["energy error, largest relative"]
    assert "not conserved" in seen["momentum error, largest relative"]


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
    assert re.search(r"Processor time, per body in a batch of 256: medians of (one|[23]) round.* ±\d+%", outcome.out)
    heads = next(line for line in outcome.out.splitlines() if line.startswith("method"))
    assert "time [s]  +- [%]" in heads

    failed = [line for line in outcome.out.splitlines() if line.startswith(BROKEN)]
    assert len(failed) == 3
    assert all("failed: RuntimeError: this one is broken" in line for line in failed)

    slopes = defaultdict(list)
    for cells in map(str.split, outcome.out.splitlines()):
        if cells and cells[0] in methods and cells[-1] == "yes" and len(cells) == 11:
            slopes[cells[0]] += [float(cells[3]), float(cells[5])]
    # The next term of the error bends the lines by about .01 on the first pair of rungs; the table shows two digits.
    assert slopes["LIEMID[EA]"] == pytest.approx([2] * 4, abs=0.021)
    assert slopes["LIEMID[E1]"] == pytest.approx([1] * 4, abs=0.021)

    data = png.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", data[16:24])
    assert 1200 <= width <= 2400
    assert 900 <= height <= 2000
    assert 40_000 < len(data) < 1_000_000
    assert f"wrote {png}" in outcome.out


def test_ladder_doubles_and_follows_the_figure_for_p1():
    assert convergence.ladder(scenes.scene("P1")) == [500, 1000, 2000, 4000, 8000]
    assert convergence.ladder(scenes.scene("slow-top"), levels=2)[0] * 2 == scenes.scene("slow-top").steps
    with pytest.raises(ValueError, match="must be positive"):
        convergence.ladder(scenes.scene("P1"), coarsest=0)
    with pytest.raises(ValueError, match="use fewer"):
        convergence.ladder(scenes.scene("P1"), coarsest=2**20, levels=12)


def test_reference_of_a_top_about_another_axis():
    """Bruls and Cardona's top, whose axis is e2: published to the digits given."""
    scene = scenes.scene("bruls-cardona")
    reference = convergence.find_reference(scene, 1000)
    velocity = reference.momentum / np.asarray(scene.body.moments)
    np.testing.assert_allclose(velocity, [0.1222332194973833, 150, -5.855624589205458], atol=1e-11)
    tip = [-0.150416822745643, -0.724165591636897, -0.673022269560442]
    np.testing.assert_allclose(reference.attitude[:, 1], tip, atol=1e-12)


def test_extrapolated_reference_is_as_good_as_it_says(monkeypatch):
    scene = scenes.scene("slow-top")
    exact = convergence.find_reference(scene, 1000)
    monkeypatch.setattr(convergence, "_exact", lambda scene: None)
    found = convergence.find_reference(scene, 1000)
    assert "extrapolation" in found.source
    assert found.uncertainty < 1e-6
    assert not math.isnan(found.uncertainty)
    np.testing.assert_allclose(found.attitude, exact.attitude, atol=2 * found.uncertainty)
    scale = float(np.linalg.norm(exact.momentum))
    np.testing.assert_allclose(found.momentum, exact.momentum, atol=2 * found.uncertainty * scale)


@pytest.mark.sample(0)
def test_compiled_programs_are_kept_for_the_next_process(tmp_path):
    """In the folder that JAX is told; the second process loads them."""

    def run(**more: str) -> tuple[int, str]:
        env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "JAX_LOG_COMPILES": "1", **more}
        command = [sys.executable, "-m", "midlie_jax", "run", "P1", "--steps", "7", "--out", str(tmp_path / "run.npz")]
        found = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
        return len(list(tmp_path.glob("cache/midlie_jax/*/*-cache"))), found.stderr

    none, _ = run(JAX_ENABLE_COMPILATION_CACHE="0")
    kept, _ = run()
    _, log = run()
    assert none == 0 < kept
    assert "Persistent compilation cache hit" in log
