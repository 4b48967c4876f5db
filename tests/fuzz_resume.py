"""The third part of `make fuzz`: what changes between the stop of a run and its resumption.

A small run is stopped after some of its parts, something is changed, and the run is resumed. It must be refused, or end
with the bits of a run that was never stopped; where nothing has changed it must not be refused, unless it calls code
that cannot be seen.
"""

import contextlib
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import hiding
import jax.numpy as jnp
import numpy as np
import zarr
from hypothesis import strategies as st

import midlie_jax as ml

PLACES = {place.__name__: place for place in (*hiding.SEEN, hiding.in_a_global, hiding.in_a_global_of_a_jit)}
PLACES["called_back"] = hiding.called_back
CODE = {"product": lambda value, y: value * y, "other product": lambda value, y: (value + 1e-3) * y}
DEFAULT = {
    "method": "SYMMETRIC[EA]",
    "body": (2.0, 2.0, 1.0),
    "start": 3.0,
    "dt": 0.1,
    "t0": 0.0,
    "steps": 8,
    "save_every": 1,
    "code": "product",
    "role": "torque",
    "numbers": (0.1, 0.2, 0.3),
}
CHANGES = {
    "nothing": {},
    "numbers": {"numbers": (0.1, 0.2, float(np.nextafter(0.3, 1)))},
    "many numbers": {"numbers": (100.0, 200.0, 300.0)},
    "method": {"method": "SYMMETRIC[E2]"},
    "body": {"body": (2.0, 2.0, 1.1)},
    "start": {"start": float(np.nextafter(3.0, 4))},
    "dt": {"dt": float(np.nextafter(0.1, 1))},
    "t0": {"t0": 1e-9},
    "steps": {"steps": 16},
    "save_every": {"save_every": 2},
    "code": {"code": "other product"},
    "role": {"role": "both"},
}


class Case(NamedTuple):
    """A run and what happens to it."""

    place: str  # of the numbers
    role: str  # of the function with the numbers: torque, observe or both
    change: str
    parts: int  # written before the stop


CASES = st.builds(
    Case,
    place=st.sampled_from(sorted(PLACES)),
    role=st.sampled_from(["torque", "observe"]),
    change=st.sampled_from(sorted(CHANGES)),
    parts=st.integers(1, 3),
)


class StoppedError(Exception):
    """As if the process ended here."""


def run(out: Path, place: str, settings: dict, **options) -> None:
    """Two bodies, in two groups and spans of two or three saved states."""
    given = {**DEFAULT, **settings}
    hidden, code = PLACES[place](np.array(given["numbers"])), CODE[given["code"]]
    momentum = jnp.array([[0.1, 0.2, given["start"]], [0.3, -0.1, 2.0]])
    start = ml.RigidState(momentum, jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1)))

    def torque(t, state):
        return code(hidden(state.attitude[1:] + t), jnp.array([0.3, 0.2, 0.1]))

    def observe(t, state):
        return {"seen": code(hidden(state.momentum), jnp.ones(())), "momentum": state.momentum}

    ml.simulate(
        given["method"],
        ml.RigidBody(jnp.array(given["body"])),
        torque if given["role"] != "observe" else None,
        start,
        out=out,
        **{name: given[name] for name in ("dt", "t0", "steps", "save_every")},
        observe=observe if given["role"] != "torque" else None,
        **{"group": 1, "span": 3, "chunk": 1, "progress": False, **options},
    )


def contents(path: Path) -> dict[str, np.ndarray]:
    return {name: np.asarray(array[...]) for name, array in zarr.open_group(path, mode="r").arrays()}


@cache
def uninterrupted(place: str, role: str) -> dict[str, np.ndarray]:
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder) / "run.zarr", place, {"role": role})
        return contents(Path(folder) / "run.zarr")


def check(case: Case) -> None:
    """Raises AssertionError where two runs are mixed, and where a run that is the same is refused."""
    expected = uninterrupted(case.place, case.role)
    left = case.parts

    def stop(work: int) -> None:
        nonlocal left
        left -= 1
        if not left:
            raise StoppedError

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.zarr"
        with contextlib.suppress(StoppedError):
            run(path, case.place, {"role": case.role}, progress=stop)
        try:
            run(path, case.place, {"role": case.role, **CHANGES[case.change]}, resume=True)
        except ValueError as error:
            if "holds another run" not in str(error) and "cannot be resumed" not in str(error):
                raise
            if case.change == "nothing" and case.place != "called_back":
                raise AssertionError(f"{case}: the same run is refused: {error}") from error
            return
        for name, values in contents(path).items():
            if not np.array_equal(values, expected[name], equal_nan=values.dtype.kind == "f"):
                raise AssertionError(f"{case}: {name} is of two runs")
