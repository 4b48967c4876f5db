"""`midlie inspect --plot` draws any store, and `midlie export` writes attitudes that give the rotation back."""

import csv
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax._math.euler import euler_angles, matrices_of
from midlie_jax.cli.main import main
from midlie_jax.cli.run_chart import store_figure

pytest.importorskip("zarr")
SEQUENCES = ["".join(s) for s in itertools.product("XYZ", repeat=3) if s[1] not in (s[0], s[2])]


def turned(axis, angles):
    return np.asarray(ml.so3.to_matrix(ml.so3.exp(jnp.asarray(np.outer(angles, np.eye(3)["XYZ".index(axis)])))))


def together(sequence, angles):
    one, two, three = (turned(axis, angles[:, i]) for i, axis in enumerate(sequence))
    return one @ two @ three


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_angles_give_the_rotation_back(sequence):
    """Also where the first and third axis are parallel."""
    proper = sequence[0] == sequence[2]
    second = [0.0, np.pi] if proper else [np.pi / 2, -np.pi / 2]
    angles = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    angles[:, 1] = abs(angles[:, 1]) if proper else angles[:, 1] / 2
    angles[:2, 1] = second
    matrices = together(sequence, angles)
    found, locked = euler_angles(matrices, sequence)
    assert list(np.flatnonzero(locked)) == [0, 1]
    np.testing.assert_allclose(together(sequence, found), matrices, atol=1e-12)
    np.testing.assert_allclose(found[2:], angles[2:], atol=1e-9)


NEAREST = np.array([0.0, 1e-15, 1e-12, 1e-9, 9e-8, 1e-7, 3e-7, 1e-6, 1e-5, 1e-3])  # to the pole, radians


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_angles_near_the_poles_give_the_rotation_back(sequence):
    """Near a pole, rounding changes the first angle much; the three angles together still give the rotation.

    Of rounded matrices and of quaternions, in float32 and float64; by SciPy.
    """
    angles = np.random.default_rng(1).uniform(-3, 3, (20, 2, len(NEAREST), 3))
    low, high = (0, np.pi) if sequence[0] == sequence[2] else (-np.pi / 2, np.pi / 2)
    angles[..., 1] = np.stack([low + NEAREST, high - NEAREST])
    rotations = Rotation.from_euler(sequence, angles.reshape(-1, 3))
    for dtype in (np.float32, np.float64):
        given = rotations.as_quat(scalar_first=True).astype(dtype)
        whole = Rotation.from_quat(given.astype(float), scalar_first=True).as_matrix()
        for matrices, wanted in ((matrices_of(given), whole), (rotations.as_matrix().astype(dtype),) * 2):
            found, _ = euler_angles(matrices, sequence)
            rebuilt = Rotation.from_euler(sequence, found.astype(float)).as_matrix()
            np.testing.assert_allclose(rebuilt, wanted, atol=8 * np.finfo(matrices.dtype).eps)


def test_a_quaternion_of_float32_near_a_pole():
    """The exported third angle was 1.093451, which with the first angle is a rotation that is wrong by 0.08."""
    quaternion = np.array([[0.34997767, 0.61442322, 0.34997699, -0.61442322]], np.float32)
    for matrices, near in (
        (matrices_of(quaternion), 1e-15),
        (np.asarray(ml.so3.to_matrix(jnp.asarray(quaternion))), 1e-6),
    ):
        found, _ = euler_angles(matrices, "ZYX")
        turn = Rotation.from_euler("ZYX", found.astype(float)).inv() * Rotation.from_quat(quaternion, scalar_first=True)
        assert turn.magnitude() < near


def start(bodies):
    return ml.RigidState(
        jnp.tile(jnp.array([0.1, 0.3, 3.0]), (bodies, 1)) * jnp.arange(1.0, bodies + 1)[:, None],
        jnp.tile(jnp.eye(4)[0], (bodies, 1)),
    )


def simulated(out, **options):
    given = {"dt": 0.1, "steps": 10, "save_every": 2, "progress": False, **options}
    return ml.simulate("SYMMETRIC[EA]", ml.RigidBody([2.0, 2.0, 1.0]), None, start(3), out=out, **given)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("run") / "run.zarr")


