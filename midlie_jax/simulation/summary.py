"""`Simulation`, the result of `simulate`; and the merged statistics of all groups."""

from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.typed_by import TypedBy
from ..drivers.observe import Statistic
from ..drivers.observe.series import Series
from ..drivers.path import States
from .describe import Whole
from .names import named
from .plan import Plan
from .saved import states_of
from .sink import Sink
from .variables import TIME, Variable, own_dims

_SHOWN = 5  # failed bodies in the list


class Simulation(NamedTuple, TypedBy[States]):
    """The result of `simulate`; in annotations `Simulation[RigidState]`, a run of these states.

    Attributes:
        out: the folder or file.
        bodies, steps: the size of the whole run.
        saves: the number of saved states per body, including the initial one.
        first_bad: (n,), for each body the index of its first saved state that cannot be trusted; `saves` if there is
            none. The first bad step is between the previous saved state and this one. A gain of energy is judged at the
            end of each span, against the start of the run; then it is the first state of that span after the start.
        computed: the number of body-steps computed by this call; less than bodies times steps if it resumed a run, or
            if several processes share it.
        seconds: the run time of this call, including compilation.
        repaired: damaged data of the file that have been computed or written again; damaged spare states are only
            discarded.
        carry: the `midlie_jax.Carry` of all bodies at the end, from which every driver continues with the same bits;
            None if other processes hold some of the bodies.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> momentum = jnp.stack([jnp.zeros(4), jnp.zeros(4), jnp.linspace(40.0, 50.0, 4)], axis=-1)
        >>> start = ml.RigidState(momentum, jnp.tile(ml.so3.exp(jnp.array([0.3, 0.0, 0.0])), (4, 1)))
        >>> run = ml.simulate("JACOBI[EA]", body, torque, start, out="tops.npz", dt=0.01, steps=100, save_every=10)
        >>> run.bodies, run.saves, bool(run.ok.all())
        (4, 11, True)
        >>> run.open()["momentum"].shape
        (4, 11, 3)
    """

    out: Path
    bodies: int
    steps: int
    saves: int
    first_bad: np.ndarray
    computed: int
    seconds: float
    repaired: tuple[str, ...]
    carry: Any = None

    @property
    def ok(self) -> np.ndarray:
        """(n,), whether all states of a body can be trusted."""
        return self.first_bad == self.saves

    def open(self) -> Any:
        """The run as an `xarray.Dataset`, which reads the file as needed; for a .npz file, its arrays.

        The method `to_netcdf` of the dataset writes a NetCDF file. The attributes `parameters`, `versions` and
        `midlie_jax` are JSON strings, for `json.loads`.
        """
        if self.out.suffix == ".npz":
            return np.load(self.out)
        import xarray

        return xarray.open_zarr(self.out)

    def states(self) -> States:
        """The saved states of all bodies, of the class of `start`, with leading axes (n, k), all in memory.

        States that cannot be trusted may hold NaN.

        Raises:
            ValueError: the run saved other values by `observe`.
        """
        states: Any = states_of(self.out)
        return states

    def __str__(self) -> str:
        rate = f", {self.computed / self.seconds:.3g} body-steps/s" if self.computed else ""
        lines = [
            f"{self.out}: {self.bodies} bodies, {self.steps} steps, {self.saves} saved states of each",
            f"computed now: {self.computed} body-steps in {self.seconds:.3g} s{rate}",
            failures(self.first_bad, self.saves),
            *(f"damaged, and mended: {name}" for name in self.repaired),
        ]
        return "\n".join(lines)


def failures(first_bad: np.ndarray, saves: int) -> str:
    """The number of failed bodies, and their indices, in words."""
    failed = np.flatnonzero(first_bad < saves)
    if not failed.size:
        return "all bodies ok"
    listed = ", ".join(f"body {body} from saved state {first_bad[body]}" for body in failed[:_SHOWN])
    more = f" and {failed.size - _SHOWN} more" if failed.size > _SHOWN else ""
    return f"{failed.size} of {first_bad.size} bodies FAILED: {listed}{more}"


def merged_statistic(observe: Statistic, seen: Any, sink: Sink, interval: Array) -> Whole:
    """The variables (time, ...) of a statistic over all bodies, merged from the parts of the groups in a file.

    A statistic over times has its lags or frequencies instead of times.

    Args:
        seen: the pytree of the data of a part.
        interval: the time between two saved states, ().
    """
    of_times = isinstance(observe, Series)
    parts = (sink.read(name) for name in named(seen))
    arrays = [jnp.asarray(part[:, -1] if of_times else part) for part in parts]
    finished = _finished(observe, jax.tree.unflatten(jax.tree.structure(seen), arrays), interval)
    found: Whole = {}
    for name, leaf in named(finished).items():
        values = np.asarray(leaf)
        about = {"long_name": f"{name} over all bodies that can be trusted", **observe.attributes()}
        first = observe.row_of(name) if isinstance(observe, Series) else TIME
        found[name] = (Variable((first, *own_dims(name, values.shape[1:])), values.shape, values.dtype, about), values)
    return found


def names_of_merged(observe: Statistic, seen: Any, plan: Plan, dtype: Any) -> list[str]:
    """The names of the variables of `merged_statistic`, without computing them; `dtype` is the dtype of the run."""
    axes = (plan.groups,) if isinstance(observe, Series) else (plan.groups, plan.saves)
    parts = jax.tree.map(lambda x: jax.ShapeDtypeStruct((*axes, *x.shape), x.dtype), seen)
    return list(named(eqx.filter_eval_shape(_finished, observe, parts, jax.ShapeDtypeStruct((), dtype))))


def _finished(observe: Statistic, parts: Any, interval: Array) -> Any:
    """The merged parts of all groups as stored in a file, a pytree of arrays."""
    return observe.finished(observe.result(observe.merged(parts), interval))
