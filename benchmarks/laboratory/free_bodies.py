"""Free bodies at random, and their spatial momentum without JAX: for the tests and the benchmark of rounding."""

from typing import Any

import numpy as np

TURNS = 10.0 ** np.arange(-5.0, 0.5)  # radians a step, nearly


def free_bodies(equal_moments: bool, dtype: Any, *, count: int, seed: int) -> list[np.ndarray]:
    """Moments, momenta with angular velocities of .45 to .9, attitudes and steps: `count` bodies for each of `TURNS`.

    Args:
        equal_moments: whether the first two moments of every body are equal.
        dtype: of the arrays.
        count: bodies for each turn.
        seed: of the random numbers.
    """
    rng, rows = np.random.default_rng(seed), count * len(TURNS)
    masses = rng.uniform(0.3, 1, (rows, 3))
    if equal_moments:
        masses[:, 1] = masses[:, 0]
    moments = masses.sum(1, keepdims=True) - masses
    momentum, attitude = rng.normal(size=(rows, 3)), rng.normal(size=(rows, 4))
    momentum *= rng.uniform(0.45, 0.9, (rows, 1)) / np.linalg.norm(momentum / moments, axis=1, keepdims=True)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return [x.astype(dtype) for x in (moments, momentum, attitude, np.repeat(TURNS, count))]


def spatial_momentum(attitude: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """R Pi, with R the rotation that the attitude stands for whatever its length; in the precision of the arguments."""
    w, u = attitude[..., :1], attitude[..., 1:]
    square = np.sum(attitude**2, axis=-1, keepdims=True)
    return momentum + 2 * np.cross(u, w * momentum + np.cross(u, momentum)) / square
