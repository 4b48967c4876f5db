"""`midlie fit`: what it reads from a file, prints and draws, and what it says of a wrong file."""

import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cases import LEVEL, assert_one_line, midlie, tumbled
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from midlie_jax.cli.fit import free_flight
from midlie_jax.fitting import fit

ROOT = Path(__file__).resolve().parent.parent

MOMENTS, RATE = np.array([1.0, 3.2, 4.0]), np.array([0.8, 1.2, 2.0])
FIELD, IRON = np.array([30.0, 10.0, -35.0]), np.array([5.0, -8.0, 3.0])
# Of a tumbling body with I1/I3 = 0.25, some six turns in twenty seconds.
states_at = partial(tumbled, MOMENTS, RATE, attitude=LEVEL)


def noisy(rng, values, size):
    return values + size * rng.standard_normal(np.shape(values))


def magnetic(rng, turns):
    return noisy(rng, turns.inv().apply(FIELD) + IRON, 0.3)


def save(file, head, columns, separator=",", form="{:.6f}"):
    """Columns of numbers or texts; a NaN is an empty cell."""
    texts = [[x if isinstance(x, str) else "" if np.isnan(x) else form.format(x) for x in one] for one in columns]
    rows = zip(*texts, strict=True)
    file.write_text("\n".join([head.replace(",", separator), *(separator.join(row) for row in rows)]) + "\n")
    return file


@pytest.fixture
def nothing_is_compiled(monkeypatch):
    monkeypatch.setattr(sys.modules[fit.__module__], "solved", None)


def numbers(out, name):
    return [float(x) for x in re.findall(rf"^{name}(?:\[\d\])? +(-?[\d.]\S*)", out, re.M)]


def interval(out):
    return [float(x) for x in re.search(r"moments\[0\] / moments\[2\] .*\[([\d.]+), ([\d.]+)\]", out).groups()]


@pytest.mark.sample(0)
def test_the_moments_and_rates_of_a_file_are_found_and_drawn(tmp_path):
    """In degrees per second, with columns of another order and an empty cell, from t = 2; then with a wrong unit."""
    picture, times = tmp_path / "fit.png", np.arange(2.0, 14.1, 0.2)
    rates = np.rad2deg(states_at(times - 2)[0])
    rates[3, 1] = np.nan
    file = save(tmp_path / "gyro.csv", "p,q,r,seconds", [*rates.T, times], form="{:.12g}")
    columns = ["--columns", "seconds", "p", "q", "r"]
    code, out, err = midlie("fit", file, "--scene", "free-body", "--unit", "deg/s", *columns, "--out", picture)
    assert (code, err) == (0, "")
    assert "182 angular velocities at 61 times" in out
    np.testing.assert_allclose(numbers(out, "rate"), np.rad2deg(RATE), atol=1e-6)  # in the unit of the file
    moments = np.array(numbers(out, "moments"))
    np.testing.assert_allclose(moments, MOMENTS * moments.sum() / MOMENTS.sum(), atol=1e-8)
    assert abs(float(re.search(r"moments\[0\] / moments\[2\] +(\S+)", out)[1]) - 0.25) < 1e-8
    assert picture.read_bytes().startswith(b"\x89PNG")
    file = save(tmp_path / "ms.csv", "t,p,q,r", [200 * times, *rates.T], form="{:.8g}")
    code, out, err = midlie("fit", file, "--unit", "deg/s", "--moments", *MOMENTS)
    assert code == 2
    assert re.search("the body turns [0-9.]+ times between rows", err)
    assert "; ok" not in out


