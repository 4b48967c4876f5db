"""How a run is divided into parts: groups of bodies and spans of time.

A part is the unit of writing to the variables of the file. The division depends on the run alone, and not on devices,
processes or run time, so that all of them compute the same bits.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

Arrays = dict[str, np.ndarray]
BODY, GROUP, TIME, SPAN = "body", "group", "time", "span"  # names of dimensions


class Part(NamedTuple):
    """One group of bodies in one span of time."""

    span: int
    group: int

    def __str__(self) -> str:
        return f"span {self.span}, group {self.group}"


class Plan(NamedTuple):
    """How a run is divided into parts."""

    bodies: int
    saves: int  # saved states per body, including the initial one
    save_every: int  # steps between two saved states
    group: int  # bodies per group; the last group may be smaller
    span: int  # saved states per span, at least 2; the last span may be smaller
    chunk: int  # bodies moved at once on one device
    begin: int = 0  # the index of the first step of the run

    @property
    def groups(self) -> int:
        return -(-self.bodies // self.group)

    @property
    def spans(self) -> int:
        return -(-self.saves // self.span)

    def parts(self, groups: Iterable[int]) -> Iterator[Part]:
        """The parts of these groups in the order of computation: span by span, each for all groups."""
        return (Part(span, group) for span in range(self.spans) for group in groups)

    def bodies_of(self, group: int) -> slice:
        return slice(group * self.group, min((group + 1) * self.group, self.bodies))

    def bodies_in(self, group: int) -> int:
        return min(self.group, self.bodies - group * self.group)

    def saves_of(self, span: int) -> slice:
        return slice(span * self.span, min((span + 1) * self.span, self.saves))

    def first_step(self, span: int) -> int:
        """The index of the first step of a span; its steps lead to the first of its saved states."""
        return self.begin + max(0, span * self.span - 1) * self.save_every

    def steps(self, span: int) -> int:
        """The number of steps of a span; the initial state, the first one of span 0, needs none."""
        saved = self.saves_of(span)
        return (saved.stop - saved.start - (span == 0)) * self.save_every

    @property
    def intervals(self) -> int:
        """The largest number of intervals between saved states in a span."""
        return self.span - (self.spans == 1)

    def place(self, part: Part, dims: tuple[str, ...]) -> tuple[slice, slice]:
        """The place of a part in a variable (body, time, ...), (group, time, ...) or (group, span, ...)."""
        rows = slice(part.group, part.group + 1) if dims[0] == GROUP else self.bodies_of(part.group)
        return rows, slice(part.span, part.span + 1) if dims[1] == SPAN else self.saves_of(part.span)

    def work(self, parts: Iterable[Part]) -> int:
        return sum(self.bodies_in(part.group) * self.steps(part.span) for part in parts)

    def done(self, group: int, span: int, steps: int) -> int:
        """The body-steps of a group before a span, and in the first `steps` steps of it."""
        return self.work(Part(before, group) for before in range(span)) + self.bodies_in(group) * steps

    def groups_of(self, process: int, processes: int) -> range:
        """The groups that a process computes: consecutive, and distributed as evenly as possible."""
        return range(process * self.groups // processes, (process + 1) * self.groups // processes)
