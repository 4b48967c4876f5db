"""`check`: tests before a run whether a step is stable for a method, body, torque and start, and suggests a stable one.

A trial of some thousand steps (`trials.py`) shows whether the run fails or the energy drifts, and measures rotation
angles and rates of the torque, to compare with the limits of `integrators/limits.py`. A trial with half the step
estimates the accuracy, which is not part of the verdict. Samples of the torque within steps show whether it jumps.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import as_count, require_numbers
from .._xla.replay import traits
from ..drivers.arguments import as_method, as_scalar, check_clock, check_system
from ..drivers.clock import time_of
from ..drivers.ensemble import Batch, as_batch
from ..integrators.base import Method
from ..model.bodies import Body
from ..model.compatibility import check_state
from ..model.state import AnyState
from ..model.torques import TorqueLike, on_body
from ..model.torques.by_step import in_step, is_by_step
from .trials import Rounding, Trial, Trials

_MOST_COUPLED = 32  # coupled bodies whose torques are linearised together
_NO_BATH = "check needs a deterministic run, and a heat bath is random"
_LARGEST_JUMP, _SMALL_JUMP = 0.05, 1e-3  # relative errors of the impulse: not sane, printed
_JUMPS = "the torque jumps in time, and steps sample it at instants; use midlie_jax.torques.Pulses or Held"
_LOOKS = 8  # samples of the torque in a step, besides those next to its ends
_ROUNDS = 4  # how often the interval of the largest change is divided
_NEXT = 2.0**-14  # distance of a one-sided sample from the end of a step, in steps
_LEFT = 0.3  # the fraction of a change that remains if the torque jumps, rather than being steep
_MOST_SAMPLED, _LEAST_SAMPLED = 20_000, 64  # sampled steps, of all bodies and of one
_GOLDEN = (5**0.5 - 1) / 2
_LOST = 0.3  # radians
_OFF = 0.95  # the factor that shortens a suggested step until it is off every resonance
_SHORTER, _TRIALS = 0.7, 40  # the factor that shortens it until a trial succeeds, and the largest number of trials


class Check(NamedTuple):
    """Whether a step is sane, that is, stable (not accurate). For a batch, each number is for the worst state.

    Attributes:
        method, dt: name of the method, and the step.
        sane: whether `solved` holds, `turn` is at most 0.8 `reach`, `stiffness` is at most half of `limit`, the step is
            off every resonance, `energy_error` is at most half, where it is defined, and `jump_error` at most 0.05.
        steps: the number of steps of the trial.
        solved: whether all steps of the trial succeeded, with finite numbers.
        lasted: the number of steps after which the states were last good; `steps` if `solved`. The states are sampled
            about a hundred times, so the first bad step may be up to a hundredth of the trial later.
        energy_error: the largest change of the energy of a body in the trial, divided by the sum of its initial kinetic
            energy and the range of its potential energy; NaN if the exact motion does not conserve the energy, or
            without a formula for the energy.
        turn: the rotation angle of the body in a step, in radians, at most `reach`: |dt| times the speed (|Omega|,
            except for flights composed of rotations about given axes), in root sum square with the possible
            contribution of an unstable torque. Like `rate` and `stiffness`, it is the largest value in the trial.
        reach: the largest `turn` that the method supports; infinity if unknown.
        rate: the largest modulus |lambda| of the rates of the torque, per unit of time: the body under the linearised
            torque alone moves as exp(lambda t). For a field it is the frequency of small oscillations, or the growth
            rate near an unstable direction.
        stiffness: |dt| rate.
        limit: the largest `stiffness` for which the method is stable, or its equation has a single solution.
        resonance: omega |dt| k / pi; at 1 kicks resonate with the motion. omega (of the nutation or the precession) and
            k = 1, 2 or 3 are the choice nearest to 1. Infinity without a torque or a fast spin, and for methods without
            kicks.
        harmonic: the k of `resonance`; 0 if there is none.
        resonant: whether a body is, at the start, within the width of the resonance.
        rounding: the estimate of rounding errors after any number of steps, by `rounding.error(steps)`, and of whether
            the run needs a `CompensatedState`, by `rounding.loses(steps)`.
        jump_error: the largest relative error of the impulse from jumps of the torque in time, within steps or at their
            ends; 0 if it does not jump, or only by `midlie_jax.torques.Held` and `Pulses`, which are exact.
        error: estimated error of the attitude in radians in the first half of the trial, from a run with half the step
            and the order of the method; for states without an attitude the error of the axis or the direction, or the
            relative error of the momentum. NaN if a run fails. It is not part of `sane`.
        judged: the quantity of `error`: "attitude", "axis", "direction" or "momentum".
        suggested: the largest step found, with the sign of dt, that a separate trial confirms as sane. Infinity if
            nothing rotates the body; 0 if no sane step was found. Jumps of the torque are ignored. It may not be sane
            beyond the length of the trial, and need not be accurate: `midlie_jax.recommend` measures accuracy.

    Examples:
        >>> found = ml.check("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> found.solved, round(found.turn, 3), round(found.rate, 3)
        (True, 0.502, 1.955)
    """

    method: str
    dt: float
    sane: bool
    steps: int
    solved: bool
    lasted: int
    energy_error: float
    turn: float
    reach: float
    rate: float
    stiffness: float
    limit: float
    resonance: float
    harmonic: int
    resonant: bool
    suggested: float
    rounding: Rounding
    jump_error: float
    error: float
    judged: str

    @property
    def parts(self) -> list[tuple[str, str]]:
        """The printed text in parts, each with a heading."""
        return self.parts_of(self.steps)

    def parts_of(self, steps: int) -> list[tuple[str, str]]:
        """The text in parts, with the rounding of a run of `steps` steps."""
        verdict = "sane" if self.sane else "NOT sane"
        if math.isinf(self.suggested):
            better = "any step is"
        elif self.suggested == 0:
            better = "no sane step was found"
            if not math.isfinite(self.rate):
                better += ": the torque or its derivative is not finite"
        else:
            better = f"a step of {self.suggested:.2g} is" + (" stable" if self.jump_error > _LARGEST_JUMP else "")
            better += "" if self.sane else ", by a trial of its own"
        reach = f"the method reaches {self.reach:.2g}" if math.isfinite(self.reach) else "no limit is known"
        parts = [("step", f"{verdict}; {better}"), ("turn a step", f"{self.turn:.2g} rad; {reach}")]
        if self.rate:
            limit = f"the limit is {self.limit:.2g}" if math.isfinite(self.limit) else "no limit is known"
            parts.append(("torque", f"rate {self.rate:.2g}, times the step {self.stiffness:.2g}; {limit}"))
        if self.resonance > 0.5 and self.harmonic:
            period, near = 2 * self.harmonic / self.resonance, "within" if self.resonant else "outside"
            text = f"{period:.3g} steps a turn of nutation or precession; {near} the width of the resonance at"
            parts.append(("resonance", f"{text} {2 * self.harmonic}"))
        if not self.solved:
            reasons = "a solve does not succeed, the step is beyond the reach, or a number is not finite"
            trial = f"FAILS after {self.lasted} of {self.steps} steps: {reasons}"
        elif math.isnan(self.energy_error):
            trial = f"{self.steps} steps succeed"
        else:
            trial = f"{self.steps} steps succeed; the energy changes by {self.energy_error:.1g} of its scale"
        parts.append(("trial", trial))
        if self.jump_error > _SMALL_JUMP:
            parts.append(("jumps", f"up to {self.jump_error:.2g} times the impulse can be wrong: {_JUMPS}"))
        accuracy = "not judged by the verdict"
        if not math.isnan(self.error):
            unit = "of the momentum" if self.judged == "momentum" else f"rad of the {self.judged}"
            accuracy += f"; the error is about {self.error:.1g} {unit} after {self.steps // 2} steps"
            accuracy += "; the phase of the motion is lost" if self.error > _LOST else ""
        return [*parts, ("accuracy", accuracy), ("rounding", self.rounding.text(steps))]

    def __str__(self) -> str:
        width = max(len(name) for name, _ in self.parts)
        lines = [f"{self.method}, dt {self.dt:g}", *(f"  {name:<{width}}  {text}" for name, text in self.parts)]
        return "\n".join(lines)


def check(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: AnyState,
    *,
    dt: float | Array,
    steps: int | None = None,
    t0: float | Array = 0.0,
    torque_axes: Any = "auto",
) -> Check:
    """Tests by trials, before a run, whether a step is sane (stable), and suggests a sane one.

    The verdict is about stability, not accuracy: a sane step can lose the phase of a motion within a long run. The
    printed text estimates the error; `midlie_jax.recommend` finds the step for a given error at the end of a run.

    Compiling takes some seconds; further calls with the same torque function do not compile.

    Args:
        method: from `midlie_jax.method`, or its name; it must support rigid bodies.
        body, torque, torque_axes: as for `integrate`, or, if the start has a leading axis, as for `ensemble`.
        start: the state of one body, or with a leading axis (n,) of n bodies.
        dt: the step, (), may be negative.
        steps: the length of each trial. By default 10,000, or fewer if all bodies together would take more than 2
            million steps, but at least 100.
        t0: the time at the start, ().

    Returns:
        The numbers and the verdict; `print` shows them as text.

    Raises:
        ValueError: an argument is invalid, as for `integrate`, or is traced; or method or body are for particles.

    Examples:
        >>> found = ml.check("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> print(found)
        JACOBI[EA], dt 0.01
          step         sane; a step of ...
          turn a step  0.5 rad; the method reaches 1.2
          torque       rate 2, times the step 0.02; the limit is 2
          trial        100 steps succeed; the energy changes by ...
          accuracy     not judged by the verdict; the error is about ...
          rounding     about ... of the momentum in 100 steps
    """
    require_numbers("check", body, torque, start, dt, t0)
    check_state("start", start)
    method = as_method(method)
    if not start.own_axes:
        raise ValueError(f"start must be the state of a body that rotates, got a {type(start).__name__}.")
    count = start.momentum.shape[-2] if start.several else 1
    if count > _MOST_COUPLED:
        raise ValueError(
            f"start must have at most {_MOST_COUPLED} coupled bodies for check, got {count}. "
            "Check some of them, or compare runs with dt and dt/2."
        )
    dtype = start.momentum.dtype
    dt, t0 = as_scalar("dt", dt, dtype), as_scalar("t0", t0, dtype)
    check_clock(t0, dt)
    if len(start.batch) > 1:
        raise ValueError(f"start must be one state or have one leading axis, got momentum {start.momentum.shape}.")
    if not start.batch:  # a single body has no rows
        check_system(method, body, torque, start, bath=_NO_BATH)
        start, torque_axes = jax.tree.map(lambda leaf: leaf[None], start), None
    batch = as_batch(method, body, torque, start, dt, t0, torque_axes, bath=_NO_BATH)
    return _judged(Trials(batch, steps if steps is None else as_count("steps", steps)), float(dt))


def _judged(trials: Trials, dt: float) -> Check:
    own, half, method = trials.run(dt), trials.run(dt / 2), trials.batch.method
    nearest, harmonic, resonant = own.resonance(own.h)
    bounds = own.bounds
    stable = own.fine and own.h <= bounds.longest and not resonant
    suggested = max(_suggested(trials, own, dt), own.h if stable else 0.0)
    wrong = jump_error(trials.batch, dt, own.steps)
    error, judged = own.error(half, method.order)
    return Check(
        method.name, dt, stable and wrong <= _LARGEST_JUMP, own.steps, own.lasted == own.steps, own.lasted,
        own.energy_error, own.h * bounds.turn_rate, float(method.reach), bounds.rate, own.h * bounds.rate, bounds.limit,
        nearest, harmonic, resonant, math.copysign(suggested, dt), own.rounding, wrong, error, judged,
    )  # fmt: skip


def _suggested(trials: Trials, own: Trial, dt: float) -> float:
    """The largest step found that is off every resonance and confirmed by a separate trial; 0 if there is none."""
    h = min(own.longest_at_start, own.bounds.longest if own.fine else math.inf)
    if h in (0, math.inf):
        return h
    for _ in range(_TRIALS):
        while own.resonance(h)[2]:
            h *= _OFF
        trial = trials.run(math.copysign(h, dt))
        if trial.fine and h <= trial.bounds.longest:
            return h
        # The motion with this step may need a smaller one. The bounds of a failed trial are unreliable.
        h = max(trial.bounds.longest, _SHORTER * h) if trial.fine else _SHORTER * h
    return 0.0


def jump_error(batch: Batch, dt: float, steps: int) -> float:
    """The largest relative error of the impulse from jumps of the torque in time, for the worst body.

    A method samples a torque at instants, and uses a value at the end of a step for both sides. If a torque jumps
    within a step, or at its end without the mean of both sides there, the impulse is wrong by up to half the jump times
    the step. A change of the torque is a jump if it does not decrease with the time between two samples; `Held` and
    `Pulses` are exact in each step and do not count.

    The torque on the initial states is sampled in up to `steps` steps. Zero if the torque does not depend on time, or
    if the error of the impulse is below the rounding of the momentum: such a torque is zero except for rounding errors.
    """
    body, torque, start, _, t0 = eqx.combine(jax.tree.map(lambda x: x[0], batch.mapped), batch.shared)
    if torque is None or not traits(lambda t: on_body(torque, body)(t, start), t0).reads[0]:
        return 0.0
    numbers = np.arange(max(_LEAST_SAMPLED, min(steps, _MOST_SAMPLED // batch.bodies)), dtype=np.int32)
    shifted = (np.arange(_LOOKS) + (numbers[:, None] * _GOLDEN) % 1) / _LOOKS
    next_to_ends, end = np.array([_NEXT, 1 - _NEXT]), np.ones((len(numbers), 1))
    inside = np.sort(np.concatenate([shifted.clip(*next_to_ends), next_to_ends + 0 * end], axis=1), axis=1)
    places = np.broadcast_to(np.concatenate([inside, end], axis=1), (batch.bodies, len(numbers), _LOOKS + 3))

    def values(places: np.ndarray, seen_by: np.ndarray) -> np.ndarray:
        clock = jnp.asarray(dt, t0.dtype), numbers, seen_by
        return np.asarray(_values(batch.mapped, batch.shared, clock, places), np.float64)

    # With the `ByStep` values of the first step in all steps, these do not jump.
    still = np.zeros_like(numbers)
    found = values(places, still)
    own = values(places, numbers) if is_by_step(torque) else found
    impulse = np.linalg.norm(own[..., :-1, :, :], axis=-1).mean(axis=2).sum(axis=1)
    vectors = range(found.shape[-2])
    wrong = np.stack(
        [_wrong(lambda x, i=i: values(x, still)[..., i, :], places, found[..., i, :]) for i in vectors], axis=-1
    )
    start = batch.mapped[2]
    momenta = [start.momentum, *([start.linear] if len(vectors) > 1 else [])]
    size = np.stack([np.linalg.norm(np.reshape(x, (batch.bodies, -1)), axis=-1) for x in momenta], axis=-1)
    rounded = len(numbers) * np.finfo(t0.dtype).eps * size / abs(dt)
    return float(np.max(np.where(wrong > rounded, wrong / np.where(impulse > 0, impulse, 1), 0)))


def _wrong(look: Callable[[np.ndarray], np.ndarray], places: np.ndarray, found: np.ndarray) -> np.ndarray:
    """The largest error by jumps of one vector, over dt, (bodies,), from its values (bodies, steps, places, n)."""
    change, lower, upper = _largest_change(places[..., :-1], found[..., :-1, :])
    first = change
    for _ in range(_ROUNDS):
        divided = lower[..., None] + (upper - lower)[..., None] * np.linspace(0, 1, places.shape[-1])
        change, lower, upper = _largest_change(divided, look(divided))
    jumps = np.where(change > _LEFT * first, change, 0)
    before, at_end, after = found[:, :-1, -2], found[:, :-1, -1], found[:, 1:, 0]
    one_sided = np.linalg.norm(at_end - (before + after) / 2, axis=-1)
    one_sided = np.where(np.linalg.norm(after - before, axis=-1) > _LEFT * first[:, :-1], one_sided, 0)
    return jumps.sum(axis=1) / 2 + one_sided.sum(axis=1)


def _largest_change(places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each step the largest change between two neighbouring places, and these places."""
    changes = np.linalg.norm(np.diff(values, axis=-2), axis=-1)
    at = np.argmax(changes, axis=-1)[..., None]

    def of(x: np.ndarray) -> np.ndarray:
        return np.take_along_axis(x, at, axis=-1)[..., 0]

    return of(changes), of(places[..., :-1]), of(places[..., 1:])


@eqx.filter_jit
def _values(mapped: Any, shared: Any, clock: Any, places: Any) -> Any:
    """The torque at places (bodies, steps, places) within steps, as vectors (..., 1 or 2, n).

    The clock is dt, the indices of the steps, and the indices of the steps that define the values of `Held` and
    `Pulses`.
    """
    dt, numbers, seen_by = clock

    def of_body(mapped: Any, places: Any) -> Any:
        body, torque, start, _, t0 = eqx.combine(mapped, shared)
        torque = on_body(torque, body)

        def of_step(number: Any, seen_by: Any, places: Any) -> Any:
            begin, end = time_of(t0, dt, number), time_of(t0, dt, number + 1)
            torque_here = in_step(torque, time_of(t0, dt, seen_by), time_of(t0, dt, seen_by + 1), dt)

            def at(place: Any) -> Any:
                value = torque_here(jnp.where(place == 1, end, begin + place * dt), start)
                return jnp.stack([jnp.ravel(x) for x in jax.tree.leaves(value)])

            return jax.vmap(at)(places.astype(dt.dtype))

        return jax.vmap(of_step)(numbers, seen_by, places)

    return jax.vmap(of_body)(mapped, places)
