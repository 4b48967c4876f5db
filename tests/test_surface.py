"""Surfaces: volume and inertia by closed forms, what is seen of an ellipsoid, light curves, and input that is wrong."""

import itertools
import math
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import refused, still
from scipy.spatial import ConvexHull

import midlie_jax as ml
from midlie_jax.model import so3

STATE = ml.RigidState(jnp.array([0.3, -0.8, 0.5]), so3.exp(jnp.array([0.2, 0.9, -0.4])))
STILL = ml.RigidState(jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0]))
TURN = so3.exp(jnp.array([0.3, 1.2, -0.5]))
TETRAHEDRON = (
    np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
VERTICES = np.array(list(itertools.product((-0.5, 0.5), (-1.0, 1.0), (-1.5, 1.5))))  # of a box
FACES = ConvexHull(VERTICES).simplices
FACES = np.where(np.linalg.det(VERTICES[FACES])[:, None] < 0, FACES[:, ::-1], FACES)


def unit(*numbers):
    return jnp.array(numbers) / np.linalg.norm(numbers)


@pytest.mark.sample(0)
def test_a_tetrahedron_has_its_volume_centre_inertia_and_moments():
    """Of x^i y^j z^k over a right-angled one: a^(i+1) b^(j+1) c^(k+1) i! j! k!/(i + j + k + 3)!."""
    surface, legs = ml.Surface(*TETRAHEDRON), np.array([2.0, 3.0, 5.0])
    mass, whole = 7.0 * legs.prod() / 6, {}
    for degree in (1, 2, 3, 4):
        whole[degree] = surface.moments(degree, 7.0)
        for index, found in np.ndenumerate(whole[degree]):
            powers = np.bincount(index, minlength=3)
            exact = np.prod(legs ** (powers + 1) * [math.factorial(p) for p in powers]) / math.factorial(degree + 3)
            assert found == pytest.approx(7 * exact, rel=1e-12)
    matrix = so3.to_matrix(TURN)
    turned = jnp.einsum("ia,jb,kc,abc->ijk", matrix, matrix, matrix, whole[3])
    np.testing.assert_allclose(surface.turned(TURN).moments(3, 7.0), turned, rtol=1e-11)
    assert surface.mass(7.0) == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(surface.centre_of_mass, legs / 4, rtol=1e-14)
    second = whole[2] - mass * np.outer(legs, legs) / 16
    np.testing.assert_allclose(surface.inertia(7.0), np.trace(second) * np.eye(3) - second, rtol=1e-13)
    np.testing.assert_allclose(surface.areas[:3], [3.0, 5.0, 7.5])
    np.testing.assert_allclose(surface.normals[:3], [[0, 0, -1], [0, -1, 0], [-1, 0, 0]], atol=1e-15)


def test_boxes_of_triangles_of_rectangles_and_of_two_halves_are_one():
    lengths, offset = np.array([1.0, 2.0, 3.0]), np.array([50.0, -20.0, 9.0])
    inertia = 0.5 * 6.0 / 12 * np.diag(np.sum(lengths**2) - lengths**2)
    half = ml.Surface(VERTICES * np.array([0.5, 1.0, 1.0]), FACES)
    halves = half.moved([0.25, 0.0, 0.0]) + half.moved([-0.25, 0.0, 0.0])
    for surface in (ml.Surface(VERTICES, FACES), ml.Surface.box(lengths), halves):
        assert surface.volume == pytest.approx(6.0, rel=1e-14)
        np.testing.assert_allclose(surface.inertia(0.5), inertia, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(surface.body(0.5).tensor, inertia, rtol=1e-13, atol=1e-13)
    far = ml.Surface(VERTICES + offset, FACES)
    np.testing.assert_allclose(far.centre_of_mass, offset, rtol=1e-14)
    np.testing.assert_allclose(far.inertia(0.5), inertia, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(far.centred().centroids, ml.Surface(VERTICES, FACES).centroids, atol=1e-13)


@pytest.mark.sample(0)
def test_an_ellipsoid_has_its_own_volume_and_inertia_whatever_the_facets():
    """And its area vectors add up to zero; the volume by its facets, int n . x dA / 3, is that volume, too."""
    a, b, c = 3.0, 2.0, 1.0
    for facets in (20, 300):
        surface = ml.Surface.ellipsoid([a, b, c], facets)
        assert surface.count == {20: 20, 300: 320}[facets]
        volume = 4 / 3 * np.pi * a * b * c
        by_facets = np.sum(surface.areas * np.sum(surface.normals * surface.centroids, axis=1)) / 3
        np.testing.assert_allclose([surface.volume, by_facets], volume, rtol=1e-13)
        inertia = 2.0 * volume / 5 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
        np.testing.assert_allclose(surface.inertia(2.0), inertia, rtol=1e-13)
        np.testing.assert_allclose(surface.areas @ surface.normals, 0, atol=1e-12)


@pytest.mark.sample(0)
def test_principal_axes_of_a_turned_surface_are_those_of_the_surface():
    """Moments ascend, the surface turns along, and what light does to both is the same."""
    surface = ml.Surface(*TETRAHEDRON).turned(TURN)
    body, own = surface.principal(2.0)
    np.testing.assert_allclose(np.linalg.eigvalsh(surface.inertia(2.0)), body.moments, rtol=1e-12)
    np.testing.assert_allclose(own.inertia(2.0), np.diag(body.moments), atol=1e-12 * float(body.trace))
    np.testing.assert_allclose(own.centre_of_mass, 0, atol=1e-14)
    np.testing.assert_allclose(own.areas, surface.areas)
    turn = np.linalg.lstsq(own.normals, surface.normals, rcond=None)[0]  # own frame to the old one: no mirror
    assert np.linalg.det(turn) == pytest.approx(1)
    np.testing.assert_allclose(own.centroids @ turn, surface.centred().centroids, atol=1e-13)


@pytest.mark.sample(1)
@pytest.mark.parametrize("ending", ["obj", "stl", "ply"])
def test_a_surface_from_a_file_is_that_of_its_vertices(ending, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.Trimesh(VERTICES, FACES, process=False).export(tmp_path / f"box.{ending}")
    read, own = ml.Surface.from_file(tmp_path / f"box.{ending}", scale=10.0), ml.Surface(10 * VERTICES, FACES)
    assert read.count == 12
    np.testing.assert_allclose([read.volume, own.volume], 6000.0, rtol=1e-6)
    np.testing.assert_allclose(read.inertia(1.0), own.inertia(1.0), rtol=1e-5, atol=1e-2)
    trimesh.Trimesh(VERTICES, FACES[1:], process=False).export(tmp_path / f"open.{ending}")
    with pytest.raises(ValueError, match="close the surface, but 3 edges"):
        ml.Surface.from_file(tmp_path / f"open.{ending}")


def test_a_surface_from_a_table_is_that_of_its_vertices(tmp_path):
    """The layouts of DAMIT, of plate and of radar models of the PDS, and of `ver` files."""

    def rows(array, *head, numbered=False):
        return [" ".join(map(str, (*([k] if numbered else head), *row))) for k, row in enumerate(array.tolist(), 1)]

    tables = {
        "damit.txt": ["8 12", *rows(VERTICES), *rows(FACES + 1)],
        "indexed.tab": ["8", *rows(VERTICES, numbered=True), "12", *rows(FACES, numbered=True)],
        "letters.tab": ["# radar", *rows(VERTICES, "v"), *rows(FACES + 1, "f")],
        "corners.ver": ["8 12", *rows(VERTICES), *rows(FACES, 3)],
    }
    for name, lines in tables.items():
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        read = ml.Surface.from_file(tmp_path / name, scale=10.0)
        np.testing.assert_array_equal(read.corners, ml.Surface(10 * VERTICES, FACES).corners, err_msg=name)
    (tmp_path / "box.txt").write_text("1 2 3")
    with pytest.raises(ValueError, match="give an OBJ, STL or PLY file"):
        ml.Surface.from_file(tmp_path / "box.txt")


@pytest.mark.sample(0)
def test_a_surface_is_repaired(tmp_path):
    """A face inside out, one twice, one without area and a hole of one face; also in a table."""
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("networkx")
    wrong = np.concatenate([FACES[:1, ::-1], FACES[1:-1], FACES[3:4], [[0, 0, 1]]])
    trimesh.Trimesh(VERTICES, wrong, process=False).export(tmp_path / "wrong.ply")
    rows = ["8 13", *(" ".join(map(str, row)) for row in [*VERTICES.tolist(), *wrong.tolist()])]
    (tmp_path / "wrong.txt").write_text("\n".join(rows))
    for name in ("wrong.ply", "wrong.txt"):
        with pytest.raises(ValueError, match="faces must"):
            ml.Surface.from_file(tmp_path / name)
        surface = ml.Surface.from_file(tmp_path / name, repair=True)
        assert (surface.count, float(surface.volume)) == (12, pytest.approx(6.0, rel=1e-6))


@pytest.mark.sample(0)
def test_the_brightness_of_1280_facets_is_as_exact_as_the_page_says():
    """By the closed form, at each phase angle of the table in docs/surfaces.md."""
    page = (Path(__file__).parents[1] / "docs" / "surfaces.md").read_text()
    heads, *rows = (re.findall(r"\d[\d.e-]*", row) for row in re.findall(r"^\| (?:phase|root|largest).*$", page, re.M))
    axes, generator = [3.0, 2.0, 1.0], np.random.default_rng(0)
    surface = ml.Surface.ellipsoid(axes, 1280)

    def error(pair):
        law = ml.asteroids.LommelSeeliger()
        exact = ml.asteroids.EllipsoidBrightness(axes, pair[0], pair[1])(0.0, STILL)
        return ml.asteroids.Brightness(surface, pair[0], pair[1], law)(0.0, STILL) / exact - 1

    for degrees, root_mean_square, largest in zip(heads, *rows, strict=True):
        turns = np.stack([np.linalg.qr(generator.normal(size=(3, 3)))[0] for _ in range(60)])
        angle = np.deg2rad(float(degrees))
        pairs = np.stack([turns[:, 0], np.cos(angle) * turns[:, 0] + np.sin(angle) * turns[:, 1]], axis=1)
        errors = np.abs(jax.vmap(error)(jnp.asarray(pairs)))
        assert float(f"{np.sqrt(np.mean(errors**2)):.1e}") == float(root_mean_square)
        assert float(f"{errors.max():.1e}") == float(largest)


def test_a_sphere_has_the_phase_functions_of_the_books():
    """Lambert's, (sin a + (pi - a) cos a) / pi of 2 pi / 3; a sum of laws, a phase function and magnitudes."""
    angle = 1.2
    sphere = ml.Surface.ellipsoid([1.0, 1.0, 1.0], 5120)
    sun, observer = [0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]
    lambert = ml.asteroids.Brightness(sphere, sun, observer, ml.asteroids.Lambert(), albedo=0.5)(0.0, STATE)
    grey = ml.asteroids.Brightness(sphere, sun, observer, ml.asteroids.LommelSeeliger())(0.0, STATE)
    law = ml.asteroids.LommelSeeliger(0.1)
    options = {"phase": lambda a: jnp.exp(-a), "magnitude": True}
    mixed = ml.asteroids.Brightness(sphere, sun, observer, law, **options)(0.0, STATE)
    exact = (np.sin(angle) + (np.pi - angle) * np.cos(angle)) / np.pi
    assert lambert == pytest.approx(0.5 * 2 * np.pi / 3 * exact, rel=3e-4)
    assert mixed == pytest.approx(-2.5 * np.log10(np.exp(-angle) * (grey + 0.2 * lambert)), rel=1e-11)


@pytest.mark.sample(0)
def test_the_closed_form_holds_from_the_sun_and_opposite_to_it():
    """A sphere's phase function, 1 - sin(a/2) tan(a/2) ln cot(a/4), and derivatives that are finite and right."""
    eps, axes = np.finfo(float).eps, jnp.array([1.5, 1.2, 0.8])

    @jax.jit
    def at(axes, angle):
        directions = (jnp.stack([jnp.cos(a), jnp.sin(a), 0 * a]) for a in (0 * angle, angle))
        return ml.asteroids.EllipsoidBrightness(axes, *directions)(0.0, STILL)

    for angle in (0.0, 1e-6, 0.01, 1.0, 3.0, np.pi - 1e-3, np.pi):
        phase = 1.0 if angle == 0 else 1 + np.sin(angle / 2) * np.tan(angle / 2) * np.log(np.tan(angle / 4))
        found = at(jnp.ones(3), angle)
        bound = 100 * eps if angle < 3.1 else 10 * eps ** (2 / 3)
        np.testing.assert_allclose(found, np.pi / 2 * (phase if angle < np.pi else 0), rtol=0, atol=bound)
        slope = jax.jit(jax.grad(at))(axes, angle)
        assert np.all(np.isfinite(slope))
        if angle < 3.1:
            steps = 1e-6 * np.eye(3)
            expected = [(at(axes + d, angle) - at(axes - d, angle)) / 2e-6 for d in steps]
            np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-8)


@pytest.mark.sample(0)
def test_the_brightness_of_a_facet_in_the_dark_has_a_derivative():
    """Zero beyond the edge and that of the law before it, also where Sun and observer both graze: mu = mu0 = 0."""
    panel = ml.Surface.of_facets([2.0], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 0.0]])

    def seen(angle):
        towards = jnp.stack([jnp.cos(angle), jnp.zeros_like(angle), jnp.sin(angle)])
        return ml.asteroids.Brightness(panel, towards, towards, ml.asteroids.LommelSeeliger(0.1))(0.0, STILL)

    value, slope = jax.vmap(jax.value_and_grad(seen))(jnp.array([-0.1, 0.0, 1e-3, 0.4]))
    sine, cosine = np.sin([1e-3, 0.4]), np.cos([1e-3, 0.4])
    np.testing.assert_allclose(value, [0, 0, *(sine + 0.2 * sine**2)], rtol=1e-12)
    np.testing.assert_allclose(slope, [0, 0, *(cosine * (1 + 0.4 * sine))], rtol=1e-12)


@pytest.mark.sample(0)
def test_brightness_has_derivatives_with_respect_to_shape_and_attitude():
    """Against differences over a step in which facets cross the terminator, on the loop over blocks of facets too."""

    def magnitude(numbers):
        surface = ml.Surface.ellipsoid(numbers[:3], 80)
        law, directions = ml.asteroids.LommelSeeliger(0.1), (unit(1.0, 0.2, 0.1), unit(0.1, 1.0, 0.3))
        seen = ml.asteroids.Brightness(surface, *directions, law, magnitude=True)
        return seen(0.0, ml.RigidState(jnp.zeros(3), so3.exp(numbers[3:])))

    numbers, steps, value = jnp.array([3.0, 2.0, 1.0, 0.3, -0.2, 0.4]), 1e-5 * jnp.eye(6), jax.jit(magnitude)
    expected = [(value(numbers + step) - value(numbers - step)) / 2e-5 for step in steps]
    np.testing.assert_allclose(jax.jit(jax.grad(magnitude))(numbers), expected, rtol=1e-4, atol=1e-5)


Brightness, LAMBERT = ml.asteroids.Brightness, ml.asteroids.Lambert()
PANEL = ([1.0], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 0.0]])
BOX = ml.Surface.box([1.0, 2.0, 3.0])
X, Z = unit(1.0, 0, 0), unit(0, 0, 1.0)
NOTHING, UPRIGHT = jax.tree.leaves(still(2))
PAIR = ml.CoupledState(NOTHING, UPRIGHT, NOTHING, NOTHING)
test_what_is_wrong_is_named_with_its_cure = refused(
    (lambda: ml.Surface(VERTICES, FACES[:-1]), "faces must close the surface, but 3 edges"),
    (lambda: ml.Surface(VERTICES, FACES[:, ::-1]), "must be counterclockwise from outside.*faces\\[:, ::-1\\]"),
    (lambda: ml.Surface(VERTICES, np.vstack([FACES[:1, ::-1], FACES[1:]])), "must be oriented consistently, but 3"),
    (lambda: ml.Surface(VERTICES, FACES + 1), "vertices 0 to 7, got 1 to 8; OBJ files count from 1"),
    (lambda: ml.Surface(VERTICES, np.zeros((6, 4), int)), "divide larger faces into triangles"),
    (lambda: ml.Surface(VERTICES * np.array([1.0, 1, np.nan]), FACES), "vertices must be finite"),
    (lambda: ml.Surface(VERTICES * np.array([1.0, 1, 0]), FACES), "faces must have an area, but 8 have none"),
    (lambda: jax.jit(lambda f: ml.Surface(VERTICES, f).volume)(FACES), "faces must be concrete integers"),
    (lambda: ml.Surface.of_facets(PANEL[0], [[0.0, 0.0, 2.0]], PANEL[2]), "normals must be unit vectors"),
    (lambda: ml.Surface.of_facets([1.0, 1.0], *PANEL[1:]), "areas must be .n,., normals and centroids .n, 3."),
    (lambda: ml.Surface.of_facets(*PANEL).volume, "need a closed surface, made of .*; this one has open panels"),
    (lambda: ml.Surface.ellipsoid([1.0, -1.0, 1.0]), "semi_axes must be positive"),
    (lambda: ml.asteroids.EllipsoidBrightness([1.0, 2.0, -1.0], X, X), "semi_axes must be positive"),
    (lambda: ml.Surface.box(2.0), "lengths must be .3,."),
    (lambda: ml.Surface(*TETRAHEDRON).body(1.0), "origin must be the centre of mass.*surface.centred"),
    (lambda: Brightness(VERTICES, [1.0, 0, 0], [1.0, 0, 0], LAMBERT), "surface must be a midlie_jax.S"),
    (lambda: Brightness(BOX, 2 * Z, Z, LAMBERT), "sun must be a unit vector"),
    (lambda: Brightness(BOX, Z, Z, ml.asteroids.Lambert), "law must be a law and not its class: write Lambert"),
    (lambda: Brightness(BOX, Z, Z, LAMBERT, albedo=-1.0), "albedo must be finite and not neg"),
    (lambda: Brightness(BOX, Z, Z, LAMBERT, albedo=[1.0, 1])(0.0, STATE), "albedo must be .. or .6,."),
    (lambda: Brightness(BOX, Z, X, LAMBERT)(0.0, PAIR), r"Brightness must have the state of one.*of_body\(i"),
    (lambda: ml.asteroids.LommelSeeliger(-0.1), "lambert must be finite and not negative"),
    (lambda: Brightness(BOX, Z, X, LAMBERT)(0.0, ml.MomentumState([1.0, 0, 0])), "no direction"),
)


def test_a_missing_trimesh_is_named_with_its_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"midlie_jax\[surfaces\]"):
        ml.Surface.from_file(tmp_path / "none.obj")
