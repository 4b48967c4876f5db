"""The best of many methods at an error: envelopes, families of methods, tables and the chart; on made-up points."""

import math

import harness
import pytest
from laboratory import frontier, rivals, work_precision
from laboratory.frontier import FAMILIES, family, members
from laboratory.frontier_chart import work_precision_figure
from laboratory.rivals.lie_group import RKMK4
from laboratory.rivals.problem import Point

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.integrators.registry import entries


def line(method: str, order: int, unit: float, counts=(1, 10, 100)) -> list[Point]:
    """error = (unit / seconds)^order"""
    return [Point(method, "", (unit / n) ** order, float(n), 2.0 * n, float(n)) for n in counts]


def test_an_envelope_keeps_what_nothing_betters():
    assert frontier.envelope([4.0, 1.0, 2.0, 3.0, 5.0], [1e-3, 1e-1, 1e-4, 1e-2, math.nan]) == [(1, 1e-1), (2, 1e-4)]


@pytest.mark.parametrize("order", [2, 4, 8])
def test_cost_is_a_straight_line_in_logarithms(order):
    reached = frontier.envelope(*zip(*[(p.seconds, p.error) for p in line("x", order, 0.5)], strict=True))
    for seconds in (1, 3, 10, 40, 100):
        assert frontier.cost_at(reached, (0.5 / seconds) ** order) == pytest.approx(seconds, rel=1e-12)
    assert frontier.cost_at(reached, 1.0) == 1  # a smaller error than asked for serves
    assert frontier.cost_at(reached, (0.5 / 101) ** order) == math.inf  # and nothing is claimed beyond the points
    assert frontier.cost_at([], 1.0) == math.inf
    assert frontier.cost_at([(1.0, 1e-2), (2.0, 0.0)], 1e-3) > 1  # an error of exactly zero has a logarithm, too


def test_the_frontier_is_the_lower_envelope_of_all_lines():
    """Order 2 with a small constant, and order 4: they cross where (1/n)^2 = (3/n)^4, n = 9."""
    both = line("low", 2, 1.0) + line("high", 4, 3.0)
    edge = frontier.frontier(both)
    errors = [error for _, error in edge]
    assert errors == sorted(errors, reverse=True)
    for cost, error in edge[1:]:
        least = min(max(1.0, error**-0.5), max(1.0, 3 * error**-0.25))
        assert cost == pytest.approx(least, rel=1e-9)
    assert frontier.best_at(both, 1 / 7.0**2).method == "low"
    assert frontier.best_at(both, (3 / 20.0) ** 4).method == "high"
    assert edge[0][0] < 1.2  # begins where the cheapest run is, not above it
    assert frontier.frontier([]) == []


NAMES = {"A": "symplectic", "B": "general", "C": "conserving"}


def test_ratios():
    ours = line("A", 4, 1.0) + line("B", 4, 0.5) + line("C", 4, 2.0)
    others = line("heyoka", 4, 2.0) + line("diffrax Tsit5", 4, 50.0, (100, 1000)) + line("CF4", 4, 0.25)
    (row, beyond) = frontier.ratios(ours, others, NAMES, [1e-4, 1e-12])
    assert row.rival.method == "CF4"
    assert row.over_rival == pytest.approx(2)
    assert row.over_diffrax == pytest.approx(1 / 100)
    # The symplectic method is quicker than the one that only conserves, so it is the best of both families.
    bests = {name: (share.best.method, share.over_heyoka) for name, share in row.families.items()}
    assert list(bests) == list(FAMILIES)
    assert bests["general"] == ("B", pytest.approx(1 / 4))
    assert bests["conserving"] == bests["symplectic"] == ("A", pytest.approx(1 / 2))
    over_heyoka = [share.over_heyoka for share in beyond.families.values()]
    assert all(math.isnan(x) for x in (beyond.over_rival, beyond.over_diffrax, *over_heyoka))
    table = harness.table(frontier.HEADS, map(frontier.cells, (row, beyond)))
    assert len({text.count("|") for text in table}) == 1
    assert table[2].count("A: ") == table[2].count(" same ") == 1
    assert "0.01" in table[2]
    assert table[3].count(" - ") == len(frontier.HEADS) - 1


def test_each_family_contains_the_next():
    everything = [p for name in NAMES for p in line(name, 4, 1.0)]
    found = [{p.method for p in members(everything, NAMES, name)} for name in FAMILIES]
    assert found == [{"A", "B", "C"}, {"A", "C"}, {"A"}]


