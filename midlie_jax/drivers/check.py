"""`check`: says before a run whether a step is sane for a method, a body, a torque and a state, and which would be.

It takes one step from every state, and compares the angle of a step, the rates of the torque and the frequencies of the
motion with the limits of `methods/limits.py`. All of these are of the start: a motion that speeds up needs a check of a
later state.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._kernel import components as cp
from .._kernel.components import is_traced
from ..methods.base import Method
from ..methods.limits import resonance, resonance_half_width
from ..methods.splitting import Splitting
from ..methods.system import Motion, System
from ..model.bodies import RigidBody, TensorBody, principal_of
from ..model.compatibility import check_state
from ..model.state import AnyState
from ..model.torques import TorqueLike
from .arguments import as_method, as_scalar, check_step, check_system
from .rows import count_rows, torque_rows

_TURN_SHARE = 0.8  # a sane step turns the body by at most this share of the method's reach
_RATE_SHARE = 0.5  # and has at most this share of the stability limit: about six steps a period for LIEMID[EA]
_HALVINGS = 20  # steps tried to find one whose equation is solved: dt, dt/2, dt/4, ...
_ORDERS = (1, 2, 3)  # the k of the resonances at h omega = pi / k that are looked for
_DIRECTIONS = 64  # between growth and decay, for stability limits
FAST = 2.0  # a spin is fast if the frequency of its nutation exceeds that of the torque by this factor
_OFF = 0.95  # by which a suggested step is shortened until it is off every resonance


class Check(NamedTuple):
    """Whether a step is sane; prints as a short text. Over a batch of states each number is that of the worst state.

    Attributes:
        method: name of the method.
        dt: the step.
        sane: whether `solved` holds, `turn` is at most 0.8 `reach`, `stiffness` is at most half of `limit`, and the
            step is off every resonance.
        solved: whether one step from each state succeeded, with finite numbers.
        turn: the angle a step, in radians, that the reach bounds: |dt| times the rate at which the method turns the
            body (|Omega|, except for the flights that are made of rotations about given axes), in root sum square with
            the speed that an unstable torque can add.
        reach: the largest `turn` of the method; infinity if it is not known.
        rate: the largest modulus |lambda| of the rates of the torque, per unit of time: the body under the linearised
            torque alone moves as exp(lambda t). For a field it is the frequency of small oscillations, or the rate at
            which the body falls away from an unstable direction.
        stiffness: |dt| rate.
        limit: the largest `stiffness` for which the method is stable, or its equation has one solution.
        resonance: omega |dt| k / pi, of the nutation or precession and of k = 1, 2 or 3 for which it is nearest to 1,
            where kicks resonate with the motion. Infinity where this is not defined: without a torque or a fast spin,
            and for methods without kicks.
        order: this k; 0 if there is none.
        resonant: whether a state is within the width of the resonance.
        suggested: the longest step that is sane by these rules, with the sign of dt; infinity if any is. It is a step
            that can be trusted, not one that is accurate: `midlie_jax.recommend` measures accuracy.
    """

    method: str
    dt: float
    sane: bool
    solved: bool
    turn: float
    reach: float
    rate: float
    stiffness: float
    limit: float
    resonance: float
    order: int
    resonant: bool
    suggested: float

    @property
    def parts(self) -> list[tuple[str, str]]:
        """The text in parts, each with a heading."""
        verdict = "sane" if self.sane else "NOT sane"
        if math.isinf(self.suggested):
            better = "any step is"
        elif self.suggested == 0:
            better = "no step is: the torque or its derivative is not finite at the start"
        else:
            better = f"steps up to {self.suggested:.2g} are"
        reach = f"the method reaches {self.reach:.2g}" if math.isfinite(self.reach) else "no limit is known"
        parts = [("step", f"{verdict}; {better}"), ("turn a step", f"{self.turn:.2g} rad; {reach}")]
        if self.rate:
            limit = f"the limit is {self.limit:.2g}" if math.isfinite(self.limit) else "no limit is known"
            parts.append(("torque", f"rate {self.rate:.2g}, times the step {self.stiffness:.2g}; {limit}"))
        if self.resonance > 0.5 and self.order:
            steps, near = 2 * self.order / self.resonance, "within" if self.resonant else "outside"
            text = f"{steps:.3g} steps a turn of nutation or precession; {near} the width of the resonance at"
            parts.append(("resonance", f"{text} {2 * self.order}"))
        if not self.solved:
            parts.append(
                (
                    "first step",
                    "FAILS: a solve does not succeed, the step is beyond the reach, or a number is not finite",
                )
            )
        return parts

    def __str__(self) -> str:
        width = max(len(name) for name, _ in self.parts)
        lines = [f"{self.method}, dt {self.dt:g}", *(f"  {name:<{width}}  {text}" for name, text in self.parts)]
        return "\n".join(lines)


def check(
    method: Method | str,
    body: RigidBody | TensorBody,
    torque: TorqueLike | None,
    state: AnyState,
    dt: float | Array,
    *,
    t0: float | Array = 0.0,
    torque_axes: Any = None,
) -> Check:
    """Whether a step is sane, before a run, and which step would be. Takes a second, to compile one step.

    Args:
        method: from `midlie_jax.method`, or its name; of rigid bodies.
        body, torque, torque_axes: as for `integrate`, or, if the state has a leading axis, as for `ensemble`.
        state: the state at the start, of one body, or with a leading axis (n,) of n bodies.
        dt: the step, (), may be negative.
        t0: the time, ().

    Returns:
        The numbers and the verdict; `print` shows them in words.

    Raises:
        ValueError: an argument is invalid, as for `integrate`; it is traced; or the method or the body is of particles.
    """
    if any(is_traced(leaf) for leaf in jax.tree.leaves((body, torque, state, dt, t0)) if eqx.is_array(leaf)):
        raise ValueError("check needs numbers, but an argument is traced; call it outside jit, vmap and grad.")
    check_state("state", state)
    method = as_method(method)
    if not issubclass(method.bodies, RigidBody):
        raise ValueError(f"check is for rigid bodies, but method {method.name!r} moves {method.bodies.__name__}.")
    batch = state.momentum.ndim - 1
    if batch not in (0, 1):
        raise ValueError(f"state must be one state or have one leading axis, got momentum {state.momentum.shape}.")
    method = check_system(method, body, torque, state, batch=batch)
    dtype = state.momentum.dtype
    dt, t0 = as_scalar("dt", dt, dtype), as_scalar("t0", t0, dtype)
    check_step(dt)
    states = state if batch else jax.tree.map(lambda leaf: leaf[None], state)
    count = len(states.momentum)
    if not count:
        raise ValueError("state holds no bodies; give one row a body.")
    arguments = (body, torque, states)
    own_body = bool(batch) and principal_of(body).moments.ndim == 2
    torques = torque_rows(torque, torque_axes, body, own_body, states, count) if batch else None
    rows = (
        jax.tree.map(lambda _: own_body, body),
        jax.tree.map(lambda _: False, torque) if torques is None else torques,
        jax.tree.map(lambda _: True, states),
    )
    count_rows(("body", "torque", "state"), arguments, rows, count)
    facts, solved = jax.tree.map(np.asarray, _facts(method, *eqx.partition(arguments, rows), t0, dt))
    return _judged(method, torque is not None, float(dt), facts, np.all(solved, axis=0))


class Facts(NamedTuple):
    """What is known of a body at the start; with a leading axis of many.

    Attributes:
        turn_rate: the angle per unit of time that the method's reach bounds, ().
        linear: the body under the linearised torque alone, as a matrix of rotation vector and momentum, (6, 6).
        nutation: |Pi| over the mean of the two moments that are nearest to each other, ().
    """

    turn_rate: Any
    linear: Any
    nutation: Any

    @classmethod
    def of(cls, method: Method, body: Any, torque: Any, state: AnyState, t: Array) -> "Facts":
        """The facts of one body; may be traced."""
        system = System.of(body, torque, state, t)
        motion = system.motion(state)
        moments = jnp.sort(cp.pack(system.inertia.moments))
        low_pair = moments[1] - moments[0] < moments[2] - moments[1]
        mean = jnp.where(low_pair, moments[0] + moments[1], moments[1] + moments[2]) / 2
        turn_rate = method.turn_rate(system.inertia, motion.momentum)
        return cls(turn_rate, _linearised(system, t, motion), cp.norm(motion.momentum) / mean)

    @property
    def rates(self) -> Any:
        """The rates lambda of the torque, (n, 6); infinite where the torque or its derivative is not."""
        finite = np.all(np.isfinite(self.linear), axis=(-1, -2), keepdims=True)
        values = np.linalg.eigvals(np.where(finite, np.asarray(self.linear, np.float64), 0))
        return np.where(finite[..., 0], values, np.inf)

    @property
    def fastest_turn(self) -> Any:
        """`turn_rate` in root sum square with twice the largest rate of growth, (n,).

        The second is the speed of a body at rest that falls from an unstable direction of the field, I x'' = k sin x,
        to the stable one: I x'^2 / 2 = 2 k.
        """
        growth = np.max(np.maximum(self.rates.real, 0), axis=-1)
        return np.hypot(self.turn_rate, 2 * growth)


@eqx.filter_jit
def _facts(method: Method, mapped: Any, shared: Any, t0: Array, dt: Array) -> tuple[Facts, Array]:
    """The facts of each body, and whether steps of dt, dt/2, dt/4, ... from its state succeed, (n, halvings)."""

    def of_one(mapped: Any) -> tuple[Facts, Array]:
        body, torque, state = eqx.combine(mapped, shared)
        system = System.of(body, torque, state, t0)
        motion = system.motion(state)
        force = system.force(t0, motion) if method.keeps_force(system) else None

        def succeeds(h: Array) -> Array:
            after, _, ok = method.step(system, t0, t0 + h, h, motion, force)
            return ok & cp.all_finite(after)

        solved = jax.vmap(succeeds)(dt * 0.5 ** jnp.arange(_HALVINGS, dtype=dt.dtype))
        return Facts.of(method, body, torque, state, t0), solved

    return jax.vmap(of_one)(mapped)


def _linearised(system: System, t: Array, motion: Any) -> Array:
    """The matrix of (rotation vector, momentum) under the linearised torque alone, without the motion of the body."""
    one, nil = jnp.ones_like(motion.momentum[0]), jnp.zeros_like(motion.momentum[0])
    zero: cp.Vector = (nil, nil, nil)
    units: list[cp.Vector] = [(one, nil, nil), (nil, one, nil), (nil, nil, one)]
    still = jax.tree.map(jnp.zeros_like, motion.pose)

    def change(momentum: Any, pose: Any) -> Any:
        return jax.jvp(lambda m: system.force(t, m), (motion,), (Motion(momentum, pose),))[1]

    by_turn = [change(zero, system.kind.rate(motion.pose, w)) for w in units]
    by_momentum = [change(w, still) for w in units]
    speeds = [system.velocity(w) for w in units]
    columns = [(*zero, *turn) for turn in by_turn]
    columns += [(*speed, *push) for speed, push in zip(speeds, by_momentum, strict=True)]
    return jnp.stack([cp.pack(column) for column in columns], axis=-1)


def _judged(method: Method, forced: bool, dt: float, facts: Facts, solved: np.ndarray) -> Check:
    h, rates = abs(dt), facts.rates
    sizes, limits = np.abs(rates), stability_limits(method, rates)
    with np.errstate(invalid="ignore"):  # an infinite rate over no limit is NaN, which argmax takes for the largest
        worst = np.unravel_index(np.argmax(sizes / limits), sizes.shape)
    rate, limit = float(sizes[worst]), float(limits[worst])
    turn_rate = float(np.max(facts.fastest_turn))
    # Without a torque there are no kicks; other methods than splittings have none.
    kicked = np.max(sizes, axis=-1) * (forced and isinstance(method, Splitting))
    nearest, order, resonant = _nearest_resonance(h, facts.nutation, kicked)
    turn, stiffness = h * turn_rate, h * rate
    sane = bool(solved[0] and turn <= _TURN_SHARE * method.reach and stiffness <= _RATE_SHARE * limit and not resonant)
    suggested = min(
        _TURN_SHARE * method.reach / turn_rate if turn_rate > 0 else math.inf,
        _RATE_SHARE * limit / rate if rate > 0 else math.inf,
    )
    if not solved[0]:
        good = np.cumprod(solved[::-1])[::-1].astype(bool)  # this step and all shorter ones succeed
        longest = h * 0.5 ** int(np.argmax(good)) if good[-1] else 0.0
        # Where the reach explains why twice this step fails, the suggestion from the reach stands.
        explained = good[-1] and 2 * longest * turn_rate > method.reach
        suggested = suggested if explained else min(suggested, longest)
    if not (math.isfinite(rate) and math.isfinite(turn_rate)):
        suggested = 0.0
    while 0 < suggested < math.inf and _nearest_resonance(suggested, facts.nutation, kicked)[2]:
        suggested *= _OFF
    # A sane step stays sane: the rules are of one step only, and between two resonances there may be longer ones.
    suggested = max(suggested, h) if sane else suggested
    return Check(
        *(method.name, dt, sane, bool(solved[0]), turn, float(method.reach), rate, stiffness, limit),
        *(nearest, order, resonant, math.copysign(suggested, dt)),
    )


def stability_limits(method: Method, rates: np.ndarray) -> np.ndarray:
    """The stability limit for each rate, whose direction is rounded, so that few limits are computed."""
    turns = np.rint(np.abs(np.angle(rates)) / np.pi * _DIRECTIONS).astype(int)
    turns = np.where(rates == 0, _DIRECTIONS // 2, turns)
    known = {n: method.stability_limit(_direction(n)) for n in set(turns.ravel().tolist())}
    return np.vectorize(known.__getitem__, otypes=[float])(turns)


def _direction(n: int) -> complex:
    """The direction number n from growth, 0, to decay, `_DIRECTIONS`."""
    angle = math.pi * n / _DIRECTIONS
    return complex(0 if 2 * n == _DIRECTIONS else math.cos(angle), math.sin(angle))


def _nearest_resonance(h: float, nutation: np.ndarray, rates: np.ndarray) -> tuple[float, int, bool]:
    """The resonance nearest to the motion of a body: omega h k / pi, k, and whether the body is in its width.

    Only of fast spins: the precession of a slow one is no motion of its own. The width is that of a torque that has
    all of its strength in the resonant harmonic. Without a fast spin infinity, 0 and False.
    """
    fast = (rates > 0) & (nutation > FAST * rates)
    if not np.any(fast):
        return math.inf, 0, False
    nutation, field = nutation[fast], rates[fast]
    frequency = np.stack([nutation, field**2 / nutation])
    frequency, k = np.broadcast_arrays(frequency, np.array(_ORDERS)[:, None, None])
    caught = np.abs(frequency - resonance(h, k)) < resonance_half_width(field, k)
    ratio = frequency * h * k / np.pi
    # Those that are caught come first, then those that are nearest.
    at = np.unravel_index(np.argmin(np.abs(np.log(ratio)) + np.where(caught, 0, 1e3)), ratio.shape)
    return float(ratio[at]), int(k[at]), bool(caught[at])
