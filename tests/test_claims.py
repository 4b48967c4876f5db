"""The claims: each measurement on maps and methods that have a property and on some that lack it; the verdicts.

The published drifts are in test_scenes.py.
"""

import argparse
from functools import cache

import jax
import numpy as np
import pytest
from cases import benchmark
from harness import saved
from laboratory.claims import command, measure, page, structure, verdicts
from laboratory.claims.counting import work
from laboratory.claims.measure import Bench

import midlie_jax as ml
from midlie_jax.integrators.registry import ENTRIES
from midlie_jax.integrators.runge_kutta import RK4, RungeKutta

script = benchmark("claims")

HAS, LACKS, PAPERS = "JACOBI[EA]", "RK4", "LIEMID[EA]"
STEPS = 2000


@cache
def bench():
    return Bench(STEPS)


@cache
def measured(name):
    return bench().measure(ml.method(name))


START, ATTITUDE = np.array([1.0, 0.8, -1.3]), np.array([0.5, 0.5, -0.5, 0.5])


def ball(states, stretch=1.0):
    """The exact flow of a ball, with the momentum stretched at the end."""
    turns = ml.so3.exp(0.7 * states.momentum)
    momentum = ml.so3.rotate(ml.so3.conjugate(turns), states.momentum)
    return ml.RigidState(stretch * momentum, ml.so3.multiply(states.attitude, turns))


@pytest.mark.sample(1)
@pytest.mark.parametrize(("stretch", "defect", "area"), [(1.0, 0, 0), (1.01, 0.013, 0.0201)])
def test_defects_of_a_map_that_is_known(stretch, defect, area):
    """A stretch by 1 + e changes the form by e times its entries, at most 1.3 here, and areas by (1 + e)^2 - 1."""
    ends = ball(structure.neighbours(START, ATTITUDE), stretch)
    matrix, after = structure.derivative(ends), np.asarray(ends.momentum[0])
    assert abs(structure.symplectic_defect(matrix, START, after) - defect) < 1e-12
    assert abs(structure.area_defect(matrix, START, after) - area) < 1e-12


@pytest.mark.parametrize(("name", "explicit"), [(PAPERS, True), (HAS, True), (LACKS, True), ("AKW", False)])
def test_the_work_of_a_step_is_what_the_registry_declares(name, explicit):
    assert work(ml.method(name)) == (ml.method(name).evaluations, explicit)


def test_a_loop_of_unknown_length_is_not_counted():
    class Endless(RungeKutta):
        def step(self, system, t0, t1, h, motion, force):
            def turn(motion):
                return motion.__class__(system.force(t0, motion), motion.pose)

            motion = jax.lax.while_loop(lambda m: m.momentum[0] < 9, turn, motion)
            return motion, force, True

    with pytest.raises(ValueError, match="a loop of unknown length evaluates the torque"):
        work(Endless("endless", RK4.formula))


PROPERTIES = {
    "momentum": verdicts.keeps_momentum,
    "symplectic": verdicts.is_symplectic,
    "area": verdicts.keeps_area,
    "reversal": verdicts.comes_back,
    "drift": verdicts.has_no_drift,
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", PROPERTIES)
def test_a_property_is_seen_where_it_is_and_missed_where_it_is_not(name):
    assert PROPERTIES[name](measured(HAS))
    assert not PROPERTIES[name](measured(LACKS))


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", [HAS, LACKS])
def test_the_order(name):
    found, order = measured(name), ml.method(name).order
    assert found.ok
    assert abs(found.order - order) < 0.1
    assert verdicts.has_order(found, order)
    assert not verdicts.has_order(found, order + 1)


@pytest.mark.sample(0)
def test_accuracy_on_p1_is_that_of_the_published_table():
    """The error of R there is a Frobenius norm, which is the root of two times the angle, at h = .005."""
    p1 = ml.method(HAS)
    assert measured(p1.name).accuracy_p1 * 2**0.5 == pytest.approx(3.2e-6, rel=0.1)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("drift", "noise", "holds"), [(0.0, 1.0, True), (0.5, 1.0, False), (1e-14, 1e-15, True)])
def test_a_trend_is_told_from_an_oscillation_and_from_rounding(drift, noise, holds):
    """A ramp of `drift`, and the oscillation of a thousand turns with the root mean square `noise`."""
    time = np.linspace(0, 1, 4000)[:, None]
    phases = np.arange(16)
    energy = drift * time + noise * 2**0.5 * np.sin(2 * np.pi * (1000 / np.pi) * time + phases)
    assert verdicts.has_no_trend(measured(HAS)._replace(energy=energy)) == holds


