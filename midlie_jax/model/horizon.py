"""`Horizon`: the part of the sky that a body hides from each of its facets, for shadows.

In the frame of a facet, with z along its normal, a direction (x, y, z) has the azimuth y / (|x| + |y|), continued to
all quadrants, and the elevation z / (|x| + |y| + |z|). Both need no angles, and a straight edge has no corner between
the axes. For each azimuth a horizon holds the top and the bottom of what is hidden, as one range of elevations. It is
exact for a body whose other parts rise from the horizon or hang over the facet; gaps between several are lost.

Four points of a facet do not have one horizon. Their mean is kept, with the width in which the facet passes from dark
to light. The lit fraction is therefore smooth, and has a derivative where a shadow moves over the facet.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp

_POINTS = np.array([[1 / 3, 1 / 3, 1 / 3], [2 / 3, 1 / 6, 1 / 6], [1 / 6, 2 / 3, 1 / 6], [1 / 6, 1 / 6, 2 / 3]])
_LEAST = 0.02  # the least width, in elevation; a degree
_FLAT = 1e-9  # the elevation of what does not rise
_BELOW, _OVER = -1.0, 2.0  # elevations below and above all of the sky
_GAP, _FEW = 0.1, 1e-3  # a lower gap, and one at fewer azimuths of all facets, is closed: it costs half the time
_TINY = 1e-12  # instead of zero as a divisor


class Horizon(NamedTuple):
    """What is hidden from each facet.

    Attributes:
        across: the direction of azimuth zero, a unit vector in the facet, (n, 3).
        sharpness: one over the width in elevation in which a facet passes from dark to light, (n,).
        top, bottom: elevations of what is hidden, at azimuths 0, 4/K, ... 4, (n, K + 1); None where nothing hangs over.
    """

    across: Array
    sharpness: Array
    top: Array
    bottom: Array | None


def horizon_of(corners: np.ndarray, normals: np.ndarray, azimuths: int, dtype: Any) -> Horizon:
    """The horizon of triangles (n, 3, 3) with normals (n, 3)."""
    across = np.cross(np.eye(3)[np.argmin(np.abs(normals), axis=1)], normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    least = 1e-7 * np.abs(corners - corners.mean((0, 1))).max()
    top, bottom = np.full((2, len(corners), azimuths), _BELOW)
    width = np.full(len(corners), _LEAST)
    for f, (normal, own) in enumerate(zip(normals, corners, strict=True)):
        above = np.flatnonzero(((corners - own.mean(0)) @ normal).max(1) > least)
        if len(above):
            frame = np.stack([across[f], np.cross(normal, across[f]), normal], axis=1)
            high, low = zip(
                *(_hidden((corners[above] - point) @ frame, azimuths) for point in _POINTS @ own), strict=True
            )
            top[f], bottom[f], width[f] = _together(np.array(high), np.array(low))
    closed = [np.concatenate([x, x[:, :1]], axis=1) for x in (top, bottom)]
    own, sharpness, highest, lowest = (jnp.asarray(x, dtype) for x in (across, 1 / width, *closed))
    return Horizon(own, sharpness, highest, lowest if np.mean(bottom > _GAP) > _FEW else None)


def _together(high: np.ndarray, low: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Top, bottom and width of a facet, from top and bottom at its points, (points, K)."""
    hidden = high > _FLAT
    some = hidden.any(0)
    if not some.any():
        return high[0], low[0], _LEAST
    high = np.where(hidden, high, -_LEAST / 2)
    # The smooth step of `open_sky` has the variance 1/20 of the square of its width.
    width = max(float(np.mean(np.sqrt(20) * high.std(0)[some])), _LEAST)
    hanging = hidden & (low > _FLAT)
    mean = np.sum(np.where(hanging, low, 0), axis=0) / np.maximum(hanging.sum(0), 1)
    bottom = np.where(2 * hanging.sum(0) >= np.maximum(hidden.sum(0), 1), mean, _BELOW - width)
    return np.where(some, high.mean(0), -width), bottom, width


