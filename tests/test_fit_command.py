"""`midlie fit`: what it reads from a file, prints and draws, and what it says of a wrong file."""

import contextlib
import io
import re

import jax.numpy as jnp
import numpy as np
import pytest

import midlie_command
import midlie_jax as ml

MOMENTS, RATE, TIMES = np.array([1.1, 2.0, 2.4]), np.array([0.3, 0.5, -0.2]), np.arange(2.0, 14.1, 0.5)


def midlie_fit(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = midlie_command.main(["fit", *map(str, arguments)])
    return code, out.getvalue(), err.getvalue()


@pytest.fixture
def data(tmp_path):
    """The free body in degrees per second, with columns of another order and empty cells; it starts at t = 2."""
    body = ml.RigidBody(MOMENTS)
    path = ml.free_motion(body, ml.MomentumState(body.momentum(jnp.asarray(RATE))), TIMES - TIMES[0])
    rates = np.rad2deg(np.asarray(path.states.momentum) / MOMENTS)
    cells = [[f"{x:.12g}" for x in (*row, t)] for t, row in zip(TIMES, rates, strict=True)]
    cells[3][1] = ""
    file = tmp_path / "gyro.csv"
    file.write_text("\n".join(["p,q,r,seconds", *(",".join(row) for row in cells)]) + "\n")
    return file


def test_the_moments_and_rates_of_a_file_are_found_and_drawn(data, tmp_path):
    picture = tmp_path / "fit.png"
    columns = ["--columns", "seconds", "p", "q", "r"]
    code, out, err = midlie_fit(data, "--scene", "free-body", "--unit", "deg/s", *columns, "--out", picture)
    assert (code, err) == (0, "")
    assert "74 angular velocities at 25 times" in out
    found = {name: float(value) for name, value in re.findall(r"^(\w+\[\d\](?: / \w+\[\d\])?)\s+(-?[\d.]+)", out, re.M)}
    for i in range(3):
        assert abs(found[f"rate[{i}]"] - RATE[i]) < 1e-8
        assert abs(found[f"moments[{i}]"] - MOMENTS[i]) < 1e-8  # their sum is 5.5, which the fit keeps
    assert abs(found["moments[0] / moments[2]"] - MOMENTS[0] / MOMENTS[2]) < 1e-8
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("t,x,y\n0,1,2\n", [], "four columns are needed"),
        ("t,x,y,z\n", [], "no rows of data"),
        ("t,x,y,z\n0,1,2,3\n1,1,two,3\n", [], "line 3: y must be a number, got 'two'"),
        ("t,x,y,z\n0,1,2,3\n", ["--columns", "t", "x", "y", "w"], "no column 'w'; it has t, x, y, z"),
        ("t,x,y,z\n1,1,2,3\n0,1,2,3\n", [], "times must ascend"),
        ("t,x,y,z\n0,,,\n1,,,\n", [], "NaN in every row"),
        ("t,x,y,z\n0,1,2,3\n", [], "two times"),
        ("t,x,y,z\n0,1,2,3\n", ["--sigma", "0"], "must be positive"),
        ("t,x,y,z\n0,1,2,3\n1,1,2,3\n", ["--moments", "1", "1", "9"], "strict triangle"),
    ],
)
def test_one_line_says_what_is_wrong_with_a_file(tmp_path, text, options, message):
    file = tmp_path / "data.csv"
    file.write_text(text)
    code, _, err = midlie_fit(file, "--unit", "rad/s", *options)
    assert code == 2
    assert message in err
    assert err.count("\n") == 1


def test_a_file_that_is_not_there_and_a_unit_that_is_not_said(tmp_path):
    assert midlie_fit(tmp_path / "no.csv", "--unit", "deg/s")[0] == 2
    assert "--unit" in midlie_fit(tmp_path / "no.csv")[2]
