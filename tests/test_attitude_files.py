"""Attitude Ephemeris Messages and ephemerides: the standard's examples, round trips, other programs, wrong files."""

import re
from datetime import UTC, datetime, timedelta
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import turn
from scipy.spatial.transform import Rotation
from test_docs import ROOT, blocks

import midlie_jax as ml
from midlie_jax.cli.main import main
from midlie_jax.spacecraft import attitudes
from midlie_jax.spacecraft.attitudes.epochs import Epoch

# Examples G-4 and G-5 of CCSDS 504.0-B-2, shortened.
QUATERNIONS = """\
CCSDS_AEM_VERS = 2.0
CREATION_DATE = 2002-11-04T17:22:31
ORIGINATOR = NASA/JPL
MESSAGE_ID = A7015Z3

META_START
COMMENT This file was produced by M.R. Somebody, MSOO NAV/JPL.
OBJECT_NAME     = MARS GLOBAL SURVEYOR
OBJECT_ID       = 1996-062A
CENTER_NAME     = MARS BARYCENTER
REF_FRAME_A     = EME2000
REF_FRAME_B     = SC_BODY_1
TIME_SYSTEM     = UTC
START_TIME      = 1996-11-28T21:29:07.2555
USEABLE_START_TIME = 1996-11-28T22:08:02.5555
USEABLE_STOP_TIME  = 1996-11-30T01:18:02.5555
STOP_TIME       = 1996-11-30T01:28:02.5555
ATTITUDE_TYPE   = QUATERNION
INTERPOLATION_METHOD = hermite
INTERPOLATION_DEGREE = 7
META_STOP

DATA_START
1996-11-28T21:29:07.2555 0.56748  0.03146  0.45689  0.68427
1996-11-28T22:08:03.5555 0.42319  -0.45697 0.23784  0.74533
1996-11-28T22:08:04.5555 -0.84532 0.26974  -0.06532 0.45652
1996-11-30T01:28:02.5555 0.74563  -0.45375  0.36875  0.31964
DATA_STOP

META_START
COMMENT  This block begins after trajectory correction maneuver TCM-3.
OBJECT_NAME     = mars global surveyor
OBJECT_ID       = 1996-062A
CENTER_NAME     = MARS BARYCENTER
REF_FRAME_A     = EME2000
REF_FRAME_B      = SC_BODY_1
TIME_SYSTEM     = UTC
START_TIME      = 1996-12-18T12:05:00.5555
STOP_TIME       = 1996-12-28T21:28:00.5555
ATTITUDE_TYPE   = QUATERNION
META_STOP

DATA_START
1996-12-18T12:05:00.5555 -0.64585 0.018542  -0.23854 0.72501
1996-12-28T21:28:00.5555 -0.25485 0.58745  -0.36845 0.67394
DATA_STOP
"""
SPIN = """\
CCSDS_AEM_VERS = 2.0
CREATION_DATE  = 2008-071T17:09:49
ORIGINATOR     = GSFC
MESSAGE_ID     = 7077456

META_START
OBJECT_NAME    = ST5-224
OBJECT_ID      = 2006-224A
CENTER_NAME    = EARTH
REF_FRAME_A    = J2000
REF_FRAME_B    = SC_BODY_1
TIME_SYSTEM    = UTC
START_TIME     = 2006-090T05:00:00.071
STOP_TIME      = 2006-090T05:00:00.946
ATTITUDE_TYPE  = SPIN
META_STOP

DATA_START
COMMENT        Spin KF ground solution, SPINKF rates
  2006-090T05:00:00.071  2.6862511e+002  6.8448486e+001  1.5969509e+002 -1.0996528e+002
  2006-090T05:00:00.196  2.6863990e+002  6.8432197e+001  1.4593720e+002 -1.0996493e+002
  2006-090T05:00:00.321  2.6864591e+002  6.8412960e+001  1.3218766e+002 -1.0996455e+002
DATA_STOP
"""
# Its first segment as in the example of CCSDS 504.0-B-1, which says the direction and the place of the scalar.
OLD = (
    QUATERNIONS.split("\n\nMETA_START\nCOMMENT  This block")[0]
    .replace("VERS = 2.0", "VERS = 1.0")
    .replace("MESSAGE_ID = A7015Z3\n", "")
    .replace("TIME_SYSTEM", "ATTITUDE_DIR = A2B\nTIME_SYSTEM")
    .replace("INTERPOLATION_METHOD", "QUATERNION_TYPE = LAST\nINTERPOLATION_METHOD")
)
SAID = {"epoch": "2026-04-13T21:45:00", "time_system": "TAI", "time_unit": "s", "object_name": "CUBE"}
SAID |= {"object_id": "2026-001A", "originator": "LAB", "ref_frame_a": "EME2000", "ref_frame_b": "SC_BODY_1"}
RANDOM = np.asarray(Rotation.random(1000, np.random.default_rng(0)).as_quat(scalar_first=True))


