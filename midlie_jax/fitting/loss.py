"""Robust losses: outliers count less than with the sum of squares.

A loss replaces each residual r by a slowly growing one, s(r); the fit minimises the sum of squares of these.

P. J. Huber, Ann. Math. Statist. 35 (1964) 73; P. W. Holland, R. E. Welsch, Commun. Statist. A6 (1977) 813 for the
scales, which keep 95 % of the efficiency of least squares for normal noise.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array

_SMALL = 1e-4  # relative to the scale; below it Cauchy's loss is a square


class Loss(eqx.Module):
    """A robust loss of residuals over sigma.

    Attributes:
        scale: the residual over sigma beyond which values count less. Sigmas must then have the right size.

    Raises:
        ValueError: the scale is not a positive number.

    Examples:
        >>> ml.fitting.Huber(2.0).counted(jnp.array([1.0, 10.0])).round(3)  # sqrt(2 * 2 * 10 - 2 * 2)
        Array([1., 6.], dtype=float64)
    """

    scale: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        if isinstance(self.scale, bool) or not isinstance(self.scale, int | float) or not 0 < self.scale < float("inf"):
            raise ValueError(f"scale must be a positive finite number, got {self.scale!r}; 2 means two sigma.")

    @abstractmethod
    def counted(self, residuals: Array) -> Array:
        """s(r): the residuals whose sum of squares the fit minimises."""

    @abstractmethod
    def residuals(self, counted: Array) -> Array:
        """The inverse of `counted`."""

    @abstractmethod
    def weight(self, residuals: Array) -> Array:
        """The weight of each residual relative to least squares, from 0 to 1."""

    def judged(self, residuals: Array) -> Array:
        """Weight times residual, over its deviation for normal noise: a few outliers hardly change its mean square."""
        x = jnp.linspace(-8.0, 8.0, 801, dtype=residuals.dtype)
        density = jnp.exp(-(x**2) / 2)
        usual = jnp.sum(density * (self.weight(x) * x) ** 2) / jnp.sum(density)
        return self.weight(residuals) * residuals / jnp.sqrt(usual)


class Huber(Loss):
    """Huber's loss: r^2 up to the scale k, then 2 k |r| - k^2. It has one minimum where least squares has one.

    Examples:
        >>> ml.fitting.Huber().weight(jnp.array([1.0, 13.45])).round(3)  # for ml.fit(..., loss=...)
        Array([1. , 0.1], dtype=float64)
    """

    scale: float = eqx.field(static=True, default=1.345)

    def counted(self, residuals: Array) -> Array:
        size = jnp.abs(residuals)
        far = jnp.maximum(size, self.scale)
        return jnp.where(
            size > self.scale, jnp.sign(residuals) * jnp.sqrt(self.scale * (2 * far - self.scale)), residuals
        )

    def residuals(self, counted: Array) -> Array:
        far = jnp.sign(counted) * (counted**2 + self.scale**2) / (2 * self.scale)
        return jnp.where(jnp.abs(counted) > self.scale, far, counted)

    def weight(self, residuals: Array) -> Array:
        return self.scale / jnp.maximum(jnp.abs(residuals), self.scale)


class Cauchy(Loss):
    """Cauchy's loss k^2 log(1 + (r / k)^2), with the scale k: far outliers have almost no influence.

    Examples:
        >>> ml.fitting.Cauchy().counted(jnp.array([0.1, 100.0])).round(3)  # for ml.fit(..., loss=...)
        Array([0.1 , 6.52], dtype=float64)
    """

    scale: float = eqx.field(static=True, default=2.385)

    def counted(self, residuals: Array) -> Array:
        size = jnp.abs(residuals) / self.scale
        far = jnp.maximum(size, _SMALL)
        return jnp.where(size > _SMALL, jnp.sign(residuals) * self.scale * jnp.sqrt(jnp.log1p(far**2)), residuals)

    def residuals(self, counted: Array) -> Array:
        return jnp.sign(counted) * self.scale * jnp.sqrt(jnp.expm1((counted / self.scale) ** 2))

    def weight(self, residuals: Array) -> Array:
        return 1 / (1 + (residuals / self.scale) ** 2)


def as_loss(loss: Any) -> Loss | None:
    """The loss of an argument of `fit`; raises a ValueError if there is no such loss."""
    named = {"huber": Huber, "cauchy": Cauchy}
    if loss is None or isinstance(loss, Loss):
        return loss
    if isinstance(loss, str) and loss in named:
        return named[loss]()
    raise ValueError(f'loss must be None, "huber", "cauchy", Huber(scale) or Cauchy(scale), got {loss!r}.')
