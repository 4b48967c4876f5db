"""Where a run goes on: what a store holds of each group is checked, and what is damaged is computed again."""

from typing import NamedTuple

from .describe import whole_variables
from .parts import Computation, Progress
from .plan import Part
from .store import Store


class Resumed(NamedTuple):
    """Where the groups of a run are.

    Attributes:
        segments: for each group, how many segments need not be computed.
        groups: for each group its states after these segments.
        repaired: what was damaged; it is computed again, or has been written again.
    """

    segments: dict[int, int]
    groups: dict[int, Progress]
    repaired: tuple[str, ...]


def begun(computation: Computation, groups: range) -> Resumed:
    """These groups at the start of the run."""
    return Resumed(dict.fromkeys(groups, 0), {group: computation.begin(group) for group in groups}, ())


def resumed(computation: Computation, store: Store, groups: range) -> Resumed:
    """The state of these groups in a store, whose damaged parts it takes back.

    The states at the end of a segment are kept for the last two segments only. So a group with an older damaged part is
    computed from its start.
    """
    found = Resumed({}, {}, ())
    for group in groups:
        segments, damaged = whole_segments(store, group)
        if damaged:
            store.forget(group, segments)
            found = found._replace(repaired=(*found.repaired, *damaged))
        found.segments[group] = segments
        if segments:
            state, first_bad = store.state(Part(segments - 1, group))
            found.groups[group] = computation.resume(group, state, first_bad)
            store.write_first_bad(group, first_bad)
        else:
            found.groups[group] = computation.begin(group)
    return found


def repair_whole(computation: Computation, store: Store) -> tuple[str, ...]:
    """Writes variables again that no part writes, such as the time, where they are damaged; returns their names."""
    whole = whole_variables(computation.batch, computation.plan)
    damaged = {name: given for name, given in whole.items() if not store.holds(name, given[1])}
    store.add(damaged)
    return tuple(damaged)


def whole_segments(store: Store, group: int) -> tuple[int, list[str]]:
    """How many segments of a group are whole, with the states to go on from, and what else is damaged."""
    segments = store.committed(group)
    damaged = store.damage(group)
    if damaged:
        return 0, damaged
    for count in range(segments, max(0, segments - 2), -1):
        if store.whole_state(Part(count - 1, group)):
            return count, damaged
        damaged.append(f"the states after {Part(count - 1, group)}")
    return 0, damaged
