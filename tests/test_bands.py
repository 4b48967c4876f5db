"""Quantile bands: what is drawn are the quantiles of the bodies that did not fail, and all have names."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import midlie_jax as ml

TIMES = np.linspace(0.0, 4.0, 30)
VALUES = np.random.default_rng(0).normal(size=(200, 1)) * np.sin(TIMES) + 0.01 * np.arange(200)[:, None]


@pytest.fixture
def axes():
    figure = Figure(figsize=(6.4, 4.8))
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def names(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_bands_are_quantiles(axes):
    found = ml.plot.bands(axes, TIMES, VALUES, levels=(0.5, 0.9))
    np.testing.assert_allclose(axes.lines[0].get_xydata().T, [TIMES, np.median(VALUES, axis=0)])
    assert (found.bodies, found.failed) == (200, 0)
    assert len(axes.collections) == 2
    for level, drawn in zip((0.9, 0.5), axes.collections, strict=True):
        low, high = np.quantile(VALUES, [(1 - level) / 2, (1 + level) / 2], axis=0)
        np.testing.assert_allclose(found.edges[level], [low, high])
        corners = drawn.get_paths()[0].vertices
        assert corners[:, 1].min() == pytest.approx(low.min())
        assert corners[:, 1].max() == pytest.approx(high.max())
        inside = np.mean((low <= VALUES) & (high >= VALUES))
        assert inside == pytest.approx(level, abs=0.01)
    assert names(axes) == ["90 %", "50 %", "median, 200 bodies"]


def test_failed_bodies_are_left_out_and_counted(axes):
    """To the last bit as if they had not been there."""
    broken = np.concatenate([VALUES[:50], np.full((3, 30), 1e9), VALUES[50:]])
    broken[50, 7], broken[51, 29], broken[52, 0] = np.nan, np.inf, -np.inf
    found, clean = ml.plot.bands(axes, TIMES, broken, label="tops"), ml.plot.bands(axes, TIMES, VALUES)
    assert (found.bodies, found.failed) == (200, 3)
    np.testing.assert_array_equal(found.median, clean.median)
    np.testing.assert_array_equal(found.edges[0.9], clean.edges[0.9])
    assert "tops, 200 bodies, 3 failed and left out" in names(axes)


def test_two_ensembles_are_in_one_legend(axes):
    ml.plot.bands(axes, TIMES, VALUES, label="slow", levels=(0.5,))
    ml.plot.bands(axes, TIMES, 1.01 * VALUES, label="fast", colour="#D55E00", levels=(0.9,))
    assert names(axes) == ["50 %", "slow, 200 bodies", "90 %", "fast, 200 bodies"]


def contrast(colour, background):
    """The ratio of the Web Content Accessibility Guidelines."""

    def luminance(c):
        linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in to_rgb(c)]
        return np.dot([0.2126, 0.7152, 0.0722], linear)

    low, high = sorted((luminance(colour), luminance(background)))
    return (high + 0.05) / (low + 0.05)


def test_light_and_dark(axes):
    """Text has the colour of the axis labels, whatever the style; the line stands out from white and from black."""
    axes.xaxis.label.set_color("#fedcba")
    ml.plot.bands(axes, TIMES, VALUES)
    assert {to_rgb(text.get_color()) for text in axes.get_legend().get_texts()} == {to_rgb("#fedcba")}
    assert all(contrast(axes.lines[0].get_color(), background) > 4 for background in ("white", "black"))


WRONG = {
    "shapes": ((TIMES, VALUES.T), {}, r"times must be \(n,\) and values \(bodies, n\), got \(30,\) and \(30, 200\)"),
    "vectors": ((TIMES, VALUES[..., None]), {}, "For a vector, pass one component"),
    "nothing": ((TIMES, VALUES[:0]), {}, "times must be"),
    "words": ((TIMES, "values"), {}, "must be arrays of numbers, got an array of shape .* and str"),
    "unsorted": ((TIMES[::-1], VALUES), {}, "times must ascend and be finite. Sort"),
    "NaN times": ((TIMES * np.nan, VALUES), {}, "times must ascend"),
    "all failed": ((TIMES, VALUES * np.nan), {}, "finite row, got none in 200 rows.*first_bad"),
    "percent": ((TIMES, VALUES), {"levels": (50.0, 90.0)}, r"levels must be fractions .*got \(50.0, 90.0\)"),
    "no level": ((TIMES, VALUES), {"levels": ()}, "levels must be fractions"),
}


@pytest.mark.parametrize(("arguments", "options", "message"), WRONG.values(), ids=WRONG.keys())
def test_bad_input_is_named(axes, arguments, options, message):
    with pytest.raises(ValueError, match=message):
        ml.plot.bands(axes, *arguments, **options)
    assert not axes.lines
    assert not axes.collections


def test_the_package_imports_no_matplotlib():
    code = (
        "import sys, midlie_jax as ml; print('midlie_jax.plot' in sys.modules, 'matplotlib' in sys.modules); "
        "ml.plot.bands; print('matplotlib' in sys.modules)"
    )
    root = Path(__file__).resolve().parent.parent
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root).stdout
    assert said.split() == ["False", "False", "False"]
