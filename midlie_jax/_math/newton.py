"""Newton's method for three equations, in a fixed number of iterations, so that it fuses into a step."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from .._xla.fusion import fuse, split
from . import components as cp

Residual = Callable[[cp.Vector], cp.Vector]
# Pairs of Newton steps in `newton_pairs`: three suffice for DMV up to h |Omega| = 0.7, where two roots come close to
# each other, and for SLIEMID up to |Psi| = 0.3 and ratios of the moments of 1e3. Beyond, a solve may fail; `ok` is then
# False.
PAIRS = 3


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


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def newton_pairs(
    residual: Callable[..., cp.Vector],
    slope: Callable[..., cp.Columns],
    guess: Callable[..., cp.Vector],
    *arguments: Any,
) -> cp.Vector:
    """The root x of residual(*arguments, x) near guess(*arguments), with derivatives of any order by the implicit
    function theorem.

    `slope` gives the columns of the Jacobian. Both Newton steps of a pair use the Jacobian at its start. Each pair is a
    separate loop, because within one loop XLA's emitter would evaluate these residuals many times.
    """
    x = guess(*arguments)
    for _ in range(PAIRS):
        inverse = cp.Inverse3.of(slope(*arguments, x))
        for _ in range(2):
            x = cp.subtract(x, inverse.times(residual(*arguments, x)))
        x = split(x)
    return x


@newton_pairs.defjvp
def _newton_pairs_jvp(residual: Any, slope: Any, guess: Any, primals: Any, tangents: Any) -> Any:
    x = split(newton_pairs(residual, slope, guess, *primals))
    inverse = cp.Inverse3.of(slope(*primals, x))
    _, change = jax.jvp(lambda *arguments: residual(*arguments, x), primals, tangents)
    return x, cp.scale(-1, inverse.times(change))


def _solve_linear(linear: Callable[[Any], Any], right: Any) -> Any:
    one, zero = jnp.ones_like(right[0]), jnp.zeros_like(right[0])
    columns = (linear((one, zero, zero)), linear((zero, one, zero)), linear((zero, zero, one)))
    return cp.Inverse3.of(columns).times(right)
