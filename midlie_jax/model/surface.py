"""`Surface`: the facets of a body and the enclosed solid; and what forces on facets and their brightness share."""

import warnings
from collections.abc import Callable
from functools import reduce
from itertools import combinations_with_replacement, permutations
from math import factorial
from os import PathLike
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import (
    as_count,
    as_finite,
    as_floats,
    as_function_of_time,
    as_not_negative,
    as_positive,
    described,
    is_unit,
    require,
    require_rows,
    same_dtype,
    vector_at,
)
from .._math import components as cp
from .._math.powers import unit as unit_of
from . import so3
from .bodies import RigidBody, TensorBody
from .polyhedra import Horizon, Solid, as_faces, horizon_of, open_sky, read_mesh, require_area, solid_of, sphere
from .state import AnyState, Time, require_all_directions

_FACES_OF_BOX = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
_CENTRED = 1e-5  # the largest distance of the origin from the centre of mass, in radii of gyration


class Surface(eqx.Module):
    """Flat facets of a body, convex or not: for light curves, sunlight and air drag.

    Facets shadow each other only after `with_shadows`, and light is scattered once. Vertices and lengths may be traced.

    Attributes:
        areas: of the facets, (n,), length^2.
        normals: outward unit vectors, body frame, (n, 3). A facet has one side.
        centroids: their centres of area, body frame, (n, 3), length.
        solid: volume, centre of mass and second moments of the interior; None for open panels (`of_facets`).
        corners: of the triangles, body frame, (n, 3, 3), length; None where facets are not triangles.
        horizon: what the surface hides from its facets; None without `with_shadows`.

    Args:
        vertices: body frame, (v, 3), length.
        faces: the triangles, (n, 3) vertex indices from 0, counterclockwise from outside.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, a face without area, a surface that is not closed, not
            consistently oriented, or inside out. Self-intersection is not checked.

    Examples:
        >>> box = ml.Surface.box([0.1, 0.1, 0.3])
        >>> body, surface = box.principal(density=1000.0)  # moments ascending, and the same box in that frame
        >>> body.moments.round(6)
        Array([0.005, 0.025, 0.025], dtype=float64)
    """

    areas: Float[Array, " n"]
    normals: Float[Array, "n 3"]
    centroids: Float[Array, "n 3"]
    solid: Solid | None
    corners: Float[Array, "n 3 3"] | None
    horizon: Horizon | None

    def __init__(self, vertices: Any, faces: Any):
        vertices = as_finite("vertices", vertices, (3,))
        if vertices.ndim != 2:
            raise ValueError(f"vertices must be (v, 3), got {vertices.shape}; map over several surfaces with jax.vmap.")
        corners = vertices[as_faces(faces, len(vertices))]
        edges = corners[:, 1:] - corners[:, :1]
        unit, per_unit = unit_of(jnp.max(jnp.abs(edges)))
        doubled = jnp.cross(per_unit * edges[:, 0], per_unit * edges[:, 1])
        length = jnp.linalg.norm(doubled, axis=-1)
        if not cp.is_traced(length):
            require_area(np.asarray(length))
        self.areas, self.normals = length / 2 * unit * unit, doubled / length[:, None]
        self.centroids = jnp.mean(corners, axis=1)
        self.solid, self.corners, self.horizon = solid_of(corners), corners, None
        cure = "reverse every face: faces[:, ::-1]."
        require("faces", self.solid.volume, lambda v: v > 0, "must be counterclockwise from outside: the volume", cure)

    @classmethod
    def _of(
        cls, areas: Any, normals: Any, centroids: Any, solid: Any, corners: Any = None, horizon: Any = None
    ) -> "Surface":
        surface = object.__new__(cls)
        vars(surface).update(
            areas=areas, normals=normals, centroids=centroids, solid=solid, corners=corners, horizon=horizon
        )
        return surface

    def _with(self, **changes: Any) -> "Surface":
        return self._of(**{**vars(self), **changes})

    @classmethod
    def of_facets(cls, areas: Any, normals: Any, centroids: Any) -> "Surface":
        """Facets that need not be closed, such as the panels of a satellite; the normal defines the side.

        Args:
            areas: (n,), length^2, not negative; a ValueError for other shapes, signs or lengths of normals.
            normals, centroids: unit vectors and lengths, body frame, (n, 3).
        """
        areas = as_not_negative("areas", areas, cure="the normal defines the side of a facet.")
        normals, centroids = as_floats("normals", normals, (3,)), as_finite("centroids", centroids, (3,))
        if areas.ndim != 1 or not len(areas) or not normals.shape == centroids.shape == (*areas.shape, 3):
            shapes = f"{areas.shape}, {normals.shape} and {centroids.shape}"
            raise ValueError(f"areas must be (n,), normals and centroids (n, 3), got {shapes}.")
        same_dtype("areas", areas, normals=normals, centroids=centroids)
        require_rows("normals", normals, is_unit, "must be unit vectors", "divide them by their norms.")
        return cls._of(areas, normals, centroids, None)

    @classmethod
    def from_file(cls, path: str | PathLike[str], scale: Any = 1.0, *, repair: bool = False) -> "Surface":
        """A closed surface of triangles from a file: a table of DAMIT or PDS, OBJ, STL, PLY or another of trimesh.

        A table is text: the numbers of vertices and faces, then the vertices and the faces, numbered from 0 or 1. Each
        number may also come before its rows, rows may begin with their index, or with v and f.

        Args:
            path: of the file. Coincident vertices are merged, except in tables.
            scale: factor for lengths, such as 1e3 for a file in kilometres.
            repair: whether faces that are double or have no area are removed, holes of three or four edges are
                filled, and faces are oriented outwards.

        Raises:
            ImportError: trimesh is needed, but not installed: pip install 'midlie_jax[surfaces]'.
            ValueError: the file cannot be read, it holds no triangles, or as for the class.
        """
        factor = as_positive("scale", scale)
        vertices, faces = read_mesh(path, repair)
        return cls(factor * jnp.asarray(vertices, factor.dtype), faces)

    @classmethod
    def ellipsoid(cls, semi_axes: Any, facets: int = 1280) -> "Surface":
        """An ellipsoid along the axes of the frame, made of tangent facets.

        The facets divide the unit sphere nearly evenly and are stretched with it. Each has the vector area of its part
        of the ellipsoid. Volume, centre and inertia are exact; the visible area converges with the number of facets.

        Args:
            semi_axes: (3,), length, positive.
            facets: the least number of facets; 20 k^2 are made, for the smallest k.
        """
        axes = _lengths("semi_axes", semi_axes)
        directions, angles = (jnp.asarray(x, axes.dtype) for x in sphere(as_count("facets", facets)))
        unit, per_unit = unit_of(jnp.max(axes))
        relative = per_unit * axes
        product = relative[0] * relative[1] * relative[2]
        vectors = product * angles[:, None] * directions / relative[None, :]
        areas = jnp.linalg.norm(vectors, axis=-1)
        solid = Solid(4 / 3 * np.pi * product, jnp.zeros_like(axes), jnp.diag(relative**2 / 5)).times(unit)
        return cls._of(areas * unit * unit, vectors / areas[:, None], directions * axes[None, :], solid)

    @classmethod
    def box(cls, lengths: Any) -> "Surface":
        """A box about the origin with these lengths of its edges, (3,), and 6 facets, at +x, -x, +y, -y, +z and -z.

        Raises a ValueError for lengths that are not positive or of another shape.
        """
        edges = _lengths("lengths", lengths)
        x, y, z = edges
        normals = jnp.asarray(_FACES_OF_BOX, edges.dtype)
        areas = jnp.repeat(jnp.stack([y * z, z * x, x * y]), 2)
        unit, per_unit = unit_of(jnp.max(edges))
        a, b, c = relative = per_unit * edges
        solid = Solid(a * b * c, jnp.zeros_like(edges), jnp.diag(relative**2 / 12)).times(unit)
        return cls._of(areas, normals, normals * edges[None, :] / 2, solid)

    @property
    def count(self) -> int:
        """The number of facets; a ValueError for a batch of surfaces."""
        if self.areas.ndim != 1 or self.normals.shape != (len(self.areas), 3) or self.centroids.ndim != 2:
            raise ValueError(f"a surface has areas (n,), got {self.areas.shape}; map over several with jax.vmap.")
        return len(self.areas)

    @property
    def is_convex(self) -> bool:
        """Whether no centroid is above another facet; a ValueError if traced."""
        normals, centroids = np.asarray(self.normals), np.asarray(self.centroids)
        most = 1e-4 * np.abs(centroids - centroids.mean(0)).max()
        blocks = (slice(i, i + 256) for i in range(0, self.count, 256))
        levels = np.sum(normals * centroids, axis=1)
        return all(np.all(normals[i] @ centroids.T <= levels[i, None] + most) for i in blocks)

    @property
    def volume(self) -> Float[Array, ""]:
        """The volume of the solid; a ValueError for open panels."""
        return self._inside().volume

    @property
    def centre_of_mass(self) -> Float[Array, "3"]:
        """The centre of mass of the homogeneous solid, (3,)."""
        return self._inside().centre

    def mass(self, density: Any) -> Float[Array, ""]:
        """Density times volume."""
        return as_positive("density", density) * self.volume

    def inertia(self, density: Any) -> Float[Array, "3 3"]:
        """The inertia tensor of the homogeneous solid about its centre of mass, (3, 3), mass length^2."""
        return self.mass(density) * self._inside().per_mass

    def moments(self, degree: int, density: Any) -> Array:
        """The integrals of x_i x_j ... over the mass, (3,) * degree, about the origin, such as for `MutualGravity`.

        Raises a ValueError if the density is not positive, or the surface is not of closed triangles.
        """
        if self.solid is None or self.corners is None:
            raise ValueError("moments need a closed surface of triangles; make every part of vertices and faces.")
        a, b, c = (self.corners[:, i] for i in range(3))
        six = jnp.sum(a * jnp.cross(b, c), axis=-1)
        axes = "ijkl"[: as_count("degree", degree)]
        product = f"n,{','.join('n' + i for i in axes)}->{axes}"
        total = sum(jnp.einsum(product, six, *some) for some in combinations_with_replacement((a, b, c), degree))
        orders = list(permutations(range(degree)))
        symmetric = sum(jnp.transpose(jnp.asarray(total), order) for order in orders) / len(orders)
        # For a tetrahedron from the origin: J. B. Lasserre, K. E. Avrachenkov, Am. Math. Mon. 108 (2001) 151.
        return as_positive("density", density) * (factorial(degree) / factorial(degree + 3)) * symmetric

    def body(self, density: Any) -> TensorBody:
        """The homogeneous body in the frame of the surface; a ValueError unless the origin is its centre of mass."""
        solid = self._inside()
        if not cp.is_traced(solid):
            centre, radius = np.asarray(solid.centre), np.sqrt(np.trace(np.asarray(solid.spread)))
            if np.linalg.norm(centre) > _CENTRED * radius:
                raise ValueError(
                    f"the origin must be the centre of mass, which is at {centre}; use surface.centred(), also for the "
                    "torques on the body."
                )
        return TensorBody(self.inertia(density))

    def principal(self, density: Any) -> tuple[RigidBody, "Surface"]:
        """The homogeneous body in its principal axes, moments ascending, and the surface in the same frame.

        The largest component of the first and the second axis in the old frame is positive, and the axes are
        right-handed. The origin is moved to the centre of mass. Where moments are equal, the axes have no derivative.
        """
        body, axes = RigidBody.from_tensor(self.inertia(density))
        largest = jnp.argmax(jnp.abs(axes), axis=0)
        signs = jnp.sign(axes[largest, jnp.arange(3)])
        signs = jnp.stack([signs[0], signs[1], signs[0] * signs[1]])  # `axes` is right-handed already
        return body, self.centred()._in_axes(axes * signs[None, :])

    def centred(self) -> "Surface":
        """The surface with the origin at its centre of mass."""
        return self.moved(-self.centre_of_mass)

    def moved(self, offset: Any) -> "Surface":
        """The surface moved by a vector, (3,)."""
        offset = as_finite("offset", offset, (3,))
        solid = None if self.solid is None else self.solid._replace(centre=self.solid.centre + offset)
        corners = None if self.corners is None else self.corners + offset[None, None, :]
        return self._with(centroids=self.centroids + offset[None, :], solid=solid, corners=corners)

    def turned(self, rotation: Any) -> "Surface":
        """The surface rotated about the origin by a unit quaternion (w, x, y, z), (4,)."""
        rotation = as_floats("rotation", rotation, (4,))
        require("rotation", rotation, is_unit, "must be a unit quaternion (w, x, y, z)", "divide it by its norm.")
        return self._in_axes(so3.to_matrix(rotation).T)

    def with_shadows(self, azimuths: int = 64) -> "Surface":
        """The surface whose facets shadow and hide each other, in light and in the wind of `FreeMolecularDrag`.

        Each facet gets a horizon: the elevations that the rest of the surface hides, at these azimuths. A facet
        is lit in part, smoothly. The shadows have no derivative with respect to the shape. Two gaps above each other at
        one azimuth count as hidden. A ValueError is raised if the facets are not triangles, or are traced.

        Args:
            azimuths: 64 for errors of about 0.02 magnitudes in shadows of 0.4 (docs/surfaces.md); fewer are not faster.
        """
        if self.corners is None:
            raise ValueError("shadows need triangles; make every part of the surface of vertices and faces.")
        if cp.is_traced(self.corners, self.normals):
            raise ValueError("shadows need concrete vertices; call with_shadows() outside jit, grad and vmap.")
        self.count  # noqa: B018  # no batch
        corners, normals = np.asarray(self.corners, float), np.asarray(self.normals, float)
        return self._with(horizon=horizon_of(corners, normals, as_count("azimuths", azimuths), self.areas.dtype))

    def __add__(self, other: "Surface") -> "Surface":
        """Both surfaces together, closed if both are. They must not overlap. With shadows if one of them has them."""
        if not isinstance(other, Surface):
            return NotImplemented

        def joined(name: str) -> Array:
            return jnp.concatenate([getattr(self, name), getattr(other, name)])

        both = None if self.solid is None or other.solid is None else self.solid.joined(other.solid)
        corners = None if self.corners is None or other.corners is None else joined("corners")
        union = self._of(joined("areas"), joined("normals"), joined("centroids"), both, corners=corners)
        tables = [surface.horizon.top for surface in (self, other) if surface.horizon is not None]
        return union.with_shadows(max(table.shape[1] - 1 for table in tables)) if tables else union

    def _in_axes(self, axes: Array) -> "Surface":
        solid = self.solid
        if solid is not None:
            solid = Solid(solid.volume, solid.centre @ axes, axes.T @ solid.spread @ axes)
        corners = None if self.corners is None else self.corners @ axes
        horizon = None if self.horizon is None else self.horizon._replace(across=self.horizon.across @ axes)
        return self._of(self.areas, self.normals @ axes, self.centroids @ axes, solid, corners, horizon)

    def _inside(self) -> Solid:
        if self.solid is None:
            raise ValueError("volume and inertia need a closed surface, made of faces; this one has open panels.")
        return self.solid


