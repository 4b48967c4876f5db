"""How far one step is from symplectic on T*SO(3), and from preserving area on the momentum sphere, by differences.

The derivative of the step comes from steps that start at neighbouring states, so that any compiled method can be
measured as it is. A stencil of eight points has an error below rounding; what is left is about 1e-13.

Directions at a state are pairs (turn, change of Pi), with the turn in the body frame. The canonical form of T*SO(3) is
then, up to its sign, w((a, x), (b, y)) = a . y - b . x + Pi . (a x b). A map is symplectic if M^T W1 M = W0, where M is
its derivative and W0, W1 are the form at both ends (Hairer, Lubich, Wanner, Geometric Numerical Integration, VII.5).
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from midlie_jax.model import so3
from midlie_jax.model.states import RigidState

_DELTA = 1 / 32
_PLACES = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280]) / _DELTA


def canonical(momentum: Any) -> np.ndarray:
    """The matrix (6, 6) of the canonical form at a body-frame momentum (3,)."""
    zero, one = np.zeros((3, 3)), np.eye(3)
    x, y, z = np.asarray(momentum)
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[-hat, one], [-one, zero]])


def neighbours(momentum: Any, attitude: Any) -> RigidState:
    """The states (49,) whose steps give the derivative at a state: the state, then a stencil for each direction."""
    changes = [np.zeros(6), *(_DELTA * place * axis for axis in np.eye(6) for place in _PLACES)]
    turns, pushes = np.split(np.array(changes), 2, axis=1)
    start = jnp.broadcast_to(jnp.asarray(attitude, float), (len(turns), 4))
    return RigidState(jnp.asarray(momentum + pushes), so3.multiply(start, so3.exp(jnp.asarray(turns))))


def derivative(ends: RigidState) -> np.ndarray:
    """The derivative M (6, 6) of a step, from where it takes the states of `neighbours`."""
    momentum = np.asarray(ends.momentum)
    seen = np.asarray(so3.log(so3.multiply(so3.conjugate(ends.attitude[:1]), ends.attitude)))
    change = np.concatenate([seen, momentum], axis=1)[1:].reshape(6, len(_PLACES), 6)
    return np.einsum("p,jpi->ij", _WEIGHTS, change)


def symplectic_defect(matrix: np.ndarray, before: Any, after: Any) -> float:
    """The largest entry of |M^T W1 M - W0|, for the momenta before and after the step."""
    return float(np.abs(matrix.T @ canonical(after) @ matrix - canonical(before)).max())


def area_defect(matrix: np.ndarray, before: Any, after: Any) -> float:
    """|area of the image / area - 1| on the momentum sphere, for a step of a free body."""
    block = matrix[3:, 3:]
    cofactors = np.stack([np.cross(block[1], block[2]), np.cross(block[2], block[0]), np.cross(block[0], block[1])])
    start, end = (np.asarray(p) / np.linalg.norm(p) for p in (before, after))
    return abs(float(end @ cofactors @ start) - 1)
