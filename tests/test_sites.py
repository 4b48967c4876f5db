"""Sites of bodies: places and wrenches are transposes, follow the body as a whole, and are those of potentials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, epsilon, turn
from travel_cases import start

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
    """A state, points that it knows, and forces on them."""
    points = ON_AXIS if "axis" in kind else POINTS
    return start(kind, dtype), jnp.asarray(points, dtype), jnp.asarray(FORCES, dtype)


def of_points(masses, places):
    """The rigid body and its points."""
    body, points = ml.molecules.from_points(masses, places)
    assert isinstance(body.body, ml.RigidBody)
    return body, body.body.moments, points


def moved(state, turned, shift):
    """The whole turned in space and then shifted."""
    held = "attitude" if hasattr(state, "attitude") else "axis"
    new = ml.so3.multiply(turned, state.attitude) if held == "attitude" else ml.so3.rotate(turned, state.axis)
    return type(state)(state.momentum, new, state.linear, ml.so3.rotate(turned, state.position) + shift)


@pytest.mark.parametrize(("kind", "dtype"), [*zip(HELD, DTYPES, strict=True)])
def test_the_wrench_is_the_transpose_of_the_motion_of_the_sites(kind, dtype):
    state, points, forces = of_kind(kind, dtype)

    def of_velocity(angular, linear):
        """The velocities of the sites of a body that turns, in the frame of the momentum, and travels."""
        along = {"position": linear}
        if kind == "free":
            pure = jnp.concatenate([jnp.zeros(1, dtype), angular / 2])
            along["attitude"] = ml.so3.multiply(state.attitude, pure)
        else:
            along["axis"] = jnp.cross(angular, state.axis)
        held = {name: getattr(state, name) for name in along}
        rest = {name: getattr(state, name) for name in ("momentum", "linear")}
        return jax.jvp(lambda pose: ml.molecules.sites(type(state)(**rest, **pose), points), (held,), (along,))[1]

    _, transpose = jax.vjp(of_velocity, *jnp.zeros((2, 3), dtype))
    torque, force = transpose(forces)
    found = ml.molecules.wrench_on_sites(state, points, forces)
    np.testing.assert_allclose(found.torque, torque, atol=40 * epsilon(dtype))
    np.testing.assert_allclose(found.force, force, atol=40 * epsilon(dtype))
    assert found.torque.dtype == dtype


@pytest.mark.parametrize("kind", HELD)
def test_sites_and_wrenches_follow_the_whole(kind):
    state, points, forces = of_kind(kind)
    turned, shift = jnp.asarray(turn(0.3, 1.1, -0.4)), jnp.array([3.0, -1.0, 2.0])
    new = moved(state, turned, shift)
    all_turned = jnp.tile(turned, (4, 1))
    np.testing.assert_allclose(
        ml.molecules.sites(new, points),
        ml.so3.rotate(all_turned, ml.molecules.sites(state, points)) + shift[None],
        atol=1e-14,
    )
    before, after = (
        ml.molecules.wrench_on_sites(state, points, forces),
        ml.molecules.wrench_on_sites(new, points, ml.so3.rotate(all_turned, forces)),
    )
    np.testing.assert_allclose(after.force, ml.so3.rotate(turned, before.force), atol=1e-14)
    torque = before.torque if kind == "free" else ml.so3.rotate(turned, before.torque)
    np.testing.assert_allclose(after.torque, torque, atol=1e-14)


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


WRONG = {
    "shapes": (([1.0, 2.0], WATER), r"masses must be \(a,\) and places \(a, 3\)"),
    "negative": (([1.0, -2.0, 1.0], WATER), "masses must be finite and not negative.*check their signs"),
    "one point": (([1.0], WATER[:1]), "places must hold masses at two or more positions, got 1.*midlie_jax.Particles"),
    "off the line": (([1.0, 1.0, 0.0], WATER), "places must be on one line.*Give that site a mass"),
    "not finite": (([1.0, 1.0, 1.0], WATER * np.nan), "places must be finite"),
}


@pytest.mark.parametrize("wrong", list(WRONG))
def test_points_that_make_no_body(wrong):
    arguments, message = WRONG[wrong]
    with pytest.raises(ValueError, match=message):
        ml.molecules.from_points(*arguments)


def test_sites_that_a_state_does_not_know():
    state = start("free axis")
    with pytest.raises(ValueError, match=r"points must be on the third axis(?s:.*)use a state with an attitude"):
        ml.molecules.sites(state, POINTS)
    traced = jax.jit(ml.molecules.sites)(state, jnp.asarray(POINTS))
    assert jnp.all(jnp.isnan(traced))
    with pytest.raises(ValueError, match="this needs the attitude"):
        ml.molecules.sites(ml.MomentumState([0.0, 0.0, 1.0]), POINTS)
    with pytest.raises(ValueError, match=r"points must be \(a, 3\)"):
        ml.molecules.sites(start("free"), POINTS[0])
    with pytest.raises(ValueError, match=r"forces must be \(4, 3\)"):
        ml.molecules.wrench_on_sites(start("free"), POINTS, FORCES[:3])
    with pytest.raises(ValueError, match="cast one"):
        ml.molecules.sites(start("free", "float32"), jnp.asarray(POINTS))


def test_a_body_that_does_not_travel_has_its_sites_about_the_fixed_point():
    state, points, forces = of_kind("free")
    here = ml.molecules.sites(state.turning, points)
    np.testing.assert_allclose(here, ml.molecules.sites(state, points) - state.position[None], atol=1e-15)
    found = ml.molecules.wrench_on_sites(state.turning, points, forces).torque
    np.testing.assert_array_equal(found, ml.molecules.wrench_on_sites(state, points, forces).torque)
