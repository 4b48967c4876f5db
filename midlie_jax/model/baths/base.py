"""`HeatBath`: the temperature and the random key of a bath, and the checks that a run makes."""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import as_floats, described, is_key, require
from ..exposure import PreparedBath, root_of


class HeatBath(eqx.Module):
    """Base class of heat baths.

    Attributes:
        kT: the temperature in units of energy, (), or a function of time t -> (). Not negative.
        key: a typed key, `jax.random.key(seed)`; (n,) for an ensemble.
    """

    methods: ClassVar[str]
    kT: Any
    key: Array

    def __init__(self, kT: Any, key: Any):
        self.kT, self.key = _as_temperature(kT), _as_key(key)

    @property
    def words(self) -> tuple[Array, ...]:
        """The words of the random key, uint32.

        The barrier hides a constant key from XLA, which would fold the noise at compile time, with different rounding.
        """
        words = jax.lax.optimization_barrier(jax.random.key_data(self.key))
        return tuple(words[i] for i in range(words.shape[-1]))

    def root(self, t: Array) -> Array:
        """sqrt(kT) at a time, in the dtype of the time; NaN for a negative temperature."""
        temperature: Any = self.kT(t) if callable(self.kT) else self.kT
        if jnp.shape(temperature):
            raise ValueError(f"kT must be one number at each time, got shape {jnp.shape(temperature)}.")
        return root_of(jnp.asarray(temperature).astype(t.dtype))

    def for_run(self, start: Any, exposures: Any, root: Any) -> PreparedBath:
        """The bath of a run; `root` is sqrt(kT) as a function of time, or None if the exposures include it."""
        count = start.momentum.shape[-2] if start.several else 0
        return PreparedBath(root, self.words, exposures, jnp.arange(count, dtype=jnp.int32) if count else 0)

    def check(self, state: Any) -> None:
        """Raises unless the numbers of the bath fit the state of one body."""
        del state

    @abstractmethod
    def check_kind(self, state: Any, body: Any) -> None:
        """Raises unless the bath can act on this kind of body; reads no shapes, so the state may have more axes."""

    def check_on(self, state: Any, body: Any) -> None:
        """Raises unless the bath can act on one body, or on coupled bodies, in this kind of state."""
        self.check_kind(state, body)
        if not callable(self.kT) and self.kT.shape:
            raise ValueError(f"kT must be one number for one body, got shape {self.kT.shape}.")
        if self.key.shape:
            raise ValueError(
                f"a bath of one run has one key, got {self.key.shape} of them; several are for midlie_jax.ensemble."
            )


def _as_temperature(kT: Any) -> Any:
    if callable(kT):
        return kT
    kT = as_floats("kT", kT)
    require("kT", kT, lambda x: np.isfinite(x) & (x >= 0), "must be finite and not negative", "check its sign.")
    return kT


def _as_key(key: Any) -> Array:
    if not is_key(key):
        raise ValueError(f"key must be a typed key, got {described(key)}; make it with jax.random.key(seed).")
    return key
