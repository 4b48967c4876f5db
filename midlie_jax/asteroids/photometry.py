"""`Photometry`: magnitudes of an asteroid from many nights, as a measurement for `midlie_jax.fit`."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_finite, as_floats, is_unit, require, require_function
from ..fitting.loss import Loss
from ..fitting.measurements import Part, Recorded, deviations, rows, source, with_arrays

_REWEIGHTINGS = 10


class Photometry(Recorded):
    """Magnitudes of a body, with an unknown zero point for each night.

    The zero points are linear unknowns. They are computed from the other parameters at each step of the fit, so they
    need no guess and no start: the best zero point is the mean of a night's differences, weighted by sigma and by the
    loss of the fit. They count as unknowns in the degrees of freedom, and `Fit.zero_points` returns them.

    A spin state from ranges of 30 %, with `file` a mapping of arrays and times in hours:

        from midlie_jax import fitting

        def model(v):
            body, (s, phi) = ml.RigidBody(v["moments"]), v["phases"]
            return body, None, ml.asteroids.tumbling(
                body, precession_period=v["precession"], rotation_period=v["rotation"], axis="short", pole=v["pole"],
                phases=(s, phi), mode="short",
            )

        def light(v, sun, observer):
            return ml.asteroids.EllipsoidBrightness(jnp.append(v["axes"], 1.0), sun, observer)

        guess = {
            "moments": fitting.Moments([0.5, 0.9, 1.0], scale="fixed"), "precession": fitting.Positive(7.5),
            "rotation": fitting.Positive(47.0), "pole": fitting.UnitVector([0.0, 0.0, 1.0]),
            "phases": fitting.Periodic([0.0, 0.0], period=[1.0, 2 * jnp.pi]), "axes": fitting.Positive([1.7, 1.2]),
        }
        ranges = {"moments": 0.3, "precession": 0.3, "rotation": 0.3, "axes": 0.3, "pole": "all", "phases": "all"}

        def spin_state(file):                    # (n,) and (n, 3)
            seen = ml.asteroids.Photometry(
                file["time"], file["magnitude"], 0.02, light, sun=file["sun"], observer=file["observer"],
                night=file["night"], light_time=file["light_time"],
            )
            return ml.fit(
                model, guess, seen, method="free_motion", starts=512, ranges=ranges, first_span=56.0, loss="huber",
                absolute_sigma=True,
            )                                    # .minima, .outliers, .zero_points()

    Args:
        times: (n,), ascending, of the observations.
        values: (n,), magnitudes; NaN where missing.
        sigma: standard deviation in magnitudes, () or (n,).
        light: a function (values, sun, observer) -> brightness, of the values of the parameters and two directions
            (3,). The brightness is called as brightness(t, state), such as an `EllipsoidBrightness` or a `Brightness`.
        sun, observer: unit vectors from the body to the Sun and to the observer, space frame, (3,) or (n, 3).
        night: (n,), the night or telescope of each value, as numbers or strings; None for one zero point.
        light_time: the travel time of the light to the observer, () or (n,), in the unit of time. It is subtracted
            from `times`.
        clock: as for `midlie_jax.fitting.Rates`.

    Raises:
        ValueError: as for `midlie_jax.fitting.Rates`; `light` cannot be called; or directions are not unit vectors.

    Examples:
        >>> def light(values, sun, observer):  # values of the parameters of the fit
        ...     return ml.asteroids.EllipsoidBrightness(values["semi_axes"], sun, observer)
        >>> seen = ml.asteroids.Photometry(
        ...     np.arange(4.0), [15.1, 15.3, 16.2, 16.0], 0.02, light, sun=[1.0, 0.0, 0.0], observer=[0.6, 0.8, 0.0],
        ...     night=["first", "first", "second", "second"],
        ... )  # for ml.fit
        >>> seen.nights
        ('first', 'second')
    """

    light: Callable[..., Any]
    sun: Float[Array, "n 3"]
    observer: Float[Array, "n 3"]
    of_night: Float[Array, "n k"]  # 1 where a value belongs to a night, else 0
    means: Float[Array, " k"]  # of the measured magnitudes of each night, which `values` are relative to
    nights: tuple[Any, ...] = eqx.field(static=True)

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        light: Callable[..., Any],
        *,
        sun: Any,
        observer: Any,
        night: Any = None,
        light_time: Any = 0.0,
        clock: Part = None,
    ):
        require_function("light", light, "values, sun, observer")
        emitted = as_floats("times", times) - as_floats("light_time", light_time)
        self.times, magnitudes, self.present = rows(emitted, values, ())
        count, dtype = len(self.times), magnitudes.dtype
        names, index = np.unique(np.zeros(count) if night is None else np.asarray(night), return_inverse=True)
        if index.shape != (count,):
            raise ValueError(f"night must have shape ({count},), one for each value, got {index.shape}.")
        self.nights = tuple(names.tolist())
        self.of_night = jax.nn.one_hot(index, len(names), dtype=dtype)
        of_present = jnp.where(self.present[:, None], self.of_night, 0.0)
        self.means = magnitudes @ of_present / jnp.maximum(jnp.sum(of_present, axis=0), 1.0)
        self.values = jnp.where(self.present, magnitudes - self.of_night @ self.means, 0.0)
        self.sigma, self.clock, self.bias = deviations(sigma, self.values), source("clock", clock, ()), None
        self.sun, self.observer = (_directions(name, x, count) for name, x in (("sun", sun), ("observer", observer)))
        self.light = with_arrays(light)

    def differences(self, parameters: Any, body: Any, states: Any) -> Array:
        def magnitude(t: Array, state: Any, sun: Array, observer: Array) -> Array:
            brightness = self.light(parameters, sun, observer)
            value = brightness(t, state)
            return value if getattr(brightness, "magnitude", False) else -2.5 * jnp.log10(value)

        times = self.times_of_model(parameters)
        return jax.vmap(magnitude)(times, states, self.sun, self.observer) - self.values

    @property
    def linear(self) -> int:
        return len(self.nights)

    def eliminated(self, residuals: Array, loss: Loss | None) -> tuple[Array, Array]:
        # The derivative of the residuals by the zero points.
        over = jnp.where(self.present[:, None], self.of_night / self.sigma[:, None], 0.0)

        def means(values: Array, weights: Array) -> Array:
            each = over * weights[:, None]
            return values @ each / jnp.maximum(jnp.sum(each * over, axis=0), jnp.finfo(over.dtype).tiny)

        # The weights of a loss depend on the result, but need no derivative: the zero points minimise the loss.
        fixed, weights = jax.lax.stop_gradient(residuals), jnp.ones_like(residuals)
        for _ in range(_REWEIGHTINGS):
            weights = weights if loss is None else loss.weight(fixed - over @ means(fixed, weights))
        found = means(residuals, weights)
        return residuals - over @ found, self.means - found


def _directions(name: str, value: Any, count: int) -> Array:
    array = as_finite(name, value)
    if array.shape not in ((3,), (count, 3)):
        raise ValueError(f"{name} must have shape (3,) or ({count}, 3), got {array.shape}.")
    require(name, array, is_unit, "must be unit vectors", "divide each by its norm.")
    return jnp.broadcast_to(array, (count, 3))