GOOD = "t,x,y,z\n0,1,2,3\n1,1,2,3\n"
DATED = "t,x,y,z\n2026-01-01T00:00:00Z,1,2,3\n2026-01-01T00:00:01Z,1,2,3\n"
WRONG = [
    ("t,x,y,z\n\udcff\udcfe,1", [], "is not text"),
    (GOOD, ["--from", "9"], "its times go from 0 to 1"),
    ("t,x,y\n0,1,2\n", [], "four columns are needed"),
    ("t,x,y,z\n0,1,2,3\n", ["--columns", "t", "x", "y", "w"], "no column 'w'; it has t, x, y, z"),
    ("t,x,y,z\n0,,,\n1,,,\n", [], "NaN in every row"),
    ("t,x,y,z\n0,1,2,3\n", [], "two times"),
    ("t,x,y,z\n0,.1,.2,.3\n1,.1,.2,.3\n", ["--moments", "1", "1", "9"], "strict triangle"),
    ("0,1,2,3\n1,1,2,3\n", [], "line 1: numbers in place of column names"),
    ("t,x,y,z\n0,1,2,3\n\n1,1,2", [], "line 4 has 3 cells and the header 4: the row is truncated"),
    ("t,x,y,z\n0,1.25,2.25,3.25\n1,1.25,2.25,3.2", [], "line 3 is truncated: it has no line break"),
    ("t,x,y,z\n0,1,5,2,3,1\n", [], "line 2 has 6 cells and the header 4; numbers with decimal commas"),
    ("t;x;y;z\n0,5;1;2;3\n1,5;1;z;3\n", [], "line 3: y must be a number, got 'z'"),
    ("\ufefft,x,y,z\r\n0,1,2,3\r\n1,1,inf,3\r\n", [], "line 3: y must be finite"),
    ("wx,wy,wz,time\n0,1,2,3\n1,1,2,3\n", [], "the time in column 'time', not in the first"),
    ("t_ms,x,y,z\n0,1,2,3\n1,1,2,3\n", [], "'t_ms' is in ms by its name; give --time-unit ms"),
    ("t,wx [deg/s],wy,wz\n0,1,2,3\n1,1,2,3\n", [], "is in deg/s by its name; give --unit deg/s"),
    ("t,x,y,z\n0,1,2,3\n10,1,2,3\n20,1,2,3\n", [], "rotates 5.96 times between rows; check the unit of time"),
    ("t,x,y,z\n0,1,2,3\n1,125,2,3998\n2,1,2,3\n3,1,2,3\n", [], "line 3: the rate is 4e+03, but usually 3.74; check"),
    (GOOD, ["--magnetometer", "x", "y", "z"], "give --sigma and --magnetometer-sigma"),
    (GOOD, ["--hard-iron"], "--hard-iron needs --magnetometer"),
    (DATED, ["--time-unit", "ms"], "--time-unit must be left out for dates"),
    (DATED, ["--from", "2026-01-01T00:00:01"], "--from 2026-01-01T00:00:01 must have a zone like Z"),
    (DATED, ["--from", "1.1"], "its times go from 2026-01-01T00:00:00.000000Z to 2026-01-01T00:00:01.000000Z"),
    (DATED + "2026-01-01T00:00:02,1,2,3\n", [], "line 4: t must have a zone like Z or +02:00 in all times"),
    (DATED + "2,1,2,3\n", [], "line 4: t must be a date, as in the rows above, got '2'"),
    (DATED + "2026-01-01T01:00:00+01:00,1,2,3\n", [], "line 4: times must ascend, but t goes back from 2026-01-01"),
    ('t;x;y;z\n0;1;2;"1,204.5"\n', [], "line 2: z must be a number, got '1,204.5'"),
    ("# a phone\nsep=;\nt;x;y;z\n0;1;2;3\n1;1;two;3\n", [], "line 5: y must be a number, got 'two'"),
]


def test_one_line_says_what_is_wrong_with_a_file(tmp_path, nothing_is_compiled):
    file = tmp_path / "data.csv"
    for text, options, message in WRONG:
        file.write_bytes(text.encode("utf-8", "surrogateescape"))
        assert_one_line(["fit", file, "--unit", "rad/s", *options], [message])


