"""The part of `make fuzz` over execution paths: random combinations of what `test_paths.py` goes through in order."""

import tempfile
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
from hypothesis import strategies as st
from path_scenes import DT, SCENES, T0
from test_paths import STEPS, Case, agree, at, case_run, reference

import midlie_jax as ml

FIRST = [0, 1, 31, 100]  # indices of the first step, while the torques that grow with time are of order one


class Drawn(NamedTuple):
    """A scene and one way to run it; `steps` is at most `STEPS`."""

    scene: str
    dtype: str
    driver: str
    saves: int  # saved intervals, 0 for the end alone
    every: int
    bodies: int
    chunk: int
    first: int

    @property
    def save_every(self) -> int | None:
        return self.every if self.saves else None

    @property
    def steps(self) -> int:
        return self.every * max(1, self.saves)


def _fits(drawn: Drawn) -> bool:
    return drawn.steps <= STEPS


CASES = st.builds(
    Drawn,
    scene=st.sampled_from(sorted(SCENES)),
    dtype=st.sampled_from(["float32", "float64"]),
    driver=st.sampled_from(["integrate", "jit", "vmap", "jit(vmap)", "ensemble", "simulate", "two runs"]),
    saves=st.sampled_from([0, 0, 1, 2, 3, 5]),
    every=st.sampled_from([1, 2, 3, 5, 8, 13, 31, 32, 33, 66]),
    bodies=st.integers(1, 5),
    chunk=st.integers(1, 5),
    first=st.sampled_from(FIRST),
).filter(_fits)


def check(drawn: Drawn) -> None:
    """Raises AssertionError where a run differs from one that saves every step."""
    case = Case(drawn.scene, drawn.dtype)
    options = {"steps": drawn.steps, "save_every": drawn.save_every, "first_step": drawn.first}
    index = slice(0, drawn.steps + 1, drawn.every) if drawn.saves else drawn.steps
    rows = range(drawn.bodies)
    if drawn.driver in ("integrate", "jit"):
        run: Any = partial(case_run, case, **options)
        run = eqx.filter_jit(run) if drawn.driver == "jit" else run
        found = [run(case.start(0), case.keys()[0]).states]
        rows = range(1)
    elif drawn.driver.endswith("vmap") or drawn.driver == "jit(vmap)":
        run = jax.vmap(partial(case_run, case, **options))
        run = jax.jit(run) if drawn.driver.startswith("jit") else run
        states = run(case.starts(drawn.bodies), case.keys(drawn.bodies)).states
        found = [at(states, row) for row in rows]
    elif drawn.driver == "two runs":
        middle = drawn.steps // 2
        rows = range(1)
        start = case.start(0)
        if middle:
            start = case.run(steps=middle, save_every=None, first_step=drawn.first).states
        end = case.run(start=start, steps=drawn.steps - middle, save_every=None, first_step=drawn.first + middle)
        found, index = [end.states], drawn.steps
    elif drawn.driver == "ensemble":
        states = case.together(drawn.bodies, chunk=drawn.chunk, **options).states
        found = [at(states, row) for row in rows]
    else:
        given = {"dt": DT, "t0": T0, "progress": False, "chunk": drawn.chunk, **options}
        torque, starts = case.torque(case.keys(drawn.bodies)), case.starts(drawn.bodies)
        given["torque_axes"] = case.torque_axes
        with tempfile.TemporaryDirectory() as folder:
            out = f"{folder}/run.zarr"
            states = ml.simulate(case.scene.method, case.body, torque, starts, out=out, **given).states()
        found = [at(states, row) for row in rows]
        index = slice(0, drawn.steps + 1, drawn.every)  # the start and the end, if nothing is said
    for row, one in zip(rows, found, strict=True):
        agree(one, at(reference(case, row, drawn.first), index), case.allowed)
