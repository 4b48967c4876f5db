"""Shadows: by hand where an edge is straight, by ray tracing where a shape is not, and in runs and derivatives."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_surface import STILL, TETRAHEDRON, unit

import midlie_jax as ml
from midlie_jax.model import so3


class DarkLaw(ml.asteroids.Scattering):
    """That of light curve inversion; without arrays, so that it is hashable."""

    def __call__(self, mu, mu0):
        return ml.asteroids.LommelSeeliger(0.1)(mu, mu0)


LAW = DarkLaw()


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


def dumbbell():
    """An oval of Cassini, turned about its long axis: two lobes with a thin neck."""
    return stretched(3, lambda v: np.sqrt(2 * v[:, 0] ** 2 - 1 + np.sqrt((2 * v[:, 0] ** 2 - 1) ** 2 + 0.0824)))


def cratered():
    random, holes = np.random.default_rng(1), []
    for _ in range(15):
        centre, size = random.normal(size=3), random.uniform(0.2, 0.5)
        holes.append((centre / np.linalg.norm(centre), size))

    def radius(v):
        angles = [(np.arccos(np.clip(v @ centre, -1, 1)) / size, size) for centre, size in holes]
        return 1 + sum(0.45 * size * (np.minimum(angle, 1) ** 2 - 1) for angle, size in angles)

    return stretched(3, radius)


def stretched(subdivisions, radius):
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions)
    vertices = np.asarray(ball.vertices)
    return ml.Surface(vertices * radius(vertices)[:, None], np.asarray(ball.faces))


def bowl():
    """Half of a hollow ball, open towards z."""
    trimesh = pytest.importorskip("trimesh")
    angles = np.linspace(0, np.pi / 2, 9)
    wall = [(r * np.sin(a), -r * np.cos(a)) for r, order in ((0.8, 1), (1.0, -1)) for a in angles[::order]]
    mesh = trimesh.creation.revolve(np.array(wall), sections=24)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    faces = np.asarray(mesh.faces)
    return ml.Surface(np.asarray(mesh.vertices), faces if mesh.volume > 0 else faces[:, ::-1])


def pair():
    """Two balls that touch."""
    first, second = (stretched(3, lambda v, r=r: np.full(len(v), r)) for r in (1.0, 0.7))
    return first.moved([-1.0, 0, 0]) + second.moved([0.7, 0, 0])


@partial(jax.jit, static_argnames=("law", "magnitude"))
def seen(surface, sun, observer, law=LAW, state=STILL, magnitude=False, albedo=1.0):
    light = ml.asteroids.Brightness(surface, sun, observer, law, magnitude=magnitude, albedo=albedo)
    return light(0.0, state)


@jax.jit
def light_curve(surface, suns, observers):
    return jax.vmap(lambda sun, observer: seen(surface, sun, observer, magnitude=True))(suns, observers)


quiet = pytest.mark.filterwarnings("ignore:this surface is not convex")
WIDE = 20.0


def wall_and_floor():
    """A floor from x = 0 to 1, and a wall of height 1/2 at x < 0, four times as wide."""
    floor = grid_box([1.0, WIDE, 0.1], [20, 1, 1], [0.5, 0.0, -0.05])
    return floor + grid_box([0.2, 4 * WIDE, 0.6], [1, 1, 1], [-0.1, 0.0, 0.2])


# By hand.


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


@quiet
def test_two_parallel_plates_take_half_the_force_of_two():
    plate = grid_box([0.01, 1.0, 1.0], [1, 2, 2])
    plates = plate + plate.moved([0.5, 0.0, 0.0])
    free = ml.FreeState(jnp.zeros(3), STILL.attitude, jnp.zeros(3), jnp.zeros(3))
    force = [
        ml.asteroids.Sunlight(x, [1.0, 0.0, 0.0], 1.0, speed_of_light=1.0)(0.0, free).force
        for x in (plates, plates.with_shadows())
    ]
    np.testing.assert_allclose(force, [[-2.0, 0, 0], [-1.0, 0, 0]], atol=1e-12)


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


def test_a_convex_surface_has_no_shadows_and_gives_no_warning():
    surface = ml.Surface(*TETRAHEDRON)
    directions = np.random.default_rng(3).normal(size=(20, 2, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    own, with_shadows = (light_curve(x, directions[:, 0], directions[:, 1]) for x in (surface, surface.with_shadows()))
    np.testing.assert_allclose(own, with_shadows, rtol=1e-13)
    assert surface.is_convex
    assert not wall_and_floor().is_convex


def test_a_surface_that_is_not_convex_gives_a_warning_without_shadows():
    surface = wall_and_floor()
    for make in (
        lambda x: ml.asteroids.Brightness(x, [1.0, 0, 0], [1.0, 0, 0], LAW),
        lambda x: ml.asteroids.Sunlight(x, [1.0, 0, 0], 1.0),
    ):
        with pytest.warns(UserWarning, match=r"use surface.with_shadows\(\)"):
            make(surface)
        make(surface.with_shadows(8))  # a warning is an error here
    with pytest.raises(ValueError, match="every part of the surface of vertices"):
        ml.Surface.box([1.0, 2.0, 3.0]).with_shadows()
    with pytest.raises(ValueError, match="outside jit"):
        jax.jit(lambda x: x.with_shadows())(surface)


# By ray tracing.

PHASES = (0, 30, 60, 90)  # degrees


def directions(phase, upright):
    """24 rotations about an axis, the Sun and the observer at other latitudes."""
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)

    def at(longitude, latitude):
        x, y = np.cos(longitude) * np.cos(latitude), np.sin(longitude) * np.cos(latitude)
        z = np.full_like(x, np.sin(latitude))
        return np.stack([x, y, z] if upright else [z, x, y], axis=-1)

    sun = at(turn, 0.4)
    return sun, at(turn + np.radians(phase), -0.2) if phase else sun


def points_of(k):
    """Barycentric coordinates of the centres of k^2 equal triangles in one."""
    upright = [((i + 1 / 3) / k, (j + 1 / 3) / k) for i in range(k) for j in range(k - i)]
    others = [((i + 2 / 3) / k, (j + 2 / 3) / k) for i in range(k) for j in range(k - i - 1)]
    points = np.array(upright + others)
    return np.concatenate([1 - points.sum(1, keepdims=True), points], axis=1)


def traced(surface, suns, observers, points):
    """Magnitudes by rays from points of each facet to the Sun and to the observer."""
    trimesh = pytest.importorskip("trimesh")
    corners, normals = np.asarray(surface.corners), np.asarray(surface.normals)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=False)
    start = points[None] @ corners + 1e-6 * normals[:, None]
    found = []
    for sun, observer in zip(suns, observers, strict=True):
        mu, mu0 = normals @ observer, normals @ sun
        open_ = np.repeat(((mu > 0) & (mu0 > 0))[:, None], len(points), axis=1)
        for way in (sun, observer):
            rays = np.nonzero(open_)
            open_[rays] = ~mesh.ray.intersects_any(start[rays], np.tile(way, (len(rays[0]), 1)))
        weights = np.asarray(surface.areas) * open_.mean(1)
        some = weights > 0
        found.append(np.sum(weights[some] * np.asarray(LAW(jnp.asarray(mu[some]), jnp.asarray(mu0[some])))))
    return -2.5 * np.log10(found)


SHAPES = {"dumbbell": (dumbbell, 0.02), "craters": (cratered, 0.01), "bowl": (bowl, 0.03), "pair": (pair, 0.03)}


@quiet
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", SHAPES)
def test_a_light_curve_is_that_of_rays(name):
    """To a thirtieth of what shadows change, or to a hundredth of a magnitude where that is more."""
    pytest.importorskip("embreex")
    make, most = SHAPES[name]
    plain = make()
    surface = plain.with_shadows()
    phases = PHASES[:3] if name == "bowl" else PHASES  # beyond, all but the rim is dark
    for phase in phases:
        suns, observers = directions(phase, upright=name != "bowl")
        exact = traced(plain, suns, observers, points_of(4))
        without, own = (np.abs(light_curve(x, suns, observers) - exact).max() for x in (plain, surface))
        assert own < most
        assert own < max(0.01, without / 8)


# In runs.


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
@pytest.mark.sample(1)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_shadows_in_a_run_are_those_of_its_states(dtype):
    surface = jax.tree.map(lambda x: x.astype(dtype), wall_and_floor().centred().with_shadows())
    sun, observer = (jnp.asarray(unit(*d), dtype) for d in ((-0.6, 0.3, 0.5), (-0.2, 0.1, 1.0)))
    light = ml.asteroids.Brightness(surface, sun, observer, LAW)
    body = ml.RigidBody(jnp.array([1.0, 1.8, 2.3], dtype))
    start = ml.RigidState(jnp.array([0.3, -0.8, 0.5], dtype), so3.exp(jnp.array([0.2, 0.9, -0.4], dtype)))
    options = {"dt": jnp.asarray(0.05, dtype), "steps": 20}
    torque = ml.asteroids.Sunlight(surface, sun, jnp.asarray(1e-2, dtype), 0.1, 0.2, 0.5, speed_of_light=1.0)
    torque = jax.tree.map(lambda x: x.astype(dtype), torque)
    path = ml.integrate("JACOBI[EA]", body, torque, start, **options)
    curve = ml.integrate("JACOBI[EA]", body, torque, start, **options, observe=light).states
    assert curve.dtype == dtype
    np.testing.assert_allclose(curve, jax.vmap(lambda state: light(0.0, state))(path.states), rtol=1e-4)

    def end(momentum):
        state = ml.RigidState(momentum, start.attitude)
        return ml.integrate("JACOBI[EA]", body, torque, state, **options).states.momentum[-1]

    if dtype == "float64":
        slope = jax.grad(lambda m: jnp.sum(end(m) * jnp.array([0.3, 1.0, 2.0])))(start.momentum)
        assert jnp.all(jnp.isfinite(slope))
        step = 1e-6 * jnp.eye(3)
        found = [
            jnp.sum((end(start.momentum + s) - end(start.momentum - s)) * jnp.array([0.3, 1.0, 2.0])) / 2e-6
            for s in step
        ]
        np.testing.assert_allclose(slope, found, rtol=1e-5, atol=1e-7)
