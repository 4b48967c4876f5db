"""The change of energy and spatial momentum in a run, and whether the exact motion conserves them.

Computed in float64 for a run of any dtype, so that the result shows the rounding of the run, not that of these sums.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...model import torques
from ...model.observables import energy, kinetic_energy, spatial_momentum
from ...model.states import RigidState
from .record import Record


class Change(NamedTuple):
    """The change of a quantity since the start, for each body and time.

    Attributes:
        values: the change relative to a value at the start, (bodies, n).
        name: name of the quantity.
        formula: formula of the values.
        note: which part of the quantity is meant; may be "".
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


def energy_change(record: Record) -> Change:
    """(E(t) - E(0)) / |E(0)|; of the kinetic energy if the torque has no potential."""
    body, torque, states = _doubles(record)
    first = jax.tree.map(lambda leaf: leaf[0, 0], states)
    times = np.asarray(record.times, np.float64)
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
    return Change(_relative(energies - energies[:, :1], np.abs(energies[:, :1])), name, formula, reason=reason)


def momentum_change(record: Record) -> Change:
    """|pi(t) - pi(0)| / |pi(0)|; if the torque conserves only one component, its change over |pi(0)|."""
    _, torque, states = _doubles(record)
    momenta = np.asarray(spatial_momentum(states))
    change = momenta - momenta[:, :1]
    size = np.linalg.norm(momenta[:, :1], axis=-1)
    name, formula = "spatial momentum", "|π - π₀| / |π₀|"
    if isinstance(torque, torques.HeavyTop):
        note = "vertical component, which is conserved"
        return Change(_relative(np.abs(change[..., 2]), size), name, "|πz - πz₀| / |π₀|", note)
    if isinstance(torque, torques.DipoleInField):
        field = np.asarray(torque.field)
        along = np.abs(change @ field) / np.linalg.norm(field)
        note = "component along the field, which is conserved"
        return Change(_relative(along, size), name, "|πf - πf₀| / |π₀|", note)
    whole = _relative(np.linalg.norm(change, axis=-1), size)
    if torque is None:
        return Change(whole, name, formula, "all of it")
    return Change(whole, name, formula, reason="not conserved: the torque changes it")


def _relative(change: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return change / np.where(scale > 0, scale, 1)


def _doubles(record: Record) -> tuple[Any, Any, RigidState]:
    """Body, torque and states in float64. The states are not checked, because those of a failed run may contain NaN."""

    def double(leaf: Any) -> Any:
        floating = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, jnp.float64) if floating else leaf

    states = jax.tree.unflatten(jax.tree.structure(record.scene.start), (record.momenta, record.attitudes))
    body, torque, states = jax.tree.map(double, (record.scene.body, record.scene.torque, states))
    return body, torque, states
