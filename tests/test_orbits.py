"""Orbits of every eccentricity against arithmetic of fifty digits, tables of positions, and the dipole that turns."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from cases import refused
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax.model import orbits, torques

EPS = np.finfo(float).eps
MU, Q = 2.1, 1.3
ECCENTRICITIES = [0.0, 0.97, 1.0, 1 + 1e-9, 4.25, 0.3, 0.8, 1 - 1e-9, 1.5, 50.0]
BODY = ml.RigidBody(jnp.array([1.0, 1.8, 2.3]))
START = ml.RigidState(jnp.array([0.3, -0.8, 0.5]), ml.so3.exp(jnp.array([0.2, 0.9, -0.4])))


def stumpff(alpha, s):
    """U_0 to U_3, from their definitions."""
    if alpha == 0:
        return mp.mpf(1), s, s * s / 2, s**3 / 6
    root = mp.sqrt(abs(alpha))
    c, n = (mp.cos(root * s), mp.sin(root * s)) if alpha > 0 else (mp.cosh(root * s), mp.sinh(root * s))
    return c, n / root, (1 - c) / alpha, (s - n / root) / alpha


def place(numbers, s):
    """Time, position and velocity at the universal variable s, from (position, velocity, mu), exactly."""
    r, v, mu = numbers[:3], numbers[3:6], numbers[6]
    distance = mp.sqrt(sum(x * x for x in r))
    sigma = sum(x * y for x, y in zip(r, v, strict=True)) / mp.sqrt(mu)
    u = stumpff(2 / distance - sum(x * x for x in v) / mu, s)
    time = (distance * u[1] + sigma * u[2] + u[3]) / mp.sqrt(mu)
    there = distance * u[0] + sigma * u[1] + u[2]
    f, g = 1 - u[2] / distance, time - u[3] / mp.sqrt(mu)
    ff, gg = -mp.sqrt(mu) * u[1] / (distance * there), 1 - u[2] / there
    mix = [(f * x + g * y, ff * x + gg * y) for x, y in zip(r, v, strict=True)]
    return time, np.array([x for x, _ in mix]), np.array([y for _, y in mix])


def exact(orbit, s):
    """Time, position, velocity and by how much the position changes where each given number changes by its own size."""
    with mp.workdps(50):
        numbers = [mp.mpf(float(x)) for x in (*orbit.position, *orbit.velocity, orbit.mu)]
        time, position, velocity = place(numbers, mp.mpf(s))
        t, step, changes = float(time), mp.mpf(10) ** -22, []
        for j, x in enumerate(numbers):
            moved_time, moved, _ = place([*numbers[:j], x * (1 + step), *numbers[j + 1 :]], mp.mpf(s))
            changes.append(((moved - position) - velocity * (moved_time - time)) / step)
        changes.append(velocity * time)
        size = sum(mp.sqrt(sum(c * c)) for c in np.array(changes))
        position = position + velocity * (mp.mpf(t) - time)
        return t, position, velocity, np.array(changes[:7]), float(size)


def elements(e, **more):
    given = {"inclination": 0.4, "ascending_node": -1.0, "argument_of_periapsis": 2.0, "periapsis": Q}
    return orbits.KeplerOrbit.from_elements(mu=MU, eccentricity=e, **given | {"time_of_periapsis": 0.0} | more)


def anomalies(e, radii=1e4):
    """s from the periapsis out to so many radii, or around an ellipse, on both sides."""
    alpha = (1 - e) / Q
    if 0 <= e < 0.99:
        s = np.linspace(0, np.pi, 9)[1:] / np.sqrt(alpha)
    else:
        distances = Q * np.geomspace(1.001, radii, 9)
        w = np.sqrt(2 * (distances - Q))  # by r = q + e U_2, on a parabola; else by the anomaly
        s = w if abs(alpha) < 1e-6 else np.arccosh(1 + (distances / Q - 1) * (e - 1) / e) / np.sqrt(-alpha)
    return np.concatenate([-s[::-1], [0.0], s])


def missed(found, position):
    return float(mp.sqrt(sum((mp.mpf(float(a)) - b) ** 2 for a, b in zip(found, position, strict=True))))


positions = jax.jit(jax.vmap(lambda orbit, t: orbit(t), in_axes=(None, 0)))


@pytest.mark.sample(5)
@pytest.mark.parametrize("e", ECCENTRICITIES)
def test_an_orbit_from_its_periapsis_is_exact_to_rounding(e):
    """The error is that of a few eps of the numbers given and of the distance, out to 1e4 radii."""
    orbit = elements(e)
    times, places, _, _, sizes = zip(*(exact(orbit, s) for s in anomalies(e)), strict=True)
    found = np.asarray(positions(orbit, jnp.array(times)))
    for x, right, size in zip(found, places, sizes, strict=True):
        distance = float(mp.sqrt(sum(right * right)))
        assert missed(x, right) <= EPS * (4 * distance + 2 * size)
    far = [float(mp.sqrt(sum(p * p))) / Q for p in (places[0], places[-1])]
    assert min(far) > 9e3 if e > 0.99 else min(far) == pytest.approx((1 + e) / (1 - e))


@pytest.mark.sample(0)
@pytest.mark.parametrize(("e", "radii"), [(1 - 1e-9, 26.0), (1.0, 1e4), (1.5, 26.0), (50.0, 1e4)])
def test_an_orbit_from_far_out_passes_its_periapsis(e, radii):
    """From there the error is that of a few eps of the numbers given at the place that feels them most."""
    _, place, velocity, *_ = exact(elements(e), anomalies(e, radii)[0])
    orbit = orbits.KeplerOrbit([float(x) for x in place], [float(x) for x in velocity], MU, -3.0)
    s = anomalies(e, radii) - anomalies(e, radii)[0]
    times, places, _, _, sizes = zip(*(exact(orbit, x) for x in s), strict=True)
    found = np.asarray(positions(orbit, jnp.array(times) - 3.0))
    distances = np.array([float(mp.sqrt(sum(p * p))) for p in places])
    most = max(np.array(sizes) / distances)
    errors = [missed(x, right) for x, right in zip(found, places, strict=True)]
    assert np.all(errors <= 4 * EPS * (1 + most) * distances + 4 * EPS * np.linalg.norm(velocity.astype(float)) * 3)


@pytest.mark.sample(0)
@pytest.mark.parametrize("e", [0.0, 1.0, 4.25])
def test_derivatives_with_respect_to_what_is_given(e):
    orbit, s = elements(e), anomalies(e, 30.0)[[2, 7, 12]]
    times, places, velocities, changes, _ = zip(*(exact(orbit, x) for x in s), strict=True)

    def position(r, v, mu, t):
        return orbits.KeplerOrbit(r, v, mu)(t)

    given = orbit.position, orbit.velocity, orbit.mu
    for way in (jax.jacfwd, jax.jacrev):
        found = jax.jit(jax.vmap(way(position, (0, 1, 2, 3)), (None, None, None, 0)))(*given, jnp.array(times))
        for n, size in enumerate(float(mp.sqrt(sum(p * p))) for p in places):
            columns = np.concatenate([found[0][n].T, found[1][n].T, np.asarray(found[2][n])[None]])
            right = changes[n].astype(float) / np.concatenate([*given[:2], [MU]])[:, None]
            np.testing.assert_allclose(columns, right, atol=1e-13 * np.abs(right).max() * (1 + size))
            np.testing.assert_allclose(found[3][n], velocities[n].astype(float), rtol=1e-12, atol=1e-13)


@pytest.mark.sample(0)
@pytest.mark.parametrize("e", [0.97, 1.5])
def test_three_derivatives_in_time_are_those_of_gravity(e):
    """Acceleration -mu r / r^3, and its slope."""
    orbit, times = elements(e), jnp.array([-20.0, -0.7, 0.0, 40.0])

    def derivatives(t):
        first = jax.jacfwd(orbit)
        return orbit(t), first(t), jax.jacfwd(first)(t), jax.jacfwd(jax.jacfwd(first))(t), orbit.velocity_at(t)

    r, v, a, j, velocities = (np.asarray(x) for x in jax.jit(jax.vmap(derivatives))(times))
    np.testing.assert_array_equal(velocities, v)
    size = np.linalg.norm(r, axis=-1, keepdims=True)
    np.testing.assert_allclose(a, -MU * r / size**3, atol=1e-13 * (MU / size**2).max())
    slope = -MU * (v / size**3 - 3 * r * (r * v).sum(-1, keepdims=True) / size**5)
    np.testing.assert_allclose(j, slope, atol=2e-12 * np.abs(slope).max())


@pytest.mark.parametrize("e", [0.0, 0.6, 1.0, 2.5])
def test_elements_say_one_orbit_in_every_way(e):
    orbit = elements(e)
    frame = Rotation.from_euler("ZXZ", [-1.0, 0.4, 2.0]).as_matrix()
    np.testing.assert_allclose(orbit.position, Q * frame[:, 0], atol=1e-15)
    np.testing.assert_allclose(orbit.velocity, np.sqrt(MU * (1 + e) / Q) * frame[:, 1], atol=1e-15)
    angle, epoch = 1.1, 5.0
    radius = Q * (1 + e) / (1 + e * np.cos(angle))
    towards = frame @ [np.cos(angle), np.sin(angle), 0]
    by_angle = elements(e, time_of_periapsis=None, true_anomaly=angle, epoch=epoch)
    np.testing.assert_allclose(by_angle(epoch), radius * towards, rtol=1e-14, atol=1e-15)
    wide = elements(e, periapsis=None, semi_latus_rectum=Q * (1 + e), time_of_periapsis=None, true_anomaly=angle)
    np.testing.assert_allclose(wide(0.0), radius * towards, rtol=1e-14, atol=1e-15)
    if e == 1:
        barker = np.sqrt(2 * Q**3 / MU) * (np.tan(angle / 2) + np.tan(angle / 2) ** 3 / 3)  # Barker's equation
        np.testing.assert_allclose(orbit(barker), radius * towards, rtol=1e-14, atol=1e-15)
        return
    mean = MU**0.5 * (abs(1 - e) / Q) ** 1.5 * 2.0
    size = {"periapsis": None, "semi_major_axis": Q / (1 - e)}
    by_mean = elements(e, **size, time_of_periapsis=None, mean_anomaly=mean, epoch=2.0)
    np.testing.assert_allclose(by_mean(0.7), orbit(0.7), rtol=1e-13, atol=1e-14)


TIMES = jnp.linspace(-1.0, 2.0, 61)
HYPERBOLA = elements(1.5)


def tabled(times=TIMES, velocities=True, orbit=HYPERBOLA):
    speeds = positions(orbit.velocity_at, times) if velocities else None
    return orbits.TableOrbit(times, positions(orbit, times), speeds)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("even", "velocities"), [(True, True), (False, False)])
def test_a_table_is_of_fourth_order(even, velocities):
    errors = []
    for count in (41, 81, 161):
        times = jnp.linspace(-1.0, 2.0, count)
        times = times if even else times + 0.05 * jnp.sin(5 * times)
        table = tabled(times, velocities)
        assert table.even is even
        between = jnp.linspace(times[0], times[-1], 997)
        rows = slice(0, None) if velocities else slice(100, -100)  # beside the ends slopes are from one side
        errors.append(np.abs(positions(table, between) - positions(HYPERBOLA, between))[rows].max())
        np.testing.assert_allclose(positions(table, times), table.positions, rtol=1e-14, atol=1e-15)
    assert np.all(np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 4) < 0.35)
    if velocities and even:  # on a circle the bound is (angle a row)^4 / 384
        circle = orbits.CircularOrbit([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1.0)
        table, between = tabled(jnp.linspace(0.0, 2 * jnp.pi, 101), True, circle), jnp.linspace(0.0, 6.0, 997)
        assert np.abs(positions(table, between) - positions(circle, between)).max() < 4.1e-8


@pytest.mark.sample(0)
def test_a_table_without_velocities_has_the_errors_that_its_docstring_says():
    """On a circle of 50 rows, relative to those of a table with velocities: next to the ends, and elsewhere."""
    circle = orbits.CircularOrbit([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1.0)
    tables = [tabled(jnp.linspace(0, 2 * np.pi, 51), velocities, circle) for velocities in (False, True)]
    for begin, end, least, most in ((0.0, 0.2, 1.73, 1.75), (1.5, 4.7, 0.9, 1.03)):
        t = jnp.linspace(begin, end, 2001)
        errors = [np.linalg.norm(positions(table, t) - positions(circle, t), axis=-1).max() for table in tables]
        assert least < errors[0] / errors[1] < most


RUN = {"dt": 0.05, "steps": 60, "t0": -1.0}
IN_TABLE = "JACOBI[EA]", BODY, ml.spacecraft.GravityGradient(BODY.moments, tabled(), MU) + torques.Damping(0.1)


def test_a_run_beyond_its_table_is_refused_before_it_starts(tmp_path):
    starts = jax.tree.map(lambda x: jnp.stack([x, x]), START)
    message = r"holds a TableOrbit from t = -1 to 2, but the run needs times from -1 to 2.05"
    saved = {"out": tmp_path / "run.npz"}
    for run, start, more in ((ml.integrate, START, {}), (ml.ensemble, starts, {}), (ml.simulate, starts, saved)):
        with pytest.raises(ValueError, match=message):
            run(*IN_TABLE, start, **{**RUN, "steps": 61}, **more)
    with pytest.raises(ValueError, match=r"times from -1\.05 to -1;"):
        ml.integrate(*IN_TABLE, START, dt=-0.05, steps=1, t0=-1.0)
    density = ml.densities.OrbitalDistance(tabled(), Q)
    with pytest.raises(ValueError, match="density holds a TableOrbit"):
        ml.integrate_variable_step("JACOBI[EA]", BODY, None, START, density=density, dt=0.1, steps=99, t1=2.5)


@pytest.mark.sample(0)
def test_a_table_that_is_left_under_jit_is_a_flag():
    run = jax.jit(lambda t0: ml.integrate(*IN_TABLE, START, dt=0.05, steps=4, t0=t0).ok)
    assert run(1.8)
    assert not run(1.85)


@pytest.mark.sample(0)
def test_a_table_of_a_field_is_interpolated_like_one_of_positions():
    dipole = orbits.DipoleField(HYPERBOLA, [0.3, -0.2, -1.5], 1.0)
    field, between = orbits.TableField(TIMES, positions(dipole, TIMES)), jnp.linspace(-0.99, 1.97, 61)
    assert np.abs(positions(field, between) - positions(dipole, between)).max() < 1e-4
    torque = torques.DipoleInField([0.0, 0.0, 0.1], field)
    with pytest.raises(ValueError, match="torque holds a TableField from t = -1 to 2, but the run needs"):
        ml.integrate("JACOBI[EA]", BODY, torque, START, **{**RUN, "steps": 61})


def test_a_dipole_turns_with_its_planet():
    """In the frame of the planet its field is one that does not turn."""
    turning, moment, t = 0.7, jnp.array([0.3, -0.2, -1.5]), 1.3
    field = orbits.DipoleField(HYPERBOLA, moment, 1.0, turning=turning)
    frame = Rotation.from_rotvec([0, 0, turning * t]).as_matrix()
    fixed = orbits.DipoleField(lambda t: jnp.asarray(frame.T) @ HYPERBOLA(t), moment, 1.0)
    np.testing.assert_allclose(field(t), frame @ fixed(t), rtol=1e-13)


THREE, TABLE = np.eye(3), tabled()
test_mistakes_are_named = refused(
    (lambda: orbits.KeplerOrbit([1.0, 0, 0], [2.0, 0, 0], 1.0), "velocity must not be along the position"),
    (lambda: orbits.KeplerOrbit([1.0, 0, 0], [0.0, 1, 0], -1.0), "mu must be positive and finite"),
    (lambda: orbits.CircularOrbit([0.0, 0, 0], [0.0, 1, 0], 1.0), "position must not be the centre"),
    (lambda: orbits.CircularOrbit([1.0, 2, 3], [0.1, 0.2, 0.3], 1.0), "a part perpendicular to position"),
    (lambda: elements(1.0, periapsis=None), "exactly one of periapsis, semi_major_axis, .* got none"),
    (lambda: elements(0.5, semi_major_axis=2.0), "got periapsis and semi_major_axis; give one"),
    (lambda: elements(0.5, true_anomaly=2.0), "got time_of_periapsis and true_anomaly; give one"),
    (lambda: elements(0.5, epoch=2.0), "leave out epoch"),
    (lambda: elements(-0.1), "eccentricity must be finite and not negative"),
    (lambda: elements(1.0, periapsis=None, semi_major_axis=2.0), "a parabola has none"),
    (lambda: elements(1.0, time_of_periapsis=None, mean_anomaly=0.1), "mean_anomaly has no meaning on a parabola"),
    (lambda: elements(2.0, time_of_periapsis=None, true_anomaly=2.2), "true_anomaly must be where the orbit is"),
    (lambda: elements(0.5, inclination=97.4), "inclination must be between 0 and pi, got 97.4; give radians"),
    (lambda: elements(0.5, ascending_node=211.2), "ascending_node must be between -2 pi and 2 pi, got 211.2;"),
    (lambda: orbits.KeplerOrbit([7e3, 0, 0], [0, 7.5, 0], 3.986e14), "orbit and mu must be in the same units"),
    (lambda: orbits.TableOrbit(TIMES, 1e3 * TABLE.positions, TABLE.velocities), "velocities must be in the units of"),
    (lambda: orbits.TableField([0.0, 1.0], THREE), r"values must have shape \(2, 3\)"),
    (lambda: orbits.TableOrbit([0.0, 1.0, 1.0], THREE), r"times must ascend, but times\[2\] = 1.0 follows 1.0"),
    (lambda: orbits.TableOrbit([0.0, np.nan, 1.0], THREE), "times must be finite"),
    (lambda: orbits.TableOrbit([0.0], THREE[:1]), "at least 2"),
    (lambda: orbits.TableOrbit([0.0, 1.0, 2.0], THREE, THREE[:2]), r"velocities must have shape \(3, 3\)"),
    (lambda: orbits.DipoleField(HYPERBOLA, THREE[0], turning=np.inf), "turning must be finite"),
)


@pytest.mark.sample(0)
def test_legal_orbits_of_any_speed_pass_the_check_of_units():
    """Far out on a thin ellipse, a fast hyperbola, a place at rest; the inclinations at both ends of their range."""
    for inclination in (0.0, np.pi, np.float32(np.pi)):
        elements(0.5, inclination=inclination)
    thin, fast = (orbits.KeplerOrbit([r, 0.0, 0.0], [0.0, v, 0.0], 1.0) for r, v in ((1.0, 0.02), (100.0, 30.0)))
    still = orbits.TableOrbit([0.0, 1.0], [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    orbits.KeplerOrbit([1e3, 0.0, 0.0], [0.0, 5e3, 0.0], 4.9)  # past an asteroid, in SI units
    for orbit in (thin, fast, still, lambda t: jnp.array([1.0, 0.0, 0.0])):
        ml.spacecraft.GravityGradient(None, orbit, 1.0)