def kept(tmp_path, text):
    file = tmp_path / "seen.aem"
    file.write_text(text)
    return attitudes.read(file)


def test_the_quaternions_of_the_standard(tmp_path):
    found = kept(tmp_path, QUATERNIONS)
    assert (found.version, found.header["MESSAGE_ID"], len(found.segments)) == ("2.0", "A7015Z3", 2)
    assert found.epoch == "1996-11-28T21:29:07.255500000"
    assert found.segments[0].metadata["INTERPOLATION_METHOD"] == "hermite"
    assert found.segments[1].comments == ("This block begins after trajectory correction maneuver TCM-3.",)
    start = datetime(1996, 11, 28, 21, 29, 7, 255500)
    last = datetime(1996, 12, 28, 21, 28, 0, 555500)
    np.testing.assert_allclose(
        found.times[[0, 1, 2, 5]], [0, 2336.3, 2337.3, (last - start).total_seconds()], rtol=1e-14
    )
    first = np.array([0.68427, 0.56748, 0.03146, 0.45689])
    np.testing.assert_allclose(found.attitudes[0], first / np.linalg.norm(first), rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(found.attitudes, axis=1), 1, rtol=1e-15)


def test_the_spin_of_the_standard(tmp_path):
    """The rates in the file follow from the attitudes that its angles stand for: the z component of the velocity."""
    found = kept(tmp_path, SPIN)
    segment = found.segments[0]
    rotations = Rotation.from_quat(found.attitudes, scalar_first=True)
    alpha, delta = np.deg2rad(segment.columns["SPIN_ALPHA"]), np.deg2rad(segment.columns["SPIN_DELTA"])
    axes = np.stack([np.cos(alpha) * np.cos(delta), np.sin(alpha) * np.cos(delta), np.sin(delta)], axis=1)
    np.testing.assert_allclose(rotations.apply([0.0, 0.0, 1.0]), axes, atol=1e-14)
    between = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / np.diff(found.times)[:, None]
    rates = segment.columns["SPIN_ANGLE_VEL"]
    np.testing.assert_allclose(np.rad2deg(between[:, 2]), (rates[1:] + rates[:-1]) / 2, rtol=3e-4)


def test_a_frame_turned_by_a_right_angle_by_hand(tmp_path):
    """A body turned by +90 deg about z has its x axis along y of space. In the file: (0, 0, sin 45, cos 45), A to B."""
    half = np.sqrt(0.5)
    state = ml.RigidState(np.zeros((1, 3)), np.array([[half, 0.0, 0.0, half]]))
    np.testing.assert_allclose(ml.so3.rotate(state.attitude[0], jnp.array([1.0, 0.0, 0.0])), [0, 1, 0], atol=1e-15)
    for options, wanted in (
        ({}, [0, 0, half, half]),
        ({"form": "euler", "sequence": "ZYX"}, [90, 0, 0]),
        ({"form": "spin", "body": ml.RigidBody([1.0, 1.0, 1.0])}, [270, 90, 90, 0]),
    ):
        attitudes.write(state, tmp_path / "turned.aem", times=[0.0], **SAID | options)
        line = (tmp_path / "turned.aem").read_text().splitlines()[-2].split()
        turned = np.array(line[1:], float)
        if "body" in options:  # with the axis at the pole, only the sum of the first and the last angle counts
            np.testing.assert_allclose([(turned[0] + 90 + turned[2]) % 360, turned[1]], [90, 90], atol=1e-12)
        else:
            np.testing.assert_allclose(turned, wanted, atol=1e-14)
        np.testing.assert_allclose(np.abs(attitudes.read(tmp_path / "turned.aem").attitudes @ state.attitude[0]), 1)


