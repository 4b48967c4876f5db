"""What the exact motion conserves, the errors of a run in it (`changes_of`), and `conserved`, which draws them.

Errors are computed in float64, if it is enabled, so that they show the rounding errors of the run and not of its
evaluation.
"""

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from .._math import components as cp
from ..drivers.path import Path
from ..model import torques
from ..model.bodies import Body
from ..model.compatibility import check_body, check_torque
from ..model.leaf import Leaf
from ..model.observables import energy
from ..model.state import AnyState
from ..model.states import TravellingState
from ..model.torques import TorqueLike, on_body
from .motion import motion_of
from .style import BLUE, GREEN, VERMILLION, name_in_legend, remark

# Colours and dashes of energy, angular and linear momentum.
_LINES = (BLUE, "-"), (VERMILLION, (0, (4, 1.5))), (GREEN, (0, (1.5, 1.5)))


class Conserved(NamedTuple):
    """The errors drawn by `conserved`.

    Attributes:
        times: (n,), the saved times before the run failed.
        energy: the relative error of the energy, with its sign, (n,); None if it is not conserved.
        momentum: the relative error of the conserved part of the spatial momentum, (n,); None if there is none.
        linear: the relative error of the linear momentum, (n,); None if it is not conserved, or the body does not
            translate.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> found = ml.plot.conserved(Figure().add_subplot(), body, torque, path)
        >>> bool(abs(found.energy).max() < 1e-6), bool(abs(found.momentum).max() < 1e-12)
        (True, True)
    """

    times: np.ndarray
    energy: np.ndarray | None
    momentum: np.ndarray | None
    linear: np.ndarray | None = None


def conserved(
    axes: Any,
    body: Body,
    torque: TorqueLike | None,
    path: Path[AnyState],
    *,
    colour: str | None = None,
    label: str | None = None,
) -> Conserved:
    """Draws the relative errors of a run in the quantities that the exact motion conserves.

    Bold lines show the largest relative error so far, faint lines the error at each saved time. Conserved are:

    - the energy, if the torque has a potential that does not depend on time;
    - all of the spatial momentum without a torque and under a `PointMass`, its vertical component under a `HeavyTop`,
      and its component along the field under a `DipoleInField` whose field is constant, along the acceleration under a
      `UniformGravity`, and along the pole under an `Oblateness`; under a sum of torques, what each of them conserves;
    - without a torque, for a state that has no attitude, the length of the momentum;
    - for a body that translates, the linear momentum if no force acts at the saved times. Its spatial momentum is the
      total angular momentum about the origin, x cross p + R Pi;
    - for coupled bodies, the sums of their momenta, if at the saved times their forces, or their torques about the
      origin, add up to zero up to rounding.

    Other quantities are named on the picture and not drawn. Errors are computed in float64 if it is enabled, and drawn
    at half a unit in the last place of the run's dtype at least. To compare methods, call the function again on the
    same axes, with another colour for each.

    Args:
        axes: matplotlib's axes, which get a legend.
        body, torque: as for `integrate`.
        path: a `Path` of one body, with any state, or of coupled bodies.
        colour: the colour of all lines (momenta are dashed); by default blue, vermilion and green.
        label: prefix of the names "energy" and "momentum", for example the name of the method.

    Raises:
        ValueError: the arguments do not fit each other; the first two states are bad; nothing is conserved.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> found = ml.plot.conserved(Figure().add_subplot(), body, torque, path, label="JACOBI[EA]")
        >>> found.energy.shape
        (101,)
    """
    motion = motion_of(path, together=True)
    check_body(body, motion.states)
    check_torque(torque)
    changes = changes_of(body, torque, motion.times, motion.states)
    if all(change.reason for change in changes):
        raise ValueError(f"nothing is conserved: {'; '.join(f'{c.name}: {c.reason}' for c in changes)}.")
    least = float(jnp.finfo(motion.states.momentum.dtype).eps) / 2
    axes.set_yscale("log")
    axes.set(xlabel=axes.get_xlabel() or "time  [time]", ylabel=axes.get_ylabel() or "relative error  [-]")
    found: list[np.ndarray | None] = []
    for change, (own, dash) in zip(changes, _LINES, strict=False):
        name = f"{label}: {change.short or change.name}" if label else change.short or change.name
        if change.reason:
            remark(axes, f"{name} {change.reason}")
            found.append(None)
            continue
        chosen, sizes = colour or own, np.maximum(np.abs(change.values), least)
        largest = np.maximum.accumulate(sizes)
        axes.plot(motion.times, sizes, color=chosen, linewidth=0.7, alpha=0.45)
        axes.plot(motion.times, largest, color=chosen, linewidth=2.0, linestyle=dash, label=name)
        found.append(change.values)
    axes.margins(x=0)
    name_in_legend(axes)
    remark(axes, motion.failed)
    return Conserved(motion.times, *found)


