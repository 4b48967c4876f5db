"""The claims: each measurement on maps and methods that have a property and on some that lack it; the verdicts.

The published drifts are in test_drift.py.
"""

import argparse
from functools import cache

import numpy as np
import pytest
from cases import benchmark

import midlie_jax as ml
from midlie_jax.integrators.registry import ENTRIES

script = command = measure = structure = verdicts = benchmark("claims")
Bench, work = script.Bench, script.work
HAS, LACKS, PAPERS = "JACOBI[EA]", "RK4", "LIEMID[EA]"
STEPS = 2000


@cache
def bench():
    return Bench(STEPS)


@cache
def measured(name):
    return bench().measure(ml.method(name))


@pytest.mark.parametrize(("stretch", "defect", "area"), [(1.0, 0, 0), (1.01, 0.013, 0.0201)])
def test_defects_of_a_map_that_is_known(stretch, defect, area):
    """The exact flow of a ball; a stretch of the momentum by 1 + e changes the form by e times its entries, at most 1.3
    here, and areas by (1 + e)^2 - 1."""
    start = np.array([1.0, 0.8, -1.3])
    states = structure.neighbours(start, np.array([0.5, 0.5, -0.5, 0.5]))
    turns = ml.so3.exp(0.7 * states.momentum)
    momentum = stretch * ml.so3.rotate(ml.so3.conjugate(turns), states.momentum)
    matrix = structure.derivative(ml.RigidState(momentum, ml.so3.multiply(states.attitude, turns)))
    after = np.asarray(momentum[0])
    assert abs(structure.symplectic_defect(matrix, start, after) - defect) < 1e-12
    assert abs(structure.area_defect(matrix, start, after) - area) < 1e-12


@pytest.mark.parametrize(("name", "explicit"), [(PAPERS, True), (HAS, True), (LACKS, True), ("AKW", False)])
def test_the_work_of_a_step_is_what_the_registry_declares(name, explicit):
    assert work(ml.method(name)) == (ml.method(name).evaluations, explicit)


@pytest.mark.sample(0)
def test_properties_are_seen_where_they_are_and_missed_where_they_are_not():
    """Also the accuracy on P1 of the published table, whose error of R is the root of two times the angle."""
    for name, has in ((HAS, True), (LACKS, False)):
        found, order = measured(name), ml.method(name).order
        tests = verdicts.keeps_momentum, verdicts.is_symplectic, verdicts.keeps_area, verdicts.comes_back
        assert {test(found) for test in (*tests, verdicts.has_no_drift)} == {has}
        assert found.ok
        assert abs(found.order - order) < 0.1
    assert measured(HAS).accuracy_p1 * 2**0.5 == pytest.approx(3.2e-6, rel=0.1)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("drift", "noise", "holds"), [(0.0, 1.0, True), (0.5, 1.0, False), (1e-14, 1e-15, True)])
def test_a_trend_is_told_from_an_oscillation_and_from_rounding(drift, noise, holds):
    """A ramp of `drift`, and the oscillation of a thousand turns with the root mean square `noise`."""
    time = np.linspace(0, 1, 4000)[:, None]
    energy = drift * time + noise * 2**0.5 * np.sin(2000 * time + np.arange(16))
    assert verdicts.has_no_trend(measured(HAS)._replace(energy=energy)) == holds


@pytest.mark.sample(0)
def test_verdicts_are_computed_from_the_figures():
    """The best is the best on both scenes, and the paper's method gets the verdicts of the figures that it is given."""
    names = [PAPERS, HAS, "NMB"]
    methods, errors = [ml.method(name) for name in names], zip(names, (1.0, 2.0, 3.0), (1.0, 2.0, 0.9), strict=True)
    found = [measured(HAS)._replace(method=name, accuracy=a, accuracy_p1=b) for name, a, b in errors]
    assert not verdicts.ranked(found[0], methods, found, verdicts.of_its_kind)[1]  # NMB is better on P1
    assert verdicts.ranked(found[0], methods[:2], found[:2], verdicts.of_its_kind)[1]
    for source, word in ((HAS, True), (LACKS, False)):
        given = [measured(source)._replace(method=PAPERS)]
        by_claim = {v.claim: v.holds for v in verdicts.paper_verdicts([ml.method(PAPERS)], given)}
        assert by_claim["symplectic on T*SO(3)"] == by_claim["conserves momentum"] == word
    assert all(v.holds for v in verdicts.registry_verdicts(ml.method(HAS), measured(HAS)))
    falls = [v.key for v in verdicts.registry_verdicts(ml.method(HAS), measured(LACKS)) if not v.holds]
    assert {"momentum", "symplectic", "area", "symmetric", "no drift", "evaluations"} <= set(falls)


@pytest.mark.sample(0)
def test_the_command_prints_and_writes_figures_and_verdicts(monkeypatch, tmp_path, capsys):
    """With what the tests have measured already."""
    monkeypatch.setattr(measure, "_PARTING", (1,))
    monkeypatch.setattr(command, "Bench", lambda *steps: bench())
    monkeypatch.setattr(command, "_measured", lambda bench, methods: [measured(m.name) for m in methods])
    files = ["--page", str(tmp_path / "page.md"), "--out", str(tmp_path / "energy.png")]
    script.main(["--methods", HAS, LACKS, "--steps", str(STEPS), *files])
    assert "declarations of the registry hold" in capsys.readouterr().out
    text = (tmp_path / "page.md").read_text()
    assert f"| `{HAS}` | drift -1.05e-03 -> -1.05e-03 |" in text
    assert (
        ",holds,python benchmarks/claims.py --methods 'JACOBI[EA]'\n"
        in (tmp_path / "tables" / "claims-drifts.csv").read_text()
    )
    assert (tmp_path / "energy.png").read_bytes().startswith(b"\x89PNG")


def test_the_default_methods_are_on_the_page():
    """Those of the paper and one of each flight and scheme."""

    def chosen(every):
        return [m.name for m in command._methods(argparse.Namespace(methods=None, all=every))]

    rigid = {n: e for n, e in ENTRIES.items() if issubclass(ml.RigidBody, e.method.bodies)}
    assert {name for name, entry in rigid.items() if entry.paper} <= set(chosen(False))
    assert len(chosen(False)) < len(rigid) < len(chosen(True))
    saved = benchmark("harness").saved
    for name in ("figures", "declared"):
        assert [row["method"] for row in saved(f"claims-{name}")] == chosen(False)
