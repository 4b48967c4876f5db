"""`HeatBath`, with the keys and checks of a bath; `Warm`, with a temperature; `BathOfBodies`, and their `Sum`."""

from abc import abstractmethod
from collections.abc import Iterable
from itertools import chain
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..._checks.arguments import as_finite, as_not_negative, described, is_key, require, require_function, shown
from ..._math.components import is_traced
from ..bodies import Body, RigidBody, SymmetricRotor, TensorBody, is_symmetric
from ..exposure import ROUNDED, PreparedBath, root_of
from ..state import AnyState


class HeatBath(eqx.Module):
    methods: ClassVar[str]

    @property
    def keys(self) -> tuple[Any, ...]:
        own: Any = self
        return (own.key,)

    def check(self, state: Any) -> None:
        """Raises unless the numbers of the bath fit the state of one body."""

    @abstractmethod
    def check_kind(self, state: Any, body: Any) -> None:
        """Raises unless the bath can act on this kind of body; reads no shapes, so the state may have more axes."""

    def check_on(self, state: Any, body: Any) -> None:
        self.check_kind(state, body)
        for key in self.keys:
            if key.shape:
                raise ValueError(f"a bath of one run has one key, got {key.shape}; more are for midlie_jax.ensemble.")


class Warm(HeatBath):
    kT: Any
    key: Array

    def __init__(self, kT: Any, key: Any):
        self.kT = kT if callable(kT) else as_not_negative("kT", kT, cure="check its sign.")
        self.key = as_key(key)

    def root(self, t: Array) -> Array:
        """sqrt(kT) at a time, in the dtype of the time; NaN for a negative temperature."""
        temperature: Any = self.kT(t) if callable(self.kT) else self.kT
        if jnp.shape(temperature):
            raise ValueError(f"kT must be one number at each time, got shape {jnp.shape(temperature)}.")
        return root_of(jnp.asarray(temperature).astype(t.dtype))

    def check_on(self, state: Any, body: Any) -> None:
        self.check_kind(state, body)
        if not callable(self.kT) and self.kT.shape:
            raise ValueError(f"kT must be one number for one body, got shape {self.kT.shape}.")
        super().check_on(state, body)


class BathOfBodies(HeatBath):
    """A bath that acts on the momenta of rigid bodies; `numbers` names the fields of rotation and translation."""

    methods: ClassVar[str] = "JACOBI[BAOAB], or SYMMETRIC[BAOAB] for two equal moments"
    numbers: ClassVar[tuple[str, ...]] = ()

    def effects(self, body: Body, times: dict[float, Array], t: Array, with_root: bool = True) -> Any:
        """The exposures of stages that take these times, by coefficient; with the temperature at t if `with_root`."""
        raise NotImplementedError(f"{type(self).__name__} must define effects.")

    def prepared(self, body: Body, coefficients: Iterable[float], t: Array, h: Array, start: Any) -> Any:
        """The parts of the bath, a tuple with one or several `PreparedBath`, for stages with these coefficients."""
        times, words = {b: b * h for b in sorted(coefficients)}, words_of(self.keys[0])
        if any(callable(getattr(self, name)) for name in self.numbers):
            return (PreparedBath.of(words, eqx.Partial(self.effects, body, times), None, start),)
        root = getattr(self, "root", None) if callable(getattr(self, "kT", None)) else None
        return (PreparedBath.of(words, self.effects(body, times, t, with_root=root is None), root, start),)

    def check_kind(self, state: Any, body: Any) -> None:
        name, kind = type(self).__name__, type(state).__name__
        if not isinstance(body.turning, RigidBody | TensorBody | SymmetricRotor):
            raise ValueError(f"{name} acts on rigid bodies and rotors, not on a {kind}; leave out {name}.")
        if self.numbers and (state.kind.rotation is None) != (getattr(self, self.numbers[1]) is None):
            raise ValueError(
                f"a {kind} translates: give {name} the {self.numbers[1]}, or 0 for none."
                if state.kind.rotation is not None
                else f"a {kind} does not translate: leave out {self.numbers[1]}."
            )
        if isinstance(body.turning, SymmetricRotor):
            body.turning.known_along  # noqa: B018 - raises if it is unknown

    def check_on(self, state: Any, body: Any) -> None:
        super().check_on(state, body)
        count = state.momentum.shape[-2] if state.several else None
        for name in self.numbers:
            value = getattr(self, name)
            if value is None:
                continue
            time = jax.ShapeDtypeStruct((), state.momentum.dtype)
            shape = jax.eval_shape(value, time).shape if callable(value) else value.shape
            leading = shape[:-2] if shape[-2:] == (3, 3) else shape[:-1]
            if not (shape == () or (shape[-1] == 3 and leading in ((), (count,)))):
                wanted = "(), (3,) or (3, 3)" + ("" if count is None else f", or ({count}, 3) or ({count}, 3, 3)")
                raise ValueError(
                    f"{name} of one run must be of shape {wanted}, got {shape}; more are for midlie_jax.ensemble."
                )
            self.check_numbers(name, shape, state, body)

    def check_numbers(self, name: str, shape: tuple[int, ...], state: Any, body: Any) -> None:
        """Raises unless this body supports numbers of this shape, which its state does."""

    def __add__(self, other: Any) -> "BathOfBodies":
        return Sum(self, other)


