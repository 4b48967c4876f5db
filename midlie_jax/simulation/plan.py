"""How a run is cut into parts: groups of bodies, and spans of time.

A part is what is written to the variables of the file at once. How a run is cut depends on the run alone, and not on
devices, processes or the time that they take, so that all of them compute the same bits.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from ..drivers.chunks import even_size

_BYTES = 2**25  # about the size of one part in the file
# The most body-steps of one part, unless two saved states need more. With these, most runs write a part several times
# per minute, which a reader of the file can see. The cost of a kill does not depend on it, see `pace.py`.
_BODY_STEPS = 3 * 10**7
GROUP = 2**15  # bodies of one group, by default
_CARRIED = 2**28  # the most bytes that a group carries from span to span, by default


class Part(NamedTuple):
    """One group of bodies in one span of time."""

    span: int
    group: int

    def __str__(self) -> str:
        return f"span {self.span}, group {self.group}"


class Plan(NamedTuple):
    """How a run is cut into parts.

    Attributes:
        bodies: all bodies.
        saves: saved states of each body, the start included.
        save_every: steps between two saved states.
        group: bodies of a group; the last group may be smaller.
        span: saved states of a span, at least 2; the last span may be smaller.
        chunk: bodies that are moved at once on one device.
        begin: the index of the first step of the run.
    """

    bodies: int
    saves: int
    save_every: int
    group: int
    span: int
    chunk: int
    begin: int = 0

    @property
    def groups(self) -> int:
        return -(-self.bodies // self.group)

    @property
    def spans(self) -> int:
        return -(-self.saves // self.span)

    def parts(self, groups: range) -> Iterator[Part]:
        """The parts of these groups in the order in which they are computed: span by span, each for all groups."""
        return (Part(span, group) for span in range(self.spans) for group in groups)

    def bodies_of(self, group: int) -> slice:
        return slice(group * self.group, min((group + 1) * self.group, self.bodies))

    def bodies_in(self, group: int) -> int:
        """How many bodies a group has."""
        bodies = self.bodies_of(group)
        return bodies.stop - bodies.start

    def saves_of(self, span: int) -> slice:
        return slice(span * self.span, min((span + 1) * self.span, self.saves))

    def first_step(self, span: int) -> int:
        """The index of the first step of a span: its steps lead to the first of its saved states."""
        return self.begin + max(0, span * self.span - 1) * self.save_every

    def steps(self, span: int) -> int:
        """The number of steps of a span; the start, the first saved state of span 0, needs none."""
        saved = self.saves_of(span)
        return (saved.stop - saved.start - (span == 0)) * self.save_every

    @property
    def intervals(self) -> int:
        """The largest number of intervals between saved states in a span."""
        return self.span - (self.spans == 1)

    def place(self, part: Part, of_groups: bool, of_spans: bool = False) -> tuple[slice, slice]:
        """The place of a part in a variable (body, time, ...), or in one of a statistic.

        That is (group, time, ...), or of a statistic over times (group, span, ...).
        """
        rows = slice(part.group, part.group + 1) if of_groups else self.bodies_of(part.group)
        return rows, slice(part.span, part.span + 1) if of_spans else self.saves_of(part.span)

    def work(self, parts: Iterable[Part]) -> int:
        """The body-steps of parts."""
        return sum(self.bodies_in(part.group) * self.steps(part.span) for part in parts)

    def groups_of(self, process: int, processes: int) -> range:
        """The groups that a process computes: consecutive ones, as evenly distributed as possible."""
        return range(process * self.groups // processes, (process + 1) * self.groups // processes)


def sizes(bodies: int, group: int | None, chunk: int | None, longest: int, most: int = GROUP) -> tuple[int, int]:
    """The bodies of a group and of a chunk: as requested, or else cut evenly, so that few copies are computed.

    Args:
        longest: the most bodies of a chunk if its size was not requested.
        most: the most bodies of a group if its size was not requested.
    """
    if group is None:
        group = _evenly(bodies, most)
        chunk = chunk or _evenly(group, longest)
        return min(-(-group // chunk) * chunk, bodies), chunk
    return min(group, bodies), chunk or _evenly(min(group, bodies), longest)


def most_carried(bytes_a_body: int) -> int:
    """The most bodies of a group by default if something is carried of each from span to span."""
    return max(1, min(GROUP, _CARRIED // bytes_a_body))


def _evenly(count: int, most: int) -> int:
    """The size of parts if there are as few as possible of at most `most`; all have it except the last."""
    return even_size(count, -(-count // most))


def span_of(group: int, save_every: int, bytes_a_save: int | float) -> int:
    """How many saved states a span has by default.

    Args:
        group, save_every: as in `Plan`.
        bytes_a_save: the bytes of one saved state of one body in the file.
    """
    by_bytes = _BYTES / max(group * bytes_a_save, 1)
    by_work = _BODY_STEPS / (group * save_every)
    return max(2, int(min(by_bytes, by_work)))