def test_the_direction_and_the_place_of_the_scalar_of_version_1(tmp_path):
    """B2A is the inverse; and so is A2B from the body to space."""
    seen = kept(tmp_path, OLD).attitudes
    np.testing.assert_array_equal(seen, kept(tmp_path, QUATERNIONS).segments[0].attitudes)
    inverse = seen * [1, -1, -1, -1]
    np.testing.assert_array_equal(kept(tmp_path, OLD.replace("A2B", "B2A")).attitudes, inverse)
    exchanged = OLD.replace("REF_FRAME_A     = EME2000", "REF_FRAME_A = SC_BODY_1")
    exchanged = exchanged.replace("REF_FRAME_B     = SC_BODY_1", "REF_FRAME_B = EME2000")
    np.testing.assert_array_equal(kept(tmp_path, exchanged).attitudes, inverse)
    first = re.sub(r"^(1996\S+) +(\S+) +(\S+) +(\S+) +(\S+)$", r"\1 \5 \2 \3 \4", OLD, flags=re.MULTILINE)
    np.testing.assert_array_equal(kept(tmp_path, first.replace("= LAST", "= FIRST")).attitudes, seen)


@pytest.mark.sample(4)
@pytest.mark.parametrize(
    ("form", "version"), [("quaternion", "2.0"), ("ZXZ", "1.0"), ("321", "2.0"), ("spin", "2.0"), ("quaternion", "1.0")]
)
def test_random_attitudes_come_back(tmp_path, version, form):
    rng = np.random.default_rng(1)
    times, momenta = np.sort(rng.uniform(0, 1e4, 1000)), rng.normal(size=(1000, 3))
    options = {"form": form} if form in ("quaternion", "spin") else {"form": "euler", "sequence": form}
    if form == "spin":
        options["body"] = ml.RigidBody([1.0, 2.0, 2.5])
    state, file = ml.RigidState(momenta, RANDOM), tmp_path / "random.aem"
    assert attitudes.write(state, file, times=times, version=version, **SAID | options) == 1000
    found = attitudes.read(file)
    np.testing.assert_allclose(found.times, times - times[0], rtol=0, atol=1.1e-9)
    turns = Rotation.from_quat(RANDOM, scalar_first=True).inv() * Rotation.from_quat(found.attitudes, scalar_first=True)
    assert turns.magnitude().max() < (4e-15 if form == "quaternion" else 2e-14)
    if form == "spin":
        rates = np.rad2deg(momenta[:, 2] / 2.5)
        np.testing.assert_allclose(found.segments[0].columns["SPIN_ANGLE_VEL"], rates, rtol=1e-14)


def test_euler_angles_are_turns_of_the_frame_one_after_the_other(tmp_path):
    """By SciPy, whose capital letters are turns about axes as they are by then."""
    angles = np.random.default_rng(3).uniform(-80, 80, (3, 3))
    lines = [f"1996-11-28T22:08:0{i}.0 {' '.join(map(repr, row.tolist()))}" for i, row in enumerate(angles)]
    text = re.sub(r"DATA_START[\s\S]*", "\n".join(["DATA_START", *lines, "DATA_STOP", ""]), OLD, count=1)
    text = text.replace("= QUATERNION", "= EULER_ANGLE\nEULER_ROT_SEQ = XYZ").replace("QUATERNION_TYPE = LAST\n", "")
    seen = Rotation.from_quat(kept(tmp_path, text).attitudes, scalar_first=True)
    assert (Rotation.from_euler("XYZ", angles, degrees=True).inv() * seen).magnitude().max() < 1e-14


