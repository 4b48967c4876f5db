"""The charts as drawn: no two lines alike, every line in the legend, nothing off the picture."""

import itertools
import math
import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from laboratory import rivals, work_precision
from laboratory.frontier import FAMILIES
from laboratory.frontier_chart import BANDS, LEGEND, work_precision_figure
from laboratory.rivals.problem import Point
from matplotlib.text import Text

from midlie_jax.cli import charts, convergence, figures, run_chart, scenes
from midlie_jax.cli.record import Record
from midlie_jax.integrators.registry import methods_of_figure_1

NOTE = (
    "1024 bodies side by side, one core, float64. Errors against the Taylor series in 38 digits (heyoka, MPFR), good "
    f"to 2e-16. {LEGEND}"
)
TITLES = [f"{name}: {scenes.scene(name).title}, T = {scenes.scene(name).duration:g}" for name in scenes.scenes()]
REFERENCE = "extrapolation of LIEMID[EA] from up to 128000 steps"
LONGEST = max(TITLES, key=len)
METHODS = [
    *(method.name for method in methods_of_figure_1()),
    "LIEMID[new]",
    "JACOBI[EA]",
    "SYMMETRIC[SRKN14a]",
    "DOP853",
    "RK4",
    "rival B",
]
OTHERS_FIRST = [*METHODS[:5], "JACOBI[EA]", "DOP853", "RK4", "DLM[EA]", "LIEMID[new]", *METHODS[5:8], "rival B"]


def rows(names, bend=0.01, spread=0.02):
    """Lines that all but coincide at their fine ends, or fan out for a larger `bend`."""
    return [
        convergence.Row(
            method=name,
            dt=0.02 / 2**level,
            steps=500 * 2**level,
            momentum_error=(1 + bend) ** i * 0.1 / 4**level,
            attitude_error=(1 + bend) ** i * 0.01 / 4**level,
            evaluations=500 * 2**level * (1 + 20 * (i % 4)),
            seconds=1e-4 * 2**level * (1 + 10 * bend * i),
            ok=True,
        )._replace(**({"spread": spread} if "spread" in convergence.Row._fields else {}))
        for i, name in enumerate(names)
        for level in range(4 if i % 5 else 2)
    ]


def points(names, bend, orders=(4,)):
    """Lines of points, all but coinciding or fanning out, of many orders."""
    return [
        Point(name, "", ((1 + bend) ** i / n) ** orders[i % len(orders)], 1e-6 * (1 + bend * i) * n, 2.0 * n, float(n))
        for i, name in enumerate(names)
        for n in (2, 7, 20, 70)[: 4 - (i % 3 == 2)]
    ]


def frontier_points(scene, bend, orders):
    ours = points(work_precision.methods_for(scenes.scene(scene)), bend, orders)
    return ours, points([rival.label for rival in rivals.RIVALS], bend, orders), work_precision.families_of(ours)


def kinds_of_chart():
    """Every kind of chart with the largest sets of lines that occur, crowded and spread out."""
    for bend in (0.01, 0.3):
        for label, names in (("convergence", METHODS), ("convergence-others-first", OTHERS_FIRST)):
            yield (
                f"{label}-{bend}",
                lambda bend=bend, names=names: charts.convergence_figure(
                    rows(names, bend), title=LONGEST, reference=REFERENCE
                ),
            )
        for scene in ("P1", "asymmetric-top", "tumbling-brick"):  # two equal moments, three moments, a free body
            for orders in ((4,), (2, 4, 8)):
                yield (
                    f"frontier-{scene}-{bend}-{orders}",
                    lambda scene=scene, bend=bend, orders=orders: work_precision_figure(
                        *frontier_points(scene, bend, orders), title=LONGEST, note=NOTE
                    ),
                )


CHARTS = dict(kinds_of_chart())


@pytest.fixture(scope="module", params=CHARTS)
def figure(request):
    made = CHARTS[request.param]()
    made.canvas.draw()
    return made


def lines(panel):
    return [line for line in panel.lines if line.get_marker() not in ("", "None", None)]


def is_frontier(figure):
    return len(figure.axes) == 2