Direction = Array | Callable[[Any], Array]


def as_direction(name: str, value: Any) -> Direction:
    direction = as_function_of_time(name, value)
    if not callable(direction):
        cure = "divide it by its norm; give a position as a function of time."
        require(name, direction, is_unit, "must be a unit vector", cure)
    return direction


def seen_from_body(name: str, direction: Direction, t: Time, state: AnyState) -> cp.Vector:
    if not callable(direction):
        return state.seen_from_body(cp.vector(direction))
    vector = cp.vector(vector_at(name, direction, t))
    return require_all_directions(state).seen_from_body(cp.scale(cp.inverse_root(cp.dot(vector, vector)), vector))


def as_fractions(name: str, value: Any) -> Array:
    fraction = as_floats(name, value)
    require(name, fraction, lambda x: (x >= 0) & (x <= 1), "must be between 0 and 1", "give a fraction.")
    return fraction


def of_facets(name: str, value: Array, surface: Surface) -> Array:
    if value.shape not in ((), (surface.count,)):
        raise ValueError(f"{name} must be () or ({surface.count},), one for each facet, got {value.shape}.")
    return jnp.broadcast_to(value, (surface.count,))


def as_amount(name: str, value: Any) -> Array | Callable[[Any], Array]:
    return cast(Callable[[Any], Array], value) if callable(value) else as_not_negative(name, value)


