"""Names on ordinary figures, with no layout engine: all inside the picture, none on another panel."""

import itertools

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Text3D

import midlie_jax as ml
from midlie_jax.plot import style

BRICK = ml.RigidBody(np.array([1.0, 2.0, 2.5]))
FLAT, SOLID = {}, {"subplot_kw": {"projection": "3d"}}


@pytest.fixture(scope="module")
def free():
    start = ml.RigidState([0.02, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])
    return ml.free_motion(BRICK, start, jnp.linspace(0.0, 30.0, 301))


@pytest.fixture
def subplots():
    """`plt.subplots`, with the renderer that draws files."""
    plt.switch_backend("agg")
    made = []

    def make(*shape, **options):
        figure, axes = plt.subplots(*shape, **options)
        made.append(figure)
        return figure, np.atleast_1d(axes).ravel()

    yield make
    for figure in made:
        plt.close(figure)


def errors(axes, path, label="a method"):
    ml.plot.conserved(axes, BRICK, None, path, label=label)


def energy_ellipsoid(axes, path):
    ml.plot.polhode(axes, BRICK, path, label="a momentum with a long name")


def sphere(axes, path):
    ml.plot.axis_path(axes, path, axis=1, label="an axis with a long name")


def extent(text, renderer):
    """The extent of a text without its leader; on 3-D axes at the place where it is drawn."""
    if not isinstance(text, Text3D):
        return Text.get_window_extent(text, renderer)
    place, axes = text.get_position_3d(), text.axes
    assert isinstance(axes, Axes3D)
    text.set_position(proj3d.proj_transform(*place, axes.get_proj())[:2])
    found = Text.get_window_extent(text, renderer)
    text.set_position(place[:2])
    return found


def names(axes):
    """The extents of the legend and of the names beside lines, or of the letters at the axes of a body or of space."""
    renderer = axes.figure.canvas.get_renderer()
    shown = [text for text in axes.texts if text.get_text() and text.get_gid() != "midlie_jax.plot.remark"]
    legends = [axes.get_legend().get_window_extent(renderer)] if axes.get_legend() else []
    return [extent(text, renderer) for text in shown] + legends


def assert_all_is_seen(figure):
    """Every name is inside the figure, and no name lies on another panel, on its labels, or on another name."""
    figure.canvas.draw()
    page, renderer = figure.bbox, figure.canvas.get_renderer()
    for axes in figure.axes:
        for name in names(axes):
            assert page.x0 <= name.x0 < name.x1 <= page.x1
            assert page.y0 <= name.y0 < name.y1 <= page.y1
            for other in figure.axes:
                if other is not axes:
                    taken = [other.bbox] if other.name != "3d" else []
                    taken += [other.yaxis.get_tightbbox(renderer)] if other.name != "3d" else []
                    assert not any(name.overlaps(box) for box in (*taken, *names(other)))
    for one, other in itertools.combinations([name for axes in figure.axes for name in names(axes)], 2):
        assert not one.overlaps(other)


@pytest.mark.parametrize(
    ("shape", "options", "draw"),
    [
        ((), FLAT, errors),
        ((), SOLID, energy_ellipsoid),
        ((1, 2), SOLID, energy_ellipsoid),
        ((1, 3), SOLID | {"figsize": (10, 4)}, sphere),
    ],
    ids=["errors", "polhode", "polhodes side by side", "spheres"],
)
def test_names_are_inside_an_ordinary_figure(subplots, free, shape, options, draw):
    figure, panels = subplots(*shape, **options)
    for axes in panels:
        draw(axes, free)
    assert_all_is_seen(figure)
    for axes in panels:
        assert axes.bbox.width > 0.2 * figure.bbox.width / len(panels)  # something is left for the picture


@pytest.mark.parametrize("view", [(30, -60), (0, 0), (90, 0), (10, 100), (-40, 215)])
def test_names_stay_apart_and_in_the_picture_from_every_side(subplots, free, view):
    figure, (axes,) = subplots(**SOLID)
    ml.plot.polhode(axes, BRICK, free)
    other = ml.MomentumState(np.asarray(free.states.momentum) * [1.0, -1.0, 1.0])
    ml.plot.polhode(axes, BRICK, free._replace(states=other), label="the other way", colour=style.VERMILLION)
    axes.view_init(*view)
    assert_all_is_seen(figure)


def test_a_sphere_beside_a_panel_of_errors(subplots, free):
    figure = plt.figure()
    errors(figure.add_subplot(1, 2, 1), free)
    sphere(figure.add_subplot(1, 2, 2, projection="3d"), free)
    assert_all_is_seen(figure)
    plt.close(figure)
    figure = plt.figure(figsize=(9, 4))
    sphere(figure.add_subplot(1, 2, 1, projection="3d"), free)
    errors(figure.add_subplot(1, 2, 2), free)
    assert_all_is_seen(figure)
    plt.close(figure)