class Change(NamedTuple):
    """The change of a quantity since the initial state."""

    values: np.ndarray  # relative to an initial value, (..., n)
    name: str
    formula: str
    note: str = ""  # the part of the quantity to which the values refer; may be ""
    reason: str = ""  # why the exact motion does not conserve the quantity; "" if it does
    short: str = ""  # a name short enough to fit next to a panel, if `name` is not

    @property
    def in_words(self) -> str:
        """The largest change, or the reason why the quantity is not conserved."""
        if self.reason:
            return self.reason
        return f"{float(np.max(np.abs(self.values))):.2e}" + (f"  ({self.note})" if self.note else "")


def changes_of(body: Body, torque: TorqueLike | None, times: ArrayLike, states: AnyState) -> list[Change]:
    """The changes of the energy, of the angular momentum and, of a body that translates, of the linear momentum.

    The states have leading axes (..., n), and may contain NaN; the times are (n,). The forces on the first body, or on
    the first copy of coupled bodies, decide whether the momenta are conserved.
    """
    body, torque, states = _doubles((body, torque, states))
    times = np.asarray(times, jnp.result_type(float))
    first = jax.tree.map(lambda leaf: leaf[(0,) * (len(states.batch) - 1)], states)
    whole = balanced(body, torque, times, first)
    changes = [_energy_change(body, torque, times, states), _momentum_change(torque, states, whole)]
    if isinstance(states, TravellingState):
        changes.append(_linear_change(body, torque, times, states, first))
    return changes


