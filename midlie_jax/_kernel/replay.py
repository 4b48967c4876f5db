"""Runs a function written on small arrays entry by entry, so that it fuses into a step written on scalars.

A user's torque is written on (3,) and (4,) arrays: stacks, slices, cross products, small matrix products, perhaps
the gradient of a potential. Inside a fused loop XLA evaluates each stacked array once per entry read, which
multiplies at every stacking; a torque of ten lines can run a thousand times slower than it should, or never
finish compiling. So the function is traced once, and its operations are replayed on scalars: moving entries about
costs nothing, products become sums of scalars. Operations that have no rule (loops, solvers, large tables) are
replayed as they are.

An array being replayed is an integer array of places in a pool of scalars. Moving entries is then indexing, done
by NumPy; only arithmetic touches the pool. The rules for single operations are in `rules.py`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters import partial_eval

from .internals import axes_of, promoted
from .rules import Pool, bind, body_of, fits, rule_for


class Traits(NamedTuple):
    """What a function is like.

    Attributes:
        costly: whether it holds anything that XLA counts as expensive, or that is replayed as it is.
        reads: its arguments, with True for each leaf that the result depends on.
    """

    costly: bool
    reads: Any


def traits(function: Callable[..., Any], *arguments: Any) -> Traits:
    """Found by tracing the function once."""
    closed = jax.make_jaxpr(function)(*arguments)
    _, used = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    return Traits(_has_costly(closed), jax.tree.unflatten(jax.tree.structure(arguments), used))


def _has_costly(closed: ClosedJaxpr) -> bool:
    return any(_is_costly(equation) for equation in closed.jaxpr.eqns)


def _is_costly(equation: Any) -> bool:
    body = body_of(equation)
    if body is not None:
        return _has_costly(body)
    rule = rule_for(equation)
    return rule is None or not rule.cheap or equation.params.get("y", 1) < 0  # a power with a negative exponent


class Packed(NamedTuple):
    """A vector given by its entries."""

    entries: tuple[Array, ...]


class _Entries(NamedTuple):
    """A small array given by the places of its entries in the pool."""

    places: np.ndarray


def by_components(function: Callable[..., Array], *arguments: Any) -> tuple[list[Any], jax.ShapeDtypeStruct]:
    """Evaluates `function` on arguments whose vectors are given by their entries.

    Args:
        function: returns one array.
        arguments: pytrees whose leaves are scalars, or `Packed` vectors, which the function sees as arrays.

    Returns:
        The entries of the result in order, and its shape and dtype.
    """
    pool = Pool()
    leaves, structure = jax.tree.flatten(arguments, is_leaf=lambda x: isinstance(x, Packed))
    inputs, kinds = [], []
    for leaf in leaves:
        vector = isinstance(leaf, Packed)
        # The type of the whole array, with all that JAX counts as a part of it.
        (kind,) = jax.make_jaxpr(lambda x=leaf, v=vector: jnp.stack(x.entries) if v else jnp.asarray(x))().out_avals
        inputs.append(_Entries(pool.store(leaf.entries if vector else [leaf], kind.shape)))
        kinds.append(kind)
    closed, out = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(structure, kinds))
    if not isinstance(out, jax.ShapeDtypeStruct):
        raise ValueError(f"the torque must return one array, got {type(out).__name__}; use jnp.stack([...]).")
    (result,) = _replay(pool, closed, inputs)
    places = result.places if isinstance(result, _Entries) else _taken_apart(pool, result).places
    return pool.at(places), out


def _taken_apart(pool: Pool, value: Any) -> _Entries:
    shape = jnp.shape(value)
    if not isinstance(value, Tracer):
        value = np.asarray(value)
    return _Entries(pool.store([value[i] if i else value for i in np.ndindex(shape)], shape))


def _small(pool: Pool, value: Any) -> Any:
    """Taken apart where that can be done."""
    return _taken_apart(pool, value) if fits(jax.typeof(value)) else value


def _array(pool: Pool, value: Any, kind: Any) -> Any:
    """The array of this type again, for an operation that needs it whole."""
    if isinstance(value, _Entries):
        scalars = [jnp.asarray(scalar, kind.dtype) for scalar in pool.at(value.places)]
        if not kind.shape:
            (value,) = scalars
        else:
            value = jnp.stack(scalars).reshape(kind.shape) if scalars else jnp.zeros(kind.shape, kind.dtype)
    return promoted(value, axes_of(kind))


def _replay(pool: Pool, closed: ClosedJaxpr, inputs: Sequence[Any]) -> list[Any]:
    jaxpr = closed.jaxpr
    environment: dict[Any, Any] = {}

    def read(atom: Any) -> Any:
        return _small(pool, np.asarray(atom.val)) if isinstance(atom, Literal) else environment[atom]

    environment.update(zip(jaxpr.constvars, (_small(pool, c) for c in closed.consts), strict=True))
    environment.update(zip(jaxpr.invars, inputs, strict=True))
    for equation in jaxpr.eqns:
        results = _apply(pool, equation, [read(atom) for atom in equation.invars])
        environment.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _apply(pool: Pool, equation: Any, values: list[Any]) -> list[Any]:
    body = body_of(equation)
    if body is not None:
        return _replay(pool, body, values)
    with equation.ctx.manager:
        if all(isinstance(v, _Entries) for v in values) and all(fits(atom.aval) for atom in equation.outvars):
            rule = rule_for(equation)
            places = None if rule is None else rule.replay(pool, equation, [v.places for v in values])
            if places is not None:
                return [_Entries(p) for p in places]
        arrays = [_array(pool, v, atom.aval) for v, atom in zip(values, equation.invars, strict=True)]
        return [_small(pool, result) for result in bind(equation, arrays)]
