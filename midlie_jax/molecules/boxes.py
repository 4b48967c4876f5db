"""`integrate` for molecules in a box: compiled runs, between which the list of neighbours is built again; `Pressure`.

If a site moves too far under a list, the run goes back to its last state and takes fewer steps at a time.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import as_count, shown
from .._math.components import is_traced
from .._xla.compiler import exact_jit, tuned_jit
from ..drivers.arguments import as_argument, as_first_step, as_method, as_saving, check_step, check_system, check_times
from ..drivers.observe import as_observe_of_one, observe_state
from ..drivers.observe.observables import Observable
from ..drivers.observe.series import Series
from ..drivers.path import Path, end_alone
from ..drivers.stepper import Carry, carried_on, stepper
from ..integrators.base import Method
from ..model.baths.base import HeatBath
from ..model.bodies import Body
from ..model.free_body import FreeBody
from ..model.state import AnyState
from ..model.torques import TorqueLike
from ..model.torques.reads_body import with_bath
from .pair_forces import PairForces
from .points import sites

_SAFETY = 0.8  # of the predicted life of a list
_FIRST, _LONGEST = 16, 4096  # steps under the first list, and under any


class Pressure(Observable):
    """The pressure of a box whose torque is `PairForces`, (), from momenta and virial; energy/length^3.

    In kJ/mol/nm^3, which is 16.6054 bar. The velocities are those of the centres of mass.

    Raises:
        ValueError: in a run with another torque.

    Examples:
        >>> dilute = ml.molecules.PairForces([[0.0, 0.0, 0.0]], box=3.0, cutoff=1.0, sigmas=[0.34], epsilons=[0.996])
        >>> body, far = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), 40.0), [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]]
        >>> gas = ml.CoupledState(jnp.zeros((2, 3)), [[1.0, 0, 0, 0]] * 2, linear=jnp.ones((2, 3)), position=far)
        >>> found = ml.molecules.Pressure().of(jnp.array(0.0), gas, body, dilute.listed(gas))
        >>> (found * 27 * 3 * 40).round(6)  # of an ideal gas: the sum of p^2/m over 3 V
        Array(6., dtype=float64)
    """

    def of(self, t: Array, state: AnyState, body: Body, torque: TorqueLike | None) -> Array:
        if not isinstance(torque, PairForces) or not isinstance(body, FreeBody):
            raise ValueError(f"torque must be PairForces alone for the pressure, got {shown(torque)}.")
        x, y, z = torque.box
        linear: Array = jnp.asarray(state.linear)  # pyright: ignore[reportAttributeAccessIssue]
        mass = body.mass[:, None] if body.mass.ndim else body.mass
        twice_kinetic = jnp.sum(linear * (linear / mass))
        return (twice_kinetic + torque.virial(t, state)) / (3 * x * y * z)


def integrate(
    method: Method | str,
    body: Body,
    torque: TorqueLike,
    start: AnyState | Carry,
    *,
    dt: float | Array,
    steps: int,
    save_every: int | None = 1,
    skin: float = 0.2,
    t0: float | Array = 0.0,
    observe: Any = None,
    bath: HeatBath | None = None,
) -> Path[Any]:
    """Like `midlie_jax.integrate`, for molecules under `PairForces`; keeps their list of neighbours up to date.

    It works outside of `jax.jit` and derivatives only; inside them use `midlie_jax.integrate` with
    `forces.listed(start)`.

    Args:
        method, body, start, dt, steps, save_every, t0, observe, bath: as for `midlie_jax.integrate`.
        torque: `PairForces`, or a sum with them.
        skin: the distance beyond the cut-off up to which neighbours are listed. A wider one makes lists last longer and
            steps slower.

    Returns:
        The path. After a failure the last values are repeated; `path.first_bad` is the index of the first of them. A
        gain of energy is not a failure here; observe the energy.

    Raises:
        ValueError: as for `midlie_jax.integrate`, `torque` contains no `PairForces`, or `start` is not finite.

    Examples:
        >>> argon = ml.molecules.PairForces([[0.0, 0.0, 0.0]], box=3.0, cutoff=1.0, sigmas=[0.34], epsilons=[0.996])
        >>> body, still = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), 40.0), jnp.zeros((2, 3))
        >>> pair = ml.CoupledState(still, [[1.0, 0, 0, 0]] * 2, linear=still, position=still.at[1, 0].set(0.4))
        >>> bool(ml.molecules.integrate("JACOBI[EA]", body, argon, pair, dt=0.002, steps=500, save_every=50).ok)
        True
    """
    if is_traced(body, torque, start, dt, t0, bath):
        raise ValueError(
            "body, torque, start, dt, t0 and bath must not be traced: lists are built between compiled runs. Use "
            "midlie_jax.integrate with forces.listed(start)."
        )
    steps, observe = as_count("steps", steps), as_observe_of_one(observe)
    every = as_saving(save_every, steps) or steps
    if isinstance(observe, Series):
        observe.check(save_every and 1 + steps // every)
    like, index, carried = carried_on(start, 0)
    lists = _Lists(torque, skin, like)
    heated = with_bath(lists.torque, bath)
    method = check_system(as_method(method), body, heated, like)
    h, begin = as_argument("dt", dt, like.momentum.dtype), as_argument("t0", t0, like.momentum.dtype)
    check_step(method, h)
    check_times(method, heated, begin, h, as_first_step(index, steps), steps)
    end = _advance(method, body, lists.torque, bath, like, h, begin, start if carried else None, None)
    if carried:  # whose state may have other axes than `like`
        lists.renew(end.state, _FIRST)

    def seen(t: Array, state: Any) -> Any:
        return state if observe is None else _seen(observe, t, state, body, lists.torque)

    def advance(carry: Carry, state: Any) -> Any:
        left = every
        while True:
            number = min(left, lists.left)
            then = _advance(method, body, lists.torque, bath, like, h, begin, carry, jnp.asarray(number))
            if then.ok:
                carry, state, left = then.carry, then.state, left - number
                lists.follow(state, number)
            if left == 0 or (not then.ok and number == 1):
                return then
            if not then.ok:
                lists.renew(state, number // 2)

    rows = [(seen(end.time, end.state), end.time, bool(end.ok))]
    for _ in range(steps // every):
        value = rows[-1][0]
        if end.ok:
            end = advance(end.carry, end.state)
            value = seen(end.time, end.state)
        rows.append((value, end.time, bool(end.ok)))
    values, times, ok = zip(*rows, strict=True)
    stacked, good = jax.tree.map(lambda *x: jnp.stack(x), *values), np.asarray(ok)
    if isinstance(observe, Series):
        stacked = observe.of_bodies(
            jax.tree.map(lambda x: x[None], stacked), jnp.asarray(good)[None], jnp.asarray(h * every)
        )
    path = Path(jnp.stack(times), stacked, end.ok, jnp.asarray(good.sum(), jnp.int32), end.result, end.carry)
    return end_alone(path) if save_every is None else path


class _Then(NamedTuple):
    carry: Carry
    state: Any
    time: Array
    ok: Array
    result: Any


def _advance_by(
    method: Method, body: Any, torque: Any, bath: Any, like: Any, dt: Array, t0: Array, carry: Any, steps: Any
) -> _Then:
    one = stepper(method, body, torque, like, dt=dt, t0=t0, bath=bath)
    carry = one.init() if carry is None else carry
    carry = carry if steps is None else one.advance(carry, steps)
    return _Then(carry, one.state(carry), one.time(carry), one.ok(carry), one.result(carry))


_advance = tuned_jit(_advance_by, lambda method, body, torque, bath, like, *_: like.count)
_seen = exact_jit(observe_state)


class _Lists:
    """The torque with the list of now, and for how many steps the list will hold."""

    def __init__(self, torque: Any, skin: float, state: Any):
        self._torque, self._skin, self._slots = torque, skin, 0
        if not _pair_forces(torque):
            raise ValueError(f"torque must contain PairForces, got {shown(torque)}. Use midlie_jax.integrate instead.")
        if not skin > 0:
            raise ValueError(f"skin must be positive, got {skin:g}. A site must move by less than half of it per step.")
        self.renew(state, _FIRST)

    def renew(self, state: Any, left: int) -> None:
        """Builds the list of this state; at least `left` steps are tried under it."""

        def listed(x: Any) -> Any:
            return x.listed(state, skin=self._skin, slots=self._slots) if isinstance(x, PairForces) else x

        self.torque = jax.tree.map(listed, self._torque, is_leaf=lambda x: isinstance(x, PairForces))
        self._slots = max(len(forces.neighbours.nearest) for forces in _pair_forces(self.torque))
        self._age, self.left = 0, max(1, left)

    def follow(self, state: Any, number: int) -> None:
        self._age += number
        moved = max(float(_moved(forces, state)) for forces in _pair_forces(self.torque))
        life = int(min(_LONGEST, _SAFETY * self._skin / 2 * self._age / max(moved, 1e-300)))
        self.left = life - self._age
        if self.left < 1:
            self.renew(state, life)


@jax.jit
def _moved(forces: PairForces, state: Any) -> Array:
    assert forces.neighbours is not None
    return forces.neighbours.moved(sites(state, forces.points))


def _pair_forces(torque: Any) -> list[Any]:
    found = jax.tree.leaves(torque, is_leaf=lambda x: isinstance(x, PairForces))
    return [x for x in found if isinstance(x, PairForces)]
