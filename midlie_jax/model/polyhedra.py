"""Polyhedra: files, integrals over the volume, checks of the faces, and directions spread over the sphere."""

from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import combinations, product
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import in_wider, require
from .._math import components as cp
from .._math.powers import unit

_NAMED = 3  # the most edges or faces that a message names


class Solid(NamedTuple):
    """The interior of a closed surface: volume, centre of mass, and the mean of y y^T about it, (3, 3)."""

    volume: Array
    centre: Array
    spread: Array

    @property
    def per_mass(self) -> Array:
        return jnp.trace(self.spread) * jnp.eye(3, dtype=self.spread.dtype) - self.spread

    def times(self, length: Array) -> "Solid":
        """The solid scaled by `length`; a ValueError if the dtype cannot hold its volume."""
        volume = self.volume * length * length * length
        limits = np.finfo(volume.dtype)
        cure = in_wider(volume.dtype, "use another unit of length")
        held = f"must enclose a volume of {limits.tiny:.0e} to {limits.max:.0e} in {volume.dtype}"
        require("surface", volume, lambda v: (np.abs(v) > limits.tiny) & (np.abs(v) <= limits.max), held, cure)
        return Solid(volume, self.centre * length, self.spread * length * length)

    def joined(self, other: "Solid") -> "Solid":
        volume = self.volume + other.volume
        centre = (self.volume * self.centre + other.volume * other.centre) / volume
        shares = ((s.spread + _outer(s.centre - centre)) * (s.volume / volume) for s in (self, other))
        return Solid(volume, centre, sum(shares, start=jnp.zeros_like(self.spread)))


def _outer(v: Array) -> Array:
    return v[:, None] * v[None, :]


def solid_of(corners: Array) -> Solid:
    """The interior of triangles (n, 3, 3), counterclockwise from outside: tetrahedra from one interior point."""
    inside = jnp.mean(corners, axis=(0, 1))
    x = corners - inside[None, None, :]
    length, per_length = unit(jnp.max(jnp.abs(x)))  # a power of two, so fifth powers stay in range
    x = per_length * x
    six = jnp.sum(x[:, 0] * jnp.cross(x[:, 1], x[:, 2]), axis=-1)  # 6 times the volume of a tetrahedron
    total = jnp.sum(x, axis=1)
    volume = jnp.sum(six) / 6
    centre = jnp.sum(six[:, None] * total, axis=0) / (24 * volume)
    squares = jnp.einsum("nki,nkj->nij", x, x) + total[:, :, None] * total[:, None, :]
    spread = jnp.sum(six[:, None, None] * squares, axis=0) / (120 * volume)
    solid = Solid(volume, centre, spread - _outer(centre)).times(length)
    return solid._replace(centre=inside + solid.centre)


def as_faces(value: Any, vertices: int) -> np.ndarray:
    try:
        faces = np.asarray(value)
    except jax.errors.TracerArrayConversionError as error:
        raise ValueError("faces must be concrete integers; only vertices may be traced by jit or grad.") from error
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(
            f"faces must be integers (n, 3), got {faces.dtype} {faces.shape}; divide larger faces into triangles."
        )
    if faces.min() < 0 or faces.max() >= vertices:
        raise ValueError(
            f"faces must name vertices 0 to {vertices - 1}, got {faces.min()} to {faces.max()}; OBJ files count from 1."
        )
    edges = Counter((int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True))
    twice = [edge for edge, count in edges.items() if count > 1]
    if twice:
        raise ValueError(
            f"faces must be oriented consistently, but {len(twice)} edges occur twice in the same "
            f"direction: {_named(twice)}; reverse some faces (b, a, c), or remove duplicates."
        )
    alone = [(a, b) for a, b in edges if (b, a) not in edges]
    if alone:
        raise ValueError(
            f"faces must close the surface, but {len(alone)} edges belong to one face only: "
            f"{_named(alone)}; fill holes and merge vertices, or use Surface.of_facets for open "
            "panels."
        )
    return faces


def require_area(areas: np.ndarray) -> None:
    flat = np.flatnonzero(~(areas > 0))
    if len(flat):
        raise ValueError(f"faces must have an area, but {len(flat)} have none: {_named(flat.tolist())}; remove them.")


def _named(items: list[Any]) -> str:
    return ", ".join(map(str, items[:_NAMED])) + (", ..." if len(items) > _NAMED else "")


