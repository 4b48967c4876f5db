"""How far a run's energy and spatial momentum moved from what they were, and whether they should have stayed.

Computed in float64 whatever the run's dtype, so that what is seen is the rounding of the run and not that of the sums.
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
    """A quantity less its value at the start, for each body and time.

    Attributes:
        values: relative to a scale of the start, (bodies, n).
        name: of the quantity.
        formula: of the values.
        note: which part of it, for the reader; may be "".
        reason: why the true motion does not keep it; "" if it does.
    """

    values: np.ndarray
    name: str
    formula: str
    note: str = ""
    reason: str = ""

    @property
    def in_words(self) -> str:
        """The largest change, or why there is no sense in it."""
        if self.reason:
            return self.reason
        return f"{float(np.max(np.abs(self.values))):.2e}" + (f"  ({self.note})" if self.note else "")


def energy_change(record: Record) -> Change:
    """(E(t) - E(0)) / |E(0)|; of the kinetic energy alone where there is no potential."""
    body, torque, states = _doubles(record)
    first = jax.tree.map(lambda leaf: leaf[0, 0], states)
    times = np.asarray(record.times, np.float64)
    kinetic, reason = False, ""
    try:
        still = [float(energy(body, torque, first, t)) for t in np.unique(times[:: max(1, len(times) // 8)])]
        if min(still) != max(still):
            reason = "not conserved: the potential depends on time"
    except ValueError as error:
        kinetic, reason = True, f"not defined: {str(error).split(';')[0]}"

    def at(states: Any, times: Any) -> Any:
        return kinetic_energy(body, states) if kinetic else energy(body, torque, states, times)

    energies = np.asarray(jax.jit(at)(states, jnp.asarray(times)))
    name, formula = ("kinetic energy", "(K - K₀) / K₀") if kinetic else ("energy", "(E - E₀) / |E₀|")
    return Change(_relative(energies - energies[:, :1], np.abs(energies[:, :1])), name, formula, reason=reason)


def momentum_change(record: Record) -> Change:
    """|pi(t) - pi(0)| / |pi(0)|, or that of the one component that the torque leaves alone."""
    _, torque, states = _doubles(record)
    momenta = np.asarray(spatial_momentum(states))
    change = momenta - momenta[:, :1]
    size = np.linalg.norm(momenta[:, :1], axis=-1)
    name, formula = "spatial momentum", "|π - π₀| / |π₀|"
    if isinstance(torque, torques.HeavyTop):
        note = "vertical component, the one conserved"
        return Change(_relative(np.abs(change[..., 2]), size), name, "|πz - πz₀| / |π₀|", note)
    if isinstance(torque, torques.DipoleInField):
        field = np.asarray(torque.field)
        along = np.abs(change @ field) / np.linalg.norm(field)
        note = "component along the field, the one conserved"
        return Change(_relative(along, size), name, "|πf - πf₀| / |π₀|", note)
    whole = _relative(np.linalg.norm(change, axis=-1), size)
    if torque is None:
        return Change(whole, name, formula, "all of it")
    return Change(whole, name, formula, reason="not conserved: the torque changes it")


def _relative(change: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return change / np.where(scale > 0, scale, 1)


def _doubles(record: Record) -> tuple[Any, Any, RigidState]:
    """Body, torque and states. The states are put together unchecked: those of a run that failed may hold NaN."""

    def double(leaf: Any) -> Any:
        floating = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, jnp.float64) if floating else leaf

    states = jax.tree.unflatten(jax.tree.structure(record.scene.start), (record.momenta, record.attitudes))
    body, torque, states = jax.tree.map(double, (record.scene.body, record.scene.torque, states))
    return body, torque, states