def log(tmp_path, bias=0.0):
    times, rng = np.arange(0.0, 20.01, 0.05), np.random.default_rng(1)
    rates = noisy(rng, states_at(times)[0] + bias * np.array([1.0, -0.8, 0.6]), 0.01)
    return save(tmp_path / "log.csv", "t,wx,wy,wz", [times, *rates.T])


@pytest.mark.sample(0)
def test_a_doubtful_fit_is_not_ok_and_with_its_cure_the_truth_is_found(tmp_path):
    """A bias of a degree and a half per second that nobody asked for."""
    biased = log(tmp_path, bias=np.deg2rad(1.5))
    code, out, err = midlie("fit", biased, "--unit", "rad/s")
    assert code == 2
    assert "neighbouring residuals are correlated" in err
    assert "try --bias" in err
    assert "; ok" not in out
    code, out, err = midlie("fit", biased, "--unit", "rad/s", "--bias", "--sigma", "0.01")
    assert (code, err) == (0, "")
    low, high = interval(out)
    assert low < 0.25 < high < low + 0.01
    assert abs(numbers(out, "bias")[0] - np.deg2rad(1.5)) < 2e-3


@pytest.mark.sample(0)
def test_residuals_above_sigma_and_single_wrong_values_are_not_ok(tmp_path):
    """Of a part of the file; a wrong value is named by its line and time."""
    file, part = log(tmp_path), ["--unit", "rad/s", "--from", "0", "--to", "15"]
    code, out, err = midlie("fit", file, *part, "--sigma", "0.003")
    assert "903 angular velocities at 301 times" in out
    assert (code, "times the sigmas" in err, "NOT ok" in out) == (2, True, True)
    rows = file.read_text().split("\n")
    for row in (100, 200, 300):
        cells = rows[row].split(",")
        rows[row] = ",".join([*cells[:3], "5.5", *cells[4:]])
    file.write_text("\n".join(rows))
    code, _, err = midlie("fit", file, *part)
    assert code == 2
    assert "lines 101, 201, 301: Rates: 3 values are off by" in err
    assert "at t = 4.95, 9.95, 14.95" in err


LATE = 0.03


def two_logs(tmp_path, late=0.0, begin=0.9):
    """A gyroscope at 20 Hz and a magnetometer at 7 Hz, with other separators and units; and the options of the docs."""
    times, others, rng = np.arange(0.0, 20.01, 0.05), np.arange(begin, 19.0, 1 / 7), np.random.default_rng(1)
    rates = np.rad2deg(noisy(rng, states_at(times)[0], 0.01))
    field = magnetic(rng, states_at(others - late)[1])
    gyro = save(tmp_path / "gyro.csv", "t,wx,wy,wz", [times + 100, *rates.T])
    compass = save(tmp_path / "mag.csv", "bx,by,bz,stamp_ms", [*field.T, 1000 * (others + 100)], ";")
    page = (ROOT / "docs" / "fitting.md").read_text()
    (line,) = re.findall(r"^midlie fit DATA.csv (.*) --magnetometer-clock fitted$", page, re.MULTILINE)
    return gyro, compass, [compass if word == "FILE" else word for word in line.split()]


@pytest.mark.sample(0)
def test_two_files_of_two_instruments_are_fitted_together(tmp_path):
    """Of other times, units and separators; the second begins later, and its clock is ahead."""
    gyro, compass, options = two_logs(tmp_path, LATE)
    code, out, err = midlie("fit", gyro, *options, "--magnetometer-clock", "fitted")
    assert (code, err) == (0, "")
    assert f"{compass}: {len(compass.read_text().splitlines()) - 1} directions of the field" in out
    low, high = interval(out)
    assert low < 0.25 < high
    np.testing.assert_allclose(numbers(out, "iron"), IRON, rtol=0, atol=0.3)
    found, deviation = (float(x) for x in re.search(r"^clock +(\S+) +(\S+)", out, re.M).groups())
    assert abs(found - LATE) < 3 * deviation < 0.01
    assert "those at t = 100 s" in out


