"""Spins on lattices, beside closed forms and other programs: the parts of benchmarks/spins.py."""

import jax.numpy as jnp
import numpy as np

import midlie_jax as ml


def random(shape: tuple[int, ...], seed: int) -> ml.spins.SpinState:
    """Spins (*shape, 3) that point anywhere, the state of infinite temperature."""
    drawn = np.random.default_rng(seed).normal(size=(*shape, 3))
    return ml.spins.SpinState(jnp.asarray(drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)))
