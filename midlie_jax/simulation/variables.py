"""What a file holds, for readers without this package: variables with dimensions, units and frames, and attributes.

The attributes describe the run; the user can add others.
"""

import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import is_key, shown
from ..drivers.clock import time_of
from ..drivers.ensemble import Batch
from ..drivers.observe import Observe, Statistic, observe_state
from ..drivers.observe.series import Series
from ..drivers.path import COORDINATES, named
from ..model.torques.reads_body import without_bath
from .plan import BODY, GROUP, SPAN, TIME, Arrays, Plan

_MOST_IN_ATTRIBUTES = 16  # a parameter with more numbers becomes a variable
ATTRIBUTE = "midlie_jax"  # the attribute of a store with the data for resuming
_DICTS = "parameters", "versions", ATTRIBUTE
_MAY_CHANGE = "title"
# Read by `saved_path`.
_READ = {"time", "times", "first_bad", "ok", "dt", "t0", "moments", "momenta", "attitudes", ATTRIBUTE}


class Variable(NamedTuple):
    """One array of the file."""

    dims: tuple[str, ...]  # names of its dimensions
    shape: tuple[int, ...]  # its whole shape
    dtype: np.dtype[Any]
    attributes: dict[str, str]  # long_name, units and frame, if available


Variables = dict[str, Variable]


def parameter(name: str) -> str:
    """The name of the array of a parameter of a run, such as "body.moments"."""
    return f"parameter_{name.replace('.', '_')}"


def numbers(array: Any) -> np.ndarray:
    """The NumPy array; for random keys, their data."""
    return np.asarray(jax.random.key_data(array) if is_key(array) else array)


def bytes_of(leaves: Any) -> int:
    """The bytes of a pytree of shapes and dtypes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(leaves))


def value_leaves(batch: Batch, observe: Observe | None) -> Any:
    """The observed values of one body at one time, as a pytree of shapes and dtypes."""
    mapped = jax.tree.map(lambda x: x[0], batch.mapped)
    body, torque, start, _, t0 = eqx.combine(mapped, batch.shared)
    return eqx.filter_eval_shape(observe_state, observe, t0, start, body, torque)


def seen_leaves(batch: Batch, observe: Observe | None) -> Any:
    """The values that a run writes at one time, as shapes and dtypes: for one body, or for a part of a statistic.

    For a statistic over times, the values that it writes at the end of a span.
    """
    seen, axes = value_leaves(batch, observe), (1, 1) if isinstance(observe, Series) else (1,)
    if not isinstance(observe, Statistic):
        return seen
    return eqx.filter_eval_shape(observe.part, _with_axes(seen, axes), jax.ShapeDtypeStruct(axes, jnp.bool_))


def seen_variables(seen: Any, observe: Observe | None, plan: Plan) -> Variables:
    """The variables that a run writes, by name: (body, time, ...), or for a statistic (group, time, ...).

    For a statistic over times (group, span, ...): its value at the end of each span.
    """
    times = (SPAN, plan.spans) if isinstance(observe, Series) else (TIME, plan.saves)
    first = (GROUP, plan.groups) if isinstance(observe, Statistic) else (BODY, plan.bodies)
    known = seen.described() if observe is None else {}
    found: Variables = {}
    for name, leaf in named(seen).items():
        dims, attributes = known.get(name, ((), {"long_name": name}))
        dims = dims or _own_dims(name, leaf.shape)
        shape = (first[1], times[1], *leaf.shape)
        found[name] = Variable((first[0], times[0], *dims), shape, np.dtype(leaf.dtype), attributes)
    return found


def merged_variables(batch: Batch, observe: Observe | None, seen: Any, plan: Plan) -> Variables:
    """The variables (time, ...) of a statistic over all bodies; a statistic over times has lags or frequencies."""
    if not isinstance(observe, Statistic):
        return {}
    axes = (plan.groups,) if isinstance(observe, Series) else (plan.groups, plan.saves)
    interval = jax.ShapeDtypeStruct((), batch.mapped[2].momentum.dtype)
    found: Variables = {}
    for name, leaf in named(eqx.filter_eval_shape(_finished, observe, _with_axes(seen, axes), interval)).items():
        about = {"long_name": f"{name} over all bodies that can be trusted", **observe.attributes()}
        first = observe.row_of(name) if isinstance(observe, Series) else TIME
        found[name] = Variable((first, *_own_dims(name, leaf.shape[1:])), leaf.shape, np.dtype(leaf.dtype), about)
    return found


def merged(observe: Statistic, seen: Any, read: Callable[[str], np.ndarray], interval: Array) -> Arrays:
    """The values of `merged_variables`, from the parts of the groups in a file.

    `seen` is the pytree of the data of a part, `read` returns a variable of the file, and `interval` is the time
    between two saved states, ().
    """
    parts = [jnp.asarray(read(name)) for name in named(seen)]
    parts = [part[:, -1] for part in parts] if isinstance(observe, Series) else parts
    finished = _finished(observe, jax.tree.unflatten(jax.tree.structure(seen), parts), interval)
    return {name: np.asarray(leaf) for name, leaf in named(finished).items()}


def whole_variables(batch: Batch, plan: Plan) -> tuple[Variables, Arrays]:
    """The variables available before the run: the times, and parameters with many numbers."""
    *_, dt, t0 = eqx.combine(batch.mapped, batch.shared)
    indices = plan.begin + plan.save_every * jnp.arange(plan.saves, dtype=jnp.int32)
    if t0.ndim or dt.ndim:
        t0, dt, indices = t0.reshape(-1, 1), dt.reshape(-1, 1), indices[None]
    times = np.asarray(jax.jit(time_of)(t0, dt, indices))
    name, dims = ("time", (TIME,)) if times.ndim == 1 else ("times", (BODY, TIME))
    variables = {name: Variable(dims, times.shape, times.dtype, {"long_name": "time", "units": "time"})}
    values = {name: times}
    shared = {name: value for name, value in parameters(batch.shared).items() if value.size > _MOST_IN_ATTRIBUTES}
    for first, found in (((BODY,), parameters(batch.mapped)), ((), shared)):
        for short, value in found.items():
            name = parameter(short)
            dims = (*first, *_own_dims(name, value.shape[len(first) :]))
            about = {"long_name": f"{name.removeprefix('parameter_')}, in the units of the run"}
            variables[name], values[name] = Variable(dims, value.shape, value.dtype, about), value
    return variables, values


def coordinates(variables: Iterable[Variable]) -> tuple[Variables, Arrays]:
    """The names of the components, for the dimensions of these variables."""
    used = {dim for variable in variables for dim in variable.dims} & set(COORDINATES)
    values = {dim: np.array(COORDINATES[dim], dtype=object) for dim in sorted(used)}
    return {dim: Variable((dim,), names.shape, names.dtype, {}) for dim, names in values.items()}, values


def parameters(arguments: Any) -> Arrays:
    """The numbers of (body, torque, start, dt, t0) without `start`, by name."""
    body, torque, _, dt, t0 = arguments
    torque, bath = without_bath(torque)
    arrays = eqx.filter({"body": body, "torque": torque, "bath": bath, "dt": dt, "t0": t0}, eqx.is_array)
    return {name: numbers(values) for name, values in named(arrays, ".").items()}


def _finished(observe: Statistic, parts: Any, interval: Array) -> Any:
    return observe.finished(observe.result(observe.merged(parts), interval))


def _with_axes(leaves: Any, axes: tuple[int, ...]) -> Any:
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct((*axes, *x.shape), x.dtype), leaves)


def _own_dims(name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Names for the dimensions of an array without known meaning."""
    return tuple(f"{name}_{i + 1}" for i in range(len(shape)))


