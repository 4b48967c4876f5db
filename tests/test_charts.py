"""The charts as drawn: no two lines alike, every line in the legend, and the numbers that were measured."""

import itertools
import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import midlie_jax as ml
from midlie_jax.cli import charts, convergence, figures, run_chart, scenes
from midlie_jax.cli.record import Record
from midlie_jax.integrators.registry import methods_of_figure_1

FAMILY = [method.name for method in methods_of_figure_1()]
OTHERS = ["LIEMID[new]", "JACOBI[EA]", "SYMMETRIC[SRKN14a]", "DOP853", "RK4", "rival B"]


def rows(names, **changes):
    """Lines of errors that fan out."""
    return [
        convergence.Row(
            method=name,
            dt=0.02 / 2**level,
            steps=500 * 2**level,
            momentum_error=1.3**i * 0.1 / 4**level,
            attitude_error=1.3**i * 0.01 / 4**level,
            evaluations=500 * 2**level * (1 + 20 * (i % 4)),
            seconds=1e-4 * 2**level * (1 + 3 * i),
            ok=True,
            spread=0.3,
        )._replace(**changes)
        for i, name in enumerate(names)
        for level in range(4 if i % 5 else 2)
    ]


def converged(names, **changes):
    return charts.convergence_figure(
        rows(names, **changes), title="a scene", reference="nothing", clock="Some time [s]"
    )


CHARTS = {
    "the paper's methods first": lambda: converged([*FAMILY, *OTHERS]),
    "a ladder of 90 methods": lambda: converged(map(str, range(90))),
}


def marked(panel):
    return [line for line in panel.lines if line.get_marker() not in ("", "None", None)]


@pytest.mark.parametrize("name", CHARTS)
def test_no_two_lines_look_alike_and_all_are_in_the_legend(name):
    figure = CHARTS[name]()
    figure.canvas.draw()
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(set(named)) == len(named)
    for panel in figure.axes:
        looks = [(line.get_color(), line.get_linestyle(), line.get_marker()) for line in marked(panel)]
        assert len(set(looks)) == len(looks)
        assert len({look[0] for look in looks}) >= min(len(looks), 10)
        assert {line.get_label() for line in marked(panel)} <= set(named)


def test_times_carry_their_spread_and_free_bodies_are_charted_against_steps():
    """A bar from 0.7 to 1.3 of each time, in the panel of times alone, and none where the spread is not known."""
    figure = converged(["LIEMID[EA]"], evaluations=0)
    (bars,) = figure.axes[1].collections
    assert figure.axes[1].get_xlabel() == "Some time [s]"
    assert "Steps" in figure.axes[3].get_xlabel()
    middles = figure.axes[1].lines[0].get_xdata()
    for (low, high), middle in zip((segment[:, 0] for segment in bars.get_segments()), middles, strict=True):
        np.testing.assert_allclose((low, high), (0.7 * middle, 1.3 * middle))
    assert not any(figure.axes[i].collections for i in (0, 2, 3))
    assert not converged(["LIEMID[EA]"], spread=math.nan).axes[1].collections


def test_nothing_to_draw_is_said():
    with pytest.raises(ValueError, match="no method gave a finite result"):
        charts.convergence_figure([convergence.Row("SW", 0.1, 10, failure="x")], title="", reference="")


# Machado, Oliveira and Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291: what those see who lack one cone.
VISIONS = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(colour: str, vision) -> np.ndarray:
    """CIELAB of an sRGB colour seen so, white D65."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    xyz = to_xyz @ np.clip(np.asarray(vision) @ linear, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISIONS)
def test_the_colours_differ_in_every_colour_vision(vision):
    """By 15 units of CIELAB and more; 2 are just seen side by side."""
    seen = [lab(colour, VISIONS[vision]) for colour in (*figures.COOL, *figures.WARM)]
    assert min(np.linalg.norm(one - other) for one, other in itertools.combinations(seen, 2)) > 15


def record(name, bodies=1, states=300, **changes):
    """A made-up run: bodies that turn about a slanted axis, their momenta growing a little."""
    scene = scenes.scene(name, "float64")
    times = np.linspace(0, scene.duration, states)
    angle = (np.linspace(0, 40, states) + 0.1 * np.arange(bodies)[:, None])[..., None] / 2
    attitudes = np.concatenate([np.cos(angle), np.sin(angle) * np.array([0.6, 0.0, 0.8])], axis=-1)
    momenta = np.asarray(scene.start.momentum) * (1 + 1e-3 * np.linspace(0, 1, states)[:, None]) * np.ones_like(angle)
    made = Record(scene, "LIEMID[EA]", scene.dt, scene.steps, 1e-3, 0, times, momenta, attitudes, np.full(bodies, True))
    return made._replace(**changes)


def test_the_numbers_of_a_run_are_those_drawn():
    made = record("free-asymmetric", 3)
    energy, momentum, trace, *rates = run_chart.run_figure(made).axes
    grown = 1 + 1e-3 * np.linspace(0, 1, 300)
    np.testing.assert_allclose(energy.lines[1].get_ydata(), grown**2 - 1, atol=1e-12)
    matrices = np.asarray(ml.so3.to_matrix(jnp.asarray(made.attitudes)))
    space = np.einsum("...ij,...j", matrices, made.momenta)
    change = np.linalg.norm(space - space[:, :1], axis=-1) / np.linalg.norm(space[:, :1], axis=-1)
    np.testing.assert_allclose(momentum.lines[1].get_ydata(), change[1], atol=1e-12)
    ends = trace.lines[0].get_xydata()[[0, -1]]
    np.testing.assert_allclose(ends, matrices[0, [0, -1], :2, 2], atol=1e-12)
    moments = np.asarray(made.scene.body.moments)
    for i, panel in enumerate(rates):
        np.testing.assert_allclose(panel.lines[2].get_ydata(), made.momenta[2, :, i] / moments[i], rtol=1e-12)


def test_a_run_that_failed_is_drawn_as_far_as_it_went():
    made = record("P1", 2)
    made.momenta[1, 100:] = np.nan
    made.attitudes[1, 100:] = np.nan
    figure = run_chart.run_figure(made._replace(ok=np.array([True, False])))
    figure.canvas.draw()
    assert "FAILED for 1 of 2" in " ".join(figure.texts[1].get_text().split())
    assert np.isfinite(figure.axes[0].lines[0].get_ydata()).all()
    assert np.isfinite(figure.axes[0].lines[1].get_ydata()[:100]).all()


@pytest.mark.parametrize("name", ["pulsed-body", "thrown-brick"])
def test_a_run_is_drawn_with_units(name):
    made = record(name, 1, 6)
    if name == "thrown-brick":
        scene = made.scene
        path = ml.integrate(scene.method, scene.body, scene.torque, scene.start, dt=scene.dt, steps=20, save_every=4)
        path = jax.tree.map(lambda x: jnp.asarray(x)[None], path)
        made = Record.of(scene, scene.method, scene.dt, 20, 0.0, 0, path)
    figure = run_chart.run_figure(made)
    figure.canvas.draw()
    for panel in figure.axes:
        assert re.search(r"\[.+\]", panel.get_ylabel())
        assert re.search(r"\[.+\]", panel.get_xlabel() or "[-]")
    unit = made.scene.time_unit or "time"
    assert [f"rad/{unit}]" in panel.get_ylabel() for panel in figure.axes].count(True) == 3
    assert len(figure.axes) == (8 if name == "thrown-brick" else 6)
