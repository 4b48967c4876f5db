"""The unknowns of a fit: parameters, each a smooth one-to-one map from unconstrained numbers to physical values.

The optimiser changes only the unconstrained numbers, so every body that it tries can exist. `Layout` joins the numbers
of all parameters of a guess in one vector and names them.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_floats, as_positive, described, is_unit, require, require_finite
from ..model import so3

_NOT_FLAT = "must satisfy the strict triangle inequality"
_CURE_OF_FLAT = "lower the largest moment below the sum of the others; a flat body is a limit."
_MOST_DRAWS = 100
_TRIANGLE = np.ones((3, 3)) / 2 - np.eye(3)  # (a, b, c) = _TRIANGLE @ (I1, I2, I3)


class Parameter(eqx.Module):
    """One quantity to be estimated; `initial` is the guess of the fit.

    The optimiser varies the *unconstrained* vector (size,) of a value. The *coordinates* (k,) are the physical numbers
    of the result and its covariance.

    Examples:
        >>> guess = {"moments": ml.fitting.Moments([2.0, 3.0, 4.0]), "damping": ml.fitting.Positive(0.2)}
        >>> guess["moments"].labels(), guess["moments"].value(guess["moments"].vector()).round(6)
        (['[0]', '[1]', '[2]'], Array([2., 3., 4.], dtype=float64))
    """

    initial: eqx.AbstractVar[Array]

    @abstractmethod
    def vector(self) -> Float[Array, " size"]:
        """The unconstrained numbers of the guess."""

    @abstractmethod
    def value(self, vector: Float[Array, " size"]) -> Array:
        """The physical value of unconstrained numbers, of the shape of `initial`."""

    def coordinates(self, value: Array) -> Float[Array, " k"]:
        """The physical numbers of a value."""
        return value.reshape(-1)

    def labels(self) -> list[str]:
        """The index of each coordinate, such as "[0]"; "" for a single number."""
        shape = self.initial.shape
        return [f"[{','.join(map(str, index))}]" if index else "" for index in np.ndindex(shape)]

    def unconstrained_labels(self) -> list[str]:
        """The index of each unconstrained number."""
        return self.labels()

    def typical(self) -> Float[Array, " size"]:
        """The change of each unconstrained number that multiplies the value by about e, or rotates it by a radian."""
        return jnp.ones_like(self.vector())

    def compared(self, value: Any) -> np.ndarray:
        """Numbers whose differences tell values apart: relative, or in radians."""
        return np.log(np.asarray(value)).reshape(-1)

    def draw(self, name: str, rng: np.random.Generator, count: int, limits: Any) -> np.ndarray:
        """Values (count, ...) in a range, see `ranges` of `fit`."""
        low, high = _ends(name, self.initial, limits, np.abs(self.initial))
        found = rng.uniform(low, high, (count, *self.initial.shape))
        vectors = jax.vmap(lambda x: eqx.tree_at(lambda p: p.initial, self, x).vector())
        for _ in range(_MOST_DRAWS):
            possible = np.isfinite(np.asarray(vectors(jnp.asarray(found)))).reshape(count, -1).all(axis=1)
            wrong = np.flatnonzero(~possible)
            if not wrong.size:
                return found
            found[wrong] = rng.uniform(low, high, (wrong.size, *self.initial.shape))
        raise ValueError(f"range of {name} must hold possible values of {type(self).__name__}, got {limits!r}.")


class Free(Parameter):
    """Any real numbers, in any shape and unit, such as an initial angular velocity or the bias of a gyroscope.

    Raises:
        ValueError: the guess is not an array of finite numbers.

    Examples:
        >>> bias = ml.fitting.Free([0.0, 0.01, 0.0])
        >>> bias.vector()
        Array([0.  , 0.01, 0.  ], dtype=float64)
    """

    initial: Float[Array, "..."]

    def __init__(self, initial: Any):
        self.initial = as_finite("initial", initial)

    def vector(self) -> Float[Array, " size"]:
        return self.initial.reshape(-1)

    def value(self, vector: Float[Array, " size"]) -> Array:
        return vector.reshape(self.initial.shape)

    def typical(self) -> Float[Array, " size"]:
        size = jnp.sqrt(jnp.mean(self.initial**2))
        return jnp.where(size == 0, jnp.ones_like(size), size) * jnp.ones_like(self.vector())

    def compared(self, value: Any) -> np.ndarray:
        return np.reshape(value, -1) / np.asarray(self.typical())


class Periodic(Free):
    """Angles or phases: any real numbers, of which those that differ by a period are the same.

    Args:
        period: by default 2 pi; broadcast to the shape of the guess.

    Raises:
        ValueError: as for `Free`, or a period is not positive.

    Examples:
        >>> phases = ml.fitting.Periodic([0.1, 2.0], period=[1.0, 2 * jnp.pi])  # of ml.asteroids.tumbling
        >>> phases.vector()
        Array([0.1, 2. ], dtype=float64)
    """

    period: Float[Array, "..."]

    def __init__(self, initial: Any, period: Any = 2 * np.pi):
        super().__init__(initial)
        self.period = jnp.broadcast_to(as_positive("period", period).astype(self.initial.dtype), self.initial.shape)

    def typical(self) -> Float[Array, " size"]:
        return self.period.reshape(-1) / (2 * np.pi)

    def compared(self, value: Any) -> np.ndarray:
        angle = 2 * np.pi * value / np.asarray(self.period)
        return np.stack([np.cos(angle), np.sin(angle)])

    def draw(self, name: str, rng: np.random.Generator, count: int, limits: Any) -> np.ndarray:
        low, high = _ends(name, self.initial, 0.5 if _is_all(limits) else limits, np.asarray(self.period))
        return rng.uniform(low, high, (count, *self.initial.shape))


class Positive(Parameter):
    """Positive numbers exp(u), in any shape, such as a field strength, a mass or a damping.

    Raises:
        ValueError: a number of the guess is not positive and finite.

    Examples:
        >>> weight = ml.fitting.Positive(2.0)
        >>> bool(weight.value(weight.vector() - 10.0) > 0)  # wherever the optimiser goes
        True
    """

    initial: Float[Array, "..."]

    def __init__(self, initial: Any):
        self.initial = as_positive("initial", initial)

    def vector(self) -> Float[Array, " size"]:
        return jnp.log(self.initial).reshape(-1)

    def value(self, vector: Float[Array, " size"]) -> Array:
        return jnp.exp(vector).reshape(self.initial.shape)


class _Inertia(Parameter):
    """Moments (3,) or a tensor (3, 3); `scale="fixed"` keeps their sum, or its trace, as in the guess."""

    scale: str = eqx.field(static=True)

    def __check_init__(self) -> None:
        if self.scale not in ("free", "fixed"):
            raise ValueError(f"scale must be 'free' or 'fixed', got {self.scale!r}.")

    def draw(self, name: str, rng: np.random.Generator, count: int, limits: Any) -> np.ndarray:
        found = super().draw(name, rng, count, limits)
        found = (found + np.swapaxes(found, 1, -1)) / 2  # changes tensors only
        if self.scale == "free":
            return found
        scales = _total(np.asarray(self.initial)[None]) / _total(found)
        return found * scales.reshape(-1, *[1] * self.initial.ndim)


def _total(values: np.ndarray) -> np.ndarray:
    """The sum of each row of moments (n, 3), or the trace of each tensor (n, 3, 3)."""
    return np.sum(values if values.ndim == 2 else np.diagonal(values, axis1=1, axis2=2), axis=-1)


class Moments(_Inertia):
    """Principal moments of inertia (3,), mass x length^2: positive, each less than the sum of the other two.

    I = (b + c, c + a, a + b), where a, b and c are the integrals of x^2, y^2 and z^2 over the mass. Their logarithms
    are the three unconstrained numbers. With `scale="fixed"` the sum of the moments is fixed by the guess, and log(a/c)
    and log(b/c) are the two unconstrained numbers: the motion of a free body depends on ratios only.

    Raises:
        ValueError: the guess is not of shape (3,) or is not the inertia of a body with extent in all three directions;
            or `scale` is neither "free" nor "fixed".

    Examples:
        >>> moments = ml.fitting.Moments([2.0, 3.0, 4.0], scale="fixed")
        >>> moments.vector().shape  # two ratios
        (2,)
    """

    initial: Float[Array, "3"]

    def __init__(self, initial: Any, *, scale: str = "free"):
        self.initial, self.scale = as_positive("initial", _of_shape(initial, (3,))), scale
        require("initial", self.initial, lambda moments: moments @ _TRIANGLE > 0, _NOT_FLAT, _CURE_OF_FLAT)

    def vector(self) -> Float[Array, " size"]:
        logs = jnp.log(jnp.asarray(_TRIANGLE, self.initial.dtype) @ self.initial)
        return logs[:2] - logs[2] if self.scale == "fixed" else logs

    def value(self, vector: Float[Array, " size"]) -> Array:
        extents = jnp.exp(vector)
        if self.scale == "fixed":
            extents = jnp.append(extents, jnp.ones_like(vector[0]))
            extents = extents * (jnp.sum(self.initial) / 2 / jnp.sum(extents))
        return jnp.sum(extents) - extents

    def unconstrained_labels(self) -> list[str]:
        return ["[0]", "[1]"] if self.scale == "fixed" else self.labels()


class InertiaTensor(_Inertia):
    """A full inertia tensor (3, 3) in any frame fixed in the body, mass x length^2, for `midlie_jax.TensorBody`.

    The second moments of mass, Sigma = tr(J)/2 - J, are positive definite: Sigma = L L^T with a lower triangular L. The
    logarithms of its diagonal are three of the six unconstrained numbers. With `scale="fixed"` the trace of J is fixed
    by the guess and five numbers are left. Mass and centre of mass enter only through the torque; make them separate
    parameters.

    C. Rucker, P. M. Wensing, IEEE Robotics and Automation Letters 7 (2022) 2431; P. M. Wensing, S. Kim,
    J.-J. E. Slotine, IEEE Robotics and Automation Letters 3 (2018) 60.

    The moments of the guess must differ, because derivatives of principal axes are NaN for equal moments.

    Raises:
        ValueError: as for `Moments`, or the guess is not symmetric.

    Examples:
        >>> tensor = ml.fitting.InertiaTensor([[2.0, 0.1, 0.0], [0.1, 3.0, 0.0], [0.0, 0.0, 4.0]], scale="fixed")
        >>> tensor.vector().shape  # five numbers, because the trace is fixed
        (5,)
    """

    initial: Float[Array, "3 3"]

    def __init__(self, initial: Any, *, scale: str = "free"):
        self.initial, self.scale = _of_shape(initial, (3, 3)), scale
        require_finite("initial", self.initial)
        cure = "pass (J + J.T) / 2 if it differs by rounding."
        require("initial", self.initial, lambda x: abs(x - x.T) <= 1e-5 * abs(x).max(), "must be symmetric", cure)
        require("initial", self.initial, _of_a_body, _NOT_FLAT, _CURE_OF_FLAT)

    def vector(self) -> Float[Array, " size"]:
        half = jnp.trace(self.initial) / 2
        factor = jnp.linalg.cholesky(half * jnp.eye(3, dtype=half.dtype) - self.initial)
        if self.scale == "fixed":
            factor = factor / factor[0, 0]
        logs = jnp.log(jnp.diagonal(factor))
        below = factor[np.tril_indices(3, -1)]
        return jnp.concatenate([logs[1:] if self.scale == "fixed" else logs, below])

    def value(self, vector: Float[Array, " size"]) -> Array:
        logs = jnp.append(jnp.zeros_like(vector[0]), vector[:2]) if self.scale == "fixed" else vector[:3]
        factor = jnp.diag(jnp.exp(logs)).at[np.tril_indices(3, -1)].set(vector[-3:])
        second = factor @ factor.T
        if self.scale == "fixed":
            second = second * (jnp.trace(self.initial) / 2 / jnp.trace(second))
        return jnp.trace(second) * jnp.eye(3, dtype=second.dtype) - second

    def compared(self, value: Any) -> np.ndarray:
        return value / np.trace(value)

    def coordinates(self, value: Array) -> Float[Array, " k"]:
        """The six entries on and above the diagonal, row after row."""
        return value[np.triu_indices(3)]

    def labels(self) -> list[str]:
        return [f"[{i},{j}]" for i, j in zip(*np.triu_indices(3), strict=True)]

    def unconstrained_labels(self) -> list[str]:
        return [*["[0,0]", "[1,1]", "[2,2]"][self.scale == "fixed" :], "[0,1]", "[0,2]", "[1,2]"]


class _Unit(Parameter):
    """A point of a unit sphere, as the guess rotated by a vector of angles."""

    def vector(self) -> Float[Array, " size"]:
        return jnp.zeros_like(self.initial[1:])

    def draw(self, name: str, rng: np.random.Generator, count: int, limits: Any) -> np.ndarray:
        if _is_all(limits):
            return _on_sphere(rng.standard_normal((count, self.initial.size)))
        if isinstance(limits, bool) or not isinstance(limits, int | float) or not 0 < limits <= np.pi:
            raise ValueError(
                f'range of {name} must be "all", or the largest angle from the guess in radians, got {limits!r}.'
            )
        angles = self._within(float(limits), rng.uniform(0, 1, (count, 1)))
        axes = _on_sphere(rng.standard_normal((count, self.initial.size - 1)))
        return np.asarray(jax.vmap(self.value)(jnp.asarray(angles * axes)))

    @abstractmethod
    def _within(self, largest: float, share: np.ndarray) -> np.ndarray:
        """The angle from the guess that holds this share of the values up to the largest angle."""


class UnitQuaternion(_Unit):
    """An attitude, a unit quaternion (w, x, y, z): initial * exp(u), with the rotation vector u in the body frame.

    u is in radians and the map is one-to-one for |u| < pi. The coordinates are the rotation vector (3,) from the guess
    to the value.

    Raises:
        ValueError: the guess is not of shape (4,) or its length is not 1 to 1e-3.

    Examples:
        >>> attitude = ml.fitting.UnitQuaternion([1.0, 0.0, 0.0, 0.0])
        >>> attitude.value(jnp.array([0.2, 0.0, 0.0])).round(4)  # the guess, rotated by 0.2 about axis 1
        Array([0.995 , 0.0998, 0.    , 0.    ], dtype=float64)
    """

    initial: Float[Array, "4"]

    def __init__(self, initial: Any):
        self.initial = _of_shape(initial, (4,))
        require("initial", self.initial, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")

    def value(self, vector: Float[Array, " size"]) -> Array:
        return so3.multiply(self.initial / jnp.linalg.norm(self.initial), so3.exp(vector))

    def coordinates(self, value: Array) -> Float[Array, " k"]:
        return so3.log(so3.multiply(so3.conjugate(self.initial), value))

    def labels(self) -> list[str]:
        return [".x", ".y", ".z"]

    def compared(self, value: Any) -> np.ndarray:
        return 2 * np.outer(value, value)

    def _within(self, largest: float, share: np.ndarray) -> np.ndarray:
        return largest * np.cbrt(share)


class UnitVector(_Unit):
    """A direction, such as of a field in the body frame: the guess rotated by u, perpendicular to it.

    u is in radians, with two components along fixed directions that are perpendicular to the guess and to each other;
    the map is one-to-one for |u| < pi. The coordinates are the three components of the vector.

    Raises:
        ValueError: the guess is not of shape (3,) or its length is not 1 to 1e-3.

    Examples:
        >>> field = ml.fitting.UnitVector([0.6, 0.0, 0.8])
        >>> field.vector().shape, field.value(jnp.zeros(2))
        ((2,), Array([0.6, 0. , 0.8], dtype=float64))
    """

    initial: Float[Array, "3"]

    def __init__(self, initial: Any):
        self.initial = _of_shape(initial, (3,))
        require("initial", self.initial, is_unit, "must be a vector of length 1", "divide it by its norm.")

    def value(self, vector: Float[Array, " size"]) -> Array:
        guess, first, second = self._frame()
        return so3.rotate(so3.exp(jnp.cross(guess, vector[0] * first + vector[1] * second)), guess)

    def unconstrained_labels(self) -> list[str]:
        # The component that each number changes most, different for the two numbers.
        _, first, second = (np.abs(np.asarray(x)) for x in self._frame())
        one = int(np.argmax(first))
        return [f"[{one}]", f"[{int(np.argmax(np.where(np.arange(3) == one, -1.0, second)))}]"]

    def compared(self, value: Any) -> np.ndarray:
        return value

    def _within(self, largest: float, share: np.ndarray) -> np.ndarray:
        least = np.cos(largest)
        return np.arccos(least + (1 - least) * share)

    def _frame(self) -> tuple[Array, Array, Array]:
        """The guess, of length one, and two directions perpendicular to it and to each other."""
        guess = self.initial / jnp.linalg.norm(self.initial)
        axis = jnp.eye(3, dtype=guess.dtype)[jnp.argmin(jnp.abs(guess))]
        first = axis - jnp.sum(axis * guess) * guess
        first = first / jnp.linalg.norm(first)
        return guess, first, jnp.cross(guess, first)


class Layout(eqx.Module):
    """The parameters of a guess; its methods join the results of the `Parameter` methods of the same name."""

    guess: Any

    @property
    def parameters(self) -> list[Parameter]:
        return jax.tree.leaves(self.guess, is_leaf=_is_parameter)

    @property
    def size(self) -> int:
        return sum(parameter.vector().size for parameter in self.parameters)

    @property
    def structure(self) -> Any:
        return jax.tree.structure(self.guess, is_leaf=_is_parameter)

    def start(self) -> Float[Array, " p"]:
        return jnp.concatenate([parameter.vector() for parameter in self.parameters])

    def typical(self) -> Float[Array, " p"]:
        return jnp.concatenate([parameter.typical() for parameter in self.parameters])

    def values(self, vector: Float[Array, " p"]) -> Any:
        ends = np.cumsum([parameter.vector().size for parameter in self.parameters])
        parts = zip(self.parameters, jnp.split(vector, ends[:-1]), strict=True)
        return jax.tree.unflatten(self.structure, [parameter.value(part) for parameter, part in parts])

    def coordinates(self, vector: Float[Array, " p"]) -> Float[Array, " k"]:
        values = jax.tree.leaves(self.values(vector))
        return jnp.concatenate([p.coordinates(value) for p, value in zip(self.parameters, values, strict=True)])

    def names(self) -> list[str]:
        """The name of each coordinate, such as "moments[0]"."""
        return [f"{name}{label}" for name, p in self.named() for label in p.labels()]

    def unconstrained_names(self) -> list[str]:
        """The name of the coordinate that each unconstrained number mainly changes."""
        return [f"{name}{label}" for name, p in self.named() for label in p.unconstrained_labels()]

    def named(self) -> list[tuple[str, Any]]:
        """Each parameter with its name, such as "moments" or "gyro.bias"."""
        found = jax.tree_util.tree_leaves_with_path(self.guess, is_leaf=_is_parameter)
        return [(jax.tree_util.keystr(path, simple=True, separator=".") or "value", one) for path, one in found]

    def placed(self, values: Any) -> "Layout":
        """The layout of the guess with these values of its parameters."""
        pairs = zip(self.parameters, jax.tree.leaves(values), strict=True)
        leaves = [eqx.tree_at(lambda p: p.initial, parameter, jnp.asarray(value)) for parameter, value in pairs]
        return Layout(jax.tree.unflatten(self.structure, leaves))

    @classmethod
    def checked(cls, guess: Any) -> "Layout":
        """The layout of a guess; raises a ValueError if a leaf is not a `Parameter`, or if there is none."""
        layout = cls(guess)
        named = layout.named()
        if not named:
            raise ValueError("guess must hold a parameter, got none; give {'moments': Moments([1.0, 2.0, 2.5])}.")
        for name, leaf in named:
            if not _is_parameter(leaf):
                raise ValueError(
                    f"{name} of the guess must be a parameter, got {described(leaf)}; wrap it in "
                    "midlie_jax.fitting.Free, or use it inside the model if it is known."
                )
        dtypes = {parameter.vector().dtype.name for parameter in layout.parameters}
        if len(dtypes) > 1:
            raise ValueError(f"guess must have one dtype, got {' and '.join(sorted(dtypes))}; cast the parameters.")
        return layout


def flatness(value: Array) -> Float[Array, ""]:
    """I1 + I2 - I3 over the sum of the moments, where I3 is the largest, of moments or a tensor: zero if flat."""
    moments = value if value.ndim == 1 else jnp.linalg.eigvalsh(value)
    return 1 - 2 * jnp.max(moments) / jnp.sum(moments)


def _is_all(limits: Any) -> bool:
    return isinstance(limits, str) and limits == "all"


def _ends(name: str, initial: Any, limits: Any, unit: Any) -> tuple[np.ndarray, np.ndarray]:
    """The ends of a range: (low, high), or a number, which is a share of the unit on both sides of the guess."""
    centre = np.asarray(initial)
    try:
        low, high = (centre - limits * unit, centre + limits * unit) if np.ndim(limits) == 0 else limits
        low, high = (np.broadcast_to(np.asarray(x, float), centre.shape) for x in (low, high))
    except (TypeError, ValueError):
        low = high = np.full(centre.shape, np.nan)
    if not (np.all(np.isfinite(low) & np.isfinite(high)) and np.all(low <= high)):
        raise ValueError(
            f"range of {name} must be (low, high), or a number such as 0.3 for 30 % around the guess; got {limits!r}. "
            'Only UnitVector, UnitQuaternion and Periodic allow "all".'
        )
    return low, high


def _on_sphere(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _is_parameter(x: Any) -> bool:
    return isinstance(x, Parameter)


def _of_shape(value: Any, shape: tuple[int, ...]) -> Array:
    array = as_floats("initial", value)
    if array.shape != shape:
        raise ValueError(f"initial must have shape {shape}, got {array.shape}; map a fit over a batch with jax.vmap.")
    return array


def _of_a_body(tensor: np.ndarray) -> Any:
    return np.linalg.eigvalsh(np.trace(tensor) / 2 * np.eye(3) - tensor) > 0
