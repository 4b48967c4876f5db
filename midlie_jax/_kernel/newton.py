"""Three equations in three unknowns: the implicit part of a step whose residual holds the user's torque.

The root comes from a fixed number of Newton steps, so that it fuses into the step's one loop. Its derivative is
that of the implicit function (`lax.custom_root`), forward and reverse and of any order: nothing is ever
differentiated through the iterations.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from . import components as cp
from .fusion import fuse

Residual = Callable[[cp.Vector], cp.Vector]


def newton(residual: Residual, guess: cp.Vector, iterations: int, *, unrolled: bool = False) -> tuple[cp.Vector, Array]:
    """A root by Newton's method with the Jacobian by automatic differentiation, and the size of the residual left.

    For the implicit methods, whose residual holds the user's torque; four evaluations of it an iteration. They run
    in a loop of their own unless `unrolled`: with a torque in it, five copies would take the compiler minutes.
    """

    def improve(x: cp.Vector) -> cp.Vector:
        value, slope = jax.linearize(residual, x)
        return cp.subtract(x, _tangent(slope, value))

    def iterate(x: cp.Vector) -> cp.Vector:
        if not unrolled:
            return jax.lax.fori_loop(0, iterations, lambda _, x: fuse(improve(x)), fuse(x))
        for _ in range(iterations):
            x = improve(x)
        return x

    guess = jax.lax.stop_gradient(guess)
    x = jax.lax.custom_root(residual, guess, lambda f, start: iterate(start), _tangent)
    return x, cp.largest(jax.lax.stop_gradient(residual(x)))


def newton_pairs(residual: Residual, slope: Callable[[cp.Vector], cp.Columns], x: cp.Vector, count: int) -> cp.Vector:
    """Pairs of Newton's steps with one Jacobian each, the columns of `slope`; for flights, whose Jacobian is known.

    In one loop XLA's emitter repeats such residuals many times over; it cannot from loop to loop, so each pair has one.
    """
    for _ in range(count):
        inverse = cp.Inverse3.of(slope(x))
        for _ in range(2):
            x = cp.subtract(x, inverse.times(residual(x)))
        x = fuse(x)
    return x


def _tangent(linear: Callable[[Any], Any], right: Any) -> Any:
    """Solves linear(x) = right."""
    one, zero = jnp.ones_like(right[0]), jnp.zeros_like(right[0])
    columns = (linear((one, zero, zero)), linear((zero, one, zero)), linear((zero, zero, one)))
    return cp.Inverse3.of(columns).times(right)