def attributes_of(batch: Batch, plan: Plan) -> dict[str, Any]:
    """The description of the run, and the parameters that are equal for all bodies."""
    _, torque, start, dt, t0 = eqx.combine(batch.mapped, batch.shared)
    torque, bath = without_bath(torque)
    shared = parameters(batch.shared).items()
    return {
        "title": f"{plan.bodies} bodies moved by {batch.method.name}",
        "method": batch.method.name,
        "order": batch.method.order,
        "torque": "none" if torque is None else getattr(torque, "__name__", type(torque).__name__),
        **({} if bath is None else {"bath": type(bath).__name__}),
        "state": type(start).__name__,
        "dtype": str(start.momentum.dtype),
        **({"dt": float(dt)} if not dt.ndim else {}),
        **({"t0": float(t0)} if not t0.ndim else {}),
        "steps": (plan.saves - 1) * plan.save_every,
        "first_step": plan.begin,
        "save_every": plan.save_every,
        "parameters": {name: values.tolist() for name, values in shared if values.size <= _MOST_IN_ATTRIBUTES},
        "source": "midlie_jax",
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """The versions of midlie_jax, jax and jaxlib, by the names of these packages."""
    found: dict[str, str] = dict.fromkeys(("midlie_jax", "jax", "jaxlib"), "not installed")
    for name in found:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def folded(attributes: dict[str, Any]) -> dict[str, Any]:
    """The attributes with dicts as JSON strings, because NetCDF has no dict attributes."""
    return {name: json.dumps(value) if isinstance(value, dict) else value for name, value in attributes.items()}


def unfolded(attributes: dict[str, Any]) -> dict[str, Any]:
    """The inverse of `folded`."""
    return {name: json.loads(value) if name in _DICTS else value for name, value in attributes.items()}


def checked_attributes(attributes: Any, taken: Iterable[str]) -> dict[str, Any]:
    """The user's attributes as strings, Python numbers, and lists of these; a later error would lose the run.

    It raises a ValueError if a name is `taken` in the file, or if a value is no string, number or list.
    """
    if attributes is None:
        return {}
    if not isinstance(attributes, dict):
        raise ValueError(f"attributes must be a dict of names with texts, numbers or lists, got {shown(attributes)}.")
    taken = {*taken, *_READ} - {_MAY_CHANGE}
    for name in attributes:
        if not isinstance(name, str) or not name or name.endswith(".npy"):
            raise ValueError(f"attributes has the name {name!r}; a name must be a text, not empty, without .npy.")
        if name in taken or name.startswith(parameter("")):
            raise ValueError(f"attributes has the entry {name!r}, which the file has itself; choose another name.")
    return {name: _checked_value(name, value) for name, value in attributes.items()}


def _checked_value(name: str, value: Any) -> Any:
    array, problem = np.empty(0, object), ""
    try:
        array = np.asarray(value)
    except Exception as error:  # a ragged list, a traced array, or any error of a user's object
        problem = f" ({type(error).__name__})"
    kind = array.dtype.kind
    # NumPy converts numbers among strings to strings.
    mixed = kind == "U" and not all(isinstance(one, str) for one in np.asarray(value, object).flat)
    if kind not in "biufU" or mixed:
        raise ValueError(
            f"attributes has the entry {name!r}: {shown(value)}{problem}, but takes a text, a number, or a list of "
            "texts or of numbers whose rows are equally long; write str(...) for another thing, and an entry of its "
            "own for each part of it."
        )
    return array.tolist()
