"""Methods and scenes chosen by name, as objects, or as MODULE:NAME, an object in a user's module.

A module is searched in the current folder first, then on Python's path.
"""

import os
import sys
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module, invalidate_caches
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from .._checks.arguments import described
from ..drivers.arguments import as_method
from ..integrators.base import Method
from ..integrators.flights import Flight
from ..model.bodies import RigidBody
from . import scenes
from .scenes import Scene


def method(chosen: str | Method) -> Method:
    """The method with this name or MODULE:NAME, or the method itself; a custom one needs a name of its own."""
    if not isinstance(chosen, str) or ":" not in chosen:
        return as_method(chosen)
    found = _own(chosen, Method, "method")
    try:
        free = bool(as_method(found.name) == found)
    except ValueError:
        free = True
    if not free:
        raise ValueError(
            f"{chosen} has the name of a method of midlie_jax, {found.name!r}; give the method another name."
        )
    return found


def methods(chosen: Sequence[str | Method], body: Any = None) -> list[Method]:
    """The chosen methods, which must support the body, by default rigid bodies; each is listed once."""
    found: dict[str, Method] = {}
    for one in map(method, chosen):
        if body is None or isinstance(body, RigidBody):
            moves, what = issubclass(RigidBody, one.bodies), "rigid body"
        else:
            moves, what = one.moves(body), type(body).__name__
        if not moves:
            raise ValueError(f"method {one.name!r} does not support a {what}; choose from `midlie methods`.")
        if not bool(found.setdefault(one.name, one) == one):
            raise ValueError(
                f"two different methods are called {one.name!r}, and charts and tables use names; give "
                "the flight or the scheme of one of them another name."
            )
    return list(found.values())


def scene(chosen: str | Scene, dtype: Any = None) -> Scene:
    """The scene with this name or MODULE:NAME, or the scene itself; its arrays must have the dtype, if given."""
    if isinstance(chosen, str) and ":" not in chosen:
        return scenes.scene(chosen, dtype)
    found: Scene = _own(chosen, Scene, "scene")
    own = found.start.momentum.dtype
    if dtype is not None and own != dtype:
        raise ValueError(f"scene {found.name!r} must be in {jnp.dtype(dtype)}, got {own}; convert its arrays.")
    return found


def _own(chosen: Any, kind: type, word: str) -> Any:
    """The object MODULE:NAME, or the object itself; `kind` and `word` describe the required kind of object."""
    found = chosen
    if isinstance(chosen, str):
        module, _, name = chosen.partition(":")
        if not (module and name):
            raise ValueError(f"{chosen!r} must be MODULE:NAME, as in my_module:my_{word}.")
        if module.endswith(".py"):
            raise ValueError(f"{chosen!r} names a file; write {module[:-3].replace(os.sep, '.').strip('.')}:{name}.")
        found = _imported(module, name)
        for part in name.split("."):
            if not hasattr(found, part):
                known = ", ".join(sorted(key for key, value in vars(found).items() if isinstance(value, kind)))
                raise ValueError(f"module {module!r} has no {name!r}; its {word}s are {known or 'none'}.")
            found = getattr(found, part)
    if kind is Method and isinstance(found, Flight):
        raise ValueError(f"{chosen} is a flight; make a method of it: midlie_jax.method({chosen.split(':')[1]}, 'EA').")
    if not isinstance(found, kind):
        what = described(found)
        article = "" if what.startswith("an ") else "an " if what[0].lower() in "aeiou" else "a "
        name = chosen if isinstance(chosen, str) else word
        raise ValueError(f"{name} is {article}{what}, not a {word}; see docs/extending.md.")
    return found


def _imported(module: str, name: str) -> Any:
    """The module; if it cannot be imported, a ValueError gives the reason and the origin of the error in one line."""
    here = os.getcwd()
    if sys.path[:1] not in ([""], [here]):
        sys.path.insert(0, here)  # an installed command does not search the current folder
    invalidate_caches()  # the file may be younger than Python's list of the folder
    try:
        return import_module(module)
    except Exception as error:  # any error in the user's module
        missing = error.name or "" if isinstance(error, ModuleNotFoundError) else ""
        if missing and f"{module}.".startswith(f"{missing}."):
            near = get_close_matches(module, [file.stem for file in Path(here).glob("*.py")], n=1)
            hint = f" Did you mean '{near[0]}:{name}'?" if near else ""
            text = f"there is no module {module!r} in this folder or on Python's path.{hint}"
            raise ValueError(text) from error
        raise ValueError(f"importing {module} failed{_place(error)}: {type(error).__name__}: {error}") from error


def _place(error: Exception) -> str:
    """The origin of an error: the innermost line in the user's own files, those in the current folder."""
    if isinstance(error, SyntaxError) and error.filename:
        return f" in {Path(error.filename).name}, line {error.lineno}"
    files = [(Path(frame.filename).resolve(), frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    own = [(file, line) for file, line in files if Path.cwd() in file.parents and "site-packages" not in file.parts]
    return f" in {own[-1][0].name}, line {own[-1][1]}" if own else ""
