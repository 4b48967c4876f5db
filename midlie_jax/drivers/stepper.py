"""`stepper`: the steps of a method as pure functions of a `Carry`, from which every driver can continue."""

from dataclasses import dataclass
from functools import partial
from typing import Any, Required, TypedDict

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import as_count
from .._math import components as cp
from .._math.components import is_traced
from ..integrators.base import Method, Progress
from ..integrators.system import System
from ..integrators.verdict import at_start
from ..model.baths.base import HeatBath
from ..model.bodies import Body
from ..model.state import AnyState
from ..model.torques import TorqueLike
from ..model.torques.reads_body import with_bath, without_bath
from .arguments import as_first_step, as_method, as_scalar, check_clock, check_step, check_system
from .clock import time_of
from .derivatives import Adjoint, as_adjoint
from .results import result_of
from .steps import OneStep


class Options(TypedDict, total=False):
    """The arguments that all drivers have by keyword, for type checkers."""

    dt: Required[float | Array]
    steps: Required[int]
    save_every: int | None
    t0: float | Array
    adjoint: Adjoint | None


class ConstantStep(Options, total=False):
    first_step: int | Array
    bath: HeatBath | None


class Carry(eqx.Module):
    """The complete state of a run before its next step, a pytree of arrays.

    A run that continues from a carry continues the index of the steps, and therefore the time and the noise. It is
    bitwise equal to an undivided run if both are compiled in the same way.

    Attributes:
        index: the number of steps taken, (), int32, which is the index of the next step.
        progress: momentum and pose in principal axes, the force if the method keeps it, and the verdict.
        kind: the class of the states.
        clock: the time and the step length of a run with variable steps, or None.

    Examples:
        >>> half = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=50)
        >>> whole = ml.integrate("JACOBI[EA]", body, torque, half.carry, dt=0.01, steps=50)
        >>> int(whole.carry.index)
        100
    """

    index: Array
    progress: Progress
    kind: Any = eqx.field(static=True)
    clock: Any = None

    @property
    def like(self) -> AnyState:
        """A state of the class of the run, in principal axes; with the leading axes of a batch of carries."""
        join = self.kind.join
        for _ in range(self.progress.verdict.ndim):
            join = jax.vmap(join)
        return join(self.progress.motion.momentum, self.progress.motion.pose)


