"""The predictor and corrector of P. Depondt and F. G. Mertens (J. Phys.: Condens. Matter 21, 2009, 336005), in JAX.

Each spin turns about its field; with the mean of the fields at both ends it turns again from the start. Second order.
"""

from typing import Any

import jax
import jax.numpy as jnp


def _turned(spin: Any, angle: Any) -> Any:
    """Rodrigues' formula, by components."""
    square = sum(a * a for a in angle)
    size = jnp.sqrt(square)
    safe = jnp.where(square > 0, square, 1)
    s, c = (
        jnp.where(square > 0, jnp.sin(size) / jnp.sqrt(safe), 1),
        jnp.where(square > 0, (1 - jnp.cos(size)) / safe, 0),
    )
    along = sum(a * x for a, x in zip(angle, spin, strict=True))
    (a, b, d), (x, y, z) = angle, spin
    cross = b * z - d * y, d * x - a * z, a * y - b * x
    return tuple(jnp.cos(size) * x + s * v + c * along * a for x, v, a in zip(spin, cross, angle, strict=True))


def _exchange(spin: Any) -> Any:
    """The field of J = 1 on a periodic lattice."""
    return tuple(sum(jnp.roll(x, step, axis) for axis in range(x.ndim) for step in (1, -1)) for x in spin)


@jax.jit
def run(spin: Any, dt: Any, steps: Any) -> Any:
    """Spins (*lattice, 3) after some steps under exchange with J = 1, without damping."""

    def step(_: Any, spin: Any) -> Any:
        field = _exchange(spin)
        guess = _turned(spin, tuple(dt * b for b in field))
        mean = tuple(dt / 2 * (a + b) for a, b in zip(field, _exchange(guess), strict=True))
        return _turned(spin, mean)

    return jnp.stack(jax.lax.fori_loop(0, steps, step, tuple(jnp.moveaxis(spin, -1, 0))), axis=-1)