def said(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_export_writes_time_and_attitude(run, capsys, tmp_path):
    opened = run.open()
    code, out, _ = said(capsys, "export", run.out, "--body", 2, "--csv")
    lines = list(csv.reader(out.splitlines()))
    assert (code, lines[0]) == (0, ["time", "attitude_w", "attitude_x", "attitude_y", "attitude_z"])
    table = np.array(lines[1:], float)
    np.testing.assert_array_equal(table[:, 0], opened.time)
    np.testing.assert_array_equal(table[:, 1:], opened.attitude[2])
    for options, unit, scale in (((), "deg", np.pi / 180), (("--radians",), "rad", 1.0)):
        file = tmp_path / "angles.csv"
        code, out, _ = said(capsys, "export", run.out, "--euler", "ZYX", "--out", file, *options)
        assert (code, f"wrote {file}: 6 attitudes of body 0" in out) == (0, True)
        lines = list(csv.reader(file.read_text().splitlines()))
        assert lines[0] == ["time", f"euler_1_Z [{unit}]", f"euler_2_Y [{unit}]", f"euler_3_X [{unit}]"]
        angles = scale * np.array(lines[1:], float)[:, 1:]
        matrices = np.asarray(ml.so3.to_matrix(jnp.asarray(opened.attitude[0].values)))
        np.testing.assert_allclose(together("ZYX", angles), matrices, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--euler", "ZZX"), "without equal neighbours"),
        (("--euler", "zyx"), "write for example ZYX"),
        (("--body", 3), "body must be from 0 to 2"),
        (("--out", "angles.txt"), "must end in .csv"),
    ],
)
def test_export_refuses_in_words(run, capsys, options, words):
    code, _, error = said(capsys, "export", run.out, *options)
    assert (code, words in error) == (2, True), error


OBSERVED = {
    "states": ({}, ["attitude w", "attitude x", "attitude y", "attitude z", "momentum 1", "momentum 2", "momentum 3"]),
    "a number": ({"observe": ml.observe.energy}, ["observed"]),
    "a step each": ({"dt": jnp.array([0.1, 0.2, 0.3]), "observe": ml.observe.energy}, ["observed"]),
    "histogram": (
        {"observe": ml.observe.Histogram(ml.observe.energy, [0.0, 1.0, 9.0])},
        ["observed 1", "observed 2"],
    ),
    "spectrum": ({"observe": ml.observe.Spectrum(ml.observe.energy, 5)}, ["density", "error", "number"]),
}


@pytest.mark.sample(0)
@pytest.mark.parametrize("observed", OBSERVED)
def test_any_store_is_drawn(tmp_path, capsys, observed):
    options, titles = OBSERVED[observed]
    result = simulated(tmp_path / "run.zarr", **options)
    figure = store_figure(ml.simulation.inspect(result.out))
    assert [axes.get_title(loc="left") for axes in figure.axes] == titles
    assert len(figure.axes[0].lines) == (1 if observed in ("histogram", "spectrum") else 3)
    points = 3 if observed == "spectrum" else 6
    assert all(len(line.get_xdata()) == points for axes in figure.axes for line in axes.lines)
    assert figure.axes[0].get_xlabel() == ("Frequency" if observed == "spectrum" else "Time t")
    if observed == "histogram":
        picture = tmp_path / "run.png"
        code, _, _ = said(capsys, "inspect", result.out, "--plot", picture)
        assert (code, picture.stat().st_size > 5000) == (0, True)


@pytest.mark.parametrize("ending", ["zarr", "npz"])
def test_a_run_goes_on_from_the_last_states_of_another(run, tmp_path, ending):
    """With the same bits and times; the start and the end alone are saved unless more is asked for."""
    one = simulated(tmp_path / f"one.{ending}", steps=4, save_every=None)
    states = one.states()
    assert isinstance(states, ml.RigidState)
    assert states.momentum.shape == (3, 2, 3)
    last = jax.tree.map(lambda x: x[:, -1], states)
    body = ml.RigidBody([2.0, 2.0, 1.0])
    rest = {"dt": 0.1, "steps": 6, "first_step": 4, "save_every": 2, "progress": False}
    two = ml.simulate("SYMMETRIC[EA]", body, None, last, out=tmp_path / f"two.{ending}", **rest)
    whole = run.states()
    for one, other in zip(jax.tree.leaves(two.states()), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(one, other[:, 2:])
    np.testing.assert_array_equal(two.open()["time"], run.open().time[2:])


def test_what_was_observed_is_no_state(tmp_path):
    seen = simulated(tmp_path / "run.zarr", observe=ml.observe.angular_velocity)
    with pytest.raises(ValueError, match="holds no states"):
        seen.states()