@partial(jax.tree_util.register_dataclass, data_fields=["t0", "dt", "_arrays"], meta_fields=["_others"])
@dataclass(frozen=True, eq=False, repr=False)
class Stepper:
    """The steps of one body as pure functions of a `Carry`; made by `midlie_jax.stepper`. A pytree.

    `t0` is the time of step 0, (), and `dt` the step, (). Use it under `jax.jit`, `vmap`, `grad`, `lax.scan` and
    `lax.while_loop`. In a custom `lax.scan`, `unroll=2` avoids a copy of the arrays in XLA.

    Examples:
        >>> top = ml.stepper("JACOBI[EA]", body, torque, start, dt=0.01)
        >>> carry, _ = jax.lax.scan(lambda carry, _: (top.step(carry), None), top.init(), length=100)
        >>> round(float(top.time(carry)), 6), top.result(carry) == ml.RESULTS.successful
        (1.0, Array(True, dtype=bool))
    """

    t0: Array
    dt: Array
    _arrays: list[Any]
    _others: Any

    def __repr__(self) -> str:
        return f"Stepper({self.method.name}, {self.body}, dt={eqx.tree_pformat(self.dt)})"

    @property
    def method(self) -> Method:
        """The method, fitted to the body."""
        return self._parts[0]

    @property
    def body(self) -> Any:
        """The body of all steps that do not name another."""
        return self._parts[1]

    @property
    def torque(self) -> Any:
        """The torque of all steps that do not name another."""
        return without_bath(self._parts[2])[0]

    def init(self, start: AnyState | None = None, first_step: Any = 0) -> Carry:
        """The carry before the step with the index `first_step`, from a state, by default the one given to `stepper`.

        Raises:
            ValueError: the state has another class, shape or dtype.
        """
        method, body, _, like, system = self._parts
        start = like if start is None else start
        _check_alike("start", start, like)
        first = jnp.asarray(as_first_step(first_step, 1), jnp.int32)
        progress = method.begin(system, start, time_of(self.t0, self.dt, first))
        verdict = at_start(body, cp.all_finite(start), True)
        first += 0 * verdict.astype(first.dtype)  # on the devices of the start
        return Carry(first, progress._replace(verdict=verdict), system.kind)

    def step(self, carry: Carry, *, torque: Any = None, body: Any = None) -> Carry:
        """The carry after one step: one loop in the compiled program.

        Args:
            carry: from `init`, `step`, `advance` or `Path.carry`.
            torque: a torque of the same class and structure with other parameters, for this step only.
            body: likewise. The momentum does not change. With the body at the middle of each step the run is of order
                2.

        Raises:
            ValueError: the torque or the body has another structure, shape or dtype.
        """
        return self.advance(carry, 1, torque=torque, body=body)

    def advance(
        self, carry: Carry, steps: int | Array, *, torque: Any = None, body: Any = None, adjoint: Adjoint | None = None
    ) -> Carry:
        """The carry after a number of steps.

        Args:
            carry, torque, body: as for `step`; the torque and body are used for all these steps.
            steps: an int; or an integer JAX array, (), for which one program serves every number, without a reverse
                derivative. No step is taken if it is negative.
            adjoint: how an int of steps is differentiated, as for `midlie_jax.integrate`.

        Raises:
            ValueError: as for `step`; or `steps` is not a positive integer.
        """
        _check_no_clock(carry)
        method, *given, system = self._parts
        own = one = OneStep(method, system, self.t0, self.dt)
        progress = carry.progress
        if torque is not None or body is not None:
            one = one._replace(system=self._system_under(torque, body, *given))
            progress = _moved_over(own, one, carry.index, progress)
        if isinstance(steps, Array) and not steps.ndim and jnp.issubdtype(steps.dtype, jnp.integer):
            steps = jnp.maximum(steps, 0).astype(jnp.int32)
            progress = one.counted(progress, carry.index, steps)
        elif (steps := as_count("steps", steps)) == 1 and adjoint is None:
            progress = one.take(progress, (carry.index, None))
        else:
            adjoint = as_adjoint(adjoint)
            adjoint.check(method, one.system, steps)
            indices = carry.index + jnp.arange(steps, dtype=jnp.int32)
            progress = adjoint.run(one, (indices, None), steps, progress)
        index = carry.index + steps
        return Carry(index, progress if own is one else _moved_over(one, own, index, progress), carry.kind)

    def state(self, carry: Carry) -> AnyState:
        """The state, in the user's axes."""
        return self._parts[-1].state(carry.progress.motion)

    def with_state(self, carry: Carry, state: AnyState) -> Carry:
        """The carry with another state, in the user's axes, at the same index and with the same verdict.

        Raises:
            ValueError: the state has another class, shape or dtype.

        Examples:
            >>> free = ml.stepper("JACOBI[EA]", body, None, start, dt=0.01)
            >>> carry = free.advance(free.init(), 50)
            >>> kick = jnp.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])  # of the momentum, without a rotation
            >>> carry = free.with_state(carry, free.state(carry).plus(kick))
            >>> free.state(carry).momentum.round(6), int(carry.index)
            (Array([ 0.,  2., 50.], dtype=float64), 50)
        """
        _check_no_clock(carry)
        method, *_, like, system = self._parts
        _check_alike("state", state, like)
        moved = method.begin(system, state, time_of(self.t0, self.dt, carry.index))
        return Carry(carry.index, moved._replace(verdict=carry.progress.verdict), carry.kind)

    def reads_momentum(self, torque: Any = None) -> bool:
        """Whether a torque, by default the torque of all steps, depends on the momentum."""
        system = self._parts[-1] if torque is None else self._system_under(torque, None, *self._parts[1:-1])
        return system.reads_momentum

    def time(self, carry: Carry) -> Array:
        """The time, (), computed from the index."""
        _check_no_clock(carry)
        return time_of(self.t0, self.dt, carry.index)

    def ok(self, carry: Carry) -> Array:
        """Whether all steps succeeded and all numbers are finite, ()."""
        return carry.progress.ok & cp.all_finite(carry.progress.motion)

    def result(self, carry: Carry) -> Any:
        """Why the run failed, one of `midlie_jax.RESULTS`; `RESULTS.successful` where `ok`."""
        return result_of(carry.progress.verdict, cp.all_finite(carry.progress.motion))

    @property
    def _parts(self) -> tuple[Method, Any, Any, AnyState, System]:
        structure, others = self._others
        return structure.unflatten(eqx.combine(self._arrays, list(others)))

    def _system_under(self, torque: Any, body: Any, own_body: Any, own_torque: Any, like: AnyState) -> System:
        own_torque, bath = without_bath(own_torque)
        torque, body = own_torque if torque is None else torque, own_body if body is None else body
        _check_alike("torque", torque, own_torque)
        _check_alike("body", body, own_body)
        return self.method.system(body, with_bath(torque, bath), like, self.t0, self.dt)


