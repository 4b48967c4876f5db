"""Tables on the terminal, `midlie methods` and `midlie scenes`; a progress bar and an early error about packages."""

import argparse
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from ..integrators.base import Method
from ..integrators.flights import FLIGHTS
from ..integrators.registry import DEFAULT, entries
from ..integrators.schemes import SCHEMES
from ..model.bodies import SymmetricRotor
from ..model.free_body import FreeBody
from ..model.torques import Sum
from . import chosen
from . import scenes as all_scenes
from .scenes import Scene

_MOST_NUMBERS = 12  # largest number of printed entries of an array
_HEADS = ["method", "moves", "order", "symmetric", "symplectic", "evaluations a step", "when to take it"]


def require(*packages: str) -> None:
    """Checks that packages are installed, before minutes of measurements."""
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise ImportError(f"this command needs {' and '.join(missing)}: pip install 'midlie_jax[cli]'.")


def progress_bar(total: int, unit: str) -> Any:
    """A bar for `total` units of work, which is erased at the end; nothing is shown without a terminal."""
    from tqdm import tqdm

    return tqdm(total=total, unit=unit, mininterval=0.5, dynamic_ncols=True, leave=False, disable=None)


def show_table(heads: list[str], rows: list[list[str]]) -> None:
    """Prints rows in aligned columns, text to the left and numbers to the right.

    In a row with fewer cells than heads the cells after the second may be wider than their column. An empty row prints
    an empty line.
    """
    full_rows = [row for row in rows if len(row) == len(heads)]
    widths = [max([len(head), *(len(row[i]) for row in full_rows)]) for i, head in enumerate(heads)]
    numeric = [bool(full_rows) and all(is_number(row[i] or "0") for row in full_rows) for i in range(len(heads))]

    def show(cells: list[str]) -> None:
        padded = [
            cell if i >= 2 and len(cells) < len(heads) else cell.rjust(width) if right else cell.ljust(width)
            for i, (cell, width, right) in enumerate(zip(cells, widths, numeric, strict=False))
        ]
        print("  ".join(padded).rstrip())

    show(heads)
    print("  ".join("-" * width for width in widths))
    for row in rows:
        show(row)


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # Python accepts 1_000


def methods(options: argparse.Namespace) -> None:
    if options.names:
        show_table(_HEADS, [_method(chosen.method(name)) for name in options.names])
        return
    show_table(_HEADS, [_method(entry.method) for entry in entries().values()])
    print("\nAny combination FLIGHT[SCHEME] is also a method:\n")
    show_table(
        ["flight", "order", "symplectic", "when to take it"],
        [[f.name, "exact" if f.order is None else str(f.order), _yes(f.symplectic), f.use] for f in FLIGHTS.values()],
    )
    print()
    show_table(
        ["scheme", "order", "symmetric", "when to take it"],
        [[s.name, str(s.order), _yes(s.symmetric), s.use] for s in SCHEMES.values()],
    )


def _method(method: Method) -> list[str]:
    entry = entries().get(method.name)
    properties = _yes(method.symmetric), _yes(method.symplectic), str(method.evaluations)
    return [method.name, method.bodies.__name__, str(method.order), *properties, entry.use if entry else "-"]


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def scenes(options: argparse.Namespace) -> None:
    if options.names:
        print("\n\n".join(_described(chosen.scene(name)) for name in options.names))
        return
    listed = [all_scenes.scene(name) for name in all_scenes.scenes()]
    show_table(
        ["scene", "step", "duration", "title"], [[s.name, f"{s.dt:g}", f"{s.duration:g}", s.title] for s in listed]
    )


def _described(scene: Scene) -> str:
    unit = f" {scene.time_unit}".rstrip()
    facts = {
        "units": scene.units,
        **_body(scene.body),
        "torque": _torque(scene.torque),
        **_start(scene.start),
        "step and duration": f"{scene.dt:g} and {scene.duration:g}{unit}: {scene.steps} steps",
        "source": scene.source,
    }
    if scene.method != DEFAULT:
        facts["method"] = scene.method
    width = 1 + max(map(len, facts))
    return "\n".join([f"{scene.name}: {scene.title}", *(f"  {name:<{width}} {value}" for name, value in facts.items())])


def _body(body: Any) -> dict[str, str]:
    if isinstance(body, FreeBody):
        return {**_body(body.body), "mass": _numbers(body.mass)}
    if isinstance(body, SymmetricRotor):
        return {"moment across the axis": _numbers(body.moment)}
    return {"moments of inertia": _numbers(body.moments)}


def _start(start: Any) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, (_, about) in start.described().items():
        frame = "w, x, y, z; body to space" if name == "attitude" else f"{about['frame']} frame"
        words = {"linear": "linear momentum", "position": "position"}.get(name, name)
        found[f"{words} at the start"] = f"{_numbers(getattr(start, name))}  ({frame})"
    return found


def _torque(torque: Any) -> str:
    if torque is None:
        return "none"
    if isinstance(torque, Sum):
        return " + ".join(_torque(term) for term in torque.terms)
    parameters = ", ".join(f"{name} = {_numbers(value)}" for name, value in _parameters(torque))
    return f"{getattr(torque, '__name__', type(torque).__name__)}({parameters})"


def _parameters(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """The numbers of an object that is made of named fields, with their names."""
    if is_dataclass(value):
        for field in fields(value):
            yield from _parameters(getattr(value, field.name), f"{name}.{field.name}".strip("."))
    elif name and np.asarray(value).dtype.kind in "biuf":
        yield name, value


def _numbers(array: Any) -> str:
    if np.ndim(array) and np.size(array) > _MOST_NUMBERS:
        return f"{_numbers(array[0])}, ..., {_numbers(array[-1])}"
    text = np.array2string(np.asarray(array), precision=7, separator=", ", max_line_width=1000)
    return " ".join(text.split())