def _energy_change(body: Any, torque: Any, times: np.ndarray, states: Any) -> Change:
    """(E(t) - E(0)) / |E(0)|; E is the kinetic energy alone if the torque has no potential."""
    first = jax.tree.map(lambda leaf: leaf[(0,) * len(states.batch)], states)
    kinetic, reason = False, ""
    try:
        same_state = [float(energy(body, torque, first, t)) for t in np.unique(times[:: max(1, len(times) // 8)])]
        if min(same_state) != max(same_state):
            reason = "not conserved: the potential depends on time"
    except ValueError as error:
        kinetic, reason = True, f"not defined: {str(error).split(';')[0]}"
    energy_at = jax.jit(lambda states, times: energy(body, None if kinetic else torque, states, times))
    energies = np.asarray(energy_at(states, jnp.asarray(times)))
    name, formula = ("kinetic energy", "(K - K₀) / K₀") if kinetic else ("energy", "(E - E₀) / |E₀|")
    start = energies[..., :1]
    return Change(_relative(energies - start, np.abs(start)), name, formula, reason=reason)


def _momentum_change(torque: Any, states: Any, whole: bool) -> Change:
    """|pi(t) - pi(0)| / |pi(0)|; if the torque conserves only one component, the change of this component over |pi(0)|.

    For a body that translates, pi is the total angular momentum about the origin, and the change is relative to the
    largest |x cross p| + |R Pi| of the path, because pi may vanish. For coupled bodies it is the sum over all. States
    without an attitude or an axis hold only the length of pi, or its component along the direction of a
    `DirectionState`. `whole`: all of pi is conserved, whatever the torque.
    """
    size, letter = _sizes(states, states.momentum)[..., :1], "|π₀|"
    name, changed = "spatial momentum", "not conserved: the torque changes it"
    if isinstance(states, TravellingState):
        name, letter, changed = "total angular momentum", "max |π|", "not conserved: torque or force changes it"
        orbital = np.cross(states.position, states.linear)
        size = np.nanmax(_sizes(states, orbital) + _sizes(states, states.momentum), axis=-1, keepdims=True)
    kept, in_space = ALL if whole else kept_by(torque), states.leaves[0].spatial_momentum is not Leaf.spatial_momentum
    # Compiled, because the states of a failed run are not to be checked.
    momenta = np.asarray(jax.jit(lambda s: s.spatial_momentum())(states)) if in_space else None
    if isinstance(kept, Kept) and states.kind.has_pose:
        direction = kept.direction / (np.linalg.norm(kept.direction) or 1.0)
        if momenta is None:
            x, y, z = map(jnp.asarray, direction)
            seen: Any = states.seen_from_body((x, y, z))
            along = np.sum(np.asarray(states.momentum) * np.stack(seen, axis=-1), axis=-1)
        else:
            along = momenta @ direction
        values = _relative(np.abs(along - along[..., :1]), size)
        formula, note = f"|π{kept.letter} - π{kept.letter}₀| / {letter}", f"{kept.which}, which is conserved"
        total = "total " * name.startswith("total")
        vertical = kept.which.startswith("vertical")
        short = f"vertical {total}momentum" if vertical else f"{total}momentum {kept.which.removeprefix('component ')}"
        return Change(values, name, formula, note, short=short)
    if momenta is None:
        lengths = np.linalg.norm(np.asarray(states.momentum), axis=-1)
        name, formula = "length of the momentum", "(|Π| - |Π₀|) / |Π₀|"
        return Change(_relative(lengths - size, size), name, formula, reason="" if torque is None else changed)
    values, formula = _relative(np.linalg.norm(momenta - momenta[..., :1, :], axis=-1), size), f"|π - π₀| / {letter}"
    return Change(values, name, formula, "all of it") if kept == ALL else Change(values, name, formula, reason=changed)


def _linear_change(body: Any, torque: Any, times: np.ndarray, states: Any, first: Any) -> Change:
    """|p(t) - p(0)| / max |p|, for coupled bodies of the sum over all; conserved if no force acts on `first`."""
    momenta, size = np.asarray(states.linear), np.nanmax(_sizes(states, states.linear), axis=-1, keepdims=True)
    momenta = np.sum(momenta, axis=-2) if states.several else momenta
    values = _relative(np.linalg.norm(momenta - momenta[..., :1, :], axis=-1), size)
    reason = ""
    if torque is not None:
        forces = np.asarray(_forces_on(body, torque, times, first).linear)
        acts = not add_up_to_zero(forces) if states.several else np.any(forces != 0)
        reason = "not conserved: a force acts" if acts else ""
    return Change(values, "linear momentum", "|p - p₀| / max |p|", "" if reason else "all of it", reason)


def _sizes(states: Any, vectors: Any) -> np.ndarray:
    """The lengths of vectors (..., 3), summed over coupled bodies."""
    lengths = np.linalg.norm(np.asarray(vectors), axis=-1)
    return np.sum(lengths, axis=-1) if states.several else lengths


def _relative(change: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return change / np.where(scale > 0, scale, 1)


def _doubles(tree: Any) -> Any:
    """The tree in float64, if enabled; states are not checked, because a failed run may contain NaN."""

    def double(leaf: Any) -> Any:
        floating = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, jnp.result_type(float)) if floating else leaf

    return jax.tree.map(double, tree)


class Kept(NamedTuple):
    """A component of the angular momentum that is conserved, of the total x cross p + R Pi if the body translates.

    A torque without a force does not change x cross p, and a uniform force changes the total momentum only
    perpendicular to itself.
    """

    direction: np.ndarray  # a vector along it, in space, (3,)
    letter: str  # its index in formulas
    which: str  # its name


ALL: Literal["all"] = "all"


def kept_by(torque: Any) -> Kept | Literal["all"] | None:
    """The component that is conserved under a torque, `ALL`, or None if none is known to be."""
    if torque is None or (isinstance(torque, torques.Torque) and torque.keeps_total_momentum):
        return ALL
    if isinstance(torque, torques.HeavyTop):
        return Kept(np.array([0.0, 0.0, 1.0]), "z", "vertical component")
    if isinstance(torque, torques.DipoleInField) and not callable(torque.field):
        return Kept(np.asarray(torque.field), "f", "component along the field")
    if isinstance(torque, torques.UniformGravity):
        return Kept(np.asarray(torque.acceleration), "g", "component along gravity")
    if isinstance(torque, torques.Oblateness):
        return Kept(np.asarray(torque.pole), "n", "component along the pole")
    if isinstance(torque, torques.OnEach):
        return kept_by(torque.torque)
    if not isinstance(torque, torques.Sum):
        return None
    kept = [kept_by(term) for term in torque.terms]
    some = [one for one in kept if isinstance(one, Kept)]
    if None in kept or any(not _parallel(some[0].direction, other.direction) for other in some):
        return None
    return some[0] if some else ALL


def _parallel(a: np.ndarray, b: np.ndarray) -> bool:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.linalg.norm(np.cross(a, b))) <= 4 * float(np.finfo(np.float32).eps) * size


def _forces_on(body: Any, torque: Any, times: np.ndarray, states: Any) -> Any:
    """The torque on a body at each saved time, (n, 3), or torque and force on one that translates, as `Momenta`."""
    bound: Any = on_body(torque, body)
    force = jax.vmap(lambda t, state: state.kind.force_of(bound(t, state)))
    return jax.jit(force)(jnp.asarray(times, jnp.result_type(float)), states)


def add_up_to_zero(*vectors: Any) -> bool:
    """Whether vectors (n, N, 3) of N bodies add up to zero at all times, up to rounding."""
    total = np.linalg.norm(sum(np.sum(each, axis=-2) for each in vectors), axis=-1)
    sizes = sum(np.sum(np.linalg.norm(each, axis=-1), axis=-1) for each in vectors)
    return bool(np.all(total <= np.sqrt(jnp.finfo(jnp.result_type(float)).eps) * sizes))


def balanced(body: Any, torque: Any, times: np.ndarray, states: Any) -> bool:
    """Whether the torques on coupled bodies, about the origin, add up to zero at the saved times, (n,)."""
    if torque is None or not states.several:
        return False
    found, each = _forces_on(body, torque, times, states), states.of_body(slice(None))
    travels = isinstance(states, TravellingState)
    turn = np.stack(each.to_space(cp.vector(found.angular if travels else found)), axis=-1)
    return add_up_to_zero(turn, np.cross(states.position, found.linear)) if travels else add_up_to_zero(turn)
