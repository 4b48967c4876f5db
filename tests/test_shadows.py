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

LAW, X = shadows.LAW, [1.0, 0.0, 0.0]


def grid_box(lengths, divisions, centre=(0.0, 0.0, 0.0)):
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
FREE_BODY = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), 1.0)


@quiet
@pytest.mark.parametrize("by", ["light", "wind"])
def test_two_parallel_plates_take_half_the_force_of_two(by):
    plate = grid_box([0.01, 1.0, 1.0], [1, 2, 2])
    plates = plate + plate.moved([0.5, 0.0, 0.0])
    for surface, force in ((plates, -2.0), (plates.with_shadows(), -1.0)):
        drag = ml.spacecraft.FreeMolecularDrag(surface, 1.0).on(FREE_BODY)
        push = drag if by == "wind" else ml.asteroids.Sunlight(surface, X, 1.0, speed_of_light=1.0)
        np.testing.assert_allclose(push(0.0, FREE).force, [force, 0, 0], atol=1e-12)


def test_light_passes_below_what_hangs_over_a_facet():
    """A roof of half a tunnel keeps the steep sun off the floor, and not the low one that shines in from its side."""
    floor, roof = (grid_box([1.0, 1.0, 0.1], [8, 8, 1], [0.0, 0.0, height]) for height in (-0.05, 1.05))
    tunnel = (floor + roof).with_shadows()
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
    given = (ml.asteroids.Brightness, [X, X, LAW]), (ml.asteroids.Sunlight, [X, 1.0])
    for kind, more in (*given, (ml.spacecraft.FreeMolecularDrag, [1.0, X])):
        with pytest.warns(UserWarning, match=r"use surface.with_shadows\(\)"):
            kind(surface, *more)
        kind(surface.with_shadows(8), *more)  # a warning is an error here
        kind(convex, *more)
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
