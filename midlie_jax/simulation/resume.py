"""Where a run continues: the stored data of each group are checked, and damaged parts are computed again."""

from typing import NamedTuple

from .describe import whole_variables
from .parts import Computation, Progress
from .plan import Part, Plan
from .sink import Begun
from .store import Store


class Resumed(NamedTuple):
    """The progress of the groups of a run.

    Attributes:
        spans: for each group, the number of spans that need not be computed.
        groups: for each group, its progress after these spans, including steps of the next span.
        repaired: damaged data that are computed or have been written again.
    """

    spans: dict[int, int]
    groups: dict[int, Progress]
    repaired: tuple[str, ...]

    def missing(self, plan: Plan) -> int:
        todo = (Part(s, group) for group, done in self.spans.items() for s in range(done, plan.spans))
        begun = sum(plan.bodies_in(group) * progress.steps for group, progress in self.groups.items())
        return plan.work(todo) - begun


def begun(computation: Computation, groups: range) -> Resumed:
    """These groups at the beginning of the run."""
    return Resumed(dict.fromkeys(groups, 0), {group: computation.begin(group) for group in groups}, ())


def resumed(computation: Computation, store: Store, groups: range) -> Resumed:
    """The progress of these groups in a store; commits of damaged parts are revoked.

    Only the states at the end of the last two spans are stored. A group with an older damaged part is therefore
    computed from the beginning of the run.
    """
    found = Resumed({}, {}, ())
    for group in groups:
        spans, damaged = whole_spans(store, group)
        begun, lost = kept_of(store, Part(spans, group))
        found = found._replace(repaired=(*found.repaired, *damaged, *lost))
        if begun is None:
            store.forget_begun(group)
        if damaged:
            store.forget(group, spans)
            if spans == store.plan.spans > 1 and not store.whole_state(Part(spans - 2, group)):
                store.give_up(Part(spans - 2, group))
        found.spans[group] = spans
        if spans:
            state, first_bad = store.state(Part(spans - 1, group))
            found.groups[group] = computation.resume(group, state, first_bad)
        else:
            found.groups[group] = computation.begin(group)
            first_bad = found.groups[group].first_bad[: store.plan.bodies_in(group)]
        store.write_first_bad(group, first_bad)
        if begun is not None:
            found.groups[group] = computation.resume_within(group, found.groups[group], begun)
    return found


def kept_of(store: Store, part: Part) -> tuple[Begun | None, list[str]]:
    """The stored first incomplete part of a group, and its name if it is damaged."""
    if part.span == store.plan.spans:
        return None, []
    try:
        return store.begun(part), []
    except ValueError:
        return None, [f"the steps of {part}"]


def repair_whole(computation: Computation, store: Store) -> tuple[str, ...]:
    """Rewrites the damaged variables that no part writes, such as the time; returns their names."""
    whole = whole_variables(computation.batch, computation.plan)
    damaged = {name: given for name, given in whole.items() if not store.holds(name, given[1])}
    store.add(damaged)
    return (*store.restore(), *damaged)


def whole_spans(store: Store, group: int) -> tuple[int, list[str]]:
    """The number of undamaged spans of a group with states to continue from, and the names of damaged data."""
    spans = store.committed(group)
    damaged = store.damage(group)
    if damaged:
        return 0, list(dict.fromkeys((*damaged, *store.torn(group))))
    damaged = store.torn(group)
    for count in range(spans, max(0, spans - 2), -1):
        if store.whole_state(Part(count - 1, group)):
            spare = Part(count - 2, group)
            # Before the end of the run, a killed process may have begun to overwrite the states.
            complete = count == store.plan.spans > 1
            if complete and not store.given_up(spare) and not store.whole_state(spare):
                damaged.append(f"the spare states after {spare}")
            return count, damaged
        damaged.append(f"the states after {Part(count - 1, group)}")
    return 0, damaged
