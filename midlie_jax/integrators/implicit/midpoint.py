"""The implicit midpoint rule for particles, from the part of the paper on vector spaces."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ...model.bodies import Particles
from ..system import Motion, System
from ..verdict import verdict
from .base import ITERATIONS, Implicit


class ImplicitMidpoint(Implicit):
    """p1 = p0 + h f(t + h/2, (u0 + u1)/2), u1 = u0 + h M^-1 (p0 + p1)/2: order 2, symmetric, symplectic."""

    name: str = eqx.field(static=True, default="implicit midpoint")
    symplectic: bool = eqx.field(static=True, default=True)
    bodies: type[Any] = eqx.field(static=True, default=Particles)
    evaluations: int = eqx.field(static=True, default=2 * ITERATIONS + 1)

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: Motion[Array, Array], force: Any
    ) -> tuple[Motion[Array, Array], Any, Array | bool]:
        del t1, force
        start, position = motion.momentum, motion.pose

        def travel(mean: Array) -> Array:
            return h * system.inertia.velocity(mean)

        def residual(flat: Array) -> Array:
            mean = flat.reshape(start.shape)
            pushed = start + h / 2 * system.force(t0 + h / 2, Motion(mean, position + travel(mean) / 2))
            return (mean - pushed).ravel()

        def tangent(linear: Any, right: Array) -> Array:
            return jnp.linalg.solve(jax.jacfwd(linear)(right), right)

        def iterate(function: Any, flat: Array) -> Array:
            for _ in range(ITERATIONS):
                flat = flat - jnp.linalg.solve(jax.jacfwd(function)(flat), function(flat))
            return flat

        flat = jax.lax.custom_root(residual, jax.lax.stop_gradient(start.ravel()), iterate, tangent)
        remaining = jnp.max(jnp.abs(jax.lax.stop_gradient(residual(flat))))
        mean = flat.reshape(start.shape)
        size = jnp.maximum(jnp.max(jnp.abs(mean)), jnp.max(jnp.abs(start)))
        ok = verdict(remaining <= 64 * jnp.finfo(start.dtype).eps * size)
        return Motion(2 * mean - start, position + travel(mean)), None, ok
