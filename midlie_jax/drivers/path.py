"""`Path`: the result of the drivers, typed by the class of the states, and as CSV file or xarray dataset."""

import csv
import os
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from .._checks.typed_by import TypedBy
from .._math import components as cp
from .._math.euler import as_sequence, euler_angles, matrices_of
from .._xla.internals import Tracer
from ..model.state import AnyState, State
from .results import reasons

States = TypeVar("States", covariant=True)  # a path of CompensatedStates is one of RigidStates
P = TypeVar("P", bound=Any)  # a path
_WIDTH = 120  # of a line of text
COORDINATES = {"axis": ["1", "2", "3"], "space_axis": ["x", "y", "z"], "quaternion": ["w", "x", "y", "z"]}


class Path(NamedTuple, TypedBy[States]):
    """A motion at the saved times; in annotations `Path[RigidState]`.

    Attributes:
        times: (n,), beginning with the initial time; n = 1 + steps / save_every.
        states: the states at these times, of the class of the initial state, with a leading axis (n,); with `observe`,
            the observed values.
        ok: (), False if a solve failed, a number was not finite, the body is impossible, or a run of at least 128 steps
            of translating bodies, coupled bodies or particles gained more energy than the potential can give. With
            variable steps also False if rho or the density was not positive, the two differed by more than a factor of
            2, or t1 was not reached.
        first_bad: (), the index in `times` of the first saved state that cannot be trusted, because a solve failed or a
            number stopped being finite at or before its time; n if there is none. So `states[:first_bad]` can be
            trusted. A gain of energy is detected at the end of the run, and then `first_bad` is 1.
        result: (), why the run failed, one of `midlie_jax.RESULTS`. None in a path that no driver made.
        carry: the final `midlie_jax.Carry`, with which the driver, or a `midlie_jax.stepper`, continues as if the run
            had not been divided.
        rho: with variable steps, (n,), near the density at these times: the next step is about dt / rho.
        taken: with variable steps, the number of steps taken, (); fewer than `steps` if the run reached t1 or failed.

    Examples:
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> path.times.shape, path.states.momentum.shape, bool(path.ok), int(path.first_bad)
        ((101,), (101, 3), True, 101)
    """

    times: Float[Array, "*n"]
    states: States
    ok: Bool[Array, "*batch"]
    first_bad: Int[Array, "*batch"]
    result: Any = None
    carry: Any = None
    rho: Any = None
    taken: Any = None

    def __repr__(self) -> str:
        # Its times and whether it is ok are in the first line, then the shapes of its states.
        name, states = type(self).__name__, eqx.tree_pformat(self.states, width=_WIDTH)
        known = all(isinstance(x, Array) and not isinstance(x, Tracer) for x in (self.times, self.ok, self.first_bad))
        if not known or not all(x.is_fully_addressable and x.size for x in (self.times, self.ok)):
            return f"{name}({', '.join(f'{n}={eqx.tree_pformat(x)}' for n, x in zip(self._fields, self, strict=True))})"
        times, ok = np.asarray(self.times), np.asarray(self.ok)
        first, last = (times[..., 0].min(), times[..., -1].max()) if times.ndim else (times, times)
        span = (
            f"{times.shape[-1]} saved states at times {first:.6g} to {last:.6g}" if times.ndim else f"end at {last:.6g}"
        )
        if ok.all():
            judged = "ok" if not ok.ndim else f"all {ok.size} ok"
        else:
            judged = f"states[:{int(self.first_bad)}] ok" if not ok.ndim else f"{np.count_nonzero(ok)} of {ok.size} ok"
            judged += "." if self.result is None else f". {reasons(self.result, np.asarray(~ok))}"
        return f"{name}: {span}; {judged}\n{states}"

    def to_csv(self, file: str | os.PathLike[str], *, euler: str | None = None) -> None:
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
        times, many, path = np.asarray(self.times), bool(np.ndim(self.ok)), self
        if not times.ndim:
            raise ValueError("to_csv needs saved times; this path has only the end. Run with save_every.")
        if not many:
            path = path._replace(states=jax.tree.map(lambda x: x[None], path.states), ok=path.ok[None])
        values, table = _values(path), dict[str, np.ndarray]()
        for name, (dims, array, _) in values.items():
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

    def to_xarray(self) -> Any:
        """The path as an `xarray.Dataset` with names, units and frames; its `to_netcdf` writes NetCDF.

        Dimensions are body (if there are several), time, member (of coupled bodies) and components. Needs xarray, in
        the extra `io`. SciPy, which comes with JAX, writes NetCDF of all values but complex numbers.

        Examples:
            >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=2)
            >>> dict(path.to_xarray().sizes)
            {'time': 3, 'axis': 3, 'quaternion': 4}
        """
        import xarray

        times, variables = np.asarray(self.times), {}
        of_bodies, over_time = ("body",) * np.ndim(self.ok), ("time",) * bool(times.ndim)
        for name, (dims, array, about) in _values(self).items():
            leading = (*of_bodies, *over_time)
            others = tuple(f"{name}_{i}" for i in range(array.ndim - len(leading) - len(dims)))
            variables[name] = ((*leading, *others, *dims), array, about)
        about = {"ok": "whether the whole run can be trusted", "first_bad": "first saved state not to be trusted"}
        for name, text in about.items():
            variables[name] = (of_bodies, np.asarray(getattr(self, name)), {"long_name": text})
        time = (("body", "time")[2 - times.ndim :], times, {"long_name": "time"})
        used = {dim for dims, *_ in variables.values() for dim in dims}
        coordinates = {k: v for k, v in COORDINATES.items() if k in used}
        return xarray.Dataset(variables, {"time" if times.ndim < 2 else "times": time} | coordinates)


def end_alone(path: P) -> P:
    """The path with only its final state, and `first_bad` 0 for a body that failed, else 1."""
    last = jax.tree.map(lambda x: x[-1], path.states)
    return path._replace(times=path.times[-1], states=last, first_bad=path.ok.astype(jnp.int32))


def first_bad(start: AnyState, trusted: Array) -> Array:
    """The number of trustworthy states: `Path.first_bad`, because a run that has failed stays failed."""
    return jnp.where(cp.all_finite(start), 1 + jnp.sum(trusted, dtype=jnp.int32), 0)


def named(tree: Any, separator: str = "_") -> dict[str, Any]:
    """The leaves by their position in the tree, {"momentum": ..., "attitude": ...}; "observed" for a single array."""
    places = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator=separator) or "observed": leaf for path, leaf in places}


def columns(state: Any) -> dict[str, tuple[str, ...]]:
    return {name: _columns(name, dims) for name, (dims, _) in state.described().items()}


def _columns(name: str, dims: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name}_{letter}" for letter in COORDINATES[dims[-1]])


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