WRONG_SECOND = [
    (lambda o, _: o, "needs --magnetometer-clock: `same`"),
    (lambda o, _: [*without(o, "--magnetometer-time-unit"), *SAME], "give --magnetometer-time-unit ms"),
    (lambda o, f: [*other(o, f, "stamp_ms", "stamp"), *SAME], "mag.csv has no column 'stamp_ms'.*--magnetometer-t"),
    (lambda o, f: [*other(o, f, r"\n\S+?;", "\nx;"), *SAME], "mag.csv, line 2: bx must be a number, got 'x'"),
    (lambda o, f: [*other(o, f, ";1([0-9.]+)\n", r";2\1\n"), *SAME], "is of t = 200.9 to .* count from the same"),
    (lambda o, f: [*other(o, f, ";100900", ";095000"), *SAME], "begins 5 s before .*before line 3"),
]


def test_one_line_says_what_is_wrong_with_a_second_file(tmp_path, nothing_is_compiled):
    for change, message in WRONG_SECOND:
        gyro, compass, options = two_logs(tmp_path)
        code, _, err = midlie("fit", gyro, *change(options, compass))
        assert code == 2
        assert re.search(message, err), err


SAME = ["--magnetometer-clock", "same"]


def without(options, name):
    place = options.index(name)
    return options[:place] + options[place + 2 :]


def other(options, file, old, new):
    file.write_text(re.sub(old, new, file.read_text()))
    return options


def test_a_record_with_a_flight_of_less_than_a_revolution_is_named(tmp_path, nothing_is_compiled):
    """A phone in the hand, a free flight of one second, and the catch."""
    times, rates, first, last = recorded(rate=(4.5, 0.5, 1.5), flight=1.0)
    file = save(tmp_path / "phone.csv", "t,wx,wy,wz", [1000 * times, *rates.T])
    code, _, err = midlie("fit", file, "--unit", "rad/s", "--time-unit", "ms", "--bias")
    assert code == 2
    assert "the file holds more than a free flight" in err
    begin, end = (float(x) for x in re.search(r"--from (\S+) --to (\S+)\.", err).groups())
    assert 1000 * first - 300 < begin < 1000 * first + 100 < 1000 * last - 100 < end < 1000 * last + 500


def recorded(seed=0, rate=(2.0, 7.0, 1.0), hz=100, noise=1.0, still=0.0, held=3.0, flight=1.2, flights=1, off=0.0):
    """Rest, motion in a hand, a throw, a catch: times, biased rates off the axes, begin and end of the last flight."""
    rng, moments, dt = np.random.default_rng(seed), np.array([0.9, 3.1, 3.9]), 1 / hz
    parts = [np.zeros((int(still * hz), 3))]
    for k in range(flights):
        knots = np.linspace(0, held, int(4 * held) + 2)
        shaken = rng.normal(0.0, 1.0, (len(knots), 3))
        shaken[-2], shaken[-1] = -0.2 * np.array(rate), rate
        parts.append(CubicSpline(knots, shaken)(np.arange(0, held - dt / 2, dt)))
        begin = dt * sum(map(len, parts))
        parts.append(tumbled(moments, rate, np.arange(0, flight * (1 + 0.2 * k), dt))[0])
        end, x = dt * (sum(map(len, parts)) - 1), np.linspace(0, 1, hz // 2)[:, None]
        parts.append(parts[-1][-1] * np.exp(-6 * x) * np.cos(25 * x) * [1, -0.8, 1.3])
    axis = np.random.default_rng(100 + seed).normal(size=3)
    rates = np.concatenate(parts) @ Rotation.from_rotvec(np.deg2rad(off) * axis / np.linalg.norm(axis)).as_matrix()
    rates = rates + np.deg2rad([1.5, -1.0, 0.8]) + np.deg2rad(noise) * rng.standard_normal(rates.shape)
    return dt * np.arange(len(rates)), rates, begin, end


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    "given",
    [
        {"hz": 50},
        {"rate": (1.0, 3.0, 12.0), "flight": 0.7},
        {"off": 5.0, "rate": (5.0, 9.0, 4.0), "noise": 0.1},
        {"hz": 400},
        {"held": 30.0, "still": 30.0, "noise": 0.1},
        {"flights": 3},
    ],
    ids=str,
)
def test_the_flight_in_a_record_is_found(given):
    """Never a row of the hand; at the ends at most half a window of half a radian, and a few rows, are lost."""
    for seed in range(3):
        times, rates, begin, end = recorded(seed, **given)
        first, last = free_flight(times, rates) or (np.nan, np.nan)
        lost = 0.5 / np.linalg.norm(rates, axis=1).max() + 2 / given.get("hz", 100)
        assert begin - 1e-9 <= first < begin + lost
        assert end - lost < last <= end + 1e-9
        held = times < begin  # with other flights, if there are several
        assert "flights" in given or free_flight(times[held], rates[held]) is None


