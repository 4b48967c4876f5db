"""Names of a package that are imported at their first use: those that the `__init__.pyi` of the package lists.

`classes_below` finds classes by name, for files. It loads the packages that the core does not import as a whole.
"""

import re
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import resolve_name
from pathlib import Path
from typing import Any


def names_of(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package, from the stub beside its `__init__.py`.

    A public name must not be the name of a module in the same package: Python would replace it by that module.
    """
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    where = {name: module for module, name in re.findall(r"^from (\.[\w.]*) import (\w+) as \2$", stub, re.MULTILINE)}

    def found(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if where[name] == ".":
            value = import_module(f".{name}", package)
        else:  # from .module import name
            value = getattr(__import__(resolve_name(where[name], package), None, None, [name]), name)
        return vars(sys.modules[package]).setdefault(name, value)

    return found, lambda: sorted(where), [*where]


ROOMS = ("asteroids", "molecules", "spacecraft", "spins")
_LISTED = (
    *ROOMS,
    "drivers.observe",
    "integrators.registry",
    *(f"model.{own}" for own in ("baths", "orbits", "states", "torques")),
)


def classes_below(base: type) -> list[type]:
    """All loaded subclasses of a class, also those that are imported at their first use."""
    for package in _LISTED:
        module = import_module(f"midlie_jax.{package}")
        for name in getattr(module, "__all__", ()):
            getattr(module, name)
    return _below(base)


def _below(base: type) -> list[type]:
    return [base, *(kind for below in base.__subclasses__() for kind in _below(below))]
