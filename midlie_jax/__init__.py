"""Fast, structure-preserving simulation of rotating rigid bodies, in JAX.

`__init__.pyi` lists the public names with their modules; everything else is internal. A name is imported at its first
use, so `midlie --help` does not wait for JAX, nor a run for diffrax.

The examples of all docstrings assume a heavy top, tilted by 0.3 rad, in float64, and for flights a free body:

    >>> import jax, jax.numpy as jnp, numpy as np, midlie_jax as ml
    >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
    >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
    >>> inertia = ml.RigidBody([1.0, 2.0, 2.5]).inertia()
    >>> momentum = ml.flights.components.vector(jnp.array([1.0, 0.8, -1.3]))  # a tuple of scalars
"""

import pathlib  # not `from pathlib import Path`, because `Path` is a public name here
import re
import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_STUB = pathlib.Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
# `as_typed` describes flights and schemes to type checkers; at run time they are modules in the same folder.
_WHERE = {
    name: module.removesuffix(".as_typed")
    for module, name in re.findall(r"^from \.([\w.]*) import (\w+) as \2$", _STUB, re.MULTILINE)
}
__all__ = [*_WHERE]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """A public name or a folder of the package, which is then cached; or the version of the installed package."""
    if name == "__version__":  # it is defined in pyproject.toml
        from importlib.metadata import version

        return version(__name__)
    if module := _WHERE.get(name):
        found = getattr(__import__(module, globals(), None, [name], 1), name)  # from .module import name
    else:
        found = _folder(name)
    return globals().setdefault(name, found)


def _folder(name: str) -> ModuleType:
    try:
        if name.isidentifier() and not name.startswith("__"):  # `__main__` is the command
            return import_module(f".{name}", __name__)
    except ModuleNotFoundError as error:
        if error.name != f"{__name__}.{name}":
            raise
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*_WHERE, "__version__"]


class _Package(ModuleType):
    """The package; its function `methods` stays what it is when Python imports the folder of that name."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (_WHERE.get(name) and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
