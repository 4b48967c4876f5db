"""Deprecated names of version 0.1: they still work and warn."""

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def renamed(**names: str) -> Callable[[F], F]:
    """Decorator for a function with renamed arguments, given as old=new.

    Raises, when called:
        TypeError: both names of an argument are given.
    """

    def with_old_names(function: F) -> F:
        @wraps(function)
        def called(*args: Any, **given: Any) -> Any:
            for old in names.keys() & given.keys():
                new = names[old]
                if new in given:
                    raise TypeError(f"{function.__name__} got {new} and its old name {old}; leave {old} out.")
                _warn(f"{function.__name__}({old}=)", f"{new}=")
                given[new] = given.pop(old)
            return function(*args, **given)

        return cast(F, called)

    return with_old_names


def old_name(owner: str, old: str, new: str) -> property:
    """The attribute `new` under its old name."""

    def value(self: Any) -> Any:
        _warn(f"{owner}.{old}", f".{new}")
        return getattr(self, new)

    return property(value, doc=f"The old name of `{new}`.")


def _warn(old: str, new: str) -> None:
    message = f"{old} is the name of version 0.1; write {new}. It will be taken out in 0.3."
    warnings.warn(message, DeprecationWarning, stacklevel=3)
