"""`Simulation`, the result of `simulate`; and `inspect`: the progress of a run in a store, its damage, its failures."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._checks.typed_by import TypedBy
from ..drivers.path import States
from .saved import states_of
from .store import Store

_SHOWN = 5  # failed bodies in the list


class Simulation(NamedTuple, TypedBy[States]):
    """The result of `simulate`; in annotations `Simulation[RigidState]`, a run of these states.

    Attributes:
        out: the folder or file.
        bodies, steps: the size of the whole run.
        saves: the number of saved states per body, including the initial one.
        first_bad: (n,), for each body the index of its first saved state that cannot be trusted; `saves` if there is
            none. A gain of energy is judged at the end of each span, against the start of the run; then it is the first
            state of that span after the start.
        computed: the number of body-steps computed by this call; less than bodies times steps if it resumed a run, or
            if several processes share it.
        seconds: the run time of this call, including compilation.
        carry: the `midlie_jax.Carry` of all bodies at the end, from which every driver continues with the same bits;
            None if other processes hold some of the bodies.

    Examples:
        >>> body, start = ml.RigidBody([5.0, 5.0, 1.0]), ml.RigidState(jnp.ones((4, 3)), jnp.eye(4))
        >>> run = ml.simulate("JACOBI[EA]", body, None, start, out="tops.npz", dt=0.01, steps=100, save_every=10)
        >>> bool(run.ok.all()), run.open()["momentum"].shape
        (True, (4, 11, 3))
    """

    out: Path
    bodies: int
    steps: int
    saves: int
    first_bad: np.ndarray
    computed: int
    seconds: float
    carry: Any = None

    @property
    def ok(self) -> np.ndarray:
        """(n,), whether all states of a body can be trusted."""
        return self.first_bad == self.saves

    def open(self) -> Any:
        """The run as an `xarray.Dataset`, which reads the file as needed; for a .npz file, its arrays.

        The attributes `parameters`, `versions` and `midlie_jax` of a dataset are JSON strings, for `json.loads`.
        """
        if self.out.suffix == ".npz":
            return np.load(self.out)
        import xarray

        return xarray.open_zarr(self.out)

    def states(self) -> States:
        """The saved states of all bodies, with leading axes (n, k); they may be NaN where they cannot be trusted.

        Raises:
            ValueError: the run saved other values by `observe`, or the file is damaged.
        """
        states: Any = states_of(self.out)
        return states

    def __str__(self) -> str:
        rate = f", {self.computed / self.seconds:.3g} body-steps/s" if self.computed else ""
        size = f"{self.bodies} bodies, {self.steps} steps, {self.saves} saved states of each"
        work = f"computed now: {self.computed} body-steps in {self.seconds:.3g} s{rate}"
        return "\n".join([f"{self.out}: {size}", work, _failures(self.first_bad, self.saves)])


class Inspection(NamedTuple):
    """The state of a run in a store.

    Attributes:
        path: the folder.
        attributes: the attributes of the store.
        bodies, saves: the size of the run.
        done: number of body-steps that are computed and written.
        total: number of body-steps of the whole run.
        damaged: names of data that are missing or cannot be read.
        first_bad: see `Simulation`; only the computed steps are included.

    Examples:
        >>> body, start = ml.RigidBody([5.0, 5.0, 1.0]), ml.RigidState(jnp.ones((4, 3)), jnp.eye(4))
        >>> run = ml.simulate("JACOBI[EA]", body, None, start, out="tops.zarr", dt=0.01, steps=100, save_every=10)
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
        cure = "to compute group G again, delete checkpoint/G.npz; then resume the run"
        lines = [
            f"{self.path}: {said['title']}",
            f"{size}; {said['method']}, {said['dtype']}",
            "complete" if self.done == self.total else f"{self.done / self.total:.1%} done; it can be resumed",
            _failures(self.first_bad, self.saves),
            *(f"DAMAGED: {name}" for name in self.damaged),
            *([cure] if self.damaged else []),
        ]
        return "\n".join(lines)


def inspect(path: str | Path) -> Inspection:
    """Reads a whole store, whose chunks have checksums, and names damaged data.

    Raises:
        ValueError: the folder is not the store of a run, or its description is damaged.

    Examples:
        >>> body, start = ml.RigidBody([5.0, 5.0, 1.0]), ml.RigidState(jnp.ones((4, 3)), jnp.eye(4))
        >>> run = ml.simulate("JACOBI[EA]", body, None, start, out="tops.zarr", dt=0.01, steps=100, save_every=10)
        >>> found = ml.simulation.inspect("tops.zarr")
        >>> found.done == found.total, found.damaged
        (True, ())
    """
    store = Store(Path(path), read_only=True)
    plan, damaged, done = store.plan, list[str](), 0
    first_bad = np.full(plan.bodies, plan.saves, np.int32)
    for group in range(plan.groups):
        try:
            found = store.checkpoint(group)
        except ValueError:
            damaged.append(f"the checkpoint of group {group}")
            continue
        if found is not None:
            span = int(found["span"])
            done += plan.done(group, span, int(found["steps"]))
            damaged += store.damaged(group, span)
            first_bad[plan.bodies_of(group)] = found["first_bad"]
    total = plan.work(plan.parts(range(plan.groups)))
    damaged += store.damaged_whole(done == total)
    return Inspection(store.path, store.attributes, plan.bodies, plan.saves, done, total, tuple(damaged), first_bad)


def _failures(first_bad: np.ndarray, saves: int) -> str:
    """The number of failed bodies, and their indices, in words."""
    failed = np.flatnonzero(first_bad < saves)
    if not failed.size:
        return "all bodies ok"
    listed = ", ".join(f"body {body} from saved state {first_bad[body]}" for body in failed[:_SHOWN])
    more = f" and {failed.size - _SHOWN} more" if failed.size > _SHOWN else ""
    return f"{failed.size} of {first_bad.size} bodies FAILED: {listed}{more}"
