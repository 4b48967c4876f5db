"""Where a run goes on: what a store holds of each group is checked, and what is damaged is computed again."""

from typing import NamedTuple

from .describe import whole_variables
from .parts import Computation, Progress
from .plan import Part, Plan
from .sink import Begun
from .store import Store


class Resumed(NamedTuple):
    """Where the groups of a run are.

    Attributes:
        segments: for each group, how many segments need not be computed.
        groups: for each group its progress after these segments, and in the next one.
        repaired: what was damaged; it is computed again, or has been written again.
    """

    segments: dict[int, int]
    groups: dict[int, Progress]
    repaired: tuple[str, ...]

    def missing(self, plan: Plan) -> int:
        """The body-steps of these groups that must be computed."""
        todo = (Part(s, group) for group, done in self.segments.items() for s in range(done, plan.segments))
        begun = sum(plan.bodies_in(group) * progress.steps for group, progress in self.groups.items())
        return plan.work(todo) - begun


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
        begun, lost = kept_of(store, Part(segments, group))
        found = found._replace(repaired=(*found.repaired, *damaged, *lost))
        if begun is None:
            store.forget_begun(group)
        if damaged:
            store.forget(group, segments)
            if segments == store.plan.segments > 1 and not store.whole_state(Part(segments - 2, group)):
                store.give_up(Part(segments - 2, group))
        found.segments[group] = segments
        if segments:
            state, first_bad = store.state(Part(segments - 1, group))
            found.groups[group] = computation.resume(group, state, first_bad)
        else:
            found.groups[group] = computation.begin(group)
            first_bad = found.groups[group].first_bad[: store.plan.bodies_in(group)]
        store.write_first_bad(group, first_bad)
        if begun is not None:
            found.groups[group] = computation.resume_within(group, found.groups[group], begun)
    return found


def kept_of(store: Store, part: Part) -> tuple[Begun | None, list[str]]:
    """What a store keeps of the first part of a group that is not whole; and the name of that, if it is damaged."""
    if part.segment == store.plan.segments:
        return None, []
    try:
        return store.begun(part), []
    except ValueError:
        return None, [f"the steps of {part}"]


def repair_whole(computation: Computation, store: Store) -> tuple[str, ...]:
    """Writes variables again that no part writes, such as the time, where they are damaged; returns their names."""
    whole = whole_variables(computation.batch, computation.plan)
    damaged = {name: given for name, given in whole.items() if not store.holds(name, given[1])}
    store.add(damaged)
    return (*store.restore(), *damaged)


def whole_segments(store: Store, group: int) -> tuple[int, list[str]]:
    """How many segments of a group are whole, with the states to go on from, and what else is damaged."""
    segments = store.committed(group)
    damaged = store.damage(group)
    if damaged:
        return 0, list(dict.fromkeys((*damaged, *store.torn(group))))
    damaged = store.torn(group)
    for count in range(segments, max(0, segments - 2), -1):
        if store.whole_state(Part(count - 1, group)):
            spare = Part(count - 2, group)
            # Before the end of the run a killed process may have begun to overwrite them.
            complete = count == store.plan.segments > 1
            if complete and not store.given_up(spare) and not store.whole_state(spare):
                damaged.append(f"the spare states after {spare}")
            return count, damaged
        damaged.append(f"the states after {Part(count - 1, group)}")
    return 0, damaged
