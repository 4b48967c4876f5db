"""The choice of what `make test` runs: within the budget, every law first, nothing new left out."""

import random

import pytest
from budget import Test, chosen, part

NUMBERS = random.Random(0)
METHODS = [f"[M{i}-float64]" for i in range(12)]
LAWS = [f"tests/test_{file}.py::test_law_{law}" for file in "abc" for law in range(5)]
TESTS = [Test.of(law + method, law[6:12]) for law in LAWS for method in METHODS]
TESTS += [Test.of(f"tests/test_d.py::test_alone_{i}", "test_d") for i in range(20)]
COSTS = {test.name: NUMBERS.expovariate(1.0) for test in TESTS}
LEAST = sum(  # of each file the cheapest column of all laws, and what stands alone
    min(sum(COSTS[law + method] for law in LAWS if f"_{file}." in law) for method in METHODS) for file in "abc"
) + sum(COSTS[test.name] for test in TESTS if "alone" in test.name)
ALL = {test.name for test in TESTS}


@pytest.mark.parametrize("budget", [0.0, 1.0, 10.0, 100.0, 1000.0])
def test_what_is_chosen_costs_no_more_than_the_budget(budget):
    assert sum(COSTS[name] for name in chosen(TESTS, COSTS, budget)) <= budget


@pytest.mark.parametrize("budget", [LEAST + 1e-9, 2 * LEAST, 1000.0])
def test_every_law_is_chosen_if_the_budget_allows(budget):
    found = chosen(TESTS, COSTS, budget)
    assert {name.partition("[")[0] for name in found} == {test.law for test in TESTS}
    assert (found == ALL) == (budget == 1000.0)


def test_what_shares_compiled_runs_is_chosen_together():
    found = chosen(TESTS, COSTS, 1.5 * LEAST)
    units = {}
    for test in TESTS:
        units.setdefault(test.unit, set()).add(test.name in found)
    assert all(len(values) == 1 for values in units.values())


def test_what_is_new_is_chosen():
    new = Test.of("tests/test_a.py::test_new[M-float64]", "test_a")
    assert new.name in chosen([*TESTS, new], COSTS, 0.0)


@pytest.mark.parametrize("parts", [1, 3, 4])
def test_parts_are_everything_once_and_about_as_expensive(parts):
    found = [part(TESTS, COSTS, which, parts) for which in range(parts)]
    assert set().union(*found) == ALL
    assert sum(map(len, found)) == len(ALL)
    if parts == 3:
        sums = [sum(COSTS[name] for name in names) for names in found]
        assert max(sums) <= 0.6 * sum(sums)
