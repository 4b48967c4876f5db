"""The `midlie` command as a user sees it: what it prints, what it writes, how it fails; and the charts' numbers."""

import contextlib
import io
import itertools
import math
import struct
from collections import defaultdict
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from matplotlib.text import Text

import midlie_jax as ml
from midlie_jax import charts, cli, convergence, scenes

BROKEN = "SW"


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


def midlie(*arguments: str) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main(arguments)
    return Outcome(code, out.getvalue(), err.getvalue())


def test_methods_lists_every_method_with_its_order():
    outcome = midlie("methods")
    assert outcome.code == 0
    lines = {name: line for line in outcome.out.splitlines() for name in ml.methods() if line.startswith(f"{name}  ")}
    assert list(lines) == ml.methods()
    assert all(f" {ml.method(name).order} " in line for name, line in lines.items())


def test_scenes_lists_every_scene():
    outcome = midlie("scenes")
    assert outcome.code == 0
    assert [line.split()[0] for line in outcome.out.splitlines()[2:]] == scenes.scenes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nowhere"], ["unknown scene 'nowhere'", "P1"]),
        (["run", "P1", "--method", "nobody"], ["unknown method 'nobody'", "LIEMID[EA]"]),
        (["run", "P1", "--method", "Verlet"], ["moves Particles"]),
        (["run", "P1", "--dt", "0"], ["dt must be finite and not zero"]),
        (["run", "P1", "--steps", "-3"], ["--steps", "must be positive"]),
        (["run", "P1", "--steps", "many"], ["--steps", "many"]),
        (["chart", "nowhere"], ["unknown scene 'nowhere'"]),
        (["chart", "--methods", "nobody"], ["unknown method 'nobody'"]),
        (["chart", "--methods", "Verlet"], ["'Verlet' does not move a rigid body"]),
        (["chart", "--out", "no/such/folder/x.png"], ["no such folder"]),
        (["paint"], ["paint", "chart"]),
        ([], ["COMMAND"]),
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


@pytest.mark.parametrize("package", ["matplotlib", "tqdm", "mpmath"])
def test_a_missing_extra_is_named_before_anything_is_measured(package, monkeypatch):
    find_spec = cli.find_spec
    monkeypatch.setattr(cli, "find_spec", lambda name: None if name == package else find_spec(name))
    outcome = midlie("chart")
    assert outcome.code == 2
    assert package in outcome.err
    assert "midlie_jax[cli]" in outcome.err
    assert outcome.out == ""


def facts(outcome: Outcome) -> dict[str, str]:
    """What `run` prints, by its left column."""
    assert outcome.code == 0, outcome.err
    pairs = (line.strip().split("  ", 1) for line in outcome.out.splitlines()[1:])
    return {name: value.strip() for name, value in pairs}


def test_run_reports_the_conservation_laws_of_a_batch_of_tops():
    outcome = midlie("run", "P1", "--bodies", "3", "--steps", "100", "--dt", "0.01", "--method", "LIEMID[E2]")
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


def test_run_of_a_free_body_keeps_all_of_the_spatial_momentum():
    seen = facts(midlie("run", "tumbling-brick", "--steps", "50"))
    size, what = seen["momentum error, largest relative"].split(maxsplit=1)
    assert float(size) < 50 * 8 * np.finfo(float).eps
    assert "all of it" in what


def test_run_in_single_precision_says_what_is_not_conserved():
    outcome = midlie("run", "pulsed-body", "--steps", "30", "--float32", "--method", "LIEMID[E1]")
    seen = facts(outcome)
    assert "float32" in outcome.out
    assert "no potential" in seen["energy error, largest relative"]
    assert "not conserved" in seen["momentum error, largest relative"]


