"""Jumps of a torque in time that a method does not resolve, for `check`.

A method samples a torque at instants, and uses a value at the end of a step for both sides. If a torque jumps within a
step, or at its end without the mean of both sides there, the impulse is wrong by up to half the jump times the step. A
change of the torque is a jump if it does not decrease with the time between two samples.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._xla.replay import traits
from ..drivers.clock import time_of
from ..drivers.ensemble import Batch
from ..model.torques import on_body
from ..model.torques.by_step import in_step, is_by_step

_LOOKS = 8  # samples of the torque in a step, besides those next to its ends
_ROUNDS, _PARTS = 4, 10  # how often the interval of the largest change is divided, and into how many parts
_NEXT = 2.0**-14  # distance of a one-sided sample from the end of a step, in steps
_LEFT = 0.3  # the fraction of a change that remains if the torque jumps, rather than being steep
_MOST, _LEAST = 20_000, 64  # sampled steps, of all bodies and of one
_GOLDEN = (5**0.5 - 1) / 2


def jump_error(batch: Batch, dt: float, steps: int) -> float:
    """The largest relative error of the impulse from jumps of the torque in time, for the worst body.

    The torque on the initial states is sampled in up to `steps` steps. `Held` and `Pulses` are exact in each step and
    do not count as jumps. Zero if the torque does not depend on time, or if the error of the impulse is below the
    rounding of the momentum: such a torque is zero except for rounding errors.
    """
    body, torque, start, _, t0 = eqx.combine(jax.tree.map(lambda x: x[0], batch.mapped), batch.shared)
    if torque is None or not traits(lambda t: on_body(torque, body)(t, start), t0).reads[0]:
        return 0.0
    numbers = np.arange(max(_LEAST, min(steps, _MOST // batch.bodies)), dtype=np.int32)
    shifted = (np.arange(_LOOKS) + (numbers[:, None] * _GOLDEN) % 1) / _LOOKS
    next_to_ends, end = np.array([_NEXT, 1 - _NEXT]), np.ones((len(numbers), 1))
    inside = np.sort(np.concatenate([shifted.clip(*next_to_ends), next_to_ends + 0 * end], axis=1), axis=1)
    places = np.broadcast_to(np.concatenate([inside, end], axis=1), (batch.bodies, len(numbers), _LOOKS + 3))

    def values(places: np.ndarray, seen_by: np.ndarray) -> np.ndarray:
        clock = jnp.asarray(dt, t0.dtype), numbers, seen_by
        return np.asarray(_values(batch.mapped, batch.shared, clock, places), np.float64)

    def look(places: np.ndarray) -> np.ndarray:
        """The torque, with `ByStep` values of the first step in all steps, so that these do not jump."""
        return values(places, np.zeros_like(numbers))

    found = look(places)
    own = values(places, numbers) if is_by_step(torque) else found
    impulse = np.linalg.norm(own[..., :-1, :, :], axis=-1).mean(axis=2).sum(axis=1)
    vectors = range(found.shape[-2])
    wrong = np.stack([_wrong(lambda x, i=i: look(x)[..., i, :], places, found[..., i, :]) for i in vectors], axis=-1)
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