@pytest.mark.sample(0)
def test_a_path_a_store_and_the_command_write_the_same(tmp_path, capsys):
    """In minutes, over a leap second: it is counted, and written as second 60."""
    body, start = ml.RigidBody([1.0, 2.0, 2.5]), ml.RigidState([[0.5, 0.3, 0.4]], turn(0.5, -0.3, 0.8)[None])
    run = {"dt": 0.05, "steps": 40, "save_every": 4}
    ml.simulate("RK4", body, None, start, out=tmp_path / "run.npz", progress=False, **run)
    path = ml.integrate("RK4", body, None, jax.tree.map(lambda x: x[0], start), **run)
    said = SAID | {"epoch": datetime(2016, 12, 31, 23, 59, 30, tzinfo=UTC), "time_system": "UTC", "time_unit": "min"}
    files = [tmp_path / f"{name}.aem" for name in ("path", "store", "command")]
    attitudes.write(path, files[0], **said)
    attitudes.write(tmp_path / "run.npz", files[1], **said)
    words = {"frame-a": "EME2000", "frame-b": "SC_BODY_1", "epoch": "2016-12-31T23:59:30", "time-unit": "min"}
    words |= {"time-system": "utc", "object-name": "CUBE", "object-id": "2026-001A", "originator": "LAB"}
    options = [part for name, word in words.items() for part in (f"--{name}", word)]
    assert main(["export", str(tmp_path / "run.npz"), "--format", "aem", "--out", str(files[2]), *options]) == 0
    assert "wrote" in capsys.readouterr().out
    texts = [re.sub("CREATION_DATE.*", "", file.read_text()) for file in files]
    assert texts[1] == texts[2]
    assert "T23:59:60.0" not in texts[0]  # every 12 s from 23:59:30 on
    assert "2017-01-01T00:00:05.000000000" in texts[0]  # 36 s after
    seen = [attitudes.read(file) for file in files]
    np.testing.assert_allclose(seen[0].times, 12.0 * np.arange(11), rtol=1e-12)
    for one in seen:
        np.testing.assert_allclose(one.attitudes, path.states.attitude, rtol=0, atol=1e-14)


def test_leap_seconds_are_counted_in_utc_alone():
    for system, seconds in (("UTC", 2), ("TAI", 1), ("GPS", 1)):
        before, after = (Epoch.of(system, f"{day}") for day in ("2016-12-31T23:59:59", "2017-01-01T00:00:00"))
        assert after.seconds - before.seconds == seconds
    inserted = Epoch.of("UTC", "2016-366T23:59:60.5")
    assert inserted.text(1) == "2016-12-31T23:59:60.5"
    assert inserted._replace(seconds=inserted.seconds + 1).text(1) == "2017-01-01T00:00:00.5"
    assert Epoch.of("UTC", "1972-01-01T00:00:00").text(0) == "1972-01-01T00:00:00"
    since = Epoch.of("UTC", "2026-01-01T00:00:00").seconds - Epoch.of("UTC", "1972-01-01T00:00:00").seconds
    assert since == (datetime(2026, 1, 1) - datetime(1972, 1, 1)) / timedelta(seconds=1) + 27  # 27 since 1972


# In the standard's example or another text, what is replaced by what, and the message.
WRONG = [
    (QUATERNIONS, "CCSDS_AEM", "t,x", "line 1: must be CCSDS_AEM_VERS"),
    (QUATERNIONS, "2.0\n", "3.0\n", "line 1: CCSDS_AEM_VERS must be 1.0 or 2.0, got '3.0'"),
    (QUATERNIONS, "CCSDS_AEM", "<?xml", "is XML"),
    (QUATERNIONS, "EME2000", "EME200O", "line 11: .*'EME200O'.*did you mean 'EME2000'"),
    (OLD, "ATTITUDE_DIR = A2B\n", "", "have no ATTITUDE_DIR"),
    (QUATERNIONS, "CENTER_NAME", "CENTRE_NAME", "line 10: .*did you mean 'CENTER_NAME'"),
    (QUATERNIONS, "CENTER_NAME ", "OBJECT_ID ", "line 10: OBJECT_ID occurs a second time"),
    (QUATERNIONS, "= UTC", "= MET", "line 13: TIME_SYSTEM: unknown time system 'MET'"),
    (SPIN, "= SPIN", "= EULER_ANGLE", "have no EULER_ROT_SEQ"),
    (QUATERNIONS, "  0.68427", "", "line 24: QUATERNION needs an epoch and 4 numbers, got 3"),
    (QUATERNIONS, "0.68427", "0.78427", "line 24: the quaternion must have length 1 to 0.001"),
    (QUATERNIONS, "1996-11-28T21:29:07.2555 0", "28.11.1996 0", "line 24: the epoch must be an epoch such as"),
    (QUATERNIONS, "28T22:08:04", "28T22:08:03", "line 26: epochs must ascend"),
    (QUATERNIONS, "07.2555 0", "07.2554 0", "line 24: .*not between START"),
    (QUATERNIONS, "0.67394\nDATA_STOP\n", "", "needs an epoch"),
    (QUATERNIONS, "0.67394\nDATA_STOP\n", "0.67394", "the file ends before DATA_STOP"),
]