def test_chart_measures_draws_and_survives_a_broken_method(tmp_path, monkeypatch):
    """Two methods that work and, first, one that does not, on the first half second of the slow top.

    So soon the error of LIEMID[E1] is of first order still; later the terms that grow with time, of second order,
    rule (it is conjugate to a symmetric method). One test, because measuring takes seconds.
    """

    def integrate(method, *arguments, **options):
        if method.name == BROKEN:
            raise RuntimeError("this one is broken\nand says so at length")
        return ml.integrate(method, *arguments, **options)

    short = replace(scenes.scene("slow-top"), duration=0.5)
    monkeypatch.setattr(convergence, "integrate", integrate)
    monkeypatch.setattr(scenes, "scene", lambda name, dtype=None: short)
    png = tmp_path / "figure.png"
    methods = (BROKEN, "LIEMID[EA]", "LIEMID[E1]")
    outcome = midlie("chart", "slow-top", "--out", str(png), "--steps", "64", "--levels", "3", "--methods", *methods)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "closed form of Lagrange's top" in outcome.out
    assert "run/s" in outcome.err or "s/run" in outcome.err  # the progress bar

    failed = [line for line in outcome.out.splitlines() if line.startswith(BROKEN)]
    assert len(failed) == 3
    assert all("failed: RuntimeError: this one is broken" in line for line in failed)

    slopes = defaultdict(list)
    for cells in map(str.split, outcome.out.splitlines()):
        if cells and cells[0] in methods and cells[-1] == "yes" and len(cells) == 10:
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


def made_up_rows(names: list[str]) -> list[convergence.Row]:
    """Lines that all but coincide at their fine ends: the hardest to label."""
    return [
        convergence.Row(
            method=name,
            dt=0.02 / 2**level,
            steps=500 * 2**level,
            momentum_error=(1 + 0.01 * i) * 0.1 / 4**level,
            attitude_error=(1 + 0.01 * i) * 0.01 / 4**level,
            evaluations=500 * 2**level * (1 + i // 4),
            seconds=1e-4 * 2**level * (1 + i / 10),
            ok=True,
        )
        for i, name in enumerate(names)
        for level in range(4)
    ]


def test_labels_never_overlap():
    names = [*convergence.body_methods(), "LIEMID[new]", "rival A", "rival B"]
    figure = charts.convergence_figure(made_up_rows(names), title="made up", reference="nothing")
    figure.canvas.draw()
    for panel in figure.axes:
        labels = [text for text in panel.texts if text.get_text() in names]
        assert sorted(label.get_text() for label in labels) == sorted(names)
        # An annotation's own extent includes its leader line; that of the text alone does not.
        boxes = [Text.get_window_extent(label, figure.canvas.get_renderer()) for label in labels]
        for one, other in itertools.combinations(boxes, 2):
            assert not one.overlaps(other)
        for box in boxes:
            assert figure.bbox.containsx(box.x0)
            assert figure.bbox.containsx(box.x1)


def test_free_bodies_are_charted_against_steps():
    rows = [row._replace(evaluations=0) for row in made_up_rows(["LIEMID[EA]", "NMB"])]
    figure = charts.convergence_figure(rows, title="free", reference="nothing")
    assert "Steps" in figure.axes[3].get_xlabel()


def test_nothing_to_draw_is_said():
    with pytest.raises(ValueError, match="no method gave a finite result"):
        charts.convergence_figure([convergence.Row("SW", 0.1, 10, failure="x")], title="", reference="")


def test_ladder_doubles_and_follows_the_figure_for_p1():
    assert convergence.ladder(scenes.scene("P1")) == [500, 1000, 2000, 4000, 8000]
    assert convergence.ladder(scenes.scene("slow-top"), levels=2)[0] * 2 == scenes.scene("slow-top").steps
    with pytest.raises(ValueError, match="must be positive"):
        convergence.ladder(scenes.scene("P1"), coarsest=0)


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
    monkeypatch.setattr(convergence, "_closed_form", lambda scene: None)
    found = convergence.find_reference(scene, 1000)
    assert "extrapolation" in found.source
    assert found.uncertainty < 1e-6
    assert not math.isnan(found.uncertainty)
    np.testing.assert_allclose(found.attitude, exact.attitude, atol=2 * found.uncertainty)
    scale = float(np.linalg.norm(exact.momentum))
    np.testing.assert_allclose(found.momentum, exact.momentum, atol=2 * found.uncertainty * scale)