def looks(line):
    return line.get_color(), line.get_linestyle(), line.get_marker()


@pytest.mark.sample(1)
def test_no_two_lines_look_alike(figure):
    for panel in figure.axes:
        found = [looks(line) for line in lines(panel)]
        assert len(set(found)) == len(found)
    assert len(lines(figure.axes[0])) > (8 if is_frontier(figure) else 12)


@pytest.mark.sample(3)
def test_every_line_is_in_the_legend_which_covers_no_panel(figure):
    """On a chart of frontiers, the families are named too, and the right panel has five lines at most."""
    (legend,) = figure.legends
    named = [text.get_text() for text in legend.get_texts()]
    assert len(set(named)) == len(named)
    assert {line.get_label() for panel in figure.axes for line in lines(panel)} <= set(named)
    if is_frontier(figure):
        assert set(FAMILIES) <= set(named)
        assert 0 < len(lines(figure.axes[1])) <= 5
    box = legend.get_window_extent(figure.canvas.get_renderer())
    assert figure.bbox.x0 <= box.x0
    assert box.x1 <= figure.bbox.x1
    assert not any(box.overlaps(panel.bbox) for panel in figure.axes)


def test_the_frontiers_look_the_same_in_both_panels_and_stand_out():
    """Each is wider than any single line, and each narrower than the one below: where they coincide, all are seen."""
    made = CHARTS["frontier-asymmetric-top-0.3-(2, 4, 8)"]()
    for panel in made.axes:
        bold = [line for line in panel.lines if line not in lines(panel)]
        assert [(line.get_label(), line.get_color()) for line in bold] == [
            (k, band.colour) for k, band in BANDS.items()
        ]
        widths = [line.get_linewidth() for line in bold]
        assert all(below > above + 2 for below, above in itertools.pairwise(widths))
        assert min(widths) > 1.5 * max(line.get_linewidth() for line in lines(panel))


@pytest.mark.parametrize("names", [METHODS[:10], METHODS[6:], ["JACOBI[EA]", "RK4", "GBS12", "SYMMETRIC[EA]"]])
def test_up_to_ten_lines_have_ten_colours(names):
    panel = charts.convergence_figure(rows(names), title="", reference="").axes[0]
    assert len({line.get_color() for line in lines(panel)}) == len(names) <= 10


def test_the_families_have_colours_of_ours_each_its_own():
    """So they differ from each other and from the rivals' in every colour vision, as those do."""
    colours = [BANDS[name].colour for name in FAMILIES]
    assert len(set(colours)) == len(FAMILIES)
    assert set(colours) <= set(figures.COOL)


@pytest.mark.parametrize(("ours", "others"), [(["DOP853"], []), ([], ["heyoka"]), (["DOP853"], ["heyoka"])])
def test_a_chart_of_few_lines_is_drawn(ours, others):
    ours, others = points(ours, 0.01), points(others, 0.01)
    figure = work_precision_figure(ours, others, work_precision.families_of(ours), title="", note="")
    figure.canvas.draw()
    shown = {text.get_text() for text in figure.legends[0].get_texts()}
    assert shown == {p.method for p in ours + others} | (set(FAMILIES[:1]) if ours else set())


@pytest.mark.sample(1)
def test_the_heading_touches_no_panel_and_fits(figure):
    renderer = figure.canvas.get_renderer()
    heads = [text.get_window_extent(renderer) for text in figure.texts]
    assert not heads[0].overlaps(heads[1])
    for head in heads:
        assert head.x0 >= 0
        assert head.x1 <= figure.bbox.x1
        assert head.y1 <= figure.bbox.y1
        for panel in figure.axes:
            assert head.y0 - panel.get_tightbbox(renderer).y1 > 2  # pixels


@pytest.mark.sample(5)
@pytest.mark.parametrize("title", TITLES)
def test_every_scene_title_fits(title):
    busy = "The machine was busy. " * 12
    one = charts.convergence_figure(rows(["LIEMID[EA]"]), title=title, reference="nothing", timing=busy)
    for text in one.texts:
        assert text.get_window_extent(one.canvas.get_renderer()).x1 <= one.bbox.x1


