"""Trials for `check`: runs of all bodies with one step, and their evaluation along the motion."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._xla.compiler import tuned_jit
from ..drivers.chunks import chunk_size, run_ensemble, shared_tables
from ..drivers.derivatives import Forward
from ..drivers.ensemble import Batch
from ..drivers.path import Path
from ..integrators.base import Method
from ..integrators.limits import resonance, resonance_half_width
from ..integrators.splitting import Splitting
from ..model.state import AnyState
from ..model.states import RigidState
from .facts import FAST, Facts, energies_if_constant, stability_limits
from .rounding import Rounding

TURN_SHARE = 0.8  # a sane step rotates the body by at most this share of the reach of the method
RATE_SHARE = 0.5  # and has at most this share of the stability limit: about six steps per period for LIEMID[EA]
ENERGY_SHARE = 0.5  # and changes the energy by at most this share of its scale
_HARMONICS = (1, 2, 3)  # the resonances h omega = pi / k that are tested
MOST_STEPS, _LEAST_STEPS, _BODY_STEPS = 10_000, 100, 2_000_000  # steps of a trial: per body, and of all bodies
_MOST_SAMPLES, _LEAST_SAMPLES, _BODY_SAMPLES = 100, 4, 4000  # states looked at, likewise


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
    """The result of a trial with one step, from the states that can be trusted.

    Attributes:
        h: the size of the step.
        steps, lasted, energy_error: as in `Check`.
        bounds: the steps allowed by reach and stability limit along the motion.
        longest_at_start: the largest step allowed by both at the start.
        nutation, rates: from `Facts` for each body at the start, (bodies,); for the rates, the largest modulus, or zero
            without kicks, which can resonate with the motion.
        rounding: the estimate of rounding errors, from the time averages of the `Facts` of each body.
        states: the sampled states, (bodies, times).
    """

    h: float
    steps: int
    lasted: int
    energy_error: float
    bounds: Bounds
    longest_at_start: float
    nutation: np.ndarray
    rates: np.ndarray
    rounding: Rounding
    states: Any

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

    eps = float(jnp.finfo(start.momentum.dtype).eps)
    return Rounding(
        eps,
        start.kind.compensated,
        isinstance(start, RigidState),
        h * mean(facts.changes),
        h * h * mean(facts.variations),
    )


def _energy_error(energies: Any, trusted: np.ndarray) -> float:
    if energies is None:
        return math.nan
    kinetic, potential = energies
    total = kinetic + potential
    change = np.max(np.where(trusted, np.abs(total - total[:, :1]), 0), axis=1)
    spread = np.max(np.where(trusted, np.abs(potential - potential[:, :1]), 0), axis=1)
    scale = kinetic[:, 0] + spread
    return float(np.max(change / np.where(scale > 0, scale, 1)))