@pytest.mark.parametrize("name", entries())
def test_the_family_of_a_method_is_told_by_its_attributes(name):
    method = ml.method(name)
    found = family(method)
    assert (found == "symplectic") == method.symplectic
    assert (found == "general") == (not method.symmetric and not method.symplectic and not method.keeps_energy)


@pytest.mark.parametrize(
    ("symplectic", "symmetric", "expected"),
    [
        (True, True, "symplectic"),
        (True, False, "symplectic"),
        (False, True, "conserving"),
        (False, False, "general"),
    ],
)
def test_families(symplectic, symmetric, expected):
    assert family(RKMK4(symplectic=symplectic, symmetric=symmetric)) == expected


def test_a_span_hides_no_loss():
    assert frontier.span([0.5, 2.0, math.nan]) == "0.5 to 2 (1 of 3 not compared)"
    assert frontier.span([0.5]) == "0.5 to 0.5"
    assert frontier.span([math.nan]).startswith("not compared")


def named(axes):
    return set(axes.get_legend_handles_labels()[1])


def test_a_chart_shows_rivals_where_times_and_leading_methods_where_evaluations_are_counted():
    ours = [p for one in work_precision.methods_for(scenes.scene("asymmetric-top")) for p in line(one, 4, 1.0)]
    others = [p for rival in rivals.RIVALS for p in line(rival.label, 4, 1.0)]
    families = work_precision.families_of(ours)
    assert {families[name] for name in ("DLM[KL8]", "JACOBI[EA]")} == {"symplectic"}
    assert families["DOP853"] == "general"
    figure = work_precision_figure(ours, others, families, title="made up", note="of nothing", clock="processor time")
    by_time, by_evaluations = map(named, figure.axes)
    assert by_time == {p.method for p in others} | set(FAMILIES)
    assert set(FAMILIES) < by_evaluations <= {p.method for p in ours} | set(FAMILIES)
    assert {text.get_text() for text in figure.legends[0].get_texts()} == by_time | by_evaluations
    assert figure.axes[0].get_xlabel().startswith("processor time")
    assert figure.axes[1].get_xlabel().startswith("torque evaluations")


def test_the_closed_form_is_in_all_three_families_and_shown_where_times_are():
    """It takes no steps, so the panel by steps does not show it, and the bold lines remain those of the methods."""
    names = work_precision.methods_for(scenes.scene("tumbling-brick"))
    assert "free_motion" in names
    assert "free_motion" not in work_precision.methods_for(scenes.scene("P1"))
    nan = math.nan
    ours = [p._replace(evaluations=nan) for name in names if name != "free_motion" for p in line(name, 4, 1.0)]
    ours.append(Point("free_motion", "one evaluation", 1e-14, 1e-9, nan, nan, 0.1))
    families = work_precision.families_of(ours)
    (row,) = frontier.ratios(ours, line("heyoka", 4, 1.0), families, [1e-6])
    assert {share.best.method for share in row.families.values()} == {"free_motion"}
    assert frontier.cells(row)[1].startswith("free_motion: 0.001")
    figure = work_precision_figure(ours, line("heyoka", 4, 1.0), families, title="made up", note="of nothing")
    by_time, by_steps = map(named, figure.axes)
    assert by_time == {"heyoka", "free_motion", *FAMILIES}
    assert set(FAMILIES) < by_steps <= {*names, *FAMILIES} - {"free_motion"}


def test_a_time_in_the_table_carries_the_spread_of_the_runs_that_it_comes_from():
    """Between two points the larger one; at a point its own."""
    spreads = (0.01, 0.02, 0.3)
    ours = [p._replace(spread=spread) for p, spread in zip(line("A", 4, 1.0), spreads, strict=True)]
    for error, spread in ((ours[0].error, 0.01), (ours[1].error, 0.02), (1e-2, 0.02), (1e-6, 0.3), (1e-99, math.nan)):
        assert frontier.best_at(ours, error).spread == pytest.approx(spread, nan_ok=True)
    (row,) = frontier.ratios(ours, line("CF4", 4, 0.25), NAMES, [1e-6])
    shown = dict(zip(frontier.HEADS, frontier.cells(row), strict=False))
    assert shown["general: µs per body"].endswith(" ±30%")
    assert "±" not in shown["best rival: µs per body"]
