"""`inspect`: the progress of a run in a store, its damage, and its failed bodies."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .plan import Part
from .resume import kept_of, whole_spans
from .store import Store
from .summary import failures


class Inspection(NamedTuple):
    """The state of a run in a store.

    Attributes:
        path: the folder.
        attributes: the attributes of the store.
        bodies, saves: the size of the run.
        done: number of body-steps that are computed and written.
        total: number of body-steps of the whole run.
        damaged: names of data that cannot be read or have changed; empty if there is no damage.
        first_bad: see `Simulation`; only the computed steps are included.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> momentum = jnp.stack([jnp.zeros(4), jnp.zeros(4), jnp.linspace(40.0, 50.0, 4)], axis=-1)
        >>> start = ml.RigidState(momentum, jnp.tile(ml.so3.exp(jnp.array([0.3, 0.0, 0.0])), (4, 1)))
        >>> run = ml.simulate("JACOBI[EA]", body, torque, start, out="tops.zarr", dt=0.01, steps=100, save_every=10)
        >>> found = ml.simulation.inspect("tops.zarr")
        >>> found.bodies, found.saves, found.attributes["method"]
        (4, 11, 'JACOBI[EA]')
    """

    path: Path
    attributes: dict[str, Any]
    bodies: int
    saves: int
    done: int
    total: int
    damaged: tuple[str, ...]
    first_bad: np.ndarray

    def __str__(self) -> str:
        said = self.attributes
        size = f"{self.bodies} bodies, {said['steps']} steps, {self.saves} saved states of each"
        state = "complete" if self.done == self.total else f"{self.done / self.total:.1%} done; it can be resumed"
        lines = [
            f"{self.path}: {said['title']}",
            f"{size}; {said['method']}, {said['dtype']}",
            state,
            failures(self.first_bad, self.saves),
            *(f"DAMAGED: {name}; resume the run to mend it" for name in self.damaged),
        ]
        return "\n".join(lines)


def inspect(path: str | Path) -> Inspection:
    """Reads a whole store and compares it with the stored checksums.

    Raises:
        ValueError: the folder is not the store of a run, or its description is damaged.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> momentum = jnp.stack([jnp.zeros(4), jnp.zeros(4), jnp.linspace(40.0, 50.0, 4)], axis=-1)
        >>> start = ml.RigidState(momentum, jnp.tile(ml.so3.exp(jnp.array([0.3, 0.0, 0.0])), (4, 1)))
        >>> run = ml.simulate("JACOBI[EA]", body, torque, start, out="tops.zarr", dt=0.01, steps=100, save_every=10)
        >>> found = ml.simulation.inspect("tops.zarr")
        >>> found.done == found.total, found.damaged
        (True, ())
    """
    store = Store(Path(path), read_only=True)
    plan, damaged, done = store.plan, [*store.lost_descriptions(), *store.damaged_whole()], 0
    for group in range(plan.groups):
        done += plan.work(Part(span, group) for span in range(store.committed(group)))
        spans, found = whole_spans(store, group)
        begun, lost = kept_of(store, Part(spans, group))
        done += plan.bodies_in(group) * (begun.steps if begun else 0)
        damaged += [*found, *lost]
    total = plan.work(plan.parts(range(plan.groups)))
    first_bad = store.first_bad()
    return Inspection(store.path, store.attributes, plan.bodies, plan.saves, done, total, tuple(damaged), first_bad)
