"""`midlie stability`: what it varies, what it draws, and how it fails."""

import contextlib
import io

import numpy as np
import pytest

import midlie_jax as ml
from midlie_jax.cli import scenes, stability
from midlie_jax.cli.main import main
from midlie_jax.cli.stability import stability_figure


def midlie(*arguments: str) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(["stability", *arguments])
    return code, out.getvalue(), err.getvalue()


@pytest.mark.sample(0)
def test_the_command_measures_and_draws(tmp_path):
    png = tmp_path / "maps.png"
    options = ["--methods", "SYMMETRIC[EA]", "--grid", "3", "--steps", "100", "--out", str(png)]
    code, out, err = midlie("compass", *options)
    assert (code, err) == (0, "")
    assert [line.split()[:2] for line in out.splitlines()[2:5]] == [
        ["SYMMETRIC[EA]", name] for name in ("spin", "anisotropy", "stiffness")
    ]
    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert 10_000 < png.stat().st_size < 250_000
    assert f"wrote {png}" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "unknown scene 'nowhere'"),
        (["P1", "--methods", "Verlet"], "'Verlet' does not support a rigid body"),
        (["asymmetric-top", "--methods", "SYMMETRIC[EA]"], "SYMMETRIC needs bodies with two equal moments"),
        (["pulsed-body"], "'pulsed-body' has no constant energy"),
        (["gravity-gradient"], "'gravity-gradient' has no constant energy"),
        (["P1", "--grid", "1"], "--grid"),
        (["P1", "--sweeps", "colour"], "invalid choice: 'colour'"),
        (["tumbling-brick", "--sweeps", "spin", "stiffness"], "has no stiffness to vary; it has spin, anisotropy"),
        (["P1", "--out", "maps.pdf"], "must end in .png"),
    ],
)
def test_a_mistake_is_one_line(arguments, words):
    code, out, err = midlie(*arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.sample(0)
def test_the_sweeps_that_are_asked_for_are_measured_alone(tmp_path):
    options = ["--methods", "SYMMETRIC[EA]", "--grid", "2", "--steps", "20", "--out", str(tmp_path / "maps.png")]
    code, out, err = midlie("compass", *options, "--sweeps", "stiffness")
    assert (code, err) == (0, "")
    assert [line.split()[1] for line in out.splitlines()[2:3]] == ["stiffness"]
    assert out.count("SYMMETRIC[EA]") == 1


@pytest.mark.parametrize("name", ["P1", "asymmetric-top", "tumbling-brick"])
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


def test_lines_are_the_limits_at_each_value():
    scene, method = scenes.scene("compass"), ml.method("SYMMETRIC[EA]")
    _, (_, _, field) = stability.sweeps(scene, 5)
    found = {line.kind: line.steps for line in stability.lines(method, scene, field)}
    np.testing.assert_allclose(found["stability"], 2 / field.values, rtol=2e-3)
    np.testing.assert_allclose(found["reach"], method.reach / 0.6)


def test_failures_are_hatched_and_runs_that_blow_up_are_black():
    scene = scenes.scene("compass")
    steps, sweeps = stability.sweeps(scene, 2)
    nothing = np.zeros((2, 2), bool)
    failed, blown_up = nothing.copy(), nothing.copy()
    failed[0, 1], blown_up[1, 1] = True, True
    found = [stability.Map("SYMMETRIC[EA]", np.full((2, 2), 1e-3), failed, blown_up)] * len(sweeps)
    figure = stability_figure([found], {}, steps, sweeps, title="t", note="n", time_unit="s")
    colours, black = figure.axes[0].collections
    np.testing.assert_array_equal(np.ma.getmaskarray(colours.get_array()).reshape(2, 2), failed | blown_up)
    np.testing.assert_array_equal(np.ma.getmaskarray(black.get_array()).reshape(2, 2), ~blown_up)
    assert figure.axes[0].patches[0].get_hatch()
    assert [axes.get_ylabel() for axes in figure.axes[:3]] == [sweep.label for sweep in sweeps]