@pytest.mark.parametrize("side", ["left", "right"])
def test_up_to_eight_names_are_beside_their_lines_and_more_in_a_legend(side):
    for count in (8, 9):
        figure = figures.new_figure(6.0, 5.0)
        axes = figure.add_subplot()
        ends = [figures.End(f"method {i}", figures.COOL[i % 5], 2.0, 1 + 0.001 * i) for i in range(count)]
        for end in ends:
            axes.plot([1.0, 2.0], [0.0, end.y], color=end.colour)
        axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())
        figures.label_ends(axes, ends, side)
        figure.canvas.draw()
        beside, legend = [text.get_text() for text in axes.texts], axes.get_legend()
        named = [text.get_text() for text in legend.get_texts()] if legend else []
        assert (beside if count == 8 else named) == [end.name for end in ends]
        assert not (named if count == 8 else beside)
        boxes = [Text.get_window_extent(text, figure.canvas.get_renderer()) for text in axes.texts]
        assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
        assert all(axes.bbox.x0 - 1 < one.x0 < one.x1 < axes.bbox.x1 + 1 for one in boxes)


def test_styles_run_out_for_nobody():
    fixed = {"AKW": figures.Style(figures.WARM[0], "o", figures.DASHED, False)}
    found = figures.styles(["AKW", *map(str, range(200))], figures.WARM, figures.DASHED, ours=False, fixed=fixed)
    assert found["AKW"] == fixed["AKW"]
    assert len({(style.colour, style.mark, style.dash) for style in found.values()}) == 201


