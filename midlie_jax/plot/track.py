"""`track`: the path of the centre of mass of a body that travels."""

from typing import Any

import numpy as np

from ..drivers.path import AnyPath
from ..model.states import TravellingState
from .edge import name_at_edge
from .motion import motion_of
from .style import BLUE, FEW, SIZE, colours_of, ink, is_3d, remark
from .travel import around

_MARGIN = 0.05  # room around the tracks, relative to their size
_LETTERS = "xyz"
_MARK = "midlie_jax.plot.track"  # marks the lines of this module on 3-D axes


def track(
    axes: Any, path: AnyPath[TravellingState], *, colour: str | None = None, label: str | None = None
) -> np.ndarray:
    """Draws the path of the centre of mass in space, with one scale in all directions.

    On plain axes it is drawn in the plane xy, xz or yz in which it is longest; labels "x" and "z" that the axes have
    already, such as those of an earlier call, choose the plane. A dot marks the start. Saved positions are joined by
    straight lines. Call the function again on the same axes to compare paths. A run that failed is drawn up to its last
    good state, and the picture says so. Of coupled bodies each has a track in a colour of its own; up to six are named.

    Args:
        axes: matplotlib's axes, 3-D (`figure.add_subplot(projection="3d")`) or plain.
        path: a `Path` or `AdaptivePath` of one body that travels, with `FreeState`s or `FreeAxisState`s; or of coupled
            bodies.
        colour: colour of the path, any of matplotlib's.
        label: the name of the path, written at its end; by default it has none. Of coupled bodies the number follows.

    Returns:
        The positions that are drawn, (n, 3), or of N coupled bodies (n, N, 3), at the saved times.

    Raises:
        ValueError: the path is not of one body that travels, or its first two states are bad.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.6]), mass=3.0)
        >>> weight = ml.torques.UniformGravity([0.0, 0.0, -9.81])
        >>> level = [1.0, 0.0, 0.0, 0.0]
        >>> start = ml.FreeState([0.1, 3.0, 0.2], level, linear=[12.0, 0.0, 9.0], position=[0.0, 0.0, 1.5])
        >>> path = ml.integrate("JACOBI[EA]", body, weight, start, dt=0.01, steps=100)
        >>> ml.plot.track(Figure().add_subplot(), path, label="brick").shape
        (101, 3)
    """
    motion = motion_of(path, together=True)
    if not isinstance(motion.states, TravellingState):
        raise ValueError(
            f"a {type(motion.states).__name__} has no place in space; integrate a FreeState of a FreeBody to draw one."
        )
    positions = np.asarray(motion.states.position, float)
    draw = _in_space if is_3d(axes) else _in_plane
    if motion.states.several:
        count = positions.shape[1]
        names = [f"{label or 'body'} {i}" if count <= FEW else None for i in range(count)]
        # The largest comes first, because it chooses the plane.
        for i in np.argsort(-np.max(np.ptp(positions, axis=0), axis=1), kind="stable"):
            draw(axes, positions[:, i], colour or colours_of(count)[i], names[i])
    else:
        draw(axes, positions, colour or BLUE, label)
    remark(axes, motion.failed and (f"{label}: {motion.failed}" if label else motion.failed))
    return positions


def _in_space(axes: Any, positions: np.ndarray, colour: str, label: str | None) -> None:
    from .space import draw_space

    axes.plot(*positions.T, color=colour, linewidth=1.4, label=label, gid=_MARK)
    axes.plot(*positions[:1].T, marker="o", markersize=5.0, color=colour, linestyle="")
    drawn = np.concatenate([np.transpose(line.get_data_3d()) for line in axes.lines if line.get_gid() == _MARK])
    draw_space(axes, around(drawn, _MARGIN * float(np.max(np.ptp(drawn, axis=0)))))
    if label:
        axes.text(*positions[-1], f" {label}", fontsize=SIZE, color=ink(axes))


def _in_plane(axes: Any, positions: np.ndarray, colour: str, label: str | None) -> None:
    i, j = _plane(axes, positions)
    axes.plot(positions[:, i], positions[:, j], color=colour, linewidth=1.4, label=label)
    axes.plot(*positions[0, [i, j]], marker="o", markersize=5.0, color=colour)
    axes.set(xlabel=axes.get_xlabel() or f"{_LETTERS[i]}  [length]")
    axes.set(ylabel=axes.get_ylabel() or f"{_LETTERS[j]}  [length]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.apply_aspect()
    if label:
        name_at_edge(axes, [(label, float(positions[-1, j]))], colour)


def _plane(axes: Any, positions: np.ndarray) -> tuple[int, int]:
    """The two coordinates that are drawn: those that the labels begin with, or those in which the path is longest."""
    named = [label[:1].lower() for label in (axes.get_xlabel(), axes.get_ylabel())]
    if named[0] != named[1] and all(letter and letter in _LETTERS for letter in named):
        return _LETTERS.index(named[0]), _LETTERS.index(named[1])
    shortest = int(np.argsort(np.ptp(positions, axis=0), kind="stable")[0])
    if not np.any(np.ptp(positions, axis=0)):
        shortest = 2
    i, j = (k for k in range(3) if k != shortest)
    return i, j
