"""Bodies: the inertia of what moves. States (`states.py`) say where it is and how it goes.

Every kind of body turns momentum into velocity and back (`velocity`, `momentum`): what a torque needs of it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._kernel import components as cp
from .._kernel.checks import as_floats, require, require_finite
from . import so3

# A flat body has I1 + I2 = I3 exactly; moments from a file miss it by rounding.
_TRIANGLE_SLACK = 1e-6
_SYMMETRIC_SLACK = 1e-5  # of a tensor, relative to its largest entry
# Moments lie between these powers of the smallest number of their dtype, so that their products do not leave it.
_RANGE = 0.8


def _positive(numbers: np.ndarray) -> Any:
    return np.isfinite(numbers) & (numbers > 0)


def _within_range(moments: np.ndarray) -> Any:
    least = float(np.finfo(moments.dtype).tiny) ** _RANGE
    return (moments >= least) & (moments <= 1 / least)


def _triangle(moments: np.ndarray) -> Any:
    return 2 * moments.max(-1) <= moments.sum(-1) * (1 + _TRIANGLE_SLACK)


def _symmetric(matrix: np.ndarray) -> bool:
    slack = _SYMMETRIC_SLACK * np.abs(matrix).max()
    return bool(np.allclose(matrix, np.swapaxes(matrix, -1, -2), rtol=0, atol=slack))


class RigidBody(eqx.Module):
    """A rigid body turning about a fixed point or its centre of mass.

    Attributes:
        moments: principal moments of inertia about that point, (..., 3), mass x length^2. The body frame
            is the principal frame, in the order of the moments.

    Args:
        moments: as above; any leading axes are a batch, for `midlie_jax.ensemble` or `jax.vmap`.
        physical: False admits moments that break the triangle inequality I1 <= I2 + I3, which no mass
            distribution has but which are fine as mathematics.

    Raises:
        ValueError: moments not of shape (..., 3), not positive, unphysical, or beyond 1e30 (float64: 1e246) or its
            inverse; a full tensor, for which there are `TensorBody` and `from_tensor`.
    """

    moments: Float[Array, "*batch 3"]

    def __init__(self, moments: Any, *, physical: bool = True):
        self.moments = as_floats("moments", moments, (3,))
        # Three rows of moments have the shape of a tensor; a physical tensor breaks one of the rules for moments.
        tensor = self.moments.shape[-2:] == (3, 3)
        cure = "for a full inertia tensor take midlie_jax.TensorBody or RigidBody.from_tensor." if tensor else ""
        require("moments", self.moments, _positive, "must be positive and finite", cure or "check units and order.")
        require("moments", self.moments, _within_range, "are out of range", "take other units of mass or length.")
        if physical:
            require(
                "moments",
                self.moments,
                _triangle,
                "are unphysical: the largest must not exceed the sum of the other two",
                cure or "check the tensor, or pass physical=False for a body that exists on paper alone.",
            )

    @classmethod
    def from_tensor(cls, tensor: Any, *, physical: bool = True) -> tuple["RigidBody", Float[Array, "*batch 3 3"]]:
        """The body of a full inertia tensor, and its principal axes; `TensorBody` keeps account of them by itself.

        Args:
            tensor: (..., 3, 3) symmetric positive definite inertia tensor in some frame G fixed in the body.
            physical: as for the class.

        Returns:
            The body, moments ascending, and rotation matrices `axes` (..., 3, 3) whose columns are the principal axes
            in G: tensor = axes @ diag(moments) @ axes.T. A vector v in G is axes.T @ v in the body frame, and an
            attitude R of G becomes R @ axes. Derivatives are those of eigenvectors: NaN where moments are equal.

        Raises:
            ValueError: not (..., 3, 3), not symmetric, or moments as for the class.
        """
        tensor = as_floats("tensor", tensor, (3, 3))
        require_finite("tensor", tensor)
        require("tensor", tensor, _symmetric, "must be symmetric", "pass (J + J.T) / 2 if the rest is rounding.")
        moments, axes = jnp.linalg.eigh(tensor)
        hand = jnp.where(jnp.linalg.det(axes) < 0, -1, 1).astype(axes.dtype)
        return cls(moments, physical=physical), axes * hand[..., None, None]

    def velocity(self, momentum: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular velocity I^-1 Pi, body frame."""
        return cp.pack(tuple(p / i for p, i in zip(cp.vector(momentum), cp.vector(self.moments), strict=True)))

    def momentum(self, velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular momentum I Omega, body frame."""
        return cp.pack(cp.times(cp.vector(self.moments), cp.vector(velocity)))

    @property
    def trace(self) -> Float[Array, "*batch"]:
        """I1 + I2 + I3."""
        return jnp.sum(self.moments, axis=-1)


class TensorBody(eqx.Module):
    """A rigid body given by its full inertia tensor, in a frame of your own fixed in the body.

    Momentum, attitude, torque and angular velocity are all in this frame, whatever the principal axes are:
    `midlie_jax.integrate` and its kin change to the principal frame and back. A run that is continued from a kept
    state changes frames twice more than one that was never stopped, and differs from it by rounding. Where two moments
    are equal the principal axes have no derivative in the tensor, and gradients in it are NaN; a `RigidBody` has them.

    Attributes:
        principal: the same body in its principal frame, a `RigidBody`.
        axes: unit quaternion, components in the principal frame to those in your frame, (..., 4).

    Args:
        tensor: (..., 3, 3) symmetric positive definite inertia tensor, mass x length^2.
        physical: as for `RigidBody`.

    Raises:
        ValueError: not (..., 3, 3), not symmetric, or its moments as for `RigidBody`.
    """

    principal: RigidBody
    axes: Float[Array, "*batch 4"]

    def __init__(self, tensor: Any, *, physical: bool = True):
        self.principal, axes = RigidBody.from_tensor(tensor, physical=physical)
        self.axes = so3.from_matrix(axes)

    @property
    def tensor(self) -> Float[Array, "*batch 3 3"]:
        """The inertia tensor in your frame."""
        axes = so3.to_matrix(self.axes)
        return (axes * self.principal.moments[..., None, :]) @ jnp.swapaxes(axes, -1, -2)

    def velocity(self, momentum: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular velocity I^-1 Pi."""
        return so3.rotate(self.axes, self.principal.velocity(self.to_principal(momentum)))

    def momentum(self, velocity: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """The angular momentum I Omega."""
        return so3.rotate(self.axes, self.principal.momentum(self.to_principal(velocity)))

    @property
    def trace(self) -> Float[Array, "*batch"]:
        """The trace of the tensor."""
        return self.principal.trace

    def to_principal(self, vector: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
        """A vector of your frame in principal components."""
        return so3.rotate(so3.conjugate(self.axes), vector)


class Particles(eqx.Module):
    """Point masses, or any mechanical system with a constant mass matrix: u' = M^-1 p, p' = f(t, u).

    Attributes:
        mass: a scalar, one per coordinate (n,), or the lower Cholesky factor (n, n) of a full matrix.

    Args:
        mass: positive scalar, positive (n,), or symmetric positive definite (n, n), which is factorised
            here, once.

    Raises:
        ValueError: more than two axes, not positive, or not symmetric positive definite.
    """

    mass: Float[Array, ""] | Float[Array, " n"] | Float[Array, "n n"]

    def __init__(self, mass: Any):
        mass = as_floats("mass", mass)
        if mass.ndim > 2 or (mass.ndim == 2 and mass.shape[0] != mass.shape[1]):
            raise ValueError(
                f"mass must be a scalar, (n,) or (n, n), got {mass.shape}; map over a batch with jax.vmap."
            )
        if mass.ndim < 2:
            require(
                "mass", mass, _positive, "must be positive and finite", "a coordinate without mass cannot be kicked."
            )
            self.mass = mass
            return
        require_finite("mass", mass)
        require("mass", mass, lambda m: np.allclose(m, m.T, rtol=1e-6), "must be symmetric", "pass (M + M.T) / 2.")
        factor = jnp.linalg.cholesky(mass)
        if not cp.is_traced(factor) and not np.all(np.isfinite(factor)):
            raise ValueError("mass must be positive definite: its Cholesky factorisation failed.")
        self.mass = factor

    def velocity(self, momentum: Array) -> Array:
        """M^-1 p."""
        if self.mass.ndim == 2:
            return jax.scipy.linalg.cho_solve((self.mass, True), momentum)
        return momentum / self.mass

    def momentum(self, velocity: Array) -> Array:
        """M u'."""
        if self.mass.ndim == 2:
            return self.mass @ (self.mass.T @ velocity)
        return self.mass * velocity


Body = RigidBody | TensorBody | Particles


def principal_of(body: Any) -> Any:
    """A body in its principal frame; particles, and what is no body, as they are."""
    return body.principal if isinstance(body, TensorBody) else body
