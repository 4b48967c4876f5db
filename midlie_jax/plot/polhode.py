"""`polhode`: the path of the momentum, or of the angular velocity, in the body frame, on the ellipsoid of its energy.

A body under no torque keeps its kinetic energy T and the length of its momentum Pi. So in the body frame the momentum
runs on the ellipsoid Pi . I^-1 Pi = 2T, along its intersection with a sphere. The angular velocity W runs on the
ellipsoid W . I W = 2T, along the polhode of Poinsot (H. Goldstein, Classical Mechanics, section 5.6). Here the curve of
the momentum is called a polhode, too.
"""

from typing import Any

import numpy as np

from ..drivers.path import AnyPath
from ..model.bodies import RigidBody, TensorBody, principal_of
from ..model.compatibility import body_named
from ..model.free_body import FreeBody
from ..model.state import AnyState
from .motion import Motion, motion_of
from .style import BLUE, GREY, is_3d, remark

_KINDS = ("momentum", "velocity")
_SAME = 1e-2  # energies that differ less are drawn on one ellipsoid
_FAMILY = (0.15, 0.5, 0.85)  # where, from an axis to the separatrix, other polhodes are drawn


def polhode(
    axes: Any,
    body: RigidBody | TensorBody | FreeBody,
    path: AnyPath[AnyState],
    *,
    kind: str = "momentum",
    colour: str | None = None,
    label: str | None = None,
) -> np.ndarray:
    """Draws the angular momentum in the principal frame of the body, on the ellipsoid of its kinetic energy.

    Faint curves are other polhodes of that energy; the grey curves through the axis of the middle moment are the
    separatrix. A dot marks the start. The ellipsoid is that of the energy at the start: under a torque the path leaves
    it, and the picture says so. Call the function again on the same axes for another path of nearly the same energy. A
    run that failed is drawn up to its last good state, and the picture says so.

    Args:
        axes: matplotlib's 3-D axes: `figure.add_subplot(projection="3d")`.
        body: the body of the path, a `RigidBody` or a `TensorBody`, or a `FreeBody` of one, whose rotation is drawn.
        path: a `Path` or `AdaptivePath` of one body, from `integrate`, `integrate_adaptive` or `free_motion`, with any
            state of a rigid body, or a `FreeState`.
        kind: "momentum", or "velocity" for the angular velocity, whose ellipsoid has the axes sqrt(2T / I).
        colour: colour of the path, any of matplotlib's.
        label: the name of the path, written beside its start; by default "momentum" or "angular velocity".

    Returns:
        The drawn points (n, 3), at the saved times, in the principal frame.

    Raises:
        ValueError: the axes are not 3-D; the body is not one rigid body; the path is not of one body, its first two
            states are bad, or they have no momentum in the body frame, such as an `AxisState`; the body does not turn;
            the energy differs from that of the ellipsoid on the axes.

    Examples:
        >>> from matplotlib.figure import Figure
        >>> body = ml.RigidBody([1.0, 2.0, 2.5])
        >>> start = ml.RigidState([0.01, 2.0, 0.01], [1.0, 0.0, 0.0, 0.0])
        >>> path = ml.free_motion(body, start, jnp.linspace(0.0, 18.0, 181))
        >>> ml.plot.polhode(Figure().add_subplot(projection="3d"), body, path).shape
        (181, 3)
    """
    if not is_3d(axes):
        raise ValueError('axes must be 3-D: figure.add_subplot(projection="3d").')
    if kind not in _KINDS:
        raise ValueError(f"kind must be one of {', '.join(_KINDS)}, got {kind!r}.")
    motion = motion_of(path).turning
    if motion.has_axis_alone:
        raise ValueError(
            "path must hold momenta in the body frame, which an AxisState does not; integrate a RigidState or a "
            "FreeState, such as state.with_attitude(), with the moments of the body."
        )
    body, moments = _turning(body)
    momenta = _in_principal_frame(body, motion)
    energies = np.sum(momenta**2 / moments, axis=1) / 2
    if not energies[0] > 0:
        raise ValueError("path starts at rest, which has no ellipsoid; start with a momentum that is not zero.")
    power = 0.5 if kind == "momentum" else -0.5
    points, semi_axes = momenta * moments ** (power - 0.5), np.sqrt(2 * energies[0]) * moments**power
    name, chosen = label or ("momentum" if kind == "momentum" else "angular velocity"), colour or BLUE
    _draw(axes, points, semi_axes, moments, name, chosen)
    remark(axes, motion.failed and f"{name}: {motion.failed}")
    if np.ptp(energies) > _SAME * energies[0]:
        share = np.array([energies.min(), energies.max()]) / energies[0]
        remark(axes, f"{name}: kinetic energy from {share[0]:.3g} to {share[1]:.3g} of that of the ellipsoid")
    return points


