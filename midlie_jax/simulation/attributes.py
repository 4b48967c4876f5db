"""The attributes of a file: the description of the run, and the user's own."""

import json
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import equinox as eqx
import numpy as np

from .._checks.arguments import shown
from ..drivers.ensemble import Batch
from ..model.torques.reads_body import without_bath
from .plan import Plan
from .variables import MOST_IN_ATTRIBUTES, parameter, parameters

ATTRIBUTE = "midlie_jax"  # the attribute of a store with the data for resuming
_DICTS = "parameters", "versions", ATTRIBUTE
_MAY_CHANGE = "title"
# Read by `saved_path`.
_READ = {"time", "times", "first_bad", "ok", "dt", "t0", "moments", "momenta", "attitudes", ATTRIBUTE}


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
        "parameters": {name: values.tolist() for name, values in shared if values.size <= MOST_IN_ATTRIBUTES},
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

    Raises a ValueError if a name is no string or is `taken` by an attribute or a variable of the file, or if a value is
    no string, number or list.
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
    if kind not in ("b", "i", "u", "f", "U") or _mixed(value, kind):
        raise ValueError(
            f"attributes has the entry {name!r}: {shown(value)}{problem}, but takes a text, a number, or a list of "
            "texts or of numbers whose rows are equally long; write str(...) for another thing, and an entry of its "
            "own for each part of it."
        )
    return array.tolist()


def _mixed(value: Any, kind: str) -> bool:
    """Whether NumPy has converted numbers to strings."""
    if kind != "U" or isinstance(value, str | np.ndarray | np.generic):
        return False
    return any(_mixed(row, kind) if isinstance(row, list | tuple) else not isinstance(row, str) for row in value)