@cache
def sphere(least: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions spread over the unit sphere, (n, 3), and their solid angles, (n,); n = 20 k^2 is at least `least`."""
    k = 1
    while 20 * k * k < least:
        k += 1
    golden = (1 + 5**0.5) / 2
    points = [np.roll([0, a, b * golden], i) for i in range(3) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    found = []
    for a, b, c in combinations(points, 3):
        if all(abs(np.linalg.norm(x - y) - 2) < 1e-9 for x, y in ((a, b), (b, c), (c, a))):
            found.extend(_divided(a, b, c, k))
    corners = np.array(found)
    corners /= np.linalg.norm(corners, axis=-1, keepdims=True)
    centres = corners.sum(1)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    # The solid angle of a triangle (A. van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125).
    volume = np.abs(np.sum(a * np.cross(b, c), axis=-1))
    angles = 2 * np.arctan2(volume, 1 + np.sum(a * b + b * c + c * a, axis=-1))
    return centres / np.linalg.norm(centres, axis=-1, keepdims=True), angles


def _divided(a: np.ndarray, b: np.ndarray, c: np.ndarray, k: int) -> list[list[np.ndarray]]:
    def at(i: int, j: int) -> np.ndarray:
        return a + (b - a) * (i / k) + (c - a) * (j / k)

    upright = [[at(i, j), at(i + 1, j), at(i, j + 1)] for i in range(k) for j in range(k - i)]
    return upright + [[at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)] for i in range(k) for j in range(k - i - 1)]


_TABLES = {".txt", ".tab", ".tbl", ".dat", ".plt", ".ver", ".shape", ".asc", ".mod", ".wf"}


def read_mesh(path: str | PathLike[str], repair: bool) -> tuple[np.ndarray, np.ndarray]:
    table = _table(path) if Path(path).suffix.lower() in _TABLES else None
    if table is not None and not repair:
        return table
    try:
        import trimesh
    except ImportError as error:
        raise ImportError("reading a surface needs trimesh: pip install 'midlie_jax[surfaces]'.") from error
    try:
        mesh: Any = trimesh.load_mesh(str(path)) if table is None else trimesh.Trimesh(*table, process=False)
    except NotImplementedError as error:
        raise ValueError(f"trimesh cannot read {path}: {error}; give an OBJ, STL or PLY file.") from error
    if not len(getattr(mesh, "faces", ())):
        raise ValueError(f"{path} holds no triangles; give the file of a surface.")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if repair:
        mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces())
        trimesh.repair.fix_winding(mesh)
        mesh.fill_holes()
        trimesh.repair.fix_normals(mesh, multibody=True)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _table(path: str | PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    lines = [line.split("#")[0].replace(",", " ").split() for line in Path(path).read_text().splitlines()]
    lines = [line for line in lines if line]
    try:
        if lines and lines[0][0] in "vf":
            vertices, faces = (np.array([row[1:4] for row in lines if row[0] == name], float) for name in "vf")
        else:
            vertices, faces = _counted(lines)
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path} is no table of vertices and faces; give an OBJ, STL or PLY file.") from error
    return vertices, faces.astype(int) - min(1, int(faces.min()))  # each vertex belongs to a face: the least is 0 or 1


def _counted(lines: list[list[str]]) -> Any:
    numbers = np.array([word for line in lines for word in line], float)
    together = len(lines[0]) == 2
    vertices = int(numbers[0])
    # A row of four begins with its index, or with the number of corners.
    for width, corners in product((3, 4), repeat=2):
        begin = 1 + together
        end = begin + width * vertices
        faces = int(numbers[1] if together else numbers[end] if end < len(numbers) else -1)
        rest = end + (not together)
        if faces > 0 and len(numbers) == rest + corners * faces:
            rows = numbers[begin:end].reshape(-1, width), numbers[rest:].reshape(-1, corners)
            return rows[0][:, -3:], rows[1][:, -3:]
    raise ValueError("the numbers of rows do not fit")


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
    x, y = corners[..., 0], corners[..., 1]
    slope = y / np.maximum(np.abs(x) + np.abs(y), np.finfo(float).tiny)
    place = np.where(x < 0, 2 - slope, slope % 4)
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


def open_sky(row: Any, direction: cp.Vector, normal: cp.Vector) -> Array:
    """The fraction of a facet that sees a direction above its plane; `row` has the columns and tables."""
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