def test_what_is_wrong_with_a_file_is_said_with_its_line(tmp_path):
    for text, old, new, message in WRONG:
        with pytest.raises(ValueError, match=message):
            kept(tmp_path, text.replace(old, new, 1))


def test_what_is_not_known_is_asked_for(tmp_path):
    own = QUATERNIONS.replace("SC_BODY_1", "LANDER")
    file = tmp_path / "own.aem"
    file.write_text(own)
    with pytest.raises(ValueError, match=r"line 12: .*pass frames=\('LANDER',\)"):
        attitudes.read(file)
    agreed = attitudes.read(file, frames=("LANDER",))
    with pytest.raises(ValueError, match=r"the frame that rotates with the body is unknown, REF_FRAME_A \(EME2000\)"):
        _ = agreed.attitudes
    seen = attitudes.read(file, frames=("LANDER",), body="B").attitudes
    np.testing.assert_array_equal(seen, kept(tmp_path, QUATERNIONS).attitudes)
    nutating = SPIN.replace("= SPIN", "= SPIN/NUTATION")
    nutating = re.sub(r"^( +2006.*)$", r"\1 1.0 20.0 30.0", nutating, flags=re.MULTILINE)
    segment = kept(tmp_path, nutating).segments[0]
    assert np.all(segment.columns["NUTATION_PER"] == 20)
    with pytest.raises(ValueError, match="gives no attitudes"):
        _ = segment.attitudes


REFUSED = [
    ({"ref_frame_a": "SC_BODY_1", "ref_frame_b": "EME2000"}, "exchange them"),
    ({"ref_frame_a": "SPACE"}, "unknown frame of ref_frame_a 'SPACE'"),
    ({"epoch": datetime(2026, 1, 1, tzinfo=UTC)}, "epoch must have no time zone"),
    ({"time_unit": "sec"}, "unknown time_unit 'sec'"),
    ({"time_unit": "ns", "times": [0.0, 0.1, 0.2]}, "ascend by more than a nanosecond"),
    ({"times": [0.0, 1.0]}, r"times must have shape \(3,\)"),
    ({"form": "matrix"}, "unknown form"),
    ({"form": "euler"}, "give it only with form='euler'"),
    ({"form": "euler", "sequence": "ZZX"}, "sequence must be three axes"),
    ({"form": "spin"}, "needs the body of the run"),
    ({"object_name": "two\nlines"}, "object_name must be one line"),
    ({"run": ml.RigidState(np.zeros((3, 2, 3)), np.tile(RANDOM[:3, None], (1, 2, 1)))}, "one body of a batch"),
    ({"run": 3.0}, "run must hold the attitudes"),
]


def test_what_cannot_be_written_is_refused(tmp_path):
    for changes, message in REFUSED:
        options = SAID | {"times": [0.0, 1.0, 2.0], "run": ml.RigidState(np.zeros((3, 3)), RANDOM[:3])} | changes
        with pytest.raises(ValueError, match=message):
            attitudes.write(options.pop("run"), tmp_path / "no.aem", **options)
    assert not (tmp_path / "no.aem").exists()


TIMES, STATES = 0.5 * np.arange(1000), ml.RigidState(np.zeros((1000, 3)), RANDOM)


def test_brahe_reads_what_is_written_here_and_writes_what_is_read(tmp_path):
    """brahe 1.8, of version 2.0."""
    brahe = pytest.importorskip("brahe.ccsds")
    for options in ({}, {"form": "euler", "sequence": "ZXZ"}):
        attitudes.write(STATES, tmp_path / "here.aem", times=TIMES, **SAID | options)
        there = brahe.AEM.from_file(str(tmp_path / "here.aem"))
        trajectory = there.segment_to_attitude_trajectory(0)
        assert len(there.segments[0].states) == 1000
        for i in range(0, 1000, 50):
            theirs = trajectory.quaternion(there.segments[0].states[i].epoch).to_vector(scalar_first=True)
            assert abs(abs(theirs @ RANDOM[i]) - 1) < 1e-12
    there.to_file(str(tmp_path / "there.aem"), "KVN")
    back = attitudes.read(tmp_path / "there.aem")
    np.testing.assert_allclose(back.times, TIMES, atol=1e-8)
    np.testing.assert_allclose(np.abs(np.sum(back.attitudes * RANDOM, axis=1)), 1, atol=1e-14)