class Sum(BathOfBodies):
    """Several baths at once, `a + b`, each with its own key; for example gases at two temperatures, or gas and laser.

    A bath stage applies each bath but the last for half of its time, the last one for all of it, and the others again
    in reverse order. Each of these stages is exact, and the error of the sum is of second order in the step, as for a
    torque. Baths at one temperature keep the Maxwell distribution at every step. For a number of friction and
    `Langevin(...) + Recoil(...)`, the heat of the recoil is right to a factor x/sinh(x), x = G h/I. The noise does not
    repeat if baths share a key.

    Examples:
        >>> keys = jax.random.split(jax.random.key(0))
        >>> both = ml.baths.Langevin(1.0, 0.5, keys[0]) + ml.baths.Recoil(0.2, keys[1])
        >>> bool(ml.integrate("SYMMETRIC[BAOAB]", body, None, start, dt=0.001, steps=20, bath=both).ok)
        True
    """

    parts: tuple[BathOfBodies, ...]

    def __init__(self, *parts: Any):
        if not parts:
            raise ValueError("a sum must have at least one bath, got none; pass bath=None for a run without a bath.")
        for part in parts:
            if not isinstance(part, BathOfBodies):
                raise ValueError(f"a sum must be of baths of bodies, such as Langevin, got {described(part)}.")
        self.parts = tuple(chain.from_iterable(part.parts if isinstance(part, Sum) else (part,) for part in parts))

    @property
    def keys(self) -> tuple[Any, ...]:
        return tuple(chain.from_iterable(part.keys for part in self.parts))

    def prepared(self, body: Body, coefficients: Iterable[float], t: Array, h: Array, start: AnyState) -> Any:
        halves = [{b / 2 for b in coefficients}] * (len(self.parts) - 1)
        each = zip(self.parts, [*halves, coefficients], strict=True)
        return tuple(chain.from_iterable(part.prepared(body, own, t, h, start) for part, own in each))

    def check(self, state: AnyState) -> None:
        for part in self.parts:
            part.check(state)

    def check_kind(self, state: AnyState, body: Any) -> None:
        for part in self.parts:
            part.check_kind(state, body)

    def check_on(self, state: AnyState, body: Any) -> None:
        for part in self.parts:
            part.check_on(state, body)


def words_of(key: Array) -> tuple[Array, ...]:
    """The words of a random key, uint32, behind a barrier: XLA would fold a constant one, with other rounding."""
    words = jax.lax.optimization_barrier(jax.random.key_data(key))
    return tuple(words[i] for i in range(words.shape[-1]))


def as_key(key: Any) -> Array:
    if not is_key(key):
        raise ValueError(f"key must be a typed key, got {described(key)}; make it with jax.random.key(seed).")
    return key


def as_coefficient(name: str, value: Any) -> Any:
    if callable(value):
        require_function(name, value, "t")
        return value
    return as_tensor(name, value)


def as_tensor(name: str, value: Any) -> Array:
    numbers = as_finite(name, value)
    if numbers.shape[-2:] != (3, 3) or is_traced(numbers):
        require(name, numbers, lambda x: x >= 0, "must not be negative", "check its sign.")
        return numbers
    tensor = np.asarray(numbers, np.float64)
    largest = np.abs(tensor).max(initial=0.0)
    other = f"or, if these are three numbers for each of three bodies, pass jax.vmap(jnp.diag)({name})."
    if not is_symmetric(tensor):
        raise ValueError(
            f"{name} must be symmetric if it is a tensor, got {shown(tensor)}; pass (G + G.T) / 2; {other}"
        )
    least = float(np.linalg.eigvalsh(tensor).min(initial=0.0))
    if least < -ROUNDED * largest:
        raise ValueError(
            f"{name} must be positive semi-definite, but {shown(tensor)} has the eigenvalue {least:.3g}; check its "
            f"signs; {other}"
        )
    return numbers


def at(value: Any, t: Array) -> Array:
    """The numbers at a time, in the dtype of the time; NaN if one is negative, or a tensor is not symmetric."""
    if not callable(value):
        return value.astype(t.dtype)
    found: Any = value(t)
    numbers = jnp.asarray(found).astype(t.dtype)
    if numbers.shape[-2:] != (3, 3):
        return jnp.where(numbers < 0, jnp.nan, numbers)
    off = jnp.abs(numbers - jnp.swapaxes(numbers, -1, -2))
    return jnp.where(jnp.any(off > ROUNDED * jnp.max(jnp.abs(numbers))), jnp.nan, numbers)
