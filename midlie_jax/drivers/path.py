"""`Path`: the result of the drivers, typed by the class of the states."""

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from .._checks.typed_by import TypedBy
from .._math import components as cp
from .._xla.internals import Tracer
from ..model.state import AnyState
from . import tables
from .results import reasons

States = TypeVar("States", covariant=True)  # a path of CompensatedStates is one of RigidStates
P = TypeVar("P", bound=Any)  # a path
_WIDTH = 120  # of a line of text


class Path(NamedTuple, TypedBy[States]):
    """A motion at the saved times; in annotations `Path[RigidState]`.

    Attributes:
        times: (n,), beginning with the initial time; n = 1 + steps / save_every.
        states: the states at these times, of the class of the initial state, with a leading axis (n,); with `observe`,
            the observed values.
        ok: (), False if a solve failed, a number was not finite, the body is impossible, or the run gained too much
            energy. Energy is checked in runs of at least 128 steps of translating bodies, coupled bodies or particles:
            the gain must not exceed what the potential can give. With variable steps also False if rho or the density
            was not positive, the two differed by more than a factor of 2 (the density jumped, or the steps are too
            large to follow it), or t1 was not reached.
        first_bad: (), the index in `times` of the first saved state that cannot be trusted, because a solve failed or a
            number stopped being finite at or before its time; n if there is none. So `states[:first_bad]` can be
            trusted. The first bad step ends after `times[first_bad - 1]` and not after `times[first_bad]`. With
            `save_every` 1 it is step number `first_bad` of the run, counted from 1. A gain of energy is detected at the
            end of the run, and then `first_bad` is 1.
        result: (), why the run failed, one of `midlie_jax.RESULTS`; `RESULTS.successful` where `ok`. Prints as a
            sentence with the remedy. None in a path that no driver made.
        carry: the final `midlie_jax.Carry`, with which `integrate`, `ensemble` and a `midlie_jax.stepper` continue as
            if the run had not been divided; with variable steps, `integrate_variable_step`.
        rho: with variable steps, (n,), near the density at these times: the next step is about dt / rho. To continue or
            reverse a run from a saved state, pass its entry as `rho`.
        taken: with variable steps, the number of steps taken, (); fewer than `steps` if the run reached t1 or failed.

    Examples:
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> path.times[:3].round(4), path.states.momentum.shape
        (Array([0.  , 0.01, 0.02], dtype=float64), (101, 3))
        >>> bool(path.ok), int(path.first_bad)
        (True, 101)
    """

    times: Float[Array, "*n"]
    states: States
    ok: Bool[Array, "*batch"]
    first_bad: Int[Array, "*batch"]
    result: Any = None
    carry: Any = None
    rho: Any = None
    taken: Any = None

    to_csv = tables.to_csv
    to_xarray = tables.to_xarray

    def __repr__(self) -> str:
        # Its times and whether it is ok are in the first line, then the shapes of its states.
        name, states = type(self).__name__, eqx.tree_pformat(self.states, width=_WIDTH)
        known = all(isinstance(x, Array) and not isinstance(x, Tracer) for x in (self.times, self.ok, self.first_bad))
        if not known or not all(x.is_fully_addressable and x.size for x in (self.times, self.ok)):
            return f"{name}({', '.join(f'{n}={eqx.tree_pformat(x)}' for n, x in zip(self._fields, self, strict=True))})"
        times, ok = np.asarray(self.times), np.asarray(self.ok)
        first, last = (times[..., 0].min(), times[..., -1].max()) if times.ndim else (times, times)
        span = (
            f"{times.shape[-1]} saved states at times {first:.6g} to {last:.6g}" if times.ndim else f"end at {last:.6g}"
        )
        if ok.all():
            judged = "ok" if not ok.ndim else f"all {ok.size} ok"
        else:
            judged = f"states[:{int(self.first_bad)}] ok" if not ok.ndim else f"{np.count_nonzero(ok)} of {ok.size} ok"
            judged += "." if self.result is None else f". {reasons(self.result, np.asarray(~ok))}"
        return f"{name}: {span}; {judged}\n{states}"


def end_alone(path: P) -> P:
    """The path with only its final state, and `first_bad` 0 for a body that failed, else 1."""
    last = jax.tree.map(lambda x: x[-1], path.states)
    return path._replace(times=path.times[-1], states=last, first_bad=path.ok.astype(jnp.int32))


def first_bad(start: AnyState, trusted: Array) -> Array:
    """`Path.first_bad`, from the initial state and whether each later state can be trusted so far.

    A run that has failed stays failed: its flag stays False, and NaN and infinity do not become finite. All trustworthy
    states therefore come first, and their number is the index of the first bad state.
    """
    return jnp.where(cp.all_finite(start), 1 + jnp.sum(trusted, dtype=jnp.int32), 0)