def test_ccsds_ndm_reads_what_is_written_here(tmp_path):
    """ccsds-ndm 3.1: the quaternions of version 1.0, and spin."""
    ndm = pytest.importorskip("ccsds_ndm.ndm_kvn_io")
    attitudes.write(STATES, tmp_path / "here.aem", times=TIMES, version="1.0", **SAID)
    message = ndm.NdmKvnIo().from_path(tmp_path / "here.aem")
    lines = message.body.segment[0].data.attitude_state
    theirs = np.array([[q.qc, q.q1, q.q2, q.q3] for q in (line.quaternion_state.quaternion for line in lines)])
    np.testing.assert_allclose(theirs, RANDOM, atol=1e-15)
    (tmp_path / "there.aem").write_text(ndm.NdmKvnIo().to_string(message))
    np.testing.assert_allclose(attitudes.read(tmp_path / "there.aem").attitudes, RANDOM, atol=1e-15)


def test_a_c_kernel_by_the_recipe_has_the_attitudes_and_rates_in_spice(tmp_path):
    """Between the saved times SPICE rotates at a constant rate."""
    spice = pytest.importorskip("spiceypy")
    names = {"ml": ml}
    (recipe,) = (block for block in blocks(ROOT / "docs" / "attitude-files.md") if "def write_ck" in block)
    exec(recipe, names)
    body, epoch = ml.RigidBody([1.0, 2.0, 2.5]), 8.3e8 + 0.125
    start = ml.RigidState.from_velocity(body, [0.05, 0.03, 0.04], [0.5, 0.5, -0.5, 0.5])
    path = ml.integrate("JACOBI[EA]", body, None, start, dt=1.0, steps=120, save_every=4)
    file = str(tmp_path / "run.bc")
    names["write_ck"](path, body, file, epoch)
    spice.furnsh(file)
    try:
        read = [spice.ckgpav(-999000, spice.sce2c(-999, epoch + t), 0, "J2000") for t in np.arange(0.0, 121.0, 2.0)]
    finally:
        spice.kclear()
    matrices, rates = (np.array(x) for x in list(zip(*read, strict=True))[:2])
    right = Rotation.from_quat(np.asarray(path.states.attitude), scalar_first=True)
    np.testing.assert_allclose(matrices[::2], right.inv().as_matrix(), rtol=0, atol=1e-15)
    turning = right.apply(np.asarray(path.states.momentum) / [1.0, 2.0, 2.5])
    np.testing.assert_allclose(rates[::2], turning, rtol=0, atol=1e-15)
    finer = ml.integrate("JACOBI[EA]", body, None, start, dt=1.0, steps=120, save_every=2)
    exact = Rotation.from_quat(np.asarray(finer.states.attitude), scalar_first=True)
    assert np.max((exact * Rotation.from_matrix(matrices)).magnitude()) < 0.01


# ---- ephemerides and fields: the functions of docs/orbits.md that read them, against these programs ----

FIRST_LINE = "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991"
SECOND_LINE = "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
SECONDS = np.arange(0.0, 6001.0, 20.0)
BETWEEN = np.arange(3.0, 5990.0, 7.0)


@cache
def page():
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
    """Between the rows of the table as sgp4 says."""
    from sgp4.api import Satrec

    table = page()["from_tle"](FIRST_LINE, SECOND_LINE, SECONDS)
    satellite = Satrec.twoline2rv(FIRST_LINE, SECOND_LINE)
    days = satellite.jdsatepochF + BETWEEN / 86400
    right = 1e3 * satellite.sgp4_array(np.full(len(days), satellite.jdsatepoch), days)[1]
    assert distances(table, right).max() < 0.5


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
        table = page()["from_tle"](FIRST_LINE, SECOND_LINE, SECONDS)
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
