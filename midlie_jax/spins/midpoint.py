"""Implicit midpoint rules on the sphere: a symplectic one, and the paper's Lie midpoint rule."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._math import components as cp
from .._xla.fusion import split
from ..integrators.base import Method
from ..integrators.system import AnyMotion, Motion, System
from ..integrators.verdict import verdict
from .state import Spins
from .turns import turned

_MOST = 100  # iterations; each multiplies an error by about h |d2H/dS2| / 2
_ENOUGH = 4  # in units of eps


class MidpointOnSphere(Method):
    """A midpoint rule: the change in a step is computed from the field at the middle m = (S0 + S1)/|S0 + S1|."""

    name: eqx.AbstractVar[str]
    order: int = eqx.field(static=True, default=2)
    symmetric: bool = eqx.field(static=True, default=True)
    symplectic: bool = eqx.field(static=True, default=False)
    keeps_momentum: bool = eqx.field(static=True, default=False)
    bodies: type[Any] = eqx.field(static=True, default=Spins)
    evaluations: int = eqx.field(static=True, default=8)  # approximate: it depends on the step

    @property
    def solves(self) -> int:
        return 1

    @abstractmethod
    def moved(self, spin: cp.Vector, middle: cp.Vector, change: cp.Vector) -> cp.Vector:
        """The spins after the step, from those before it, the middle and h S' there."""

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        if system.torque is None:
            return motion, None, True
        start: cp.Vector = motion.momentum
        spins: Spins = system.inertia

        def next_of(end: cp.Vector) -> cp.Vector:
            middle = _unit(cp.add(start, end))
            field = system.force(t0 + h / 2, Motion(middle, ()))
            return split(self.moved(start, middle, spins.change(h, middle, field)))

        end, apart = _fixed_point(next_of, start)
        return Motion(end, ()), None, verdict(apart <= 64 * _ENOUGH * cp.epsilon(apart))


class SphericalMidpoint(MidpointOnSphere):
    """S1 = S0 + h S'(m): order 2, symmetric, symplectic.

    It conserves every constant of the motion that is linear in the spins, such as their sum under exchange (McLachlan,
    Modin and Verdier, Phys. Rev. E 89, 2014, 061301).
    """

    name: str = eqx.field(static=True, default="spherical midpoint")
    symplectic: bool = eqx.field(static=True, default=True)

    def moved(self, spin: cp.Vector, middle: cp.Vector, change: cp.Vector) -> cp.Vector:
        return cp.add(spin, change)


class LieMidpointOnSphere(MidpointOnSphere):
    """S1 = exp(h w) S0 with S' = w x S and w at right angles to m: the paper's midpoint rule, on the sphere.

    A step changes a small area on the sphere by a relative amount of third order in h.
    """

    name: str = eqx.field(static=True, default="Lie midpoint of spins")

    def moved(self, spin: cp.Vector, middle: cp.Vector, change: cp.Vector) -> cp.Vector:
        return turned(spin, cp.cross(middle, change))


def _unit(vector: cp.Vector) -> cp.Vector:
    return cp.scale(cp.inverse_root(cp.dot(vector, vector)), vector)


def _fixed_point(function: Any, guess: Any) -> tuple[Any, Array]:
    """The solution of x = function(x) by iteration, with its derivative, and the last change of x."""

    def residual(x: Any) -> Any:
        return jax.tree.map(jnp.subtract, x, function(x))

    def solve(_: Any, x: Any) -> tuple[Any, Array]:
        return _iterated(function, x)

    def tangent(linear: Any, right: Any) -> Any:
        def inverse(matvec: Any, right: Any) -> Any:
            return _iterated(lambda x: jax.tree.map(lambda r, a, b: r + (a - b), right, x, matvec(x)), right)[0]

        return jax.lax.custom_linear_solve(linear, right, inverse, inverse)

    return jax.lax.custom_root(residual, guess, solve, tangent, has_aux=True)


def _iterated(function: Any, x: Any) -> tuple[Any, Array]:
    """x, function(x), function(function(x)), ... until nothing changes, and the last change over the largest number."""

    def goes_on(carry: Any) -> Array:
        _, change, count = carry
        return (change > _ENOUGH * cp.epsilon(change)) & (count < _MOST)

    def once(carry: Any) -> Any:
        x, _, count = carry
        after = function(x)
        return after, _apart(x, after), count + 1

    dtype = jax.tree.leaves(x)[0].dtype
    x, change, _ = jax.lax.while_loop(goes_on, once, (x, jnp.asarray(jnp.inf, dtype), jnp.asarray(0, jnp.int32)))
    return x, change


def _apart(x: cp.Vector, y: cp.Vector) -> Array:
    scale = jnp.max(cp.largest(y))
    return jnp.max(cp.largest(cp.subtract(x, y))) / jnp.where(scale > 0, scale, jnp.ones_like(scale))
