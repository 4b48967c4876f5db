"""Sites of bodies: places and wrenches are transposes, follow the body as a whole, and are those of potentials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, epsilon, refused, turn
from test_travel import start

import midlie_jax as ml

RANDOM = np.random.default_rng(0)
POINTS, FORCES = RANDOM.normal(size=(4, 3)), RANDOM.normal(size=(4, 3))
ON_AXIS = POINTS * [0.0, 0.0, 1.0]
HELD = ["free", "free axis"]
WATER_MASSES = [15.9994, 1.008, 1.008]
HALF_ANGLE = np.deg2rad(109.4712206) / 2
WATER = 0.1 * np.array([[0, 0, 0], *([s * np.sin(HALF_ANGLE), 0, np.cos(HALF_ANGLE)] for s in (1, -1))])
METHANOL_LIKE = [12.0, 16.0, 1.0, 0.0], RANDOM.normal(size=(4, 3))


def of_kind(kind, dtype="float64"):
    points = ON_AXIS if "axis" in kind else POINTS
    return start(kind, dtype), jnp.asarray(points, dtype), jnp.asarray(FORCES, dtype)


def of_points(masses, places):
    body, points = ml.molecules.from_points(masses, places)
    assert isinstance(body.body, ml.RigidBody)
    return body, body.body.moments, points


@pytest.mark.parametrize(("kind", "dtype"), [*zip(HELD, DTYPES, strict=True)])
def test_the_wrench_is_the_transpose_of_the_motion_of_the_sites(kind, dtype):
    state, points, forces = of_kind(kind, dtype)

    def moved_sites(turn, shift):
        """The sites after a rotation, in the frame of the momentum, and a displacement."""
        by = ml.so3.exp(turn)
        pose = ml.so3.multiply(state.attitude, by) if kind == "free" else ml.so3.rotate(by, state.axis)
        return ml.molecules.sites(type(state)(state.momentum, pose, state.linear, state.position + shift), points)

    torque, force = jax.jit(lambda forces: jax.vjp(moved_sites, *jnp.zeros((2, 3), dtype))[1](forces))(forces)
    found = ml.molecules.wrench_on_sites(state, points, forces)
    np.testing.assert_allclose(found.torque, torque, atol=40 * epsilon(dtype))
    np.testing.assert_allclose(found.force, force, atol=40 * epsilon(dtype))
    assert found.torque.dtype == dtype


def test_the_sites_of_a_water():
    body, moments, points = of_points(WATER_MASSES, WATER)
    np.testing.assert_allclose(moments, [0.00596800338, 0.01343999999, 0.01940800337], atol=1e-11)
    np.testing.assert_allclose(body.mass, 18.0154, rtol=1e-15)
    bond, oxygen, height = 0.1 * np.sin(HALF_ANGLE), 0.0064608, 0.0512742
    expected = [[0, oxygen, 0], [bond, -height, 0], [-bond, -height, 0]]
    np.testing.assert_allclose(points, expected, atol=1e-7)


@pytest.mark.parametrize(("molecule", "dtype"), [*zip([(WATER_MASSES, WATER), METHANOL_LIKE], DTYPES, strict=True)])
def test_points_are_a_right_handed_copy_that_the_frame_does_not_change(molecule, dtype):
    masses, places = (jnp.asarray(x, dtype) for x in molecule)
    attitude = jnp.asarray(turn(2.0, 0.4, -0.7), dtype)
    _, moments, points = of_points(masses, places)
    _, again = ml.molecules.from_points(masses, ml.so3.rotate(jnp.tile(attitude, (len(places), 1)), places) + 0.5)
    tight = 100 * epsilon(dtype)
    np.testing.assert_allclose(again, points, atol=tight)
    np.testing.assert_allclose(masses @ points, np.zeros(3), atol=10 * tight)
    found, m = np.asarray(points, np.float64), np.asarray(masses, np.float64)
    tensor = np.sum(m * np.sum(found**2, axis=1)) * np.eye(3) - np.einsum("a,ai,aj->ij", m, found, found)
    np.testing.assert_allclose(tensor, np.diag(moments), atol=10 * tight * np.max(tensor))
    if len(found) == 4:  # not flat: the volume tells the hand
        volume, expected = (np.linalg.det(p[1:] - p[:1]) for p in (found, molecule[1]))
        np.testing.assert_allclose(volume, expected, rtol=10 * tight)


def test_points_on_a_line_make_a_rotor():
    dtype = "float32"
    direction = jnp.array([0.48, -0.6, 0.64], dtype)
    heights, masses = jnp.array([0.0, 1.0, 3.0], dtype), jnp.array([2.0, 0.0, 1.0], dtype)
    body, points = ml.molecules.from_points(masses, 5 + jnp.outer(heights, direction))
    assert isinstance(body.body, ml.SymmetricRotor)
    np.testing.assert_allclose(points, [[0, 0, 1], [0, 0, 0], [0, 0, -2]], atol=20 * epsilon(dtype))
    np.testing.assert_allclose([body.body.moment, body.body.along, body.mass], [6, 0, 3], rtol=20 * epsilon(dtype))


make, sites = ml.molecules.from_points, ml.molecules.sites
test_points_that_make_no_body_and_sites_that_a_state_does_not_know = refused(
    (lambda: make([1.0, 2.0], WATER), r"masses must be \(a,\) and places \(a, 3\)"),
    (lambda: make([1.0, -2.0, 1.0], WATER), "masses must be finite and not negative.*check their signs"),
    (lambda: make([1.0], WATER[:1]), "places must hold masses at two or more positions, got 1.*Particles"),
    (lambda: make([1.0, 1.0, 0.0], WATER), "places must be on one line.*Give that site a mass"),
    (lambda: make([1.0, 1.0, 1.0], WATER * np.nan), "places must be finite"),
    (lambda: sites(start("free axis"), POINTS), "points must be on the third axis.*use a state with an attitude"),
    (lambda: sites(ml.MomentumState([0.0, 0.0, 1.0]), POINTS), "this needs the attitude"),
    (lambda: sites(start("free"), POINTS[0]), r"points must be \(a, 3\)"),
    (lambda: ml.molecules.wrench_on_sites(start("free"), POINTS, FORCES[:3]), r"forces must be \(4, 3\)"),
    (lambda: sites(start("free", "float32"), jnp.asarray(POINTS)), "cast one"),
)


def test_traced_points_off_the_axis_are_not_numbers():
    assert jnp.all(jnp.isnan(jax.jit(sites)(start("free axis"), jnp.asarray(POINTS))))


def test_a_body_that_does_not_travel_has_its_sites_about_the_fixed_point():
    state, points, forces = of_kind("free")
    np.testing.assert_allclose(sites(state.turning, points), sites(state, points) - state.position[None], atol=1e-15)
    found = ml.molecules.wrench_on_sites(state.turning, points, forces).torque
    np.testing.assert_array_equal(found, ml.molecules.wrench_on_sites(state, points, forces).torque)
