"""Sunlight, thin gas and eddy currents on a body: by hand, by closed forms, and what symmetry says."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import loop_bodies, real, refused
from scipy.special import erf
from test_surface import STATE, STILL

import midlie_jax as ml
from midlie_jax.model import so3

FREE = ml.FreeState(STATE.momentum, STATE.attitude, jnp.array([3.0, -2.0, 1.0]), jnp.zeros(3))
SPHERE = ml.Surface.ellipsoid([2.0, 2.0, 2.0], 1280)
SUN = jnp.array([0.48, 0.6, 0.64])
BOX = ml.Surface.box([1.0, 2.0, 3.0])


def light(surface, direction=SUN, flux=1.0, *fractions, c=1.0, **named):
    return ml.asteroids.Sunlight(surface, direction, flux, *fractions, speed_of_light=c, **named)


def loads_by_hand(surface, sun, flux, s, d, h):
    """Facet after facet, by the formula."""
    turn = force = 0
    facets = map(np.asarray, (surface.areas, surface.normals, surface.centroids, s))
    for area, n, r, shiny in zip(*facets, strict=True):
        mu = max(n @ sun, 0)
        push = -flux * area * mu * ((1 - shiny) * sun + (2 * shiny * mu + 2 / 3 * (d + h * (1 - shiny - d))) * n)
        turn, force = turn + np.cross(r, push), force + push
    return turn, force


def test_the_sum_over_blocks_of_facets_is_that_of_the_formula():
    """Of facets that differ, also on a body that travels."""
    surface, shiny = ml.Surface.ellipsoid([3.0, 2.0, 1.0], 80).moved([0.1, 0.2, -0.3]), jnp.linspace(0.0, 0.8, 80)
    torque = light(surface, SUN, lambda t: 8.0 + 0 * t, shiny, 0.2, 0.6, c=4.0)
    sun = np.asarray(so3.rotate(so3.conjugate(STATE.attitude), SUN))
    turn, force = loads_by_hand(surface, sun, 2.0, shiny, 0.2, 0.6)
    np.testing.assert_allclose(torque(0.0, STATE), turn, rtol=1e-12)
    wrench = torque(0.0, FREE)
    np.testing.assert_allclose(wrench.torque, turn, rtol=1e-12)
    np.testing.assert_allclose(wrench.force, so3.rotate(STATE.attitude, jnp.asarray(force)), rtol=1e-12)


@pytest.mark.sample(0)
def test_a_step_holds_nothing_of_the_size_of_facets_times_bodies():
    """In a run and its gradient: the sum is a loop over blocks of facets, one fused loop over the bodies in each."""
    bodies, facets, body = 517, 1280, ml.RigidBody([1.0, 1.8, 2.3])
    torque = light(ml.Surface.ellipsoid([3.0, 2.0, 1.0], facets).moved([0.1, 0.2, -0.3]), SUN, 0.3, 0.3, 0.2, 0.6)

    def end(momentum):
        start = ml.RigidState(momentum, STATE.attitude)
        return ml.integrate("JACOBI[EA]", body, torque, start, dt=0.05, steps=7, save_every=7).states.attitude[-1, 1]

    for function, most in ((jax.vmap(end), 1), (jax.grad(lambda momenta: jnp.sum(jax.vmap(end)(momenta))), 5)):
        program = real(function).lower(jnp.ones((bodies, 3))).compile()
        text = program.as_text()
        shapes = {tuple(map(int, found.split(","))) for found in re.findall(r"\w\d\d\[([\d,]+)\]", text)}
        assert not [shape for shape in shapes if bodies in shape and np.prod(shape) > 24 * bodies]
        assert program.memory_analysis().temp_size_in_bytes < 4 * bodies * facets
        loops = [len(re.findall(rf"\[{bodies}\].* fusion\(", b)) for b in loop_bodies(text) if "[16,12]" in b]
        assert max(loops) == most


def test_a_plate_across_the_flow_has_the_drag_of_the_books():
    """Cold gas: rho A v^2 and, fully accommodated at a warm wall, sqrt(pi)/2 rho A v v_w more; behind it nothing."""
    plate = ml.Surface.of_facets([3.0], [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    v, rho, wall, slanted = 2.0, 0.1, 0.7, np.array([0.0, 1.2, 1.6])
    for velocity, options, expected in (
        ([0.0, 0.0, v], {"wall_speed": wall}, [0, rho * 3.0 * v * (v + np.sqrt(np.pi) / 2 * wall), 0]),
        ([0.0, 0.0, -v], {}, np.zeros(3)),
        # At an angle: what is met is less by its cosine, and pushes along the velocity.
        (slanted, {}, np.cross([1.0, 0, 0], -rho * 3.0 * 1.6 * slanted)),
        # At rest in warm gas, a plate fully accommodated to it is pushed by the pressure rho c^2/2, on its one side.
        (np.zeros(3), {"thermal_speed": 1.5, "wall_speed": 1.5}, [0, 3.0 * rho * 1.5**2 / 2, 0]),
    ):
        found = ml.spacecraft.FreeMolecularDrag(plate, rho, velocity, **options)(0.0, STILL)
        np.testing.assert_allclose(found, expected, rtol=1e-14)


@pytest.mark.sample(1)
@pytest.mark.parametrize("s", [2.0, 0.5, None])
def test_a_sphere_in_thin_gas_has_the_drag_of_schaaf_and_chambre(s):
    """(2 s^2 + 1) e^(-s^2) / (sqrt(pi) s^3) + (4 s^4 + 4 s^2 - 1) erf(s) / (2 s^4) + 2 sqrt(pi) / 3 v_r / v."""
    v, rho, a, wall = 2.0, 0.1, 0.8, 0.6
    flow = {} if s is None else {"thermal_speed": v / s}
    body = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), 2.0)
    state = ml.FreeState(STATE.momentum, STATE.attitude, 2.0 * (v * SUN + jnp.array([1.0, 0, 0])), jnp.zeros(3))
    drag = ml.spacecraft.FreeMolecularDrag(
        SPHERE, lambda t: rho + 0 * t, wind=jnp.array([1.0, 0, 0]), accommodation=a, wall_speed=wall, **flow
    )
    wrench = drag.on(body)(0.0, state)
    coefficient = 2.0 + 2 * np.sqrt(np.pi) / 3 * np.sqrt((1 - a) * v * v / 2 + a * wall**2) / v
    if s is not None:  # in place of the 2 of cold gas
        coefficient += (2 * s * s + 1) * np.exp(-s * s) / (np.sqrt(np.pi) * s**3) - 2
        coefficient += (4 * s**4 + 4 * s**2 - 1) * erf(s) / (2 * s**4)
    np.testing.assert_allclose(wrench.force, -0.5 * rho * v * v * 4 * np.pi * coefficient * SUN, rtol=0, atol=3e-3)
    np.testing.assert_allclose(wrench.torque, 0, atol=1e-13)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("facets", "accommodation", "thermal_speed"), [(1, 1.0, 1.5), (17, 1.0, None), (17, 0.7, 1.5)])
def test_drag_grows_with_the_speed_at_the_wall_from_zero_on(facets, accommodation, thermal_speed):
    """Where all is accommodated the speed away is that at the wall, whose square alone has no slope at zero."""
    plates = ml.Surface.of_facets([0.2] * facets, [[0.6, 0.0, 0.8]] * facets, [[0.0, 0.5, 0.0]] * facets)
    gas = {"velocity": jnp.array([0.3, 0.0, 2.0]), "thermal_speed": thermal_speed}

    def torque(wall, part=accommodation):
        return ml.spacecraft.FreeMolecularDrag(plates, 1.0, **gas, accommodation=part, wall_speed=wall)(0.0, STILL)[2]

    step = 1e-7
    slope = float(torque(step) - torque(0.0)) / step
    slopes = jax.jit(jax.grad(torque, argnums=(0, 1)))(0.0, accommodation)
    assert slopes[0] == pytest.approx(slope, rel=1e-6, abs=1e-6)
    assert (abs(slope) > 0.01) == (accommodation == 1.0)
    assert np.isfinite(slopes[1])


def test_eddy_currents_take_the_energy_that_they_say():
    """The power is -(Omega x B) . M (Omega x B), for a number, a diagonal and a tensor; none along the field."""
    body = ml.TensorBody([[2.0, 0.1, 0.2], [0.1, 1.6, 0.0], [0.2, 0.0, 1.9]])
    field = jnp.array([0.4, -0.3, 1.2])
    tensor = jnp.array([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 1.5]])
    velocity = np.asarray(body.velocity(STATE.momentum))
    here = np.asarray(so3.rotate(so3.conjugate(STATE.attitude), field))
    for m in (0.7, jnp.array([0.7, 0.2, 1.1]), tensor):
        full = np.asarray(m) * np.eye(3) if jnp.ndim(m) < 2 else np.asarray(m)
        torque = np.asarray(ml.spacecraft.EddyCurrents(m, lambda t: field * (1 + t)).on(body)(1.0, STATE))
        across = np.cross(velocity, 2 * here)
        np.testing.assert_allclose(torque, np.cross(full @ across, 2 * here), rtol=1e-12)
        assert torque @ velocity == pytest.approx(-across @ full @ across)
        assert torque @ velocity < 0
    along = ml.RigidState(body.momentum(jnp.asarray(here)), STATE.attitude)
    np.testing.assert_allclose(ml.spacecraft.EddyCurrents(tensor, field).on(body)(0.0, along), 0, atol=1e-15)


gas, eddies = partial(ml.spacecraft.FreeMolecularDrag, BOX), ml.spacecraft.EddyCurrents
ONE = [1.0, 0.0, 0.0]
READINGS = "(?s)tensor must .*; or, if these are three numbers for each of three bodies, pass"
test_what_is_wrong_is_named_with_its_cure = refused(
    (lambda: light(BOX, [1.0, 1.0, 0.0]), "direction must be a unit vector"),
    (lambda: light(BOX, ONE, -1.0), "flux must be finite and not negative"),
    (lambda: light(BOX, ONE, 1.0, 1.2), "specular must be between 0 and 1"),
    (lambda: light(BOX, ONE, 1.0, 0.6, 0.5), "specular . diffuse must be at most 1, got 1.1"),
    (lambda: light(BOX, ONE, 1.0, [0.6] * 5)(0.0, STATE), "specular must be .. or .6,., one for each facet"),
    (lambda: light(BOX, ONE, c=0.0), "speed_of_light must be positive"),
    (lambda: light("box", ONE), "surface must be a midlie_jax.Surface, got str"),
    (lambda: light(BOX, ONE)(0.0, ml.MomentumState(ONE)), "no direction"),
    (lambda: gas(-1.0, ONE), "density must be finite and not negative"),
    (lambda: gas(1.0, ONE, wind=ONE), "give velocity or wind, not both"),
    (lambda: gas(1.0, ONE, accommodation=1.1), "accommodation must be between 0 and 1"),
    (lambda: gas(1.0, ONE, thermal_speed=0.0), "thermal_speed must be positive.*leave it"),
    (lambda: gas(1.0).on(ml.RigidBody([1.0, 1, 1]))(0.0, STATE), "acts on a body that translates"),
    (lambda: eddies([[1.0, 2, 0], [0, 1, 0], [0, 0, 1]], ONE), READINGS),
    (lambda: eddies([1.0, -1.0, 0.0], ONE), "tensor must not be negative"),
    (lambda: eddies(np.diag([1.0, -1.0, 0.0]), ONE), "(?s)tensor must be positive semi-definite.*eigenvalue -1"),
)
