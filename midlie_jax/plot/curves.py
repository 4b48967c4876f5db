"""Curves of one motion in space: `axis_path` on the unit sphere, `polhode` on the energy ellipsoid, and `track`."""

from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks.arguments import as_floats, described, is_unit, shown
from ..drivers.path import Path
from ..model.bodies import RigidBody, TensorBody, principal_of
from ..model.compatibility import body_named
from ..model.free_body import FreeBody
from ..model.state import AnyState
from ..model.states import AxisState, Coupled, TravellingState
from .motion import OrientedState, motion_of, path_of_one
from .style import BLUE, FEW, GREY, circle, colours_of, is_3d, name_in_legend, remark

_FAR = np.radians(30.0)  # if saved directions are further apart, the picture says so
_BODY_AXES = ("e1", "e2", "e3")
_SAME = 1e-2  # energies with a smaller difference are drawn on one ellipsoid
_FAMILY = (0.15, 0.5, 0.85)  # positions of other polhodes, from an axis to the separatrix
_MARGIN = 0.05  # room around tracks, relative to their size
_SLIMMEST = 0.4  # smallest side of a picture of a track over the largest, so that axis names fit
_TRACK = "midlie_jax.plot.track"  # marks tracks on 3-D axes


def axis_path(
    axes: Any,
    path: Path[OrientedState],
    axis: str | int | ArrayLike = 2,
    *,
    colour: str | None = None,
    label: str | None = None,
) -> np.ndarray:
    """Draws the path of an axis of the body in space, on the unit sphere.

    On 3-D axes (`figure.add_subplot(projection="3d")`) the part behind the sphere is faint, also after the picture is
    rotated by hand. On plain axes the sphere is viewed from +z, and the part below the xy plane is faint. A dot marks
    the initial direction; saved directions are joined by the shortest arc. Further calls add paths to the same axes.

    Args:
        axes: matplotlib's axes, 3-D or plain.
        path: a `Path` of one body or of coupled bodies, whose states have an attitude or the axis of symmetry.
        axis: an axis of the body: "e1", "e2", "e3" or its index 0, 1, 2, or a unit vector (3,) in the body frame.
            States with only an axis support only this axis, e3.
        colour, label: colour of the path, any of matplotlib's, and its name in the legend; by default the name of the
            axis. For coupled bodies the number is appended.

    Returns:
        The drawn directions in space, (n, 3), or for N coupled bodies (n, N, 3), at the saved times.

    Raises:
        ValueError: the path has no attitudes or axes, or its first two states are bad; the axis is none, or the states
            do not define it; there are more than six coupled bodies.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> path = ml.integrate("JACOBI[EA]", body, torque, start, dt=0.01, steps=100)
        >>> ml.plot.axis_path(Figure().add_subplot(projection="3d"), path).shape  # what is drawn
        (101, 3)
    """
    direction, name = as_axis(axis)
    name, states = label or name, getattr(path, "states", None)
    if isinstance(states, Coupled):
        if states.count > FEW:
            raise ValueError(
                f"path must hold at most {FEW} bodies, got {states.count}. Draw some of them: "
                "path._replace(states=path.states.of_body(i)) is the path of body i."
            )
        each = [
            axis_path(axes, path_of_one(path, i), axis, colour=colour or own, label=f"{name} of body {i}")
            for i, own in enumerate(colours_of(states.count))
        ]
        return np.stack(each, axis=1)
    motion, chosen = motion_of(path), colour or BLUE
    tips = motion.directions(direction)
    if is_3d(axes):
        from .artists import along_arcs

        ring, style = circle(181), {"linewidth": 0.6, "alpha": 0.7}
        greys = [(np.roll(ring, shift, axis=1), style) for shift in range(3)]
        ends = np.eye(3), 1.2 * np.eye(3), "xyz"
        _on_surface(axes, along_arcs(tips), np.ones(3), greys, ends, color=chosen, linewidth=1.4, label=name)
    else:
        seen_from_above(axes, tips, name, chosen)
    name_in_legend(axes)
    remark(axes, motion.failed and f"{name}: {motion.failed}")
    gap = np.max(np.arccos(np.clip(np.sum(tips[1:] * tips[:-1], axis=1), -1, 1)))
    if gap > _FAR:
        remark(axes, f"{name}: saved directions are up to {np.degrees(gap):.0f}° apart")
    return tips