# Machado, Oliveira and Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291: what those see who lack one cone.
VISIONS = {
    "all cones": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
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


def test_times_carry_their_spread():
    """A bar from 0.7 to 1.3 of each time, in the panel of times alone, and none where the spread is not known."""
    figure = charts.convergence_figure(rows(["LIEMID[EA]"], spread=0.3), title="", reference="", clock="Some time [s]")
    (bars,) = figure.axes[1].collections
    assert figure.axes[1].get_xlabel() == "Some time [s]"
    middles = figure.axes[1].lines[0].get_xdata()
    for (low, high), middle in zip((segment[:, 0] for segment in bars.get_segments()), middles, strict=True):
        np.testing.assert_allclose((low, high), (0.7 * middle, 1.3 * middle))
    assert not any(figure.axes[i].collections for i in (0, 2, 3))
    unknown = charts.convergence_figure(rows(["LIEMID[EA]"], spread=math.nan), title="", reference="")
    assert not unknown.axes[1].collections


def test_free_bodies_are_charted_against_steps():
    free = [row._replace(evaluations=0) for row in rows(["LIEMID[EA]", "NMB"])]
    figure = charts.convergence_figure(free, title="free", reference="nothing")
    assert "Steps" in figure.axes[3].get_xlabel()


def test_nothing_to_draw_is_said():
    with pytest.raises(ValueError, match="no method gave a finite result"):
        charts.convergence_figure([convergence.Row("SW", 0.1, 10, failure="x")], title="", reference="")
    with pytest.raises(ValueError, match="no method gave a finite result"):
        work_precision_figure([], [], {}, title="", note="")


def record(name, bodies=1, states=300, **changes):
    """A made-up run: bodies that turn about a slanted axis, their momenta growing a little."""
    scene = replace(scenes.scene(name, "float64"))
    times = np.linspace(0, scene.duration, states)
    angle = (np.linspace(0, 40, states) + 0.1 * np.arange(bodies)[:, None])[..., None] / 2
    attitudes = np.concatenate([np.cos(angle), np.sin(angle) * np.array([0.6, 0.0, 0.8])], axis=-1)
    momenta = np.asarray(scene.start.momentum) * (1 + 1e-3 * np.linspace(0, 1, states)[:, None]) * np.ones_like(angle)
    made = Record(scene, "LIEMID[EA]", scene.dt, scene.steps, 1e-3, 0, times, momenta, attitudes, np.full(bodies, True))
    return made._replace(**changes)


@pytest.mark.sample(1)
@pytest.mark.parametrize("bodies", [1, 40])
@pytest.mark.parametrize("name", ["P1", "bruls-cardona", "free-asymmetric", "gravity-gradient", "pulsed-body"])
def test_a_run_is_drawn_with_units_and_without_collisions(name, bodies):
    """Free and forced, kept or not, about another axis than the third, one body and many."""
    made = record(name, bodies)
    figure = run_chart.run_figure(made)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    for panel in figure.axes:
        assert re.search(r"\[.+\]", panel.get_ylabel())
        if panel.get_xlabel():
            assert re.search(r"\[.+\]", panel.get_xlabel())
    energy, momentum, trace, *rates = figure.axes
    assert len(rates) == 3
    unit = "[time]" if name in ("P1", "free-asymmetric") else "[s]"
    assert all(unit in panel.get_xlabel() for panel in (energy, momentum, rates[2]))
    assert all(f"rad/{unit[1:]}" in panel.get_ylabel() for panel in rates)
    assert ("axis e2" if name == "bruls-cardona" else "axis e3") in trace.get_title(loc="left")
    shown = min(bodies, 3)
    assert len([line for line in energy.lines if len(line.get_xdata()) == 300]) == shown
    assert bool(energy.collections) == (bodies > 1)  # the band
    extents = [panel.get_tightbbox(renderer) for panel in figure.axes]
    for one, other in itertools.combinations(extents[:3], 2):
        assert not one.overlaps(other)
    for one in extents:
        assert one.x0 >= 0
        assert one.x1 <= figure.bbox.x1
        assert one.y0 >= 0
        assert one.y1 < min(text.get_window_extent(renderer).y0 for text in figure.texts)
    assert all(not extents[i].overlaps(extents[j]) for i in (0, 1, 2) for j in (3, 4, 5))
    for panel in (energy, momentum, trace):
        small = [text for text in (*panel.texts, panel.yaxis.get_offset_text(), panel._left_title) if text.get_text()]
        for one, other in itertools.combinations([Text.get_window_extent(text, renderer) for text in small], 2):
            assert not one.overlaps(other)


def test_the_numbers_of_a_run_are_those_drawn():
    made = record("free-asymmetric", 3)
    energy, momentum, trace, *rates = run_chart.run_figure(made).axes
    grown = 1 + 1e-3 * np.linspace(0, 1, 300)
    np.testing.assert_allclose(energy.lines[1].get_ydata(), grown**2 - 1, atol=1e-12)
    matrices = np.asarray(ml_matrices(made.attitudes))
    space = np.einsum("...ij,...j", matrices, made.momenta)
    change = np.linalg.norm(space - space[:, :1], axis=-1) / np.linalg.norm(space[:, :1], axis=-1)
    np.testing.assert_allclose(momentum.lines[1].get_ydata(), change[1], atol=1e-12)
    np.testing.assert_allclose(trace.lines[0].get_xdata(), matrices[0, :, 0, 2], atol=1e-12)
    np.testing.assert_allclose(trace.lines[0].get_ydata(), matrices[0, :, 1, 2], atol=1e-12)
    moments = np.asarray(made.scene.body.moments)
    for i, panel in enumerate(rates):
        np.testing.assert_allclose(panel.lines[2].get_ydata(), made.momenta[2, :, i] / moments[i], rtol=1e-12)


def ml_matrices(quaternions):
    from midlie_jax.model import so3

    return so3.to_matrix(jnp.asarray(quaternions))


def test_a_run_that_failed_is_drawn_as_far_as_it_went():
    made = record("P1", 2)
    made.momenta[1, 100:] = np.nan
    made.attitudes[1, 100:] = np.nan
    figure = run_chart.run_figure(made._replace(ok=np.array([True, False])))
    figure.canvas.draw()
    assert "FAILED for 1 of 2" in " ".join(figure.texts[1].get_text().split())
    assert np.isfinite(figure.axes[0].lines[0].get_ydata()).all()
    assert np.isfinite(figure.axes[0].lines[1].get_ydata()[:100]).all()
