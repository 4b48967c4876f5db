"""`register_for_export`: how states, bodies, torques, carries and paths are stored by `jax.export`."""

import json
from dataclasses import fields
from importlib import import_module
from typing import Any

import equinox as eqx
import jax
from jax import export

from .._lazy import classes_below
from ..integrators.base import Progress
from ..model.free_body import Momenta, Place, Wrench
from ..model.kind import Kind
from ..model.states.rigid import CompensatedPose
from .path import Path
from .results import RESULTS

_PLAIN = bool | int | float | str | None
_TUPLES = Progress, Momenta, Place, CompensatedPose, Path
_RESULT: Any = type(RESULTS.successful)
_registered: set[type] = set()


def register_for_export(*classes: type) -> None:
    """Registers the classes of this package with `jax.export`, as inputs and outputs of stored programs.

    Call it before `serialize`, and again in the program that calls `deserialize`, with your own Equinox modules, whose
    static fields are numbers, strings, classes or tuples of these. A `Stepper` or a function in a torque cannot be an
    input; the exported function uses it as a constant.

    Raises:
        TypeError: a class is not an Equinox module.
        ValueError: when a program is stored: a static field has another value, such as a function.

    Examples:
        >>> ml.register_for_export()
        >>> top = ml.stepper("JACOBI[EA]", body, torque, start, dt=0.01)
        >>> exported = jax.export.export(jax.jit(top.step))(top.init())
        >>> int(exported.call(top.init()).index)
        1
    """
    for own in classes:
        if not (isinstance(own, type) and issubclass(own, eqx.Module)):
            raise TypeError(f"classes must be Equinox modules, got {own!r}. Derive the class from equinox.Module.")
    for tuples in _TUPLES:
        if tuples not in _registered:
            export.register_namedtuple_serialization(tuples, serialized_name=_name(tuples))
            _registered.add(tuples)
    modules = (kind for kind in classes_below(eqx.Module) if kind.__module__.startswith("midlie_jax."))
    for module in {*filter(_has_name, modules), _RESULT, *classes} - _registered:
        export.register_pytree_node_serialization(
            module,
            serialized_name=_name(module),
            serialize_auxdata=_serialized,
            deserialize_auxdata=_deserialized,
        )
        _registered.add(module)


def _has_name(kind: type) -> bool:
    return getattr(import_module(kind.__module__), kind.__qualname__, None) is kind


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _serialized(aux: Any) -> bytes:
    # Equinox keeps the attributes of a wrapped function first, and then the static fields.
    if isinstance(aux[0], tuple):
        raise ValueError("a module that wraps a function cannot be exported. Use it as a constant of the function.")
    return json.dumps([_as_json(value) for value in aux[1:]]).encode()


def _deserialized(stored: bytes) -> Any:
    zeros = jax.numpy.zeros(3)
    no_wrapped = jax.tree_util.default_registry.flatten_one_level(Wrench(zeros, zeros))[1][0]
    return no_wrapped, *(_from_json(value) for value in json.loads(stored))


def _as_json(value: Any) -> Any:
    if isinstance(value, type):
        if not _has_name(value):
            raise ValueError(
                f"the class {value.__qualname__} was made at run time and cannot be exported. Export states."
            )
        return {"class": _name(value)}
    if isinstance(value, Kind):
        return {"kind": _name(type(value)), "fields": [_as_json(getattr(value, field.name)) for field in fields(value)]}
    if isinstance(value, tuple):
        return {"tuple": [_as_json(one) for one in value]}
    if isinstance(value, _PLAIN):
        return value
    raise ValueError(
        f"a static field must be a number, a string or a class, got {value!r}. Use the object as a constant of the "
        "exported function."
    )


def _from_json(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_from_json(one) for one in value["tuple"])
    module, _, name = str(value.get("class") or value["kind"]).partition(":")
    kind = getattr(import_module(module), name)
    return kind(*map(_from_json, value["fields"])) if "kind" in value else kind