def as_axis(axis: Any) -> tuple[np.ndarray, str]:
    """An axis of the body as a unit vector (3,), and its name."""
    if isinstance(axis, int | np.integer) and not isinstance(axis, bool) and axis in (0, 1, 2):
        axis = _BODY_AXES[axis]
    if isinstance(axis, str) and axis in _BODY_AXES:
        return np.eye(3)[_BODY_AXES.index(axis)], axis
    try:
        direction = np.asarray(as_floats("axis", axis), float)
    except ValueError:
        direction = np.zeros(0)
    if direction.shape != (3,) or not is_unit(direction):
        got = repr(axis) if isinstance(axis, str | int) else shown(axis) if direction.shape == (3,) else described(axis)
        raise ValueError(
            'axis must be "e1", "e2" or "e3", or its index 0, 1 or 2, or a unit vector (3,) in the body frame, '
            f"got {got}."
        )
    return direction / np.linalg.norm(direction), "axis"


def _on_surface(
    axes: Any, points: np.ndarray, semi_axes: np.ndarray, greys: Any, ends: tuple[Any, Any, Any], **style: Any
) -> bool:
    """Draws a curve on an ellipsoid; a new ellipsoid gets grey curves and named axes. Returns whether it is new."""
    from .artists import Shade, draw_axes, draw_curve, draw_ellipsoid

    drawn = next((found for found in axes.collections if isinstance(found, Shade)), None)
    if drawn is None:
        draw_ellipsoid(axes, semi_axes)
        for curve, grey in greys:
            draw_curve(axes, curve * semi_axes, semi_axes, color=GREY, **grey)
        draw_axes(axes, *ends)
    elif drawn.semi_axes.shape != semi_axes.shape or np.max(np.abs(drawn.semi_axes / semi_axes - 1)) > _SAME / 2:
        raise ValueError(
            "path and body must have the kinetic energy of the ellipsoid on these axes, got another one. Draw them on "
            "other axes."
        )
    else:
        semi_axes = drawn.semi_axes
    draw_curve(axes, points, semi_axes, **style)
    draw_curve(axes, points[:1], semi_axes, color=style["color"], marker="o", markersize=6.0)
    return drawn is None


def seen_from_above(axes: Any, tips: np.ndarray, name: str, colour: str) -> None:
    """Draws directions (n, 3) on plain axes as seen from +z."""
    from .artists import along_arcs

    x, y, z = along_arcs(tips).T
    above = np.where(z >= 0, 1.0, np.nan)
    axes.plot(x, y, color=colour, linewidth=1.0, alpha=0.35)
    axes.plot(x * above, y * above, color=colour, linewidth=1.4, label=name)
    axes.plot(*tips[0, :2], marker="o", markersize=6.0, color=colour)
    if np.max(np.abs(tips[:, :2])) > 0.5:
        axes.plot(*circle(181)[:, :2].T, color=GREY, linewidth=0.8, zorder=1)
    axes.set(xlabel="x in space  [-]", ylabel="y in space  [-]")
    axes.set_aspect("equal", adjustable="datalim")


