"""The user attributes of a file; they are checked before the run, because a later error would lose the run."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from .._checks.arguments import shown
from ..drivers.ensemble import Batch
from ..drivers.observe import Observe, Statistic
from .describe import attributes_of
from .description import ATTRIBUTE
from .names import named, parameter
from .plan import Plan
from .summary import names_of_merged
from .variables import seen_variables

_MAY_CHANGE = "title"
_READ = "time", "times", "first_bad", "ok", "dt", "t0", "moments", "momenta", "attitudes", ATTRIBUTE  # by `saved_path`


def checked_attributes(attributes: Any, taken: Iterable[str]) -> dict[str, Any]:
    """The attributes as strings, Python numbers, and lists of these.

    Args:
        attributes: the argument of `simulate`, or None.
        taken: names of the attributes in the file.

    Raises:
        ValueError: a name is no string or is taken; a value is no string, number or list.
    """
    if attributes is None:
        return {}
    if not isinstance(attributes, dict):
        raise ValueError(f"attributes must be a dict of names with texts, numbers or lists, got {shown(attributes)}.")
    taken = set(taken)
    for name in attributes:
        if not isinstance(name, str) or not name or name.endswith(".npy"):
            raise ValueError(f"attributes has the name {name!r}; a name must be a text, not empty, without .npy.")
        if name in taken or name.startswith(parameter("")):
            raise ValueError(f"attributes has the entry {name!r}, which the file has itself; choose another name.")
    return {name: _checked_value(name, value) for name, value in attributes.items()}


def _checked_value(name: str, value: Any) -> Any:
    """A string, a Python number, or a list of these, of the same value."""
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


def taken_names(batch: Batch, observe: Observe | None, seen: Any, plan: Plan) -> set[str]:
    """The names in a file without user attributes, of which users may replace only the title."""
    taken = {*attributes_of(batch, plan), *named(batch.mapped[2]), *seen_variables(seen, observe, plan)}
    if isinstance(observe, Statistic):
        taken.update(names_of_merged(observe, seen, plan, batch.mapped[2].momentum.dtype))
    return {*taken, *_READ} - {_MAY_CHANGE}
