"""Paths as tables: CSV files and xarray datasets, with the names, units and frames of the states."""

import csv
import os
from typing import Any

import jax
import numpy as np

from .._math.euler import as_sequence, euler_angles, matrices_of
from ..model.state import State

COORDINATES = {"axis": ["1", "2", "3"], "space_axis": ["x", "y", "z"], "quaternion": ["w", "x", "y", "z"]}


ALONE = "observed"  # the name if a tree is a single array


def named(tree: Any, separator: str = "_") -> dict[str, Any]:
    """The leaves of a tree, named by their position in it: {"momentum": ..., "attitude": ...}."""
    places = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator=separator) or ALONE: leaf for path, leaf in places}


def columns(state: Any) -> dict[str, tuple[str, ...]]:
    return {name: _columns(name, dims) for name, (dims, _) in state.described().items()}


def _columns(name: str, dims: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name}_{letter}" for letter in COORDINATES[dims[-1]])


def to_csv(path: Any, file: str | os.PathLike[str], *, euler: str | None = None) -> None:
    """Writes the path as CSV: body (if there are several), time, the components of each state, and ok (1 or 0).

    Args:
        file: the name of the file, which is replaced.
        euler: a sequence of axes, such as "ZYX" or "321", adds the three Euler angles in degrees: rotations about
            the axes of the body after the earlier rotations.

    Raises:
        ValueError: the path has only its end, the bodies are coupled, or the states have no attitude.

    Examples:
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=2)
        >>> path.to_csv("top.csv", euler="ZXZ")
        >>> open("top.csv").readline().strip()[:45]
        'time,momentum_1,momentum_2,momentum_3,attitud'
    """
    values, times, many = _values(path), np.asarray(path.times), bool(np.ndim(path.ok))
    if not times.ndim:
        raise ValueError("to_csv needs saved times; this path has only the end. Run with save_every.")
    table: dict[str, np.ndarray] = {}
    for name, (dims, array, _) in values.items():
        array = array if many else array[None]
        if "member" in dims:
            raise ValueError(
                "to_csv writes one body per line, and these bodies are coupled. Use to_xarray, or "
                "path._replace(states=path.states.of_body(0))."
            )
        flat = array.reshape(*array.shape[:2], -1)
        size = flat.shape[-1]
        known = dims and dims[-1] in COORDINATES
        names = _columns(name, dims) if known else [f"{name}_{i}" for i in range(size)] if size > 1 else [name]
        table |= {head: flat[..., i] for i, head in enumerate(names)}
    if euler is not None:
        if "attitude" not in values:
            raise ValueError("euler needs attitudes, which these states do not have; leave it out.")
        euler, attitudes = as_sequence("euler", euler), values["attitude"][1]
        attitudes = attitudes if many else attitudes[None]
        angles = np.degrees(euler_angles(matrices_of(attitudes.reshape(-1, 4)), euler)[0])
        angles = angles.reshape(*attitudes.shape[:2], 3)
        table |= {f"euler_{i + 1}_{axis} [deg]": angles[..., i] for i, axis in enumerate(euler)}
    bodies = next(iter(table.values())).shape[0]
    times = np.broadcast_to(times, (bodies, times.shape[-1]))
    good = np.arange(times.shape[1]) < np.asarray(path.first_bad).reshape(-1, 1)
    with open(file, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow((*(["body"] if many else []), "time", *table, "ok"))
        for body in range(bodies):
            rows = zip(times[body], *(column[body] for column in table.values()), good[body], strict=True)
            writer.writerows((*([body] if many else []), *row[:-1], int(row[-1])) for row in rows)


def to_xarray(path: Any) -> Any:
    """The path as an `xarray.Dataset` with names, units and frames; its `to_netcdf` writes NetCDF.

    Dimensions are body (if there are several), time, member (of coupled bodies) and components. Needs xarray, in
    the extra `io`. SciPy, which comes with JAX, writes NetCDF of all values but complex numbers.

    Examples:
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=2)
        >>> dict(path.to_xarray().sizes)
        {'time': 3, 'axis': 3, 'quaternion': 4}
    """
    import xarray

    times, variables = np.asarray(path.times), {}
    of_bodies, over_time = ("body",) * np.ndim(path.ok), ("time",) * bool(times.ndim)
    for name, (dims, array, about) in _values(path).items():
        leading = (*of_bodies, *over_time)
        others = tuple(f"{name}_{i}" for i in range(array.ndim - len(leading) - len(dims)))
        variables[name] = ((*leading, *others, *dims), array, about)
    variables["ok"] = (of_bodies, np.asarray(path.ok), {"long_name": "whether the whole run can be trusted"})
    variables["first_bad"] = (
        of_bodies,
        np.asarray(path.first_bad),
        {"long_name": "first saved state not to be trusted"},
    )
    time = (("body", "time")[2 - times.ndim :], times, {"long_name": "time"})
    used = {dim for dims, *_ in variables.values() for dim in dims}
    return xarray.Dataset(
        variables, {"time" if times.ndim < 2 else "times": time} | {k: v for k, v in COORDINATES.items() if k in used}
    )


def _values(path: Any) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    states = path.states
    if isinstance(states, State):
        return {
            name: (dims, np.asarray(getattr(states, name)), about) for name, (dims, about) in states.described().items()
        }
    leading, found = np.ndim(path.ok) + bool(np.ndim(path.times)), {}
    for name, leaf in named(states).items():
        dims = tuple(f"{name}_{i}" for i in range(np.ndim(leaf) - leading))
        found[name] = (dims, np.asarray(leaf), {})
    return found