def _hidden(corners: np.ndarray, azimuths: int) -> tuple[np.ndarray, np.ndarray]:
    """Top and bottom (K,) of what triangles (m, 3, 3) hide from the origin."""
    corners = corners[(corners[..., 2] > 0).any(1)]
    high, low = np.full((2, len(corners), azimuths), [[[-9.0]], [[9.0]]])
    for triangle, azimuth, elevation in _crossings(corners, azimuths):
        np.maximum.at(high, (triangle, azimuth), elevation)
        np.minimum.at(low, (triangle, azimuth), elevation)
    x, y = corners[..., 0], corners[..., 1]
    turns = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    over = ((turns > 0).all(1) | (turns < 0).all(1)) & (np.sum(normal * corners[:, 0], axis=1) * normal[:, 2] > 0)
    high[over] = _OVER
    rises = high > _FLAT
    top = np.max(np.where(rises, high, _BELOW), axis=0, initial=_BELOW)
    bottom = np.min(np.where(rises, low, 9.0), axis=0, initial=9.0)
    return top, np.where(bottom > _FLAT, bottom, _BELOW)


def _crossings(corners: np.ndarray, azimuths: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For the edges of triangles: triangle, azimuth and elevation, where an edge crosses one of the azimuths."""
    azimuth = np.arange(azimuths) * (4 / azimuths)
    across = np.abs(azimuth - 2) - 1, np.abs((azimuth + 3) % 4 - 2) - 1  # x and y, |x| + |y| = 1
    place = _azimuth(corners[..., 0], corners[..., 1])
    for i in range(3):
        a, b = corners[:, i], corners[:, i - 2]
        span = (place[:, i - 2] - place[:, i] + 2) % 4 - 2
        begin = np.minimum(place[:, i], place[:, i] + span) * (azimuths / 4)
        first = np.ceil(begin).astype(int)
        count = np.maximum(np.floor(begin + np.abs(span) * (azimuths / 4)).astype(int) - first + 1, 0)
        edge = np.repeat(np.arange(len(a)), count)
        k = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)) % azimuths
        left, right = (across[0][k] * v[edge, 1] - across[1][k] * v[edge, 0] for v in (a, b))
        part = np.clip(left / np.where(left == right, 1, left - right), 0, 1)
        point = a[edge] + part[:, None] * (b - a)[edge]
        yield edge, k, point[:, 2] / np.maximum(np.abs(point).sum(1), _TINY)


def _azimuth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    slope = y / np.maximum(np.abs(x) + np.abs(y), np.finfo(float).tiny)
    return np.where(x < 0, 2 - slope, slope % 4)


def open_sky(row: Any, direction: cp.Vector, normal: cp.Vector) -> Array:
    """The fraction of a facet that sees a direction of any length above its plane, in the body frame.

    `row` has the columns and the tables of the horizon: across, sharpness, top, and bottom unless it is None.
    """
    across, sharpness, *tables = row[0:3], *row[3:]
    x, y, z = cp.dot(across, direction), cp.dot(cp.cross(normal, across), direction), cp.dot(normal, direction)
    size = jnp.maximum(jnp.abs(x) + jnp.abs(y), _TINY)
    slope, elevation = y / size, z / (size + jnp.abs(z))
    last = tables[0].shape[0] - 2
    place = jnp.where(x < 0, 2 - slope, jnp.where(y < 0, 4 + slope, slope)) * ((last + 1) / 4)
    index = jnp.clip(place.astype(jnp.int32), 0, last)
    part = place - index.astype(place.dtype)
    edges = [_at(table, index) * (1 - part) + _at(table, index + 1) * part for table in tables]
    below, *above = (sign * (edge - elevation) for edge, sign in zip(edges, (1, -1), strict=False))
    hidden = _step(below * sharpness + 0.5)
    return 1 - (hidden * _step(above[0] * sharpness + 0.5) if above else hidden)


def _at(table: Array, index: Array) -> Array:
    return table.at[index].get(mode="promise_in_bounds")


def _step(u: Array) -> Array:
    u = jnp.clip(u, 0, 1)
    return u * u * (3 - 2 * u)
