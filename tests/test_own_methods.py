"""Methods and scenes of a user's module on the charts: `midlie chart --methods my_module:my_method`, and in Python."""

import struct
import sys

import numpy as np
import pytest
from test_cli import midlie

from midlie_jax.simulation.summary import inspect

MODULE = """
from dataclasses import replace
import midlie_jax as ml
from midlie_jax.cli import scenes
kick, flight = ml.schemes.KICK, ml.schemes.FLIGHT
stages = ((kick, 0.25), (kick, 0.25), (flight, 0.5), (flight, 0.5), (kick, 0.25), (kick, 0.25))
my_method = ml.method("LIEMID", ml.schemes.Scheme("PARTS", 2, stages, "this test"))
number, verlet, jacobi = 3.0, ml.method("Verlet"), ml.flights.Jacobi()
impostor = type(my_method)(ml.flights.LieMidpoint(), ml.schemes.EA, "JACOBI[EA]")
my_scene = replace(scenes.scene("slow-top"), name="P1", title="a top of my own", duration=0.5)
"""
NAME = "LIEMID[PARTS]"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a module in it that no path of Python's leads to."""
    (tmp_path / "own_numbers.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", ".")])
    yield tmp_path
    for name in ("own_numbers", "own_broken"):
        sys.modules.pop(name, None)


@pytest.mark.sample(0)
def test_the_chart_takes_a_method_and_a_scene_of_a_module_in_the_current_folder(folder):
    options = ["--steps", "64", "--levels", "2", "--methods", "LIEMID[EA]", "own_numbers:my_method"]
    outcome = midlie("chart", "own_numbers:my_scene", *options)
    assert outcome.code == 0, outcome.err
    rows = [line.split() for line in outcome.out.splitlines() if line.startswith("LIEMID[")]
    assert [row[0] for row in rows] == ["LIEMID[EA]"] * 2 + [NAME] * 2
    assert [row[1:3] for row in rows[:2]] == [row[1:3] for row in rows[2:]]  # the same steps and errors
    assert struct.unpack(">II", (folder / "chart-P1.png").read_bytes()[16:24])[0] > 1000


@pytest.mark.sample(0)
def test_files_say_where_a_method_is_from_and_a_store_goes_on_with_no_other_of_that_name(folder):
    run = ["run", "own_numbers:my_scene", "--method", "own_numbers:my_method", "--steps", "16", "--out", "own.zarr"]
    for options in ([], ["--resume"]):
        outcome = midlie(*run, *options)
        assert outcome.code == 0, outcome.err
    assert midlie(*run[:-1], "own.npz").code == 0
    own = np.load(folder / "own.npz")
    assert [str(own[key]) for key in ("method", "method_from", "scene")] == [NAME, *run[3:0:-2]]
    said = inspect(folder / "own.zarr").attributes
    assert [said[key] for key in ("method", "method_from", "scene")] == [NAME, *run[3:0:-2]]
    outcome = midlie("inspect", "own.zarr")
    assert (outcome.code, "energy error" in outcome.out) == (0, False)  # not that of the scene P1 of the package
    file = folder / "own_numbers.py"
    file.write_text(MODULE.replace("(kick, 0.25), (kick, 0.25), (flight, 0.5)", "(kick, 0.5), (flight, 0.5)", 1))
    sys.modules.pop("own_numbers")
    outcome = midlie(*run, "--resume")
    assert outcome.code == 2
    assert "the code of method" in outcome.err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("own_numbres:my_method", ["no module 'own_numbres'", "Did you mean 'own_numbers:my_method'?"]),
        ("own_numbers:my_methud", ["has no 'my_methud'", "its methods are impostor, my_method, verlet"]),
        ("own_numbers:number", ["own_numbers:number is a float, not a method"]),
        ("own_numbers:jacobi", ["is a flight", "midlie_jax.method(jacobi, 'EA')"]),
        ("own_numbers:impostor", ["impostor has the name of a method of midlie_jax, 'JACOBI[EA]'", "another name"]),
        ("own_numbers:verlet", ["'Verlet' does not support a rigid body"]),
        ("own_broken:my_method", ["own_broken.py, line 2", "ZeroDivisionError: division by zero"]),
    ],
)
def test_a_wrong_name_is_one_line_that_says_what_is_wrong(name, words, folder):
    (folder / "own_broken.py").write_text("def f(x):\n    return 1 / x\n\nmy_method = f(0)\n")
    outcome = midlie("chart", "P1", "--methods", name)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    for word in words:
        assert word in outcome.err


def test_a_scene_of_a_module_must_be_one(folder):
    for name, words in (
        ("number", "own_numbers:number is a float, not a scene"),
        ("nothing", "its scenes are my_scene"),
    ):
        outcome = midlie("chart", f"own_numbers:{name}")
        assert (outcome.code, words in outcome.err) == (2, True)
