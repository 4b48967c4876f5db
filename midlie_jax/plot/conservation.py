"""The change of energy and spatial momentum along motions, and whether the exact motion conserves them.

Changes are computed in float64, if it is enabled, for runs of any dtype, so that the result shows the rounding of the
run and not that of its evaluation.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from ..model import torques
from ..model.bodies import RigidBody, TensorBody
from ..model.observables import energy, kinetic_energy, spatial_momentum
from ..model.state import BodyState
from ..model.states import with_attitude
from ..model.torques import TorqueLike


class Change(NamedTuple):
    """The change of a quantity since the start.

    Attributes:
        values: the change relative to a value at the start, (..., n).
        name: name of the quantity.
        formula: formula of the values.
        note: to which part of the quantity the values refer; may be "".
        reason: why the exact motion does not conserve the quantity; "" if it does.
    """

    values: np.ndarray
    name: str
    formula: str
    note: str = ""
    reason: str = ""

    @property
    def in_words(self) -> str:
        """The largest change, or the reason why the quantity is not conserved."""
        if self.reason:
            return self.reason
        return f"{float(np.max(np.abs(self.values))):.2e}" + (f"  ({self.note})" if self.note else "")


def energy_change(
    body: RigidBody | TensorBody, torque: TorqueLike | None, times: ArrayLike, states: BodyState[Any]
) -> Change:
    """(E(t) - E(0)) / |E(0)|; E is the kinetic energy alone if the torque has no potential.

    Args:
        body: one body.
        torque: as for `integrate`.
        times: (n,).
        states: at these times, with leading axes (..., n); they may contain NaN.
    """
    body, torque, states = _doubles((body, torque, states))
    times = np.asarray(times, jnp.result_type(float))
    first = jax.tree.map(lambda leaf: leaf[(0,) * (leaf.ndim - 1)], states)
    kinetic, reason = False, ""
    try:
        same_state = [float(energy(body, torque, first, t)) for t in np.unique(times[:: max(1, len(times) // 8)])]
        if min(same_state) != max(same_state):
            reason = "not conserved: the potential depends on time"
    except ValueError as error:
        kinetic, reason = True, f"not defined: {str(error).split(';')[0]}"

    def at(states: Any, times: Any) -> Any:
        return kinetic_energy(body, states) if kinetic else energy(body, torque, states, times)

    energies = np.asarray(jax.jit(at)(states, jnp.asarray(times)))
    name, formula = ("kinetic energy", "(K - K₀) / K₀") if kinetic else ("energy", "(E - E₀) / |E₀|")
    start = energies[..., :1]
    return Change(_relative(energies - start, np.abs(start)), name, formula, reason=reason)


def momentum_change(torque: TorqueLike | None, states: BodyState[Any]) -> Change:
    """|pi(t) - pi(0)| / |pi(0)|; if the torque conserves only one component, the change of this component over |pi(0)|.

    Args:
        torque: as for `integrate`.
        states: with leading axes (..., n); they may contain NaN. Without an attitude only the length of the momentum
            is known, or its component along the direction of a `DirectionState`.
    """
    torque, states = _doubles((torque, states))
    size = np.linalg.norm(np.asarray(states.momentum)[..., :1, :], axis=-1)
    name, changed = "spatial momentum", "not conserved: the torque changes it"
    direction, letter, which = _conserved_direction(torque)
    if direction is not None and states.has_pose:
        along = _along(states, direction / (np.linalg.norm(direction) or 1.0))
        values = _relative(np.abs(along - along[..., :1]), size)
        return Change(values, name, f"|π{letter} - π{letter}₀| / |π₀|", f"{which}, which is conserved")
    if not hasattr(states, "attitude"):
        lengths = np.linalg.norm(np.asarray(states.momentum), axis=-1)
        name, formula = "length of the momentum", "(|Π| - |Π₀|) / |Π₀|"
        return Change(_relative(lengths - size, size), name, formula, reason="" if torque is None else changed)
    momenta = np.asarray(spatial_momentum(with_attitude(states)))
    whole = _relative(np.linalg.norm(momenta - momenta[..., :1, :], axis=-1), size)
    formula = "|π - π₀| / |π₀|"
    if torque is None:
        return Change(whole, name, formula, "all of it")
    return Change(whole, name, formula, reason=changed)


def _conserved_direction(torque: Any) -> tuple[np.ndarray | None, str, str]:
    """The direction in space along which a torque keeps the momentum, its letter, and the name of this component."""
    if isinstance(torque, torques.HeavyTop):
        return np.array([0.0, 0.0, 1.0]), "z", "vertical component"
    if isinstance(torque, torques.DipoleInField) and not callable(torque.field):
        return np.asarray(torque.field), "f", "component along the field"
    return None, "", ""


def _along(states: Any, direction: np.ndarray) -> np.ndarray:
    """The component of the spatial momentum along a unit vector of space."""
    if hasattr(states, "attitude"):
        return np.asarray(spatial_momentum(with_attitude(states))) @ direction
    along: Any = states.seen_from_body(tuple(map(jnp.asarray, direction)))
    return np.sum(np.asarray(states.momentum) * np.stack(along, axis=-1), axis=-1)


def _relative(change: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return change / np.where(scale > 0, scale, 1)


def _doubles(tree: Any) -> Any:
    """The tree in float64, if that is enabled. States are not checked: those of a failed run may contain NaN."""

    def double(leaf: Any) -> Any:
        floating = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, jnp.result_type(float)) if floating else leaf

    return jax.tree.map(double, tree)
