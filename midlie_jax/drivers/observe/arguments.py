"""The argument `observe` of the drivers, and the values it saves of one body."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ...model.bodies import Body
from ...model.state import AnyState
from ...model.torques import TorqueLike, on_body
from ...model.torques.reads_body import without_bath
from .observables import Observable, as_observable
from .series import Series
from .several import several
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
        >>> ml.observe.as_observe(None) is None  # the states are saved
        True
    """
    if isinstance(value, dict) and any(isinstance(one, Statistic) for one in value.values()):
        return several(value)
    return value if value is None or isinstance(value, Statistic) else as_observable("observe", value)


def as_observe_of_one(value: Any) -> Observe | None:
    """The checked argument `observe` of a driver of one body: an observable, an autocorrelation or a spectrum.

    Raises:
        ValueError: it is another statistic, which combines bodies, or no observable.

    Examples:
        >>> ml.observe.as_observe_of_one(ml.observe.energy)
        energy
        >>> try:
        ...     ml.observe.as_observe_of_one(ml.observe.Mean(ml.observe.energy))
        ... except ValueError as error:
        ...     print(error)
        a statistic combines bodies; give it to midlie_jax.ensemble or midlie_jax.simulate.
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
        >>> body, state = ml.RigidBody([2.0, 2.0, 1.0]), ml.RigidState([1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0])
        >>> ml.observe.observe_state(ml.observe.as_observe(ml.observe.energy), jnp.array(0.0), state, body, None).item()
        2.25
        >>> ml.observe.observe_state(None, jnp.array(0.0), state, body, None) is state
        True
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
