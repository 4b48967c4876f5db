"""Trials for `check`: runs of all bodies with one step, and what their states say of limits, energy and rounding."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from .._xla.compiler import tuned_jit
from .._xla.replay import traits
from ..drivers.chunks import chunk_size, run_ensemble, shared_tables
from ..drivers.derivatives import Forward
from ..drivers.ensemble import Batch
from ..drivers.path import Path
from ..integrators.base import Method
from ..integrators.limits import resonance, resonance_half_width
from ..integrators.splitting import Splitting
from ..integrators.system import Motion, System
from ..model.observables import kinetic_energy
from ..model.state import AnyState
from ..model.states import RigidState
from ..model.torques import on_body, potential_of

FAST = 2.0  # a spin is fast if the frequency of its nutation exceeds that of the torque by this factor
_DIRECTIONS = 64  # number of directions of lambda, from growth to decay, with a computed stability limit
TURN_SHARE = 0.8  # a sane step rotates the body by at most this share of the reach of the method
RATE_SHARE = 0.5  # and has at most this share of the stability limit: about six steps per period for LIEMID[EA]
ENERGY_SHARE = 0.5  # and changes the energy by at most this share of its scale
_FEW = 3.0  # a state needs compensation if its rounding error exceeds errors of random sign by this factor
_HARMONICS = (1, 2, 3)  # the resonances h omega = pi / k that are tested
MOST_STEPS, _LEAST_STEPS, _BODY_STEPS = 10_000, 100, 2_000_000  # steps of a trial: per body, and of all bodies
_MOST_SAMPLES, _LEAST_SAMPLES, _BODY_SAMPLES = 100, 4, 4000  # states looked at, likewise


class Facts(NamedTuple):
    """Quantities of a body at one moment; with leading axes, of many bodies or moments."""

    turn_rate: Any  # the angle per unit of time to which the reach of the method refers, ()
    # The body under the linearised torque alone, as a matrix of its k velocities' displacements (a rotation vector for
    # a rigid body) and its momentum, (2 k, 2 k).
    linear: Any
    nutation: Any  # the frequency of a fast spin, `Body.inertia().nutation`, ()
    changes: Any  # the rates at which flight and torque change the momentum, relative to its size, (2,); see `Rounding`
    variations: Any  # the rates at which these changes vary, relative to the size of the momentum, (2,)
    acceleration: Any  # |d Omega/dt|, ()

    @classmethod
    def of(cls, method: Method, body: Any, torque: Any, state: AnyState, t: Array) -> "Facts":
        system = System.of(body, torque, state, t)
        motion = system.motion(state)
        rates = [method.turn_rate(own.inertia, one.momentum) for own, one in system.rotations(motion)]
        turn_rate = jnp.max(jnp.stack(rates))  # for coupled bodies, the fastest
        size = _norm(motion.momentum)
        velocity, force, kind = system.velocity(motion.momentum), system.force(t, motion), system.kind
        along = kind.momentum_rate(motion.momentum, velocity, force), kind.rate(motion.pose, velocity)
        _, change = jax.jvp(system.force, (t, motion), (jnp.ones_like(t), Motion(*along)))
        squares = (jnp.max(system.inertia.square_of_turn(1.0, x)) for x in (motion.momentum, along[0]))
        speed, acceleration = map(cp.root, squares)
        pull, jerk = _norm(force), _norm(change)  # |T|, and |dT/dt| along the motion
        changes, variations = jnp.stack([speed, pull / size]), jnp.stack([speed * speed, jerk / size])
        nutation = jnp.max(system.inertia.nutation(motion.momentum))
        return cls(turn_rate, _linearised(system, t, motion), nutation, changes, variations, acceleration)

    @property
    def rates(self) -> Any:
        """The rates lambda of the torque, (..., 2 k); infinite if the torque or its derivative is not finite."""
        finite = np.all(np.isfinite(self.linear), axis=(-1, -2), keepdims=True)
        values = np.linalg.eigvals(np.where(finite, np.asarray(self.linear, np.float64), 0))
        return np.where(finite[..., 0], values, np.inf)

    @property
    def fastest_turn(self) -> Any:
        """`turn_rate` in root sum square with twice the largest rate of growth, (...).

        A body at rest falls from the unstable direction of a field, I x'' = k sin x, to the stable one. Its final speed
        is twice the rate of growth: I x'^2 / 2 = 2 k.
        """
        growth = np.max(np.maximum(self.rates.real, 0), axis=-1)
        return np.hypot(self.turn_rate, 2 * growth)


def _norm(tree: Any) -> Array:
    numbers = cp.flat(tree)
    return cp.root(jnp.sum(numbers * numbers))


def _linearised(system: System, t: Array, motion: Any) -> Array:
    """The matrix of (displacement, momentum) under the linearised torque, without the terms of the free motion."""
    numbers = cp.flat(motion.momentum)
    units = jnp.eye(len(numbers), dtype=numbers.dtype)
    still = jnp.zeros_like(units)

    def tree(row: Array) -> Any:
        return cp.of_flat(row, motion.momentum)

    def change(momentum: Array, displacement: Array) -> Array:
        moved = Motion(tree(momentum), system.kind.rate(motion.pose, tree(displacement)))
        return cp.flat(jax.jvp(lambda m: system.force(t, m), (motion,), (moved,))[1])

    # Mapped, so the torque is traced once for all directions.
    changes = jax.vmap(change)(jnp.concatenate([still, units]), jnp.concatenate([units, still]))
    speeds = jax.vmap(lambda momentum: cp.flat(system.velocity(tree(momentum))))(units)
    return jnp.concatenate([jnp.concatenate([still, speeds]), changes], axis=1).T


def energies_if_constant(body: Any, torque: Any, states: AnyState, times: Array) -> tuple[Array, Array] | None:
    """Kinetic and potential energies (k,) of one body at several times.

    None if the sum is not constant, because the torque has no potential, or a time-dependent one.
    """
    kinetic = jax.vmap(lambda state: kinetic_energy(body, state))(states)
    if torque is None:
        return kinetic, jnp.zeros_like(kinetic)
    first = jax.tree.map(lambda x: x[0], states)
    try:
        potential = potential_of(on_body(torque, body))
        reads_time = traits(lambda t, s: jnp.asarray(potential(t, s)), times[0], first).reads[0]
    except ValueError:  # the torque, or a term of a sum, has no potential
        return None
    return None if reads_time else (kinetic, jax.vmap(potential)(times, states))


def stability_limits(method: Method, rates: np.ndarray) -> np.ndarray:
    """The stability limit for each rate; directions are rounded, so that few limits need be computed."""
    turns = np.rint(np.abs(np.angle(rates)) / np.pi * _DIRECTIONS).astype(int)
    turns = np.where(rates == 0, _DIRECTIONS // 2, turns)

    def limit(n: int) -> float:
        """The limit in direction number n, from growth (n = 0) to decay (n = `_DIRECTIONS`)."""
        angle = math.pi * n / _DIRECTIONS
        return method.stability_limit(complex(0 if 2 * n == _DIRECTIONS else math.cos(angle), math.sin(angle)))

    known = {n: limit(n) for n in set(turns.ravel().tolist())}
    return np.vectorize(known.__getitem__, otypes=[float])(turns)


class Rounding(NamedTuple):
    """The quantities that determine the rounding errors of a run; the estimate is accurate within a factor of ten.

    A step adds a change to the momentum, and the sum is rounded by up to half a unit in its last place. Errors of
    random sign grow as the square root of the number of steps. While the change varies by less than that unit from one
    step to the next, its rounding errors are equal: m such steps make one error of m times the size. A flight by the
    angle a changes the momentum by a, and this change varies by a^2 per step, so m = eps / a^2. A `CompensatedState`
    stores the errors of the sums, so the unit is then the last place of the change.

    Attributes:
        eps: the spacing of the dtype at 1.
        compensated: whether the run has a `CompensatedState`.
        rigid: whether the run has a `RigidState`, the kind that a `CompensatedState` can replace.
        changes: the changes of the momentum per step by flight and torque, relative to its size, (2, bodies).
        variations: the variation of these changes from step to step, likewise.

    Examples:
        >>> found = ml.check("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> found.rounding.error(10**6) < 1e-9, found.rounding.loses(10**6)
        (True, False)
    """

    eps: float
    compensated: bool
    rigid: bool
    changes: Any
    variations: Any

    def error(self, steps: int, compensated: bool | None = None) -> float:
        """The relative error of the momentum by rounding after a number of steps, for the worst body.

        Args:
            steps: the number of steps.
            compensated: whether the state is a `CompensatedState`; by default as in the run.
        """
        compensated = self.compensated if compensated is None else compensated
        unit = self.changes if compensated else np.ones_like(self.changes)
        least = np.finfo(float).tiny
        correlated = np.clip(self.eps * unit / np.maximum(self.variations, least), 1, steps)
        errors = np.minimum(self.changes, self.eps / 2 * unit) * np.sqrt(steps * correlated)
        return float(np.max(np.sqrt(np.sum(np.square(errors), axis=0))))

    def loses(self, steps: int) -> bool:
        """Whether rounding errors accumulate in one direction, which a `CompensatedState` would prevent."""
        usual = self.eps / 2 * steps**0.5
        return self.error(steps) > _FEW * usual and self.error(steps, compensated=True) < self.error(steps) / _FEW

    def text(self, steps: int) -> str:
        found = f"about {self.error(steps):.1g} of the momentum in {steps} steps"
        if not self.loses(steps):
            return found
        cure = "a longer step loses less, and so does float64"
        if self.rigid:
            least = self.error(steps, compensated=True)
            cure = f"a CompensatedState loses about {least:.1g}, and a longer step loses less"
        return f"{found}: so small changes are rounded the same way in many steps; {cure}"


class Bounds(NamedTuple):
    """The steps allowed by the reach and the stability limit of a method at some states; `longest` is allowed by both.

    `turn_rate` is the largest `Facts.fastest_turn`, `rate` the rate of the torque nearest to its stability limit,
    `limit`.
    """

    turn_rate: float
    rate: float
    limit: float
    longest: float

    @classmethod
    def of(cls, method: Method, facts: Facts) -> "Bounds":
        rates = facts.rates
        limits = stability_limits(method, rates)
        with np.errstate(invalid="ignore"):  # an infinite rate over no limit is NaN, which argmax treats as the largest
            worst = np.unravel_index(np.argmax(np.abs(rates) / limits), rates.shape)
        rate, limit = float(np.abs(rates[worst])), float(limits[worst])
        turn_rate = float(np.max(facts.fastest_turn))
        if not (math.isfinite(rate) and math.isfinite(turn_rate)):
            return cls(turn_rate, rate, limit, 0.0)
        by_reach = TURN_SHARE * method.reach / turn_rate if turn_rate > 0 else math.inf
        by_limit = RATE_SHARE * limit / rate if rate > 0 else math.inf
        return cls(turn_rate, rate, limit, min(by_reach, by_limit))


class Trial(NamedTuple):
    """The result of a trial with one step, from the states that can be trusted."""

    h: float  # the size of the step
    steps: int  # this, `lasted` and `energy_error` are as in `Check`
    lasted: int
    energy_error: float
    bounds: Bounds  # the steps allowed by reach and stability limit along the motion
    longest_at_start: float  # the largest step allowed by both at the start
    nutation: np.ndarray  # from `Facts` for each body at the start, (bodies,)
    rates: np.ndarray  # likewise the largest modulus, or zero without kicks, which can resonate with the motion
    rounding: Rounding  # from the time averages of the `Facts` of each body
    states: Any  # the sampled states, (bodies, times)

    def resonance(self, h: float) -> tuple[float, int, bool]:
        """The resonance nearest to the motion of a body: omega h k / pi, k, and whether the body is within its width.

        Only fast spins count, because a slow spin has no separate precession. The width assumes a torque with all of
        its strength in the resonant harmonic. Without a fast spin the result is infinity, 0 and False.
        """
        fast = (self.rates > 0) & (self.nutation > FAST * self.rates)
        if not np.any(fast):
            return math.inf, 0, False
        nutation, field = self.nutation[fast], self.rates[fast]
        frequency = np.stack([nutation, field**2 / nutation])
        frequency, k = np.broadcast_arrays(frequency, np.array(_HARMONICS)[:, None, None])
        caught = np.abs(frequency - resonance(h, k)) < resonance_half_width(field, k)
        ratio = frequency * h * k / np.pi
        # Resonances that capture a body come first, then the nearest ones.
        at = np.unravel_index(np.argmin(np.abs(np.log(ratio)) + np.where(caught, 0, 1e3)), ratio.shape)
        return float(ratio[at]), int(k[at]), bool(caught[at])

    @property
    def fine(self) -> bool:
        """Whether the run succeeded and, if the energy is defined, conserved it."""
        return self.lasted == self.steps and not self.energy_error > ENERGY_SHARE

    def error(self, half: "Trial", order: int) -> tuple[float, str]:
        """`Check.error` and `Check.judged`, from the same trial with half the step."""
        here = jax.tree.map(lambda x: x[:, : (x.shape[1] + 1) // 2], self.states)
        there = jax.tree.map(lambda x: x[:, ::2], half.states)
        apart, judged = _difference(here, there)
        failed = self.lasted < self.steps or half.lasted < half.steps
        return math.nan if failed else apart * 2**order / (2**order - 1), judged


class Trials:
    """Runs of all bodies with different steps; compiled once."""

    def __init__(self, batch: Batch, steps: int | None):
        """Trials of this many steps, rounded up so that samples are evenly spaced; None for the default."""
        self.batch, count = batch, batch.bodies
        wanted = steps or max(_LEAST_STEPS, min(MOST_STEPS, _BODY_STEPS // count))
        samples = max(_LEAST_SAMPLES, min(_MOST_SAMPLES, _BODY_SAMPLES // count))
        self.every = max(1, wanted // samples)
        self.steps = self.every * -(-wanted // self.every)

    def run(self, dt: float) -> Trial:
        batch, method = self.batch, self.batch.method
        body, torque, start, _, t0 = batch.shared
        shared = body, torque, start, jnp.asarray(dt, t0.dtype), t0
        run = method, Forward(), batch.mapped, shared, jnp.zeros((), jnp.int32)
        intervals, chunk = self.steps // self.every, chunk_size(batch.bodies, batch.mapped[2])
        path = run_ensemble(*run, intervals, self.every, False, chunk, tables=shared_tables(*run, self.steps))
        facts, energies = jax.tree.map(np.asarray, _along(method, batch.mapped, shared, path))
        first_bad = np.asarray(path.first_bad)
        good = int(np.min(first_bad)) - 1  # saved states after the start that are good for every body
        trusted = np.arange(facts.nutation.shape[1]) < np.maximum(first_bad, 1)[:, None]
        at_start = Facts(*(x[:, 0] for x in facts))
        return Trial(
            abs(dt),
            self.steps,
            self.every * max(good, 0),
            _energy_error(energies, trusted),
            Bounds.of(method, Facts(*(x[trusted] for x in facts))),
            Bounds.of(method, at_start).longest,
            at_start.nutation,
            np.max(np.abs(at_start.rates), axis=-1) * isinstance(method, Splitting),
            _rounding(batch.mapped[2], abs(dt), facts, trusted),
            path.states,
        )


@tuned_jit
def _along(method: Method, mapped: Any, shared: Any, path: Path[Any]) -> tuple[Facts, Any]:
    """The facts of each body at the saved times (bodies, times); and kinetic and potential energy then, or None."""

    def of_one(mapped: Any, states: Any) -> tuple[Facts, Any]:
        body, torque, *_ = eqx.combine(mapped, shared)
        facts = jax.vmap(lambda state, t: Facts.of(method, body, torque, state, t))(states, path.times)
        return facts, energies_if_constant(body, torque, states, path.times)

    return jax.vmap(of_one)(mapped, path.states)


def _difference(states: Any, with_half_step: Any) -> tuple[float, str]:
    """The largest difference between states and the states of a run with half the step, and the name of the quantity.

    It is the angle between attitudes, axes or directions, in radians. Between momenta without these it is relative.
    """
    for name in ("attitude", "axis", "direction", "momentum"):
        if hasattr(states, name):
            break
    a, b = (np.asarray(getattr(s, name), np.float64) for s in (states, with_half_step))
    apart, size = np.linalg.norm(a - b, axis=-1), np.linalg.norm(b, axis=-1)
    if name == "momentum":
        return float(np.max(apart / np.where(size > 0, size, 1))), name
    if name == "attitude":  # q and -q are one attitude
        apart = np.minimum(apart, np.linalg.norm(a + b, axis=-1))
    return float(np.max((4 if name == "attitude" else 2) * np.arcsin(np.minimum(apart / 2, 1)))), name


def _rounding(start: AnyState, h: float, facts: Facts, trusted: np.ndarray) -> Rounding:
    """The estimate from the means of the facts over the trusted states, which are all finite."""

    def mean(speeds: np.ndarray) -> np.ndarray:
        good = trusted[..., None] & np.isfinite(speeds)
        return (np.where(good, speeds, 0).sum(axis=1) / np.maximum(good.sum(axis=1), 1)).T

    eps, of_rigid = float(jnp.finfo(start.momentum.dtype).eps), isinstance(start, RigidState)
    changes, variations = h * mean(facts.changes), h * h * mean(facts.variations)
    return Rounding(eps, start.kind.compensated, of_rigid, changes, variations)


def _energy_error(energies: Any, trusted: np.ndarray) -> float:
    if energies is None:
        return math.nan
    kinetic, potential = energies
    total = kinetic + potential
    change = np.max(np.where(trusted, np.abs(total - total[:, :1]), 0), axis=1)
    spread = np.max(np.where(trusted, np.abs(potential - potential[:, :1]), 0), axis=1)
    scale = kinetic[:, 0] + spread
    return float(np.max(change / np.where(scale > 0, scale, 1)))