def polhode(
    axes: Any,
    body: RigidBody | TensorBody | FreeBody,
    path: Path[AnyState],
    *,
    kind: str = "momentum",
    colour: str | None = None,
    label: str | None = None,
) -> np.ndarray:
    """Draws the angular momentum in the principal frame of the body, on the ellipsoid of its kinetic energy.

    Without a torque the momentum Pi moves on the ellipsoid Pi . I^-1 Pi = 2T of its kinetic energy T, along its
    intersection with a sphere. The angular velocity W moves on the ellipsoid W . I W = 2T, along the polhode of Poinsot
    (H. Goldstein, Classical Mechanics, section 5.6). Here the curve of the momentum is called a polhode as well.

    The ellipsoid belongs to the initial energy; under a torque the path leaves it, and the picture says so. Further
    calls add paths of nearly the same energy to the same axes.

    Args:
        axes: matplotlib's 3-D axes: `figure.add_subplot(projection="3d")`.
        body: the body of the path, a `RigidBody` or a `TensorBody`, or a `FreeBody` of one, whose rotation is drawn.
        path: a `Path` of one body, with any state of a rigid body, or a `FreeState`.
        kind: "momentum", or "velocity" for the angular velocity, whose ellipsoid has the axes sqrt(2T / I).
        colour, label: as for `axis_path`; by default the name is "momentum" or "angular velocity".

    Returns:
        The drawn points (n, 3), at the saved times, in the principal frame.

    Raises:
        ValueError: the axes are not 3-D; the body is not one rigid body, or does not rotate; the first two states are
            bad, or have no momentum in the body frame; the energy differs from the energy of the drawn ellipsoid.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> start = ml.RigidState([0.01, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.free_motion(body, start, jnp.linspace(0.0, 18.0, 181))
        >>> ml.plot.polhode(Figure().add_subplot(projection="3d"), body, path).shape
        (181, 3)
    """
    if not is_3d(axes):
        raise ValueError('axes must be 3-D, got plain axes. Make them by figure.add_subplot(projection="3d").')
    if kind not in ("momentum", "velocity"):
        raise ValueError(f"kind must be one of momentum, velocity, got {kind!r}.")
    motion = motion_of(path)
    if isinstance(motion.turning, AxisState):
        raise ValueError(
            "path must hold momenta in the body frame, got AxisStates. Integrate a RigidState or a FreeState, such as "
            "state.with_attitude(), with the moments of the body."
        )
    turning = body.turning if isinstance(body, FreeBody) else body
    if not isinstance(turning, RigidBody | TensorBody):
        raise ValueError(f"body must be a RigidBody or a TensorBody, or a FreeBody of one, got {body_named(body)}.")
    moments = np.asarray(principal_of(turning).moments, float)
    if moments.shape != (3,):
        raise ValueError(f"body must be one body with moments (3,), got {moments.shape}. Take the row of the body.")
    own = motion.turning.momentum
    momenta = np.asarray(turning.to_principal(own) if isinstance(turning, TensorBody) else own, float)
    energies = np.sum(momenta**2 / moments, axis=1) / 2
    if not energies[0] > 0:
        raise ValueError("path must start with a momentum that is not zero, got a body at rest; it has no ellipsoid.")
    power = 0.5 if kind == "momentum" else -0.5
    points, semi_axes = momenta * moments ** (power - 0.5), np.sqrt(2 * energies[0]) * moments**power
    name = label or ("momentum" if kind == "momentum" else "angular velocity")
    bold, thin = {"linewidth": 1.2, "alpha": 1.0}, {"linewidth": 0.6, "alpha": 0.8}
    greys = [(curve, bold if separatrix else thin) for curve, separatrix in polhodes(moments)]
    ends = np.diag(semi_axes), np.diag(semi_axes + 0.18 * np.max(semi_axes)), _BODY_AXES
    if _on_surface(axes, points, semi_axes, greys, ends, color=colour or BLUE, linewidth=1.8, label=name):
        remark(axes, "moments of e1, e2, e3: " + ", ".join(f"{moment:.4g}" for moment in moments))
    name_in_legend(axes)
    remark(axes, motion.failed and f"{name}: {motion.failed}")
    if np.ptp(energies) > _SAME * energies[0]:
        low, high = np.array([energies.min(), energies.max()]) / energies[0]
        remark(axes, f"{name}: kinetic energy from {low:.3g} to {high:.3g} times that of the ellipsoid")
    return points


def polhodes(moments: np.ndarray) -> list[tuple[np.ndarray, bool]]:
    """Polhodes of one energy, and whether each belongs to the separatrix, as points u (181, 3) with |u| = 1.

    The momentum is sqrt(2T I) u. Its square over 2T is sum(I u^2), between the smallest moment a and the largest c.
    Polhodes below the middle moment b encircle axis a, and polhodes above it axis c. The separatrix is at b.
    """
    a, b, c = np.argsort(moments)
    low, middle, high = moments[[a, b, c]]
    cosine, sine, _ = circle(181).T
    found: list[tuple[np.ndarray, bool]] = []
    ends = [(a, (b, c), middle - low), (c, (a, b), middle - high)]
    ends = [end for end in ends if abs(end[2]) > 1e-9 * high]
    separatrix = [(1.0, ends[0])] if len(ends) == 2 else []
    for share, (axis, others, gap) in [*product(_FAMILY, ends), *separatrix]:
        # sum(I u^2) = moments[axis] + share^2 gap, at both ends of the axis.
        u = np.zeros((len(cosine), 3))
        for other, values in zip(others, (cosine, sine), strict=True):
            if moments[other] != moments[axis]:
                u[:, other] = np.sqrt(share**2 * gap / (moments[other] - moments[axis])) * values
        u[:, axis] = np.sqrt(np.maximum(1 - np.sum(u**2, axis=1), 0.0))
        found += [(u, share == 1), (u * np.where(np.arange(3) == axis, -1, 1), share == 1)]
    return found


