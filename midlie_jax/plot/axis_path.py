"""`axis_path`: the path of an axis of the body on the unit sphere of directions in space."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks.arguments import as_floats, described, is_unit, shown
from ..drivers.path import AnyPath
from ..model.states import OrientedState
from .edge import name_at_edge
from .motion import motion_of
from .several import path_of_one
from .style import BLUE, FEW, GREY, colours_of, is_3d, remark

_FAR = np.radians(30.0)  # if saved directions are further apart, the picture says so
_NAMES = ("x", "y", "z")  # the names of the axes of space
_BODY_AXES = ("e1", "e2", "e3")


def axis_path(
    axes: Any,
    path: AnyPath[OrientedState],
    axis: str | int | ArrayLike = 2,
    *,
    colour: str | None = None,
    label: str | None = None,
) -> np.ndarray:
    """Draws the path of an axis of the body in space, on the unit sphere.

    On 3-D axes (`figure.add_subplot(projection="3d")`) the part of the path towards the viewer is drawn strong and the
    other part faint, also after the picture is turned by hand. On plain axes the sphere is seen from +z, and the part
    below the xy plane is faint. A dot marks the start. Saved states are joined by the shortest arc. Call the function
    again on the same axes to compare paths. A run that failed is drawn up to its last good state, and the picture says
    so. Of up to six coupled bodies each has a path in a colour of its own.

    Args:
        axes: matplotlib's axes, 3-D or plain.
        path: a `Path` or `AdaptivePath` of one body, from `integrate`, `integrate_adaptive` or `free_motion`, with
            states that have an attitude, such as a `RigidState` or a `FreeState`, or the axis of symmetry: an
            `AxisState` or a `FreeAxisState`; or of coupled bodies.
        axis: an axis of the body: "e1", "e2", "e3" or its index 0, 1, 2, or a unit vector (3,) in the body frame. For
            states with an axis alone only e3, which is that axis.
        colour: colour of the path, any of matplotlib's.
        label: the name of the path; by default that of the axis. Of coupled bodies the number follows.

    Returns:
        The directions in space that are drawn, (n, 3), or of N coupled bodies (n, N, 3), at the saved times.

    Raises:
        ValueError: the path is not of one body with attitudes or axes, or its first two states are bad; the axis is
            neither a name, nor an index, nor a unit vector, or the states do not know it; there are more than six
            coupled bodies.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
        >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> figure = Figure()
        >>> ml.plot.axis_path(figure.add_subplot(projection="3d"), path).shape  # what is drawn
        (101, 3)
        >>> figure.savefig("axis.png")
    """
    direction, name = as_axis(axis)
    count = getattr(getattr(path, "states", None), "count", 0)
    if count:
        if count > FEW:
            raise ValueError(
                f"path holds {count} bodies, and the sphere has room for {FEW}; draw some of them: body i is "
                "path._replace(states=path.states.of_body(i))."
            )
        each = [
            axis_path(axes, path_of_one(path, i), axis, colour=colour or own, label=f"{label or name} of body {i}")
            for i, own in enumerate(colours_of(count))
        ]
        return np.stack(each, axis=1)
    motion = motion_of(path)
    tips = motion.directions(direction)
    name, chosen = label or name, colour or BLUE
    (_on_sphere if is_3d(axes) else _seen_from_above)(axes, tips, name, chosen)
    remark(axes, motion.failed and f"{name}: {motion.failed}")
    apart = np.max(np.arccos(np.clip(np.sum(tips[1:] * tips[:-1], axis=1), -1, 1)))
    if apart > _FAR:
        remark(axes, f"{name}: saved directions are up to {np.degrees(apart):.0f}° apart")
    return tips


def as_axis(axis: Any) -> tuple[np.ndarray, str]:
    """An axis of the body as a unit vector (3,), and its name."""
    if isinstance(axis, str) and axis in _BODY_AXES:
        return np.eye(3)[_BODY_AXES.index(axis)], axis
    wanted = 'axis must be "e1", "e2" or "e3", or its index 0, 1 or 2, or a unit vector (3,) in the body frame, got'
    if isinstance(axis, str):
        raise ValueError(f"{wanted} {axis!r}.")
    if isinstance(axis, int | np.integer) and not isinstance(axis, bool):
        if axis not in (0, 1, 2):
            raise ValueError(f"{wanted} {axis}.")
        return np.eye(3)[axis], _BODY_AXES[axis]
    try:
        direction = np.asarray(as_floats("axis", axis), float)
    except ValueError:
        direction = np.zeros(0)
    if direction.shape != (3,) or not is_unit(direction):
        raise ValueError(f"{wanted} {shown(axis) if np.shape(axis) == (3,) else described(axis)}.")
    return direction / np.linalg.norm(direction), "axis"


def _on_sphere(axes: Any, tips: np.ndarray, name: str, colour: str) -> None:
    from .ellipsoid import along_arcs, draw_curve, draw_dot, draw_ellipsoid, shade_of
    from .labels3d import name_point

    sphere = np.ones(3)
    if shade_of(axes) is None:
        draw_ellipsoid(axes, sphere)
        angle = np.linspace(0, 2 * np.pi, 181)
        circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        for shift in range(3):
            draw_curve(axes, np.roll(circle, shift, axis=1), sphere, color=GREY, linewidth=0.6, alpha=0.7)
        for direction, letter in zip(np.eye(3), _NAMES, strict=True):
            axes.plot(*np.stack([direction, 1.22 * direction]).T, color=GREY, linewidth=1.2)
            name_point(axes, 1.22 * direction, letter, GREY)
    draw_curve(axes, along_arcs(tips), sphere, color=colour, linewidth=1.4, label=name)
    draw_dot(axes, tips[0], sphere, colour)
    name_point(axes, tips[0], f"{name}, start", colour)


def _seen_from_above(axes: Any, tips: np.ndarray, name: str, colour: str) -> None:
    from .ellipsoid import along_arcs

    x, y, z = along_arcs(tips).T
    above = np.where(z >= 0, 1.0, np.nan)
    axes.plot(x, y, color=colour, linewidth=1.0, alpha=0.35)
    axes.plot(x * above, y * above, color=colour, linewidth=1.4, label=name)
    axes.plot(*tips[0, :2], marker="o", markersize=6.0, color=colour)
    if np.max(np.abs(tips[:, :2])) > 0.5:
        angle = np.linspace(0, 2 * np.pi, 181)
        axes.plot(np.cos(angle), np.sin(angle), color=GREY, linewidth=0.8, zorder=1)
    axes.set(xlabel="x in space  [-]", ylabel="y in space  [-]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.apply_aspect()
    name_at_edge(axes, [(name, float(y[-1]))], colour)