def carried_on(start: Any, first_step: Any) -> tuple[Any, Any, Progress | None]:
    """The initial state of a run, the index of its first step, and its progress if `start` is a `Carry`."""
    if not isinstance(start, Carry):
        return start, first_step, None
    if isinstance(first_step, Array | np.ndarray) or first_step != 0:
        raise ValueError("first_step must be left out where start is a Carry, which has the index of the next step.")
    _check_no_clock(start)
    index = start.index
    if index.ndim:
        if not is_traced(index) and np.ptp(np.asarray(index)):
            raise ValueError("start must be a Carry with one index for all bodies; map `integrate` over other carries.")
        index = index[0]
    return start.like, index, start.progress


def _check_no_clock(carry: Carry) -> None:
    if carry.clock is not None:
        raise ValueError("the carry of a run with variable steps must go to the same driver; or start from its state.")


def check_carried(carried: Progress, system: System, method: Method) -> None:
    if (carried.force is not None) != method.keeps_force(system):
        raise ValueError(
            f"start must be a Carry of the same method and torque, got one of another: {method.name} "
            f"{'needs' if carried.force is None else 'does not keep'} the force there. Start from the state."
        )


def stepper(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    *,
    dt: Any,
    t0: Any = 0.0,
    bath: HeatBath | None = None,
) -> Stepper:
    """The steps of a method as pure functions, for custom loops: control, learning, bodies that change.

    Args:
        method, body, torque, dt, t0, bath: as for `midlie_jax.integrate`.
        start: the initial state, which sets the class, shape and dtype of the run.

    Raises:
        ValueError: as for `midlie_jax.integrate`.

    Examples:
        >>> top = ml.stepper("JACOBI[EA]", body, torque, start, dt=0.01)
        >>> carry = top.advance(top.init(), 99)
        >>> carry = top.step(carry, torque=ml.torques.HeavyTop(30.0))  # one step under another weight
        >>> round(float(top.time(carry)), 6), bool(top.ok(carry)), top.state(carry).momentum.shape
        (1.0, True, (3,))
    """
    torque = with_bath(torque, bath)
    method = check_system(as_method(method), body, torque, start)
    h, t0 = (as_scalar(name, x, start.momentum.dtype) for name, x in (("dt", dt), ("t0", t0)))
    check_step(method, h)
    check_clock(t0, h)
    leaves, structure = jax.tree.flatten((method, body, torque, start, method.system(body, torque, start, t0, h)))
    arrays, others = eqx.partition(leaves, eqx.is_array)
    return Stepper(t0, h, arrays, (structure, tuple(others)))


def _moved_over(before: OneStep, after: OneStep, index: Array, progress: Progress) -> Progress:
    """The progress in another system, with the same momentum in the user's axes, and its force."""
    motion, system = progress.motion, after.system
    if system.frame is not None:
        motion = system.motion(before.system.state(motion))
    keeps = after.method.keeps_force(system)
    return progress._replace(
        motion=motion, force=system.force(time_of(after.t0, after.dt, index), motion) if keeps else None
    )


def _check_alike(name: str, value: Any, like: Any) -> None:
    if jax.tree.structure(value) != jax.tree.structure(like):
        raise ValueError(
            f"{name} must have the structure that the stepper was made with, {_form(like)}, got {_form(value)}; "
            "make another stepper for it."
        )
    for leaf, other in zip(jax.tree.leaves(value), jax.tree.leaves(like), strict=True):
        if eqx.is_array_like(other) and (jnp.shape(leaf), jnp.result_type(leaf)) != (
            jnp.shape(other),
            jnp.result_type(other),
        ):
            raise ValueError(
                f"{name} must have the shapes and dtypes that the stepper was made with, {_form(like)}, got "
                f"{_form(value)}; cast it, or make another stepper for it."
            )


def _form(value: Any) -> str:
    return " ".join(eqx.tree_pformat(value, width=1000).split())
