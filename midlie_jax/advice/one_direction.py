"""Test whether a torque reads only one space direction, so that a `DirectionState` suffices."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from ..model import so3
from ..model.states import DirectionState, RigidState
from ..model.torques import on_body
from .ladder import Case

_ATTITUDES = 6  # random attitudes at which both states must give the same torque
_TOLERANCE = 1e3  # in units of eps: a torque whose terms cancel has large rounding errors
# Errors of a torque that needs an attitude, or another part that a `DirectionState` lacks.
_REFUSALS = (AttributeError, TypeError, ValueError, NotImplementedError)


def one_direction(case: Case) -> DirectionState | None:
    """The start as a `DirectionState` with the same motion of the momentum; None if unknown, or if it has no attitude.

    The torque is called on a `DirectionState` that records the space directions it reads. Let them all be the same, d.
    If at random attitudes R and several times the torque is the same with R^T d as with R, it reads d alone. A torque
    that reads no direction, or the attitude, gives None.
    """
    body, torque, start, t0, span, _ = case
    if torque is None or type(start) is not RigidState:
        return None
    function = on_body(torque, body)
    try:
        d = _direction_read(function, start, t0)
        if d is None or not _is_enough(function, start, d, t0, span):
            return None
    except _REFUSALS:
        return None
    return _seen(start, start.attitude, d)


def _seen(start: Any, attitude: Array, d: np.ndarray) -> DirectionState:
    """The momentum of the start, and d in the body frame of this attitude."""
    return DirectionState(start.momentum, so3.rotate(so3.conjugate(attitude), jnp.asarray(d, attitude.dtype)))


def _direction_read(function: Any, start: Any, t0: Array) -> np.ndarray | None:
    """The space direction that the torque reads, a unit vector (3,); None for none or several."""
    asked = list[Any]()

    class Asked(DirectionState):
        """A state that records the directions that a torque reads."""

        def seen_from_body(self, vector: cp.Vector) -> cp.Vector:
            asked.append(vector)
            return super().seen_from_body(vector)

        def vertical(self) -> cp.Vector:
            asked.append((0.0, 0.0, 1.0))
            return super().vertical()

    function(t0, Asked(start.momentum, so3.to_matrix(start.attitude)[2]))
    if not asked or cp.is_traced(asked):
        return None
    vectors = np.array([[float(x) for x in vector] for vector in asked])
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    vectors = vectors[lengths[:, 0] > 0] / lengths[lengths[:, 0] > 0]
    same = len(vectors) > 0 and np.all(
        np.abs(vectors - vectors[:1]) <= _TOLERANCE * jnp.finfo(start.momentum.dtype).eps
    )
    return vectors[0] if same else None


def _is_enough(function: Any, start: Any, d: np.ndarray, t0: Array, span: float) -> bool:
    dtype = start.momentum.dtype
    turns = np.random.default_rng(0).normal(size=(_ATTITUDES, 4))
    attitudes = [start.attitude, *(jnp.asarray(q / np.linalg.norm(q), dtype) for q in turns)]
    for n, attitude in enumerate(attitudes):
        t = t0 + jnp.asarray(span * n / _ATTITUDES, dtype)
        whole = np.asarray(function(t, RigidState(start.momentum, attitude)))
        found = np.asarray(function(t, _seen(start, attitude, d)))
        if not np.max(np.abs(found - whole)) <= _TOLERANCE * jnp.finfo(dtype).eps * np.max(np.abs(whole)):
            return False
    return True
