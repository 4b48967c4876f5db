"""`poincare`: a Poincare section, the points where a motion crosses a surface in phase space (M. Henon, 1982)."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import described, require_function, shown
from .._checks.typed_by import TypedBy
from ..drivers.path import Path, States
from ..model.state import StateT
from .motion import Motion, motion_of
from .style import BLUE, name_in_legend, remark

_NEIGHBOURS = 4  # saved states for the cubic interpolation of a crossing
_LEAST = 64  # crossings computed at once
_HALVINGS = 55  # number of bisections of the interval between two saved states
_JUMP = 1e-3  # if bisection leaves a larger share of the change of g, g jumps there and does not cross zero
_Function = Callable[[Any, Any], Any]


class Crossings(NamedTuple, TypedBy[States]):
    """The k crossings of a surface, in the order of the path; k may be 0. In annotations `Crossings[RigidState]`.

    Attributes:
        times: (k,).
        states: the states at the crossings, of the path's class, with a leading axis (k,).
        points: the drawn coordinates, (k, 2).

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> start = ml.RigidState([0.01, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.free_motion(body, start, jnp.linspace(0.0, 18.0, 181))
        >>> first, second, third = (lambda t, s, i=i: s.momentum[i] for i in range(3))  # the second is zero at a flip
        >>> found = ml.plot.poincare(Figure().add_subplot(), path, second, first, third, direction=0)
        >>> found.times.shape, found.states.attitude.shape
        ((1,), (1, 4))
    """

    times: np.ndarray
    states: States
    points: np.ndarray


def poincare(
    axes: Any,
    path: Path[StateT],
    section: Callable[[Any, StateT], Any],
    x: Callable[[Any, StateT], Any],
    y: Callable[[Any, StateT], Any],
    *,
    direction: int = 1,
    colour: str | None = None,
    label: str | None = None,
    size: float = 2.0,
) -> Crossings[StateT]:
    """Draws a dot at each crossing of the surface `section` = 0 by a motion.

    The dots lie on a curve if the motion is regular, and fill an area if it is chaotic (M. Henon, Physica D 5 (1982)
    412).

    If `section` has different signs at two neighbouring saved states, the arrays of the state are interpolated by a
    cubic through the four nearest saved states, and bisection finds the crossing. Its error is of fourth order in the
    time between saved states; save some twenty states per period of `section`. If `section` jumps, as an angle does
    from pi to -pi, a change of sign at a jump is not a crossing. Call `poincare` again on the same axes for another
    initial state.

    Args:
        axes: matplotlib's axes; their labels are not set.
        path: a `Path` of one body, or of coupled bodies, with at least 4 saved states of any kind.
        section: g(t, state) -> (), written with jax.numpy for one state, as for `ensemble(observe=...)`.
        x, y: the coordinates to draw, functions of the same kind.
        direction: 1 for crossings at which `section` increases along the path, -1 if it decreases, 0 for both.
        colour: colour of the dots, any of matplotlib's.
        label: a name for the dots, in the legend.
        size: size of the dots, points.

    Raises:
        ValueError: the path is not of one body or has too few states; an argument is not a function, or its value is
            not one real number; the direction is not 1, -1 or 0.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> start = ml.RigidState([0.01, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.free_motion(body, start, jnp.linspace(0.0, 18.0, 181))
        >>> first, second, third = (lambda t, s, i=i: s.momentum[i] for i in range(3))  # the second is zero at a flip
        >>> found = ml.plot.poincare(Figure().add_subplot(), path, second, first, third, direction=0)
        >>> found.points.shape
        (1, 2)
    """
    for name, function in (("section", section), ("x", x), ("y", y)):
        require_function(name, function, "t, state")
    if direction not in (1, -1, 0) or isinstance(direction, bool):
        raise ValueError(f"direction must be 1, -1 or 0, got {shown(direction)}.")
    motion = motion_of(path, together=True)
    if len(motion.times) < _NEIGHBOURS:
        raise ValueError(f"path must have {_NEIGHBOURS} good states, got {len(motion.times)}. Save more often.")
    times, states = _crossings(motion, section, direction)
    points = np.stack([_values(name, f, times, states) for name, f in (("x", x), ("y", y))], axis=1)
    style: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": size, "markeredgewidth": 0}
    axes.plot(*points.T, color=colour or BLUE, label=label, **style)
    if label and len(points):
        name_in_legend(axes)
    remark(axes, motion.failed)
    return Crossings(np.asarray(times), states, points)


@partial(jax.jit, static_argnums=0)
def _map(function: _Function, times: Array, states: Any) -> Any:
    return jax.vmap(function)(times, states)


def _values(name: str, function: _Function, times: Any, states: Any) -> np.ndarray:
    """The values of a function of one time and state, (n,)."""
    values = _map(function, jnp.asarray(times), states)
    if not hasattr(values, "shape") or values.shape != np.shape(times):
        raise ValueError(f"{name}(t, state) must be one real number, got {described(values)} for {len(times)} states.")
    return np.asarray(values, float)


def _crossings(motion: Motion, section: _Function, direction: int) -> tuple[Any, Any]:
    values = _values("section", section, motion.times, motion.states)
    before, after = values[:-1], values[1:]
    upward, downward = (before < 0) & (after >= 0), (before > 0) & (after <= 0)
    places = np.flatnonzero({1: upward, -1: downward, 0: upward | downward}[direction])
    # Padded to one of few sizes, so that compiled programs are reused.
    padded = np.zeros(2 ** int(np.ceil(np.log2(max(len(places), _LEAST)))), int)
    padded[: len(places)] = places
    first = np.clip(padded - 1, 0, len(motion.times) - _NEIGHBOURS)
    rows = first[:, None] + np.arange(_NEIGHBOURS)
    times = jnp.asarray(motion.times)[rows]
    states = jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], motion.states)
    signs = jnp.asarray(np.where(before[padded] < 0, 1.0, -1.0), times.dtype)
    t, at, left = _bisected(section, times, states, jnp.asarray(padded - first), signs)
    continuous = np.abs(np.asarray(left)) <= _JUMP * np.abs(after - before)[padded]
    kept = np.flatnonzero(continuous[: len(places)])
    return jax.tree.map(lambda leaf: leaf[kept], (t, at))


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, 0, 0, 0, 0))
def _bisected(section: _Function, times: Array, states: Any, place: Array, sign: Array) -> tuple[Array, Any, Array]:
    """The time and state at which `section` vanishes, and its value there, from four states around a crossing.

    `place` is the index, among the four, of the state before the crossing; `sign` is 1 if `section` increases, else -1.
    """

    def value(t: Array) -> Array:
        return jnp.asarray(section(t, _interpolated(t, times, states)))

    def halve(_: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = (ends[0] + ends[1]) / 2
        before = sign * value(middle) < 0
        return jnp.where(before, middle, ends[0]), jnp.where(before, ends[1], middle)

    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (times[place], times[place + 1]))
    t = (low + high) / 2
    return t, _interpolated(t, times, states), value(t)


def _interpolated(t: Array, times: Array, states: Any) -> Any:
    """The state at time t on the cubic through four states, with attitude, axis or direction of length one."""
    # Lagrange's polynomials; the diagonal, without a factor, is set to 1.
    own = jnp.eye(_NEIGHBOURS, dtype=bool)
    factors = (t - times)[None, :] / jnp.where(own, 1, times[:, None] - times[None, :])
    weights = jnp.prod(jnp.where(own, 1, factors), axis=1)
    between = jax.tree.map(lambda leaf: jnp.tensordot(weights, leaf, axes=1), states)
    return between.kind.normalised(between)
