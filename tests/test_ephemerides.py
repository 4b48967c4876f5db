"""The functions of docs/orbits.md that read ephemerides and fields of other programs, against these programs."""

from datetime import datetime
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_docs import ROOT, blocks

import midlie_jax as ml

FIRST = "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991"
SECOND = "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
SECONDS = np.arange(0.0, 6001.0, 20.0)
BETWEEN = np.arange(3.0, 5990.0, 7.0)


@cache
def page():
    """The names that the blocks of the page from which the ephemerides are read define."""
    pytest.importorskip("sgp4")
    names = {"ml": ml, "np": np, "jax": jax, "jnp": jnp}
    functions = "def from_tle", "def from_spice", "def from_horizons", "def to_celestial", "def igrf"
    for block in blocks(ROOT / "docs" / "orbits.md"):
        if any(function in block for function in functions):
            exec(block, names)
    return names


def distances(table, right):
    return np.linalg.norm(np.asarray(jax.vmap(table)(jnp.asarray(BETWEEN))) - right, axis=-1)


@pytest.mark.sample(0)
def test_two_line_elements_through_sgp4():
    """Between the rows of the table as sgp4 says; and a run of a day's length is refused before it starts."""
    from sgp4.api import Satrec

    table = page()["from_tle"](FIRST, SECOND, SECONDS)
    satellite = Satrec.twoline2rv(FIRST, SECOND)
    days = satellite.jdsatepochF + BETWEEN / 86400
    right = 1e3 * satellite.sgp4_array(np.full(len(days), satellite.jdsatepoch), days)[1]
    assert distances(table, right).max() < 0.5
    torque = ml.spacecraft.GravityGradient(None, table, 3.986004418e14)
    body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidState(jnp.array([0.0, 0.0, 1e-3]), jnp.eye(4)[0])
    with pytest.raises(ValueError, match="holds a TableOrbit from t = 0 to 6000, but the run needs times from 0 to"):
        ml.integrate("JACOBI[EA]", body, torque, start, dt=10.0, steps=8640)


@pytest.mark.sample(0)
def test_a_vector_table_of_horizons(tmp_path):
    """Rows as Horizons prints them, of a circle; 0.05 ms of rounded dates are 0.4 m."""
    orbit = ml.orbits.CircularOrbit([7.0e6, 0.0, 0.0], [0.0, 0.6, 0.8], 3.986004418e14)
    rows = [
        f"{2462240.25 + t / 86400:.9f}, A.D. 2029-Apr-13 18:00:00.0000, "
        + ", ".join(f"{x / 1e3: .15E}" for x in (*orbit(t), *orbit.velocity_at(t), 0.0, 0.0, 0.0))
        for t in SECONDS
    ]
    file = tmp_path / "horizons.txt"
    file.write_text("\n".join(["Target body name: (test)", "JDTDB, Calendar Date (TDB),", "$$SOE", *rows, "$$EOE"]))
    right = jax.vmap(orbit)(jnp.asarray(BETWEEN))
    assert distances(page()["from_horizons"](file, 2462240.25), right).max() < 0.8


@pytest.mark.sample(0)
def test_a_kernel_through_spice(tmp_path):
    """A small kernel of type 9, by spkw09, of a hyperbola past the Earth."""
    spice = pytest.importorskip("spiceypy")
    orbit = ml.orbits.KeplerOrbit([4.0e7, 0.0, 0.0], [0.0, 7000.0, 1000.0], 3.986004418e14, epoch=3000.0)
    times = np.linspace(-1000.0, 8000.0, 181)
    states = [np.asarray(jax.vmap(f)(jnp.asarray(times))) / 1e3 for f in (orbit, orbit.velocity_at)]
    kernel = str(tmp_path / "flyby.bsp")
    handle = spice.spkopn(kernel, "flyby", 0)
    rows = np.ascontiguousarray(np.concatenate(states, axis=1))
    spice.spkw09(handle, 2099942, 399, "J2000", times[0], times[-1], "flyby", 9, len(times), rows, times)
    spice.spkcls(handle)
    spice.furnsh(kernel)
    try:
        table = page()["from_spice"]("2099942", SECONDS, observer="399")
    finally:
        spice.kclear()
    assert distances(table, np.asarray(jax.vmap(orbit)(jnp.asarray(BETWEEN)))).max() < 1e-3


@pytest.mark.sample(0)
def test_frames_of_astropy():
    """TEME to GCRS is a rotation: of sizes nothing changes, of directions what precession is since 2000."""
    time = pytest.importorskip("astropy.time")
    from astropy.utils import iers

    with iers.conf.set_temp("auto_download", False):
        table = page()["from_tle"](FIRST, SECOND, SECONDS)
        turned = page()["to_celestial"](table, time.Time("2019-12-09T16:38:29.36", scale="utc"))
    np.testing.assert_allclose(*(np.linalg.norm(x.positions, axis=-1) for x in (table, turned)), rtol=1e-9)
    before, after = (
        np.asarray(x.positions / jnp.linalg.norm(x.positions, axis=-1, keepdims=True)) for x in (table, turned)
    )
    angle = np.arccos(np.clip((before * after).sum(-1), -1, 1)).max()
    assert angle == pytest.approx(np.radians(5029 / 3600 * 0.1994), rel=0.05)  # 5029 arc seconds a century
    # Velocities are the slopes of the positions.
    slopes = ml.orbits.TableOrbit(turned.times, turned.positions).velocities
    assert np.abs(slopes - turned.velocities)[2:-2].max() < 1e-1


@pytest.mark.sample(0)
def test_the_field_of_igrf():
    """Its first degree is the dipole that rotates with the Earth; the whole is ppigrf's where its meridian is x."""
    igrf = pytest.importorskip("ppigrf.ppigrf")
    epoch, seconds = datetime(2020, 1, 1, 6, 30), np.arange(0.0, 6001.0, 30.0)
    circle = ml.orbits.CircularOrbit([7e6, 0.0, 0.0], [0.0, 0.3, 1.0], 3.986004418e14)
    g, h = (table.loc[datetime(2020, 1, 1)] for table in igrf.read_shc())
    moment = 1e-9 * 6371200.0**3 / 1e-7 * np.array([g[1, 1], h[1, 1], g[1, 0]])
    greenwich = ml.so3.exp(jnp.array([0.0, 0.0, ml.spacecraft.gmst(epoch)]))
    dipole = ml.orbits.DipoleField(circle, ml.so3.rotate(greenwich, jnp.asarray(moment)), turning=7.292115e-5)
    table, times = page()["igrf"](circle, seconds, epoch, max_degree=1), jnp.asarray(BETWEEN)
    found, right = (np.asarray(jax.vmap(field)(times)) for field in (table, dipole))
    assert np.abs(found - right).max() < 1e-9  # tesla; six hours of secular variation, and the interpolation
    whole = page()["igrf"](circle, seconds, epoch)
    at_start = igrf.igrf_gc(7000.0, 90.0, -np.degrees(ml.spacecraft.gmst(epoch)), epoch)
    up, south, east = (1e-9 * part.item() for part in at_start)
    np.testing.assert_allclose(whole(0.0), [up, east, -south], rtol=1e-12)
    assert 1e-7 < np.abs(np.asarray(jax.vmap(whole)(times)) - right).max() < 2e-5  # the other degrees