def three_instruments(tmp_path, order=(0, 1, 2, 3), sign=1.0):
    """With a star tracker on every tenth row, gaps of each instrument, dates, and semicolons."""
    times, rng = np.arange(0.0, 20.01, 0.05), np.random.default_rng(3)
    rates, turns = states_at(times, attitude=(0.5, 0.5, -0.5, 0.5))
    rates, field = np.rad2deg(noisy(rng, rates, 0.01)), magnetic(rng, turns)
    seen = turns * Rotation.from_rotvec(1e-3 * rng.standard_normal(rates.shape))
    quaternions = (seen if sign > 0 else seen.inv()).as_quat(scalar_first=True)[:, list(order)]
    quaternions[np.arange(len(times)) % 10 != 2], rates[100:160], field[200:300] = np.nan, np.nan, np.nan
    dates = [f"{np.datetime64('2026-03-28T23:59:58') + np.timedelta64(round(1e9 * t), 'ns')}Z" for t in times]
    columns = [dates, *rates.T, *field.T, *quaternions.T]
    return save(tmp_path / "craft.csv", "time,wx,wy,wz,mx,my,mz,a,b,c,d", columns, ";")


THREE = ["--unit", "deg/s", "--sigma", "0.573", "--tracker", "a", "b", "c", "d", "--tracker-sigma", "0.0573"]
THREE += ["--magnetometer", "mx", "my", "mz", "--magnetometer-sigma", "0.4", "--hard-iron"]


@pytest.mark.sample(0)
def test_a_gyroscope_a_star_tracker_and_a_magnetometer_with_gaps_in_one_fit(tmp_path):
    code, out, err = midlie("fit", three_instruments(tmp_path), *THREE)
    assert (code, err) == (0, "")
    low, high = interval(out)
    assert low < 0.25 < high
    assert high - low < 0.001  # without the star tracker 0.004
    np.testing.assert_allclose(numbers(out, "iron"), IRON, rtol=0, atol=0.3)
    assert np.dot(numbers(out, "field"), FIELD) / np.linalg.norm(FIELD) > np.cos(0.005)


def test_quaternions_of_another_convention_are_named(tmp_path, nothing_is_compiled):
    for given, options, cure in (
        ({"sign": -1.0}, [], "conjugated, from space to body, .* Give --space-to-body."),
        ({}, ["--space-to-body"], "conjugated, from space to body, .* Leave out --space-to-body."),
        ({"order": (1, 2, 3, 0)}, [], "scalar-last, .* Name the columns of --tracker in the order w x y z."),
    ):
        code, _, err = midlie("fit", three_instruments(tmp_path, **given), *THREE, *options)
        assert code == 2
        assert re.search(cure, err), err
