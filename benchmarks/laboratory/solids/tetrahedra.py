"""A neo-Hookean solid of linear tetrahedra: its elastic energy, its lumped masses, and the limit of its step."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

import midlie_jax as ml


def triple_product(F: Array) -> Array:
    """The determinants (e,) of (e, 3, 3)."""
    return jnp.sum(F[:, 0] * jnp.cross(F[:, 1], F[:, 2]), axis=1)


class NeoHookean(eqx.Module):
    """The elastic energy of tetrahedra, W = V [mu/2 (tr F^T F - 3) - mu ln J + lambda/2 ln^2 J] of each.

    F = Ds Dm^-1 is the deformation gradient, constant in a tetrahedron, and J its determinant (Bonet and Wood,
    Nonlinear Continuum Mechanics for Finite Element Analysis, section 6.4.3). The energy is NaN where a tetrahedron is
    turned inside out, so such a run fails with `ok` False.

    Attributes:
        corners: the nodes of each tetrahedron, (e, 4).
        inverse: Dm^-1, the inverse of its three edges at rest, (e, 3, 3).
        volume: its volume at rest, (e,).
        mu, lame: Lamé's parameters mu and lambda, pressures, () or (e,).
        determinant: of (e, 3, 3). The derivative of `jnp.linalg.det` factorises every matrix, and so is slow.
    """

    corners: Array
    inverse: Array
    volume: Array
    mu: Array
    lame: Array
    determinant: Callable[[Array], Array] = eqx.field(static=True)

    def __init__(
        self,
        nodes: Array,
        corners: Any,
        mu: Any,
        lame: Any,
        determinant: Callable[[Array], Array] = triple_product,
    ):
        self.determinant = determinant
        self.corners = jnp.asarray(corners)
        edges = self.edges(nodes)
        self.inverse, self.volume = jnp.linalg.inv(edges), jnp.abs(jnp.linalg.det(edges)) / 6
        self.mu, self.lame = (jnp.asarray(x, nodes.dtype) for x in (mu, lame))

    def edges(self, nodes: Array) -> Array:
        """The edges from the first node of each tetrahedron to the others, as columns (e, 3, 3)."""
        places = nodes[self.corners]
        return jnp.swapaxes(places[:, 1:] - places[:, :1], 1, 2)

    def __call__(self, t: Any, state: ml.ParticleState) -> Array:
        """The energy () of a state with positions (n, 3)."""
        del t
        F = self.edges(state.position) @ self.inverse
        log_J = jnp.log(self.determinant(F))
        density = self.mu / 2 * (jnp.sum(F**2, axis=(1, 2)) - 3) - self.mu * log_J + self.lame / 2 * log_J**2
        return jnp.sum(self.volume * density)

    def masses(self, nodes: Array, density: float) -> Array:
        """A quarter of the mass of each tetrahedron for each of its nodes: a column (n, 1)."""
        quarter = density * self.volume[:, None] / 4
        shared = jnp.broadcast_to(quarter, self.corners.shape)
        return jnp.zeros(len(nodes), nodes.dtype).at[self.corners].add(shared)[:, None]


def longest_step(energy: Any, mass: Array, nodes: Array, rounds: int = 400) -> float:
    """2/omega_max, beyond which Verlet is unstable: of the stiffest small vibration about these nodes.

    omega_max^2 is the largest eigenvalue of M^-1/2 K M^-1/2. Power iteration finds it from below: what is returned is
    longer than the true limit, by some per mille at most. K is applied as the derivative of the force.
    """
    root = jnp.sqrt(mass)

    def force(x: Array) -> Array:
        return -jax.grad(lambda y: energy(0.0, ml.ParticleState(jnp.zeros_like(y), y)))(x)

    def stiffness(v: Array) -> Array:
        return -jax.jvp(force, (nodes,), (v / root,))[1] / root

    def turn(_: Any, v: Array) -> Array:
        v = stiffness(v)
        return v / jnp.linalg.norm(v)

    first = jax.random.normal(jax.random.key(0), nodes.shape, nodes.dtype)
    stiffest = jax.jit(lambda v: jax.lax.fori_loop(0, rounds, turn, v))(first)
    return float(2 / jnp.sqrt(jnp.linalg.norm(stiffness(stiffest))))


def angular_momentum(state: ml.ParticleState) -> Array:
    """The sum of x cross p about the origin, (..., 3), of states (..., n, 3)."""
    return jnp.sum(jnp.cross(state.position, state.momentum), axis=-2)