def _turning(body: Any) -> tuple[RigidBody | TensorBody, np.ndarray]:
    """The one rigid body that turns, and its principal moments (3,)."""
    turning = body.turning if isinstance(body, FreeBody) else body
    if not isinstance(turning, RigidBody | TensorBody):
        raise ValueError(f"body must be a RigidBody or a TensorBody, or a FreeBody of one, got {body_named(body)}.")
    moments = np.asarray(principal_of(turning).moments, float)
    if moments.shape != (3,):
        raise ValueError(f"body must be one body with moments (3,), got {moments.shape}; take the row of the body.")
    return turning, moments


def _in_principal_frame(body: RigidBody | TensorBody, motion: Motion) -> np.ndarray:
    momenta = body.to_principal(motion.states.momentum) if isinstance(body, TensorBody) else motion.momenta
    return np.asarray(momenta, float)


def _draw(axes: Any, points: np.ndarray, semi_axes: np.ndarray, moments: np.ndarray, name: str, colour: str) -> None:
    from .ellipsoid import draw_curve, draw_dot, draw_ellipsoid, shade_of
    from .labels3d import name_point

    drawn = shade_of(axes)
    if drawn is None:
        draw_ellipsoid(axes, semi_axes)
        _background(axes, semi_axes, moments)
    elif drawn.semi_axes.shape != semi_axes.shape or np.max(np.abs(drawn.semi_axes / semi_axes - 1)) > _SAME / 2:
        raise ValueError(
            "the kinetic energy of path, or its body, is not that of the ellipsoid on these axes; draw it on others."
        )
    else:
        semi_axes = drawn.semi_axes
    draw_curve(axes, points, semi_axes, color=colour, linewidth=1.8, label=name)
    draw_dot(axes, points[0], semi_axes, colour)
    name_point(axes, points[0], f"{name}, start", colour)


def _background(axes: Any, semi_axes: np.ndarray, moments: np.ndarray) -> None:
    """Draws other polhodes of this energy, the separatrix and the axes of the body."""
    from .ellipsoid import draw_curve
    from .labels3d import name_point

    for curve, bold in polhodes(moments):
        style = {"linewidth": 1.2, "alpha": 1.0} if bold else {"linewidth": 0.6, "alpha": 0.8}
        draw_curve(axes, curve * semi_axes, semi_axes, color=GREY, **style)
    reach = 0.18 * float(np.max(semi_axes))
    for number, (direction, size) in enumerate(zip(np.eye(3), semi_axes, strict=True)):
        tip = (size + reach) * direction
        axes.plot(*np.stack([size * direction, tip]).T, color=GREY, linewidth=1.2)
        name_point(axes, tip, f"e{number + 1}, moment {moments[number]:.4g}", GREY)


def polhodes(moments: np.ndarray) -> list[tuple[np.ndarray, bool]]:
    """Polhodes of one energy, and whether each belongs to the separatrix, as points u (181, 3) with |u| = 1.

    The momentum is sqrt(2T I) u. Its square over 2T is sum(I u^2), between the smallest moment a and the largest c. The
    polhodes with a square below the middle moment b go around axis a, those above it around axis c; at b itself there
    are two ellipses through axis b.
    """
    a, b, c = np.argsort(moments)
    low, middle, high = moments[[a, b, c]]
    angle = np.linspace(0, 2 * np.pi, 181)
    found: list[tuple[np.ndarray, bool]] = []
    if high - low < 1e-9 * high:
        return found

    def around(axis: Any, others: tuple[Any, Any], rest: float) -> None:
        """The polhodes with sum(I u^2) = moments[axis] + rest, at both ends of the axis."""
        u = np.zeros((len(angle), 3))
        for other, function in zip(others, (np.cos, np.sin), strict=True):
            gap = moments[other] - moments[axis]
            u[:, other] = np.sqrt(rest / gap) * function(angle) if gap else 0.0
        u[:, axis] = np.sqrt(np.maximum(1 - np.sum(u**2, axis=1), 0.0))
        mirror = np.ones(3)
        mirror[axis] = -1
        found.extend([(u, False), (u * mirror, False)])

    for share in _FAMILY:
        if middle - low > 1e-9 * high:
            around(a, (b, c), share**2 * (middle - low))
        if high - middle > 1e-9 * high:
            around(c, (a, b), -(share**2) * (high - middle))
    if middle - low > 1e-9 * high and high - middle > 1e-9 * high:
        # sum (I - b) u^2 = 0: u_c = +- slope u_a.
        slope = np.sqrt((middle - low) / (high - middle))
        for sign in (1, -1):
            u = np.zeros((len(angle), 3))
            u[:, b] = np.cos(angle)
            u[:, a], u[:, c] = np.sin(angle) / np.hypot(1, slope), sign * slope * np.sin(angle) / np.hypot(1, slope)
            found.append((u, True))
    return found
