"""The change of energy and momenta along motions, and whether the exact motion conserves them.

Changes are computed in float64, if it is enabled, for runs of any dtype, so that the result shows the rounding of the
run and not that of its evaluation.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from ..model.bodies import Body
from ..model.observables import energy
from ..model.state import AnyState, State
from ..model.states import TravellingState
from ..model.torques import TorqueLike
from .balance import add_up_to_zero, forces_on
from .kept import ALL, Kept, kept_by


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


def energy_change(body: Body, torque: TorqueLike | None, times: ArrayLike, states: AnyState) -> Change:
    """(E(t) - E(0)) / |E(0)|; E is the kinetic energy alone if the torque has no potential.

    Args:
        body: one body.
        torque: as for `integrate`.
        times: (n,).
        states: at these times, with leading axes (..., n); they may contain NaN.
    """
    body, torque, states = _doubles((body, torque, states))
    times = np.asarray(times, jnp.result_type(float))
    first = jax.tree.map(lambda leaf: leaf[(0,) * (leaf.ndim - states.own_axes)], states)
    kinetic, reason = False, ""
    try:
        same_state = [float(energy(body, torque, first, t)) for t in np.unique(times[:: max(1, len(times) // 8)])]
        if min(same_state) != max(same_state):
            reason = "not conserved: the potential depends on time"
    except ValueError as error:
        kinetic, reason = True, f"not defined: {str(error).split(';')[0]}"

    def at(states: Any, times: Any) -> Any:
        return energy(body, None if kinetic else torque, states, times)

    energies = np.asarray(jax.jit(at)(states, jnp.asarray(times)))
    name, formula = ("kinetic energy", "(K - K₀) / K₀") if kinetic else ("energy", "(E - E₀) / |E₀|")
    start = energies[..., :1]
    return Change(_relative(energies - start, np.abs(start)), name, formula, reason=reason)


def momentum_change(torque: TorqueLike | None, states: AnyState, *, balanced: bool = False) -> Change:
    """|pi(t) - pi(0)| / |pi(0)|; if the torque conserves only one component, the change of this component over |pi(0)|.

    For a body that travels, pi is the total angular momentum about the origin, and the change is relative to the
    largest |x cross p| + |R Pi| of the path, because pi may vanish. Of coupled bodies it is the sum over all.

    Args:
        torque: as for `integrate`.
        states: with leading axes (..., n); they may contain NaN. Without an attitude or an axis only the length of the
            momentum is known, or its component along the direction of a `DirectionState`.
        balanced: whether all of it is known to be conserved, as by `balance.balanced`.
    """
    torque, states = _doubles((torque, states))
    size, letter = _sizes(states, states.momentum)[..., :1], "|π₀|"
    name, changed = "spatial momentum", "not conserved: the torque changes it"
    if isinstance(states, TravellingState):
        name, letter, changed = "total angular momentum", "max |π|", "not conserved: torque or force changes it"
        orbital = np.cross(states.position, states.linear)
        size = np.nanmax(_sizes(states, orbital) + _sizes(states, states.momentum), axis=-1, keepdims=True)
    kept = ALL if balanced else kept_by(torque)
    if isinstance(kept, Kept) and states.has_pose:
        along = _along(states, kept.direction / (np.linalg.norm(kept.direction) or 1.0))
        values = _relative(np.abs(along - along[..., :1]), size)
        formula = f"|π{kept.letter} - π{kept.letter}₀| / {letter}"
        return Change(values, name, formula, f"{kept.which}, which is conserved")
    if not _is_in_space(states):
        lengths = np.linalg.norm(np.asarray(states.momentum), axis=-1)
        name, formula = "length of the momentum", "(|Π| - |Π₀|) / |Π₀|"
        return Change(_relative(lengths - size, size), name, formula, reason="" if torque is None else changed)
    momenta = _in_space(states)
    whole = _relative(np.linalg.norm(momenta - momenta[..., :1, :], axis=-1), size)
    formula = f"|π - π₀| / {letter}"
    if kept == ALL:
        return Change(whole, name, formula, "all of it")
    return Change(whole, name, formula, reason=changed)


def linear_change(body: Body, torque: TorqueLike | None, times: ArrayLike, states: TravellingState) -> Change:
    """|p(t) - p(0)| / max |p| of a body that travels, conserved where no force acts; of coupled bodies that of the sum.

    Args:
        body: one body.
        torque: as for `integrate`.
        times: (n,).
        states: at these times, with leading axes (..., n); of a batch, the forces on the first are looked at.
    """
    body, torque, states = _doubles((body, torque, states))
    momenta, size = np.asarray(states.linear), np.nanmax(_sizes(states, states.linear), axis=-1, keepdims=True)
    momenta = np.sum(momenta, axis=-2) if states.several else momenta
    values = _relative(np.linalg.norm(momenta - momenta[..., :1, :], axis=-1), size)
    reason = ""
    if torque is not None:
        first = jax.tree.map(lambda leaf: leaf[(0,) * (leaf.ndim - states.own_axes - 1)], states)
        forces = np.asarray(forces_on(body, torque, np.asarray(times), first).linear)
        acts = not add_up_to_zero(forces) if states.several else np.any(forces != 0)
        reason = "not conserved: a force acts" if acts else ""
    return Change(values, "linear momentum", "|p - p₀| / max |p|", "" if reason else "all of it", reason)


def _sizes(states: Any, vectors: Any) -> np.ndarray:
    """The lengths of vectors (..., 3); of coupled bodies their sum."""
    lengths = np.linalg.norm(np.asarray(vectors), axis=-1)
    return np.sum(lengths, axis=-1) if states.several else lengths


def _is_in_space(states: Any) -> bool:
    """Whether the states know their angular momentum in space."""
    return hasattr(states, "attitude") or type(states).spatial_momentum is not State.spatial_momentum


def _in_space(states: Any) -> np.ndarray:
    """The angular momentum in space; compiled, because the states of a failed run are not to be checked."""
    return np.asarray(jax.jit(lambda s: s.spatial_momentum())(states))


def _along(states: Any, direction: np.ndarray) -> np.ndarray:
    """The component of the spatial momentum along a unit vector of space."""
    if _is_in_space(states):
        return _in_space(states) @ direction
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
