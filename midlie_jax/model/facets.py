"""What forces on facets and their brightness share: directions, numbers per facet, and sums."""

import warnings
from collections.abc import Callable
from functools import reduce
from typing import Any, cast

import jax.numpy as jnp
from jax import Array

from .._checks.arguments import as_floats, as_function_of_time, as_not_negative, described, is_unit, require, vector_at
from .._math import components as cp
from .polyhedra import open_sky
from .state import AnyState, Time, require_all_directions
from .surface import Surface

Direction = Array | Callable[[Any], Array]


def as_direction(name: str, value: Any) -> Direction:
    direction = as_function_of_time(name, value)
    if not callable(direction):
        cure = "divide it by its norm; give a position as a function of time."
        require(name, direction, is_unit, "must be a unit vector", cure)
    return direction


def seen_from_body(name: str, direction: Direction, t: Time, state: AnyState) -> cp.Vector:
    """The unit vector in body components; the value of a function is normalised."""
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
    """The argument `surface`; with a warning if its facets should shadow each other, but do not."""
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
    """The fraction of a facet that sees all directions; `row` begins with the normal, its horizon at `columns`."""
    if len(row) == columns:
        return 1.0
    return reduce(jnp.minimum, [open_sky(row[columns:], direction, row[0:3]) for direction in directions])


def lit(cosine: Array) -> Array:
    return jnp.where(cosine > 0, cosine, jnp.zeros_like(cosine))
