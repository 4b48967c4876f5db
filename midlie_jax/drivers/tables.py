"""Paths as tables: CSV files and xarray datasets, with the names, units and frames of the states."""

import csv
import os
from typing import Any

import jax
import numpy as np

from .._math.euler import euler_angles, matrices_of
from ..model.state import State

COORDINATES = {"axis": ["1", "2", "3"], "space_axis": ["x", "y", "z"], "quaternion": ["w", "x", "y", "z"]}


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
    columns: dict[str, np.ndarray] = {}
    for name, (dims, array, _) in values.items():
        array = array if many else array[None]
        if "member" in dims:
            raise ValueError("to_csv writes one body per line, and these bodies are coupled. Use to_xarray.")
        letters = COORDINATES.get(dims[-1]) if dims else None
        flat = array.reshape(*array.shape[:2], -1)
        names = [f"{name}_{x}" for x in letters or range(flat.shape[-1])] if letters or flat.shape[-1] > 1 else [name]
        columns |= {head: flat[..., i] for i, head in enumerate(names)}
    if euler is not None:
        if "attitude" not in values:
            raise ValueError("euler needs attitudes, which these states do not have; leave it out.")
        attitudes = values["attitude"][1]
        angles = np.degrees(euler_angles(matrices_of(attitudes.reshape(-1, 4)), euler)[0])
        angles = angles.reshape(*(attitudes if many else attitudes[None]).shape[:2], 3)
        columns |= {f"euler_{i + 1}_{axis} [deg]": angles[..., i] for i, axis in enumerate(euler)}
    bodies = next(iter(columns.values())).shape[0]
    times = np.broadcast_to(times, (bodies, times.shape[-1]))
    good = np.arange(times.shape[1]) < np.asarray(path.first_bad).reshape(-1, 1)
    with open(file, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow((*(["body"] if many else []), "time", *columns, "ok"))
        for body in range(bodies):
            rows = zip(times[body], *(column[body] for column in columns.values()), good[body], strict=True)
            writer.writerows((*([body] if many else []), *row[:-1], int(row[-1])) for row in rows)


def to_xarray(path: Any) -> Any:
    """The path as an `xarray.Dataset` with names, units and frames; its `to_netcdf` writes NetCDF.

    Dimensions are body (if there are several), time, member (of coupled bodies) and components. Needs xarray.

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
    found: dict[str, Any] = {}
    leading = np.ndim(path.ok) + bool(np.ndim(path.times))
    for place, leaf in jax.tree_util.tree_leaves_with_path(states):
        name = jax.tree_util.keystr(place, simple=True, separator="_") or "observed"
        dims = tuple(f"{name}_{i}" for i in range(np.ndim(leaf) - leading))
        found[name] = (dims, np.asarray(leaf), {})
    return found
