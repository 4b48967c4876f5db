"""The problem that every program solves: the same bodies, torque and clock, and the same measure of the error.

What depends on the kind of state, equations and errors, is in `kinds`.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import jax
import numpy as np

from midlie_jax.advice.timing import Timing, timed, timed_in_turn
from midlie_jax.cli.scenes import Scene
from midlie_jax.model.state import AnyState

from ..kinds import Kind, numbers, sizes


class Point(NamedTuple):
    """One program or method at one tolerance or step.

    Attributes:
        method: name of the method.
        setting: the tolerance or step, such as "tol 1e-06", and after a comma the options of the program, if any.
        error: at the end, as its kind of state measures it, root mean square over the bodies with a reference end.
        seconds: median time of the whole run for one body, without compiling (`timing.cost_clock`).
        evaluations: torque evaluations for one body; NaN for a method or problem without torque evaluations.
        steps: number of steps for one body; NaN for a closed form, which takes none.
        spread: half the distance between the quartiles of the timings, relative to the median.
    """

    method: str
    setting: str
    error: float
    seconds: float
    evaluations: float
    steps: float
    spread: float = math.nan


class Problem(NamedTuple):
    """Bodies to move, and the reference ends of the first of them.

    Attributes:
        scene: the body, the torque and the duration.
        kind: what its state is, and how errors are measured.
        starts: the states of n bodies at the start.
        ends: reference numbers at the end, of the first m bodies, (m, k).
        source: how the ends were computed.
        uncertainty: estimate of the error of the ends.
        repeats: largest number of timed runs.
        longest: seconds of a run of all bodies; after a longer run no smaller step is tried.
    """

    scene: Scene
    kind: Kind
    starts: AnyState
    ends: np.ndarray
    source: str
    uncertainty: float
    repeats: int = 5
    longest: float = 1.0

    @property
    def bodies(self) -> int:
        return len(self.starts.momentum)

    @property
    def states(self) -> np.ndarray:
        """The numbers at the start, (n, k)."""
        return numbers(self.starts)

    @property
    def sizes(self) -> np.ndarray:
        """The size of each number, (k,)."""
        return sizes(jax.tree.map(lambda leaf: leaf[0], self.starts))

    def error(self, ends: Any) -> float:
        """The error of the numbers (j, k) of the first j bodies at the end; at most m bodies are compared."""
        given = np.asarray(ends, np.float64)[: len(self.ends)]
        return float(np.sqrt(np.mean(self.kind.errors(given, self.ends[: len(given)]) ** 2)))

    def point(
        self, name: str, setting: str, ends: Any, timing: Timing, steps: Any, evaluations: Any, bodies: int = 0
    ) -> Iterator[Point]:
        """The point of a run of so many bodies, by default all, if its ends are finite."""
        if np.all(np.isfinite(ends)):
            count = math.nan if self.scene.torque is None else evaluations
            seconds = timing.seconds / (bodies or self.bodies)
            yield Point(name, setting, self.error(ends), seconds, count, steps, timing.spread)

    def timed(self, run: Callable[[], Any]) -> tuple[Any, Timing]:
        """The result of `run`, which must wait for it, and the timing of several runs."""
        return timed(run, most=self.repeats, longest=self.longest)

    def timed_in_turn(self, runs: Sequence[Callable[[], Any]]) -> list[Timing]:
        """The timings of several runs that take turns, so that what slows the machine for a while slows them all."""
        return [timing for _, timing in timed_in_turn(runs, most=self.repeats, longest=self.longest)]


def program(name: str) -> Any:
    """The module of that name; if it is not installed, an ImportError that names the extra."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"the rivals need {name.split('.')[0]}: pip install 'midlie_jax[bench]'.") from error
