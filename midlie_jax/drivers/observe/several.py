"""Several statistics of one run, by name: `observe={"mean": Mean(f), "bins": Histogram(g, edges)}`."""

from collections.abc import Callable
from typing import Any

from jax import Array

from .observables import Together
from .series import Series
from .statistics import Statistic


def several(statistics: dict[str, Any]) -> Statistic:
    """The statistics as one, whose results are dicts; raises unless all are statistics of one kind."""
    others = [name for name, one in statistics.items() if not isinstance(one, Statistic)]
    if others:
        raise ValueError(
            f"observe must hold only statistics or none, but {others[0]!r} is an observable; give it to another run."
        )
    over_times = [name for name, one in statistics.items() if isinstance(one, Series)]
    if over_times and len(over_times) < len(statistics):
        raise ValueError(
            f"observe must hold statistics of one kind, but only {', '.join(over_times)} is over times; use two runs."
        )
    kind: Any = SeveralSeries if over_times else SeveralAtOneTime
    return kind(statistics)


class SeveralAtOneTime(Statistic):
    statistics: dict[str, Any]

    def __init__(self, statistics: dict[str, Any]):
        self.statistics = statistics
        self.observable = Together({name: one.observable for name, one in statistics.items()})

    def each(self, function: Callable[..., Any], *trees: Any) -> dict[str, Any]:
        return {name: function(one, *(tree[name] for tree in trees)) for name, one in self.statistics.items()}

    def check(self, saves: int | None) -> None:
        self.each(lambda one: one.check(saves))

    def part(self, values: Any, good: Array) -> Any:
        return self.each(lambda one, own: one.part(own, good), values)

    def merged(self, parts: Any) -> Any:
        return self.each(lambda one, own: one.merged(own), parts)

    def result(self, merged: Any, interval: Array) -> Any:
        return self.each(lambda one, own: one.result(own, interval), merged)

    def finished(self, merged: Any) -> Any:
        return self.each(lambda one, own: one.finished(own), merged)

    def attributes(self) -> dict[str, Any]:
        return {
            f"{name}_{key}": value for name, one in self.statistics.items() for key, value in one.attributes().items()
        }


class SeveralSeries(SeveralAtOneTime, Series):
    fields = ()

    def part(self, values: Any, good: Array) -> Any:
        return Series.part(self, values, good)

    def begun(self, bodies: int, values: Any) -> Any:
        return self.each(lambda one, own: one.begun(bodies, own), values)

    def taken(self, carried: Any, values: Any, good: Array) -> Any:
        return self.each(lambda one, *own: one.taken(*own, good), carried, values)

    def sums(self, carried: Any, counted: Array) -> Any:
        return self.each(lambda one, own: one.sums(own, counted), carried)

    def of_sums(self, sums: Any, interval: Array) -> Any:
        return self.result(sums, interval)

    def row_of(self, name: str) -> str:
        own = max((each for each in self.statistics if f"_{each}_" in f"_{name}"), key=len)
        return self.statistics[own].row_of(name)