def track(axes: Any, path: Path[TravellingState], *, colour: str | None = None, label: str | None = None) -> np.ndarray:
    """Draws the path of the centre of mass in space, with one scale in all directions.

    On plain axes the path is drawn in the plane xy, xz or yz in which it is longest, or which the labels of the axes
    name. A dot marks the initial position. Further calls add paths to the same axes.

    Args:
        axes: matplotlib's axes, 3-D or plain.
        path: a `Path` of one body that translates, or of coupled bodies.
        colour, label: as for `axis_path`; by default there is no name.

    Returns:
        The drawn positions, (n, 3), or for N coupled bodies (n, N, 3), at the saved times.

    Raises:
        ValueError: the path is not of one body that translates, or its first two states are bad.

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
            f"path must hold positions, got {type(motion.states).__name__}s. Integrate a FreeState of a FreeBody."
        )
    positions = np.asarray(motion.states.position, float)
    each, names, colours = [positions], [label], [BLUE]
    if motion.states.several:
        each = list(np.moveaxis(positions, 1, 0))
        names = [f"{label or 'body'} {i}" if len(each) <= FEW else None for i in range(len(each))]
        colours = colours_of(len(each))
    longest = max(each, key=lambda one: float(np.max(np.ptp(one, axis=0))))
    draw = _in_space if is_3d(axes) else partial(in_plane, plane_of(axes, longest))
    for one, name, own in zip(each, names, colours, strict=True):
        draw(axes, one, colour or own, name)
    if names[0]:
        name_in_legend(axes)
    remark(axes, motion.failed and (f"{label}: {motion.failed}" if label else motion.failed))
    return positions


def _in_space(axes: Any, positions: np.ndarray, colour: str, label: str | None) -> None:
    from .artists import draw_space

    axes.plot(*positions.T, color=colour, linewidth=1.4, label=label, gid=_TRACK)
    axes.plot(*positions[:1].T, marker="o", markersize=5.0, color=colour, linestyle="")
    drawn = np.concatenate([np.transpose(line.get_data_3d()) for line in axes.lines if line.get_gid() == _TRACK])
    draw_space(axes, limits_around(drawn, _MARGIN * float(np.max(np.ptp(drawn, axis=0)))))


def limits_around(points: np.ndarray, margin: float) -> np.ndarray:
    """The lowest and the highest coordinates of a picture of points (n, 3), (2, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2 + margin
    half = np.maximum(half, max(_SLIMMEST * float(half.max()), np.finfo(float).tiny))
    return (low + high) / 2 + np.stack([-half, half])


def plane_of(axes: Any, positions: np.ndarray) -> str:
    """The letters of the plane: from the labels, or else the two directions in which the path is longest."""
    letters = "".join(label[:1].lower() for label in (axes.get_xlabel(), axes.get_ylabel()))
    if len(set(letters) & set("xyz")) == 2:
        return letters
    spans = np.ptp(positions, axis=0)
    return "xyz".replace("xyz"[int(np.argmin(spans))] if np.any(spans) else "z", "")


def in_plane(letters: str, axes: Any, positions: np.ndarray, colour: str, label: str | None) -> None:
    """Draws positions (n, 3) on plain axes of two directions with one scale."""
    i, j = map("xyz".index, letters)
    axes.plot(positions[:, i], positions[:, j], color=colour, linewidth=1.4, label=label)
    axes.plot(*positions[0, [i, j]], marker="o", markersize=5.0, color=colour)
    axes.set(xlabel=axes.get_xlabel() or f"{letters[0]}  [length]")
    axes.set(ylabel=axes.get_ylabel() or f"{letters[1]}  [length]")
    axes.set_aspect("equal", adjustable="datalim")
