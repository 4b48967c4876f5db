"""Newton's method for three equations, in a fixed number of iterations, so that it fuses into a step."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .._xla.fusion import fuse, split
from . import components as cp

Residual = Callable[[cp.Vector], cp.Vector]


def newton(residual: Residual, guess: cp.Vector, iterations: int, *, unrolled: bool = False) -> tuple[cp.Vector, Array]:
    """A root by Newton's method, and the largest magnitude of the residual there.

    The Jacobian comes from automatic differentiation. The iterations run in a separate loop unless `unrolled`; five
    copies of a residual with a torque would take minutes to compile.
    """

    def improve(x: cp.Vector) -> cp.Vector:
        value, slope = jax.linearize(residual, x)
        return cp.subtract(x, _solve_linear(slope, value))

    def iterate(x: cp.Vector) -> cp.Vector:
        if not unrolled:
            return jax.lax.fori_loop(0, iterations, lambda _, x: fuse(improve(x)), fuse(x))
        for _ in range(iterations):
            x = improve(x)
        return x

    guess = jax.lax.stop_gradient(guess)
    x = jax.lax.custom_root(residual, guess, lambda f, start: iterate(start), _solve_linear)
    return x, cp.largest(jax.lax.stop_gradient(residual(x)))


def newton_pairs(residual: Residual, slope: Callable[[cp.Vector], cp.Columns], x: cp.Vector, count: int) -> cp.Vector:
    """The approximate root after `count` pairs of Newton steps; both steps use the Jacobian at the start of their pair.

    `slope` gives the columns of the Jacobian, which flights have in closed form. Each pair is a separate loop: within
    one loop XLA's emitter would evaluate these residuals many times, but it cannot repeat work across loops.
    """
    for _ in range(count):
        inverse = cp.Inverse3.of(slope(x))
        for _ in range(2):
            x = cp.subtract(x, inverse.times(residual(x)))
        x = split(x)
    return x


def _solve_linear(linear: Callable[[Any], Any], right: Any) -> Any:
    one, zero = jnp.ones_like(right[0]), jnp.zeros_like(right[0])
    columns = (linear((one, zero, zero)), linear((zero, one, zero)), linear((zero, zero, one)))
    return cp.Inverse3.of(columns).times(right)