def as_lit_surface(surface: Any) -> Surface:
    if not isinstance(surface, Surface):
        raise ValueError(f"surface must be a midlie_jax.Surface, got {described(surface)}.")
    if surface.corners is not None and surface.horizon is None and not cp.is_traced(surface) and not surface.is_convex:
        warnings.warn(
            "this surface is not convex, but its facets do not shadow each other; use surface.with_shadows().",
            stacklevel=3,
        )
    return surface


def with_horizon(columns: tuple[Array, ...], surface: Surface) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Columns with the horizon's behind them, and its tables; for `sum_over_rows` and `unshadowed`."""
    horizon = surface.horizon
    if horizon is None:
        return columns, ()
    return (*columns, *cp.vector(horizon.across), horizon.sharpness), tuple(
        table for table in (horizon.top, horizon.bottom) if table is not None
    )


def unshadowed(row: Any, columns: int, *directions: cp.Vector) -> Array | float:
    if len(row) == columns:
        return 1.0
    return reduce(jnp.minimum, [open_sky(row[columns:], direction, row[0:3]) for direction in directions])


def lit(cosine: Array) -> Array:
    return jnp.where(cosine > 0, cosine, jnp.zeros_like(cosine))


def _lengths(name: str, value: Any) -> Array:
    lengths = as_positive(name, value)
    if lengths.shape != (3,):
        raise ValueError(f"{name} must be (3,), got {lengths.shape}; map over several with jax.vmap.")
    return lengths
