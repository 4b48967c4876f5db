"""The same dipole through diffrax: quaternion and body-frame momentum, with the bath as additive noise.

All that was measured to make it fast is used: one equation for all bodies, whose components are rows of numbers; the
Brownian path that draws each increment afresh; a term that adds the noise to the momenta alone; `solver.step` in a loop
without the bookkeeping of `diffeqsolve`; and XLA's options for our own steps. The quaternion is scaled to unit length
after each step. With `jax.vmap` over bodies that each have a path, a step takes about five times as long.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
from harness import Compiled, compiled
from jax import Array

from midlie_jax._xla.compiler import compiler_options

from .dipole import BODIES, FRICTION, MOMENTS, Plan, Run, of_parts, rate, thermal

SOLVERS: dict[str, Any] = {
    "EulerHeun": diffrax.EulerHeun(),
    "Heun": diffrax.Heun(),
    "SEA": diffrax.SEA(),
    "ShARK": diffrax.ShARK(),
}
_PLAIN = "EulerHeun", "Heun"  # the others read the space-time Levy area, too


class _Noise(diffrax.AbstractTerm[Any, Any]):
    """Noise of one size on the last three of seven rows."""

    size: Array
    path: Any

    def vf(self, t: Any, y: Any, args: Any) -> Any:
        return self.size

    def contr(self, t0: Any, t1: Any, **options: Any) -> Any:
        return self.path.evaluate(t0, t1, **options)

    def prod(self, vf: Any, control: Any) -> Any:
        return jnp.concatenate([jnp.zeros((4, *control.shape[1:]), control.dtype), vf * control])


def _rates(x: Any) -> Callable[[Any, Any, Any], Array]:
    friction = FRICTION * rate(x)

    def rates(t: Any, y: Any, args: Any) -> Array:
        del t, args
        a, b, c, d, *momentum = y
        (p, q, r), (u, v, w) = momentum, (m / moment for m, moment in zip(momentum, MOMENTS, strict=True))
        turning = -b * u - c * v - d * w, a * u + c * w - d * v, a * v + d * u - b * w, a * w + b * v - c * u
        east, north = 2 * (b * d - a * c), 2 * (c * d + a * b)  # components of the field along the axes of the body
        torque = -x * north - friction * u, x * east - friction * v, -friction * w
        gyroscopic = q * w - r * v, r * u - p * w, p * v - q * u
        return jnp.stack([*(k / 2 for k in turning), *(g + k for g, k in zip(gyroscopic, torque, strict=True))])

    return rates


def _loop(name: str, x: Any, h: Any, dtype: Any) -> Callable[[Array, Array, Array, int], Array]:
    """A function of the rows (7, n), a key, the number of the first step and how many steps to take."""
    solver, size = SOLVERS[name], jnp.asarray((2 * FRICTION * rate(x)) ** 0.5, dtype)
    levy: Any = diffrax.BrownianIncrement if name in _PLAIN else diffrax.SpaceTimeLevyArea

    def steps(rows: Array, key: Array, first: Array, count: int) -> Array:
        shape: Any = jax.ShapeDtypeStruct((3, rows.shape[1]), dtype)
        path = diffrax.UnsafeBrownianPath(shape, key, levy_area=levy)
        terms = diffrax.MultiTerm(diffrax.ODETerm(_rates(x)), _Noise(size, path))
        dt = jnp.asarray(h, dtype)

        def one(k: Array, carry: Any) -> Any:
            y, state = carry
            t = k.astype(dtype) * dt
            y, _, _, state, _ = solver.step(terms, t, t + dt, y, None, state, False)
            return y.at[:4].divide(jnp.sqrt(jnp.sum(y[:4] ** 2, axis=0))), state

        state = solver.init(terms, jnp.zeros((), dtype), dt, rows, None)
        return jax.lax.fori_loop(first, first + count, one, (rows, state))[0]

    return steps


def _start(key: Array, x: Any, dtype: Any) -> Array:
    state = thermal(key, x, dtype)
    return jnp.concatenate([state.attitude, state.momentum], axis=-1).T


def theirs(name: str, share: float, dtype: Any = jnp.float32) -> Run:
    """As `dipole.ours`."""
    plan = Plan.of(share)

    def run(key: Array, x: Array, h: Array) -> Array:
        a, b = jax.random.split(key)
        advance = _loop(name, x, h, dtype)

        def save(rows: Array, k: Array) -> tuple[Array, Array]:
            rows = advance(rows, b, k * plan.every, plan.every)
            return rows, jnp.stack([jnp.mean(value) for value in of_parts(rows[4:].T, rows[:4].T)])

        means = jax.lax.scan(save, _start(a, x, dtype), jnp.arange(plan.steps // plan.every))[1]
        return means[plan.skipped // plan.every :]

    return jax.jit(run, compiler_options=compiler_options(BODIES))


def timed(name: str, x: float, h: float, steps: int, dtype: Any = jnp.float32) -> Compiled:
    """As `dipole.timed`."""
    key, advance = jax.random.key(0), _loop(name, x, h, dtype)
    rows = _start(key, x, dtype)

    def run(rows: Array, key: Array) -> Array:
        return advance(rows, key, jnp.zeros((), jnp.int32), steps)

    return compiled(run, rows, key, bodies=BODIES)