@pytest.mark.sample(0)
def test_the_best_is_the_best_on_both_scenes():
    names = [PAPERS, HAS, "NMB"]
    methods = [ml.method(name) for name in names]
    found = [
        measured(HAS)._replace(method=name, accuracy=a, accuracy_p1=b)
        for name, a, b in zip(names, (1.0, 2.0, 3.0), (1.0, 2.0, 0.9), strict=True)
    ]
    kind, paper = (
        verdicts.ranked(found[0], methods, found, of) for of in (verdicts.of_its_kind, verdicts.of_the_paper)
    )
    assert not kind[1]  # NMB, of which the bench here says that it keeps the momentum, is better on P1
    assert "NMB 9.0e-01" in paper[0]
    assert verdicts.ranked(found[0], methods[:2], found[:2], verdicts.of_its_kind)[1]
    assert verdicts.ranked(found[0], methods[:1], found[:1], verdicts.of_its_kind) is None


@pytest.mark.sample(0)
def test_verdicts_are_computed_from_the_figures():
    """The paper's method gets the verdicts of the figures that it is given."""
    method = [ml.method(PAPERS)]
    for source, word in ((HAS, True), (LACKS, False)):
        found = [measured(source)._replace(method=PAPERS)]
        by_claim = {v.claim: v.holds for v in verdicts.paper_verdicts(method, found)}
        assert by_claim["symplectic on T*SO(3)"] == word
        assert by_claim["conserves momentum"] == word
        assert by_claim["as of a symplectic method, no trend of the energy: drift test"] == word
    assert all(v.holds for v in verdicts.registry_verdicts(ml.method(HAS), measured(HAS)))
    falls = [v.key for v in verdicts.registry_verdicts(ml.method(HAS), measured(LACKS)) if not v.holds]
    assert {"momentum", "symplectic", "area", "symmetric", "no drift", "evaluations"} <= set(falls)


@pytest.fixture
def no_measuring(monkeypatch):
    """The command with what the tests have measured already."""
    monkeypatch.setattr(measure, "_PARTING", (1,))
    monkeypatch.setattr(command, "Bench", lambda *steps: bench())
    monkeypatch.setattr(command, "_measured", lambda bench, methods: [measured(m.name) for m in methods])


@pytest.mark.sample(0)
def test_the_command_prints_and_writes_figures_and_verdicts(no_measuring, tmp_path, capsys):
    script.main(
        [
            *("--methods", HAS, LACKS, "--steps", str(STEPS)),
            *("--page", str(tmp_path / "page.md"), "--out", str(tmp_path / "energy.png")),
        ]
    )
    assert "declarations of the registry hold" in capsys.readouterr().out
    text = (tmp_path / "page.md").read_text()
    assert f"| `{HAS}` | drift -1.05e-03 -> -1.05e-03 |" in text
    verdicts_of = (tmp_path / "tables" / "claims-drifts.csv").read_text()
    assert f"{HAS},drift -1.05e-03 -> -1.05e-03," in verdicts_of
    assert ",holds,python benchmarks/claims.py --methods 'JACOBI[EA]'\n" in verdicts_of
    assert "![Energy over the two long runs](energy.png)" in text
    assert (tmp_path / "energy.png").read_bytes().startswith(b"\x89PNG")
    assert all(f"| `{name}` |" in text for name in (HAS, LACKS))


def chosen(**options):
    return [m.name for m in command._methods(argparse.Namespace(**({"methods": None, "all": False} | options)))]


def test_the_default_methods_are_those_of_the_paper_and_one_of_each_flight_and_scheme():
    names, rigid = chosen(), {n: e for n, e in ENTRIES.items() if issubclass(ml.RigidBody, e.method.bodies)}
    assert {name for name, entry in rigid.items() if entry.paper} <= set(names)
    assert len(names) < len(rigid) < len(chosen(all=True))
    assert len(chosen(all=True)) == len(set(chosen(all=True))) > 10 * 18


def test_the_page_has_every_default_method():
    reports = page.Path(__file__).parent.parent / "docs" / "reports"
    text = (reports / "claims.md").read_text()
    assert all(f"\n| `{name}` | " in text for name in chosen())
    for name in ("figures", "declared"):
        assert [row["method"] for row in saved(f"claims-{name}", reports / "tables")] == chosen()
