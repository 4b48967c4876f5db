"""Shadows: by hand where an edge is straight, by ray tracing where a shape is not, and in runs and derivatives."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import surfaces as shadows
from test_surface import STILL, TETRAHEDRON, unit

import midlie_jax as ml
from midlie_jax.model import so3

LAW = shadows.LAW


def grid_box(lengths, divisions, centre=(0.0, 0.0, 0.0)):
    """A box of triangles, each face in divisions along its edges."""
    squares = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, divisions[axis]):
            for a, b in np.ndindex(divisions[i], divisions[j]):
                square = np.full((4, 3), end)
                square[:, i], square[:, j] = a + np.array([0, 1, 1, 0]), b + np.array([0, 0, 1, 1])
                squares.append(square if end else square[::-1])
    points, index = np.unique(np.reshape(squares, (-1, 3)), axis=0, return_inverse=True)
    square = index.reshape(-1, 4)
    vertices = (points / divisions - 0.5) * lengths + centre
    return ml.Surface(vertices, np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]]))


@partial(jax.jit, static_argnames="law")
def seen(surface, sun, observer, law=LAW, state=STILL, albedo=1.0):
    return ml.asteroids.Brightness(surface, sun, observer, law, albedo=albedo)(0.0, state)


quiet = pytest.mark.filterwarnings("ignore:this surface is not convex")
WIDE = 20.0


def wall_and_floor():
    """A floor from x = 0 to 1, and a wall of height 1/2 at x < 0, four times as wide."""
    floor = grid_box([1.0, WIDE, 0.1], [20, 1, 1], [0.5, 0.0, -0.05])
    return floor + grid_box([0.2, 4 * WIDE, 0.6], [1, 1, 1], [-0.1, 0.0, 0.2])


@quiet
def test_a_wall_casts_the_shadow_of_its_height():
    """Its length on the floor is h / tan(elevation), so a Lambert floor seen from above loses width times h cos."""
    plain = wall_and_floor()
    surface = plain.with_shadows()
    law = ml.asteroids.Lambert()

    def lost(elevation):
        sun = jnp.stack([-jnp.cos(elevation), jnp.zeros_like(elevation), jnp.sin(elevation)])
        return seen(plain, sun, [0.0, 0.0, 1.0], law) - seen(surface, sun, [0.0, 0.0, 1.0], law)

    elevations = jnp.linspace(0.5, 1.5, 21)
    exact = WIDE * 0.5 * jnp.cos(elevations)
    losses, slopes = jax.jit(jax.vmap(jax.value_and_grad(lost)))(elevations)
    np.testing.assert_allclose(losses, exact, atol=0.01 * WIDE)
    assert float(jnp.mean(slopes)) == pytest.approx(float(jnp.mean(-WIDE * 0.5 * jnp.sin(elevations))), rel=0.1)


FREE = ml.FreeState(jnp.zeros(3), STILL.attitude, jnp.array([1.0, 0.0, 0.0]), jnp.zeros(3))
RADIUS = 0.7  # of the smaller ball
FREE_BODY = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), 1.0)


def dragged(surface, state=FREE):
    return ml.spacecraft.FreeMolecularDrag(surface, 1.0).on(FREE_BODY)(0.0, state).force


@quiet
@pytest.mark.parametrize("by", ["light", "wind"])
def test_two_parallel_plates_take_half_the_force_of_two(by):
    plate = grid_box([0.01, 1.0, 1.0], [1, 2, 2])
    plates = plate + plate.moved([0.5, 0.0, 0.0])
    for surface, force in ((plates, -2.0), (plates.with_shadows(), -1.0)):
        sunlight = ml.asteroids.Sunlight(surface, [1.0, 0.0, 0.0], 1.0, speed_of_light=1.0)
        found = dragged(surface) if by == "wind" else sunlight(0.0, FREE).force
        np.testing.assert_allclose(found, [force, 0, 0], atol=1e-12)


@quiet
def test_the_drag_of_two_balls_is_that_of_their_outline():
    """In a cold gas rho v^2 times the area of two circles without the lens in which they overlap."""
    pytest.importorskip("trimesh")
    angle = 0.3
    large, small = (shadows.stretched(2, lambda v, r=r: np.full(len(v), r)) for r in (1.0, RADIUS))
    ahead = jnp.array([jnp.cos(angle), jnp.sin(angle), 0.0])
    apart = 2.5 * np.sin(angle)
    x = (apart**2 + 1 - RADIUS**2) / (2 * apart)
    lens = np.arccos(x) + RADIUS**2 * np.arccos((apart - x) / RADIUS) - apart * np.sqrt(1 - x**2)
    state = ml.FreeState(FREE.momentum, FREE.attitude, ahead, FREE.position)
    alone = -dragged(large, state) @ ahead / np.pi  # of a polyhedron
    found = -dragged((large.moved([2.5, 0.0, 0.0]) + small).with_shadows(), state) @ ahead / alone
    np.testing.assert_allclose(found, np.pi * (1 + RADIUS**2) - lens, rtol=0.015)


def test_light_passes_below_what_hangs_over_a_facet():
    """A roof of half a tunnel keeps the steep sun off the floor, and not the low one that shines in from its side."""
    floor = grid_box([1.0, 1.0, 0.1], [8, 8, 1], [0.0, 0.0, -0.05])
    tunnel = (floor + grid_box([1.0, 1.0, 0.1], [8, 8, 1], [0.0, 0.0, 1.05])).with_shadows()
    lit = []
    for elevation in (1.4, 0.3):
        sun = jnp.array([jnp.cos(elevation), 0.0, jnp.sin(elevation)])
        floor_alone = jnp.asarray((tunnel.normals[:, 2] > 0.5) & (tunnel.centroids[:, 2] < 0.5), float)
        lit.append(seen(tunnel, sun, sun, ml.asteroids.Lambert(), albedo=floor_alone) / sun[2] ** 2)
    np.testing.assert_allclose(lit, [1 / np.tan(1.4), 1.0], atol=0.03)


def test_a_surface_that_is_not_convex_gives_a_warning_without_shadows():
    """One that is convex gives none, and the same brightness with shadows."""
    surface, convex = wall_and_floor(), ml.Surface(*TETRAHEDRON)
    assert convex.is_convex
    assert not surface.is_convex
    for make in (
        lambda x: ml.asteroids.Brightness(x, [1.0, 0, 0], [1.0, 0, 0], LAW),
        lambda x: ml.asteroids.Sunlight(x, [1.0, 0, 0], 1.0),
        lambda x: ml.spacecraft.FreeMolecularDrag(x, 1.0, [1.0, 0, 0]),
    ):
        with pytest.warns(UserWarning, match=r"use surface.with_shadows\(\)"):
            make(surface)
        make(surface.with_shadows(8))  # a warning is an error here
        make(convex)
    directions = np.random.default_rng(3).normal(size=(20, 2, 3))
    directions = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), 1, 0)
    own, shadowed = (shadows.light_curve(x, *directions) for x in (convex, convex.with_shadows()))
    np.testing.assert_allclose(own, shadowed, rtol=1e-13)
    with pytest.raises(ValueError, match="every part of the surface of vertices"):
        ml.Surface.box([1.0, 2.0, 3.0]).with_shadows()
    with pytest.raises(ValueError, match="outside jit"):
        jax.jit(lambda x: x.with_shadows())(surface)


@quiet
@pytest.mark.parametrize(("name", "most"), list(zip(shadows.SHAPES, (0.01, 0.02, 0.03, 0.03), strict=True)))
def test_a_light_curve_is_that_of_rays(name, most):
    """To a hundredth of a magnitude, or to an eighth of what shadows change where that is more."""
    pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    plain = shadows.SHAPES[name]()
    for without, own in shadows.errors(name, plain, plain.with_shadows()).values():
        assert own < most
        assert own < max(0.01, without / 8)


@quiet
def test_shadows_go_with_the_surface():
    plain = wall_and_floor().centred()
    surface = plain.with_shadows()
    turn = so3.exp(jnp.array([0.3, -0.9, 0.4]))
    sun, observer = unit(-0.6, 0.3, 0.5), unit(-0.2, 0.1, 1.0)
    value = seen(surface, sun, observer)
    assert abs(value / seen(plain, sun, observer) - 1) > 0.05
    back = ml.RigidState(jnp.zeros(3), so3.conjugate(turn))
    np.testing.assert_allclose(seen(surface.turned(turn), sun, observer, state=back), value, rtol=1e-12)
    np.testing.assert_allclose(seen(surface.moved([3.0, 2.0, 1.0]), sun, observer), value, rtol=1e-12)
    again = plain.principal(1.0)[1].with_shadows(), surface.principal(1.0)[1]
    np.testing.assert_allclose(*(seen(x, sun, observer) for x in again), rtol=0.02)
    first, second = wall_and_floor(), grid_box([1.0, 1.0, 1.0], [1, 1, 1], [30.0, 0, 0])
    both, parts = (first.with_shadows(16) + second), (first + second).with_shadows(16)
    np.testing.assert_array_equal(both.horizon.top, parts.horizon.top)


@quiet
def test_the_torque_of_light_with_shadows_has_the_derivative_of_differences():
    surface = wall_and_floor().centred().with_shadows()
    light = ml.asteroids.Sunlight(surface, unit(-0.6, 0.3, 0.5), 1.0, 0.1, 0.2, 0.5, speed_of_light=1.0)

    @jax.jit
    def torque(turn):
        return light(0.0, ml.RigidState(jnp.zeros(3), so3.exp(turn))) @ jnp.array([0.3, 1.0, 2.0])

    turn = jnp.array([0.2, 0.4, -0.4])
    found = [(torque(turn + s) - torque(turn - s)) / 2e-6 for s in 1e-6 * jnp.eye(3)]
    np.testing.assert_allclose(jax.jit(jax.grad(torque))(turn), found, rtol=1e-5, atol=1e-5)
