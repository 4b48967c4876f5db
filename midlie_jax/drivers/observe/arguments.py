"""The argument `observe` of the drivers, the values it saves of one body, and several statistics of one run by name."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ...model.bodies import Body
from ...model.state import AnyState
from ...model.torques import TorqueLike, on_body
from ...model.torques.reads_body import without_bath
from .observables import Observable, Together, as_observable
from .series import Series
from .statistics import Statistic, promoted

Observe = Observable | Statistic


class Values(Observable):
    """The values of one body that a statistic combines."""

    observable: Observable

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
        return self.observable.of(t, state, body, torque)


def as_observe(value: Any) -> Observe | None:
    """The checked argument `observe` of a driver: an observable, a statistic, a dict of these, or None for the states.

    Raises:
        ValueError: it is none of these.

    Examples:
        >>> ml.observe.as_observe(ml.observe.energy)
        energy
    """
    if isinstance(value, dict) and any(isinstance(one, Statistic) for one in value.values()):
        return _several(value)
    return value if value is None or isinstance(value, Statistic) else as_observable("observe", value)


def as_observe_of_one(value: Any) -> Observe | None:
    """The checked argument `observe` of a driver of one body: an observable, an autocorrelation or a spectrum.

    Raises:
        ValueError: it is another statistic, which combines bodies, or no observable.

    Examples:
        >>> ml.observe.as_observe_of_one(ml.observe.energy)
        energy
    """
    observe = as_observe(value)
    if isinstance(observe, Statistic) and not isinstance(observe, Series):
        raise ValueError("a statistic combines bodies; give it to midlie_jax.ensemble or midlie_jax.simulate.")
    return observe


def observe_state(observe: Observe | None, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Any:
    """The saved values of one body at one time: the observed values, or the state if nothing is observed.

    Raises:
        ValueError: the observable returns no array, or complex numbers to a statistic.

    Examples:
        >>> ml.observe.observe_state(ml.observe.as_observe(ml.observe.energy), jnp.array(0.0), start, body, None).item()
        1250.0
    """
    if observe is None:
        return state
    observable = observe.observable if isinstance(observe, Statistic) else observe
    acting = on_body(without_bath(torque)[0], body)
    value = jax.tree.map(jnp.asarray, observable.of(t, state, body, acting))
    if not jax.tree.leaves(value):
        raise ValueError("observe must return an array or a pytree of arrays, but returned none.")
    if not isinstance(observe, Statistic | Values):
        return value
    for path, leaf in jax.tree_util.tree_leaves_with_path(value):
        if jnp.iscomplexobj(leaf):
            raise ValueError(
                f"values of a statistic must be real, but observable{jax.tree_util.keystr(path)} is complex; return "
                "its real and its imaginary part."
            )
    return jax.tree.map(lambda x: promoted(x, state.momentum.dtype), value)


def _several(statistics: dict[str, Any]) -> Statistic:
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
