"""`panels`: the paths that a picture shows side by side, each with its body and its name."""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any, NamedTuple

import jax
import numpy as np

from ..drivers.path import AnyPath
from ..model.bodies import Body, RigidBody, TensorBody
from ..model.free_body import FreeBody
from ..model.rotor import Rotor
from ..model.states import Coupled, OrientedState, TravellingState
from .motion import path_of_one

_MOST = 12
_MOST_TOGETHER = 500  # bodies in one space
_ROW = 4  # the most panels in a row

Turns = RigidBody | TensorBody | Rotor | FreeBody  # bodies that turn
Bodies = Turns | Sequence[Turns]
OnePath = AnyPath[OrientedState]
Paths = OnePath | Mapping[str, OnePath] | Sequence[OnePath]


class Panel(NamedTuple):
    """What one panel shows.

    Attributes:
        name: written on the panel; may be "".
        body: one body, or coupled bodies that travel.
        path: its path.
    """

    name: str
    body: Any
    path: Any


def panels(body: Any, path: Any, together: bool = False) -> list[Panel]:
    """The panels of a picture, in order.

    Args:
        body: one body for all paths, a sequence with one body for each path, or for a path of `ensemble` a batch of
            bodies.
        path: a path of one body; a mapping of names to such paths, or a sequence of them; or a path of `ensemble`,
            whose bodies are named by their index. Coupled bodies that travel have one panel together, others one each.
        together: whether all paths will be drawn in one space.

    Raises:
        ValueError: there are no paths, or more than fit, or not as many bodies as paths; or paths that cannot be drawn
            in one space shall be.
    """
    most = _MOST_TOGETHER if together else _MOST
    names, paths = _named(path, most)
    if not paths:
        raise ValueError("path holds no path; give one, or a mapping of names to paths.")
    if len(names) > most:
        cure = "choose some of them" + (", or draw bodies that travel in one space by together=True" * _travel(paths))
        raise ValueError(f"path holds {len(names)} paths, and a picture has room for {most}; {cure}.")
    if together:
        _check_together(paths)
    bodies = _bodies(body, paths)
    if len(bodies) != len(paths):
        raise ValueError(f"body must be one body, or one for each of the {len(paths)} paths, got {len(bodies)}.")
    return [Panel(*panel) for panel in zip(names, bodies, paths, strict=True)]


def grid(count: int) -> tuple[int, int]:
    """The numbers of rows and columns of a picture with `count` panels."""
    rows = ceil(count / _ROW)
    return rows, ceil(count / rows)


def _travel(paths: list[Any]) -> bool:
    """Whether the bodies have places of their own and do not act on each other."""
    states = [getattr(path, "states", None) for path in paths]
    return all(isinstance(one, TravellingState) and not isinstance(one, Coupled) for one in states)


def _check_together(paths: list[Any]) -> None:
    for path in paths:
        states = getattr(path, "states", None)
        if isinstance(states, Coupled):
            raise ValueError(
                f"together=True is for paths of one body each; the bodies of a {type(states).__name__} are drawn "
                "together without it, and replicas side by side."
            )
        if not isinstance(states, TravellingState):
            raise ValueError(
                f"together=True draws bodies where they are, and a {type(states).__name__} has no place; without it "
                "they are drawn side by side."
            )


def _named(path: Any, most: int) -> tuple[list[str], list[Any]]:
    if isinstance(path, Mapping):
        return [str(name) for name in path], list(path.values())
    if isinstance(path, Sequence) and not hasattr(path, "states"):  # a path is a tuple, too
        return [""] * len(path), list(path)
    states: Any = getattr(path, "states", None)
    momentum: Any = getattr(states, "momentum", 0.0)
    shape = np.shape(momentum)
    coupled = isinstance(states, Coupled)
    if len(shape) == 3 + coupled:
        word = "replica" if coupled else "body"
        return [f"{word} {k}" for k in range(shape[0])], [_row(path, k) for k in range(min(shape[0], most + 1))]
    if coupled and not isinstance(states, TravellingState):
        count = states.count
        return [f"body {k}" for k in range(count)], [path_of_one(path, k) for k in range(min(count, most + 1))]
    return [""], [path]


def _row(path: Any, k: int) -> Any:
    """The path of body k of an ensemble, whose bodies may share their times."""
    times = path.times[k] if np.ndim(path.times) == 2 else path.times
    rest = jax.tree.map(lambda x: x[k] if np.ndim(x) else x, path._replace(times=()))
    return rest._replace(times=times)


def _bodies(body: Any, paths: list[Any]) -> list[Any]:
    if isinstance(body, Sequence):
        return list(body)
    coupled = any(isinstance(getattr(path, "states", None), Coupled) for path in paths)
    if len(paths) > 1 and isinstance(body, Body) and len(body.batch) == 1 + coupled:
        return each_body(body, body.batch[0])
    return [body] * len(paths)


def each_body(body: Any, count: int) -> list[Any]:
    """The bodies of a batch one by one; a body that serves all is repeated."""
    return [jax.tree.map(lambda x, i=i: x[i], body) if body.batch else body for i in range(count)]
