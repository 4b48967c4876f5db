"""`conserved`: the errors of energy and momenta of a run against time, on a logarithmic scale."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..drivers.path import AnyPath
from ..model.bodies import Body
from ..model.compatibility import check_body, check_torque
from ..model.state import AnyState
from ..model.states import TravellingState
from ..model.torques import TorqueLike
from .balance import balanced
from .conservation import Change, energy_change, linear_change, momentum_change
from .labels import name_at_edge
from .motion import motion_of
from .style import BLUE, GREEN, VERMILLION, remark

# Colours and dashes of energy, angular and linear momentum.
_LINES = (BLUE, "-"), (VERMILLION, (0, (4, 1.5))), (GREEN, (0, (1.5, 1.5)))


class Conserved(NamedTuple):
    """What `conserved` has drawn.

    Attributes:
        times: (n,), the saved times before the run failed.
        energy: the relative error of the energy, (n,); None if it is not conserved.
        momentum: the relative error of the conserved part of the spatial momentum, (n,); None if there is none.
        linear: the relative error of the linear momentum, (n,); None if it is not conserved, or the body does not
            travel.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
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
    path: AnyPath[AnyState],
    *,
    colour: str | None = None,
    label: str | None = None,
) -> Conserved:
    """Draws by how much a run breaks the laws of conservation that hold for the exact motion.

    The bold lines are the largest relative error so far, the faint ones the error at each saved time. Conserved are:

    - the energy, if the torque has a potential that does not depend on time;
    - all of the spatial momentum without a torque and under a `PointMass`, its vertical component under a `HeavyTop`,
      and its component along the field under a `DipoleInField` whose field is constant, along the acceleration under a
      `UniformGravity`, and along the pole under an `Oblateness`; under a sum of torques, what each of them conserves;
    - without a torque, for a state that has no attitude, the length of the momentum;
    - for a body that travels, the linear momentum if no force acts at the saved times. Its spatial momentum is the
      total angular momentum about the origin, x cross p + R Pi;
    - for coupled bodies, the sums of their momenta, if at the saved times their forces, or their torques about the
      origin, add up to zero but for rounding.

    What is not conserved is named on the picture and not drawn. Errors are computed in float64 if it is enabled. Errors
    below half a unit in the last place of the run's dtype are drawn at that height. Call the function again on the same
    axes to compare methods, each with a colour.

    Args:
        axes: matplotlib's axes; names stand at their right edge, for which the panel becomes narrower.
        body: the body of the path: a `RigidBody`, a `TensorBody`, a `Rotor` or a `FreeBody`.
        torque: as for `integrate`.
        path: a `Path` or `AdaptivePath` of one body, from `integrate`, `integrate_adaptive` or `free_motion`, with any
            state of one body, or of coupled bodies.
        colour: the colour of all lines (the lines of the momenta are dashed); by default blue, vermilion and green.
        label: put before the names "energy" and "momentum", for example the name of the method.

    Returns:
        The errors, signed for the energy.

    Raises:
        ValueError: body, torque and path do not fit each other; the path is not of one body, or its first two states
            are bad; neither energy nor a momentum is conserved.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> found = ml.plot.conserved(Figure().add_subplot(), body, torque, path, label="JACOBI[EA]")
        >>> found.energy.shape
        (101,)
    """
    motion = motion_of(path, together=True)
    check_body(body, motion.states)
    check_torque(torque)
    acting = body, torque, motion.times, motion.states
    changes = [energy_change(*acting), momentum_change(torque, motion.states, balanced=balanced(*acting))]
    if isinstance(motion.states, TravellingState):
        changes.append(linear_change(body, torque, motion.times, motion.states))
    if all(change.reason for change in changes):
        raise ValueError(f"nothing is conserved: {'; '.join(f'{c.name}: {c.reason}' for c in changes)}.")
    least = float(jnp.finfo(motion.states.momentum.dtype).eps) / 2
    axes.set_yscale("log")
    axes.set(xlabel=axes.get_xlabel() or "time", ylabel=axes.get_ylabel() or "relative error")
    found: list[np.ndarray | None] = []
    for change, (own, dash) in zip(changes, _LINES, strict=False):
        name = f"{label}: {_short(change)}" if label else _short(change)
        if change.reason:
            remark(axes, f"{name} {change.reason}")
            found.append(None)
            continue
        chosen, sizes = colour or own, np.maximum(np.abs(change.values), least)
        largest = np.maximum.accumulate(sizes)
        axes.plot(motion.times, sizes, color=chosen, linewidth=0.7, alpha=0.45)
        axes.plot(motion.times, largest, color=chosen, linewidth=2.0, linestyle=dash, label=name)
        axes.margins(x=0)
        name_at_edge(axes, [(name, float(largest[-1]))], chosen)
        found.append(change.values)
    remark(axes, motion.failed)
    return Conserved(motion.times, *found)


def _short(change: Change) -> str:
    """A name short enough to stand beside a panel."""
    part = change.note.split()[0] if change.note.endswith("conserved") else ""
    total = "total " if change.name.startswith("total") else ""
    if part == "vertical":
        return f"vertical {total}momentum"
    if part == "component":
        return f"{total}momentum {change.note.removeprefix('component ').partition(',')[0]}"
    return change.name
