"""Chooses what `make test` runs: as much as a budget of processor time allows, and of each law something first.

The costs are measured (`make costs`) and kept in costs.json; a test that is not in there, because it or its method is
new, costs nothing and is always chosen. Tests of one file with the same parameters are chosen together, because they
read the same compiled runs, which the first of them makes.
"""

import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
from typing import NamedTuple

COSTS = Path(__file__).with_name("costs.json")
COST = "cost"  # the property of a test that holds its name and cost
LEAST = 0.2  # seconds; costs below are not kept


class Test(NamedTuple):
    """A collected test.

    Attributes:
        name: pytest's node id.
        law: the same without parameters.
        unit: the tests that are chosen together.
    """

    name: str
    law: str
    unit: tuple[str, str]

    __test__ = False  # pytest must not collect it

    @classmethod
    def of(cls, name: str, group: str, whole: bool = False) -> "Test":
        """From a node id, and the group of files that share compiled runs.

        Args:
            whole: whether all tests of the group read what the first one computes.
        """
        law, _, parameters = name.partition("[")
        return cls(name, law, (group, "" if whole else parameters or law))


def chosen(tests: Iterable[Test], costs: dict[str, float], budget: float) -> set[str]:
    """The names of the tests to run.

    First comes the cheapest unit of each law, the cheapest laws first, then all other units, the cheapest first, as far
    as the budget allows.

    Args:
        costs: of tests by their names, processor seconds.
        budget: processor seconds of all chosen tests.
    """
    units: dict[tuple[str, str], list[str]] = defaultdict(list)
    laws: dict[str, set[tuple[str, str]]] = defaultdict(set)
    for test in tests:
        units[test.unit].append(test.name)
        laws[test.law].add(test.unit)
    cost = {unit: sum(costs.get(name, 0.0) for name in names) for unit, names in units.items()}

    def order(unit: tuple[str, str]) -> tuple[float, tuple[str, str]]:
        return cost[unit], unit

    spent, taken = 0.0, set[tuple[str, str]]()

    def take(unit: tuple[str, str]) -> None:
        nonlocal spent
        if unit not in taken and spent + cost[unit] <= budget:
            taken.add(unit)
            spent += cost[unit]

    for of_law in sorted(laws.values(), key=lambda of_law: order(min(of_law, key=order))):
        if not of_law & taken:
            take(min(of_law, key=order))
    for unit in sorted(units, key=order):
        take(unit)
    return {name for unit in taken for name in units[unit]}


def part(tests: Iterable[Test], costs: dict[str, float], which: int, parts: int) -> set[str]:
    """The names in one of several parts, of about the same cost, that together are all tests. Counted from 0.

    A group of files stays together.
    """
    groups: dict[str, list[str]] = defaultdict(list)
    for test in tests:
        groups[test.unit[0]].append(test.name)
    cost = {group: sum(costs.get(name, 0.0) for name in names) for group, names in groups.items()}
    spent, parts_of = [0.0] * parts, dict[str, int]()
    for group in sorted(groups, key=lambda group: (-cost[group], group)):
        parts_of[group] = min(range(parts), key=lambda k: (spent[k], k))
        spent[parts_of[group]] += cost[group]
    return {name for group, names in groups.items() if parts_of[group] == which for name in names}


def known_costs() -> dict[str, float]:
    return json.loads(COSTS.read_text())


def keep_costs(measured: dict[str, float]) -> None:
    """Writes the costs of the tests that ran; what is known of others stays."""
    costs = {name: cost for name, cost in known_costs().items() if name not in measured}
    costs |= {name: round(cost, 1) for name, cost in measured.items() if cost >= LEAST}
    COSTS.write_text(json.dumps(dict(sorted(costs.items())), indent=0) + "\n")


def processor_time() -> float:
    """Of this process and of its children that have ended, seconds."""
    return sum(usage.ru_utime + usage.ru_stime for usage in map(getrusage, (RUSAGE_SELF, RUSAGE_CHILDREN)))
