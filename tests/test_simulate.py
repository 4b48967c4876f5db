"""Long runs in parts: the same bits however a run is cut short or spread; and errors that say what to do."""

import contextlib
import inspect
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import zarr
from cases import whole
from simulated import BODIES, EVERY, MOMENTA, MOMENTS, STEPS, WEIGHTS, simulated

import midlie_jax as ml
from midlie_jax.simulation.store import Store

xarray = pytest.importorskip("xarray")
SAVES = 1 + STEPS // EVERY


def contents(path):
    root = zarr.open_group(path, mode="r")
    places = [root, *(group for name, group in root.groups() if name == "parts")]
    return {array.path: np.asarray(array[...]) for place in places for _, array in place.arrays()}


def assert_same(path, expected):
    found = contents(path)
    assert found.keys() == expected.keys()
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "run.zarr"
    simulated(path)
    return contents(path)


@pytest.mark.sample(0)
def test_a_simulation_is_the_ensemble(tmp_path, reference):
    """Its path, bit for bit; xarray opens it, with names, units and frames. A small run fits one file."""
    result = simulated(tmp_path / "run.zarr")
    assert (result.bodies, result.saves, result.computed) == (BODIES, SAVES, BODIES * STEPS)
    assert result.ok.all()
    assert "all bodies ok" in str(result)
    assert_same(result.out, reference)
    run = xarray.open_zarr(result.out)
    assert run.momentum.dims == ("body", "time", "axis")
    assert (run.momentum.units, run.momentum.frame) == ("mass length2 time-1", "body")
    assert list(run.quaternion.values) == ["w", "x", "y", "z"]
    assert (run.method, run.dt, run.steps) == ("SYMMETRIC[EA]", 0.05, STEPS)
    assert json.loads(run.versions)["jax"] == jax.__version__
    assert json.loads(run.parameters) == {"dt": 0.05, "t0": 0.0}
    np.testing.assert_array_equal(run.parameter_body_moments, MOMENTS)
    body = ml.RigidBody(jnp.asarray(MOMENTS))
    start = ml.RigidState(run.momentum.values[:, 0], run.attitude.values[:, 0])
    top = ml.torques.HeavyTop(jnp.asarray(run.parameter_torque_mgl.values))
    # What all bodies share is computed for each span, under a field that goes round.
    field = ml.spacecraft.GravityGradient(None, ml.orbits.CircularOrbit([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1.0), 1.0)
    for torque, found in ((top, run), (field, simulated(tmp_path / "field.zarr", torque=field).open())):
        path = ml.ensemble("SYMMETRIC[EA]", body, torque, start, dt=0.05, steps=STEPS, save_every=EVERY, chunk=4)
        np.testing.assert_array_equal(path.states.momentum, found.momentum)
        np.testing.assert_array_equal(path.states.attitude, found.attitude)
    np.testing.assert_allclose(path.times, run.time, rtol=1e-15)
    with simulated(tmp_path / "run.npz").open() as file:
        for name in ("momentum", "attitude", "first_bad", "time"):
            np.testing.assert_array_equal(file[name], reference[name])
        assert (str(file["method"]), int(file["steps"])) == ("SYMMETRIC[EA]", STEPS)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("suffix", "method"), [("zarr", "JACOBI[EA]"), ("npz", "RK4")])
def test_a_run_continued_from_a_carry_has_the_same_bits(tmp_path, suffix, method):
    """In `simulate` and `ensemble`, and after a complete run has been opened again; times and indices go on."""
    half = {"steps": STEPS // 2, "method": method}
    whole_run = simulated(tmp_path / f"whole.{suffix}", method=method).open()
    first = simulated(tmp_path / f"first.{suffix}", **half)
    if suffix == "zarr":
        first = simulated(first.out, resume=True, **half)
        assert first.computed == 0
    np.testing.assert_array_equal(first.carry.index, STEPS // 2)
    second = simulated(tmp_path / f"second.{suffix}", start=first.carry, **half)
    found = second.open()
    rest = slice((SAVES - 1) // 2, None)
    for name in ("momentum", "attitude"):
        np.testing.assert_array_equal(found[name], np.asarray(whole_run[name])[:, rest])
    np.testing.assert_array_equal(found["time"], np.asarray(whole_run["time"])[rest])
    body, torque = ml.RigidBody(jnp.asarray(MOMENTS)), ml.torques.HeavyTop(jnp.asarray(WEIGHTS))
    end = ml.ensemble(method, body, torque, second.carry, dt=0.05, steps=1).carry
    np.testing.assert_array_equal(end.index, STEPS + 1)


@pytest.mark.sample(0)
def test_a_run_from_another_carry_is_refused(tmp_path):
    half = {"steps": STEPS // 2}
    first = simulated(tmp_path / "first.npz", **half)
    with pytest.raises(ValueError, match="first_step must be left out"):
        simulated(tmp_path / "run.npz", start=first.carry, first_step=3, **half)
    with pytest.raises(ValueError, match="start must be a Carry of the same method"):
        simulated(tmp_path / "run.npz", method="RK4", start=first.carry, **half)
    simulated(tmp_path / "run.zarr", start=first.carry, **half)
    other = eqx.tree_at(lambda carry: carry.progress.force[0], first.carry, first.carry.progress.force[0] + 1)
    with pytest.raises(ValueError, match=r"carry\.force"):
        simulated(tmp_path / "run.zarr", start=other, resume=True, **half)


class CrashError(Exception):
    """As if the process ended here."""


def crash_at(monkeypatch, instant):
    """Raises in place of the write to the store with this number, in the middle of it if it is a checkpoint."""
    count, savez = [0], np.savez

    def counted(write):
        def called(target, *arguments, **named):
            count[0] += 1
            if count[0] == instant:
                if write is savez:
                    target.write(b"PK" * 500)
                raise CrashError
            return write(target, *arguments, **named)

        return called

    monkeypatch.setattr(zarr.Array, "__setitem__", counted(zarr.Array.__setitem__))
    monkeypatch.setattr(np, "savez", counted(np.savez))


CREATED = 5  # writes before the first part: the time, two parameters, the names of components
WRITES = 16 * 4  # in the 16 parts: two variables, first_bad, and the checkpoint


@pytest.mark.sample(0)
@pytest.mark.parametrize("nth", range(2))
def test_a_run_stopped_at_any_write_ends_with_the_same_bits(tmp_path, monkeypatch, reference, nth):
    path, instants = tmp_path / "run.zarr", random.Random(nth)
    first = 4 * instants.randrange(1, 17) if nth else instants.randrange(1, WRITES + 1)  # the fourth is a checkpoint
    for instant in (CREATED + first, instants.randrange(1, 20)):
        with monkeypatch.context() as patch, contextlib.suppress(CrashError):
            crash_at(patch, instant)
            simulated(path, resume=True)
            assert instant < 20  # the second time there may not be so much left to write
        assert ml.simulation.inspect(path).damaged == ()
    simulated(path, resume=True)
    assert_same(path, reference)
    left = {file.name for file in (path / "checkpoint").iterdir()}
    assert left == {"zarr.json", *(f"{group}.npz" for group in range(4))}
    assert simulated(path, resume=True).computed == 0


def pulled(t, state):
    """A torque that stops being a number for a body that comes near one direction."""
    up = ml.so3.to_matrix(state.attitude)[2]
    return jnp.sqrt(up[2] + 0.9) * jnp.cross(up, jnp.array([0.0, 0.0, 1.0]))


@pytest.mark.sample(0)
def test_a_body_that_fails_leaves_the_others_untouched(tmp_path):
    """NaN from a torque, a momentum that overflows, and a solve that ends without a solution."""
    momenta = MOMENTA.copy()
    momenta[7], momenta[33] = [1e200, 1e200, 1e200], [400.0, 90.0, 300.0]
    options = {"method": "LIEMID[EA]", "torque": pulled, "steps": 60}
    bad = simulated(tmp_path / "bad.zarr", momenta=momenta, **options)
    good = simulated(tmp_path / "good.zarr", **options)
    failed = set(np.flatnonzero(~bad.ok))
    assert {7, 33} < failed
    assert failed - {7, 33} == set(np.flatnonzero(~good.ok)) - {7, 33} != set()
    others = [body for body in range(BODIES) if body not in (7, 33)]
    one, other = contents(bad.out), contents(good.out)
    for name in ("momentum", "attitude", "first_bad"):
        np.testing.assert_array_equal(one[name][others], other[name][others])
    assert "bodies FAILED" in str(bad)
    for body in failed:
        before = one["momentum"][body, : bad.first_bad[body]]
        assert np.all(np.isfinite(before))
    assert f"body {min(failed)} from saved state {bad.first_bad[min(failed)]}" in str(bad)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("span", "first_bad"), [(15, 1), (12, 12)])
def test_a_gain_of_energy_is_found_in_spans_of_any_length(tmp_path, span, first_bad):
    """From 128 steps of the run on, also where no span has as many and where the last one is short."""
    torque = ml.torques.FromPotential(lambda t, state: jnp.sum(state.position**2) / 2)
    start = ml.ParticleState(jnp.full((3, 2), 1e-3), jnp.zeros((3, 2)))
    run = {"dt": 2.002, "save_every": 10}

    def simulated(start, out, **options):
        return ml.simulate("Verlet", ml.Particles(jnp.ones(2)), torque, start, out=tmp_path / out, **run, **options)

    assert simulated(start, "run.npz", steps=200, span=span).first_bad.tolist() == [first_bad] * 3
    before = simulated(start, "before.npz", steps=70)
    assert before.ok.all()
    assert not simulated(before.carry, "after.npz", steps=200, span=span).ok.any()


OTHERS = [
    ({"method": "SYMMETRIC[E2]"}, r"method was SYMMETRIC\[EA\] and is now SYMMETRIC\[E2\]"),
    ({"dt": 0.04}, "dt was 0.05 and is now 0.04"),
    ({"steps": 2 * STEPS}, f"steps was {STEPS} and is now {2 * STEPS}"),
    ({"momenta": MOMENTA + 1}, "start.momentum was"),
    ({"torque": ml.torques.HeavyTop(1.5)}, "torque.mgl was"),
    ({"torque": lambda t, state: 0 * state.momentum}, "torque.mgl was .* and is now absent"),
    ({"observe": ml.observe.energy}, "observe was the states and is now Quantity"),
    ({"group": 25}, "bodies of a group was 16 and is now 25"),
]


def test_another_run_is_refused(tmp_path, reference):
    """Also one of another version; the file is left as it was."""
    path = tmp_path / "run.zarr"
    simulated(path)
    for changes, message in OTHERS:
        with pytest.raises(ValueError, match=message):
            simulated(path, resume=True, **changes)
    assert_same(path, reference)
    said = zarr.open_group(path, mode="r+").attrs
    said["midlie_jax"] = str(said["midlie_jax"]).replace(f'"jax": "{jax.__version__}"', '"jax": "0.0.1"')
    with pytest.raises(ValueError, match=f"jax was 0.0.1 and is now {jax.__version__}"):
        simulated(path, resume=True)


LOCKING = """
import sys, time
from pathlib import Path
from midlie_jax.simulation.store import Store
with Store(Path(sys.argv[1])).writing():
    print("locked", flush=True)
    time.sleep(300)
"""


@pytest.mark.sample(0)
def test_a_lock_ends_with_the_process_that_holds_it(tmp_path):
    """While it lives another process is refused at once; once it is killed, what is left of its lock bars nobody."""
    path = tmp_path / "run.zarr"
    simulated(path)
    process = subprocess.Popen([sys.executable, "-c", LOCKING, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "locked\n"
        began = time.perf_counter()
        with pytest.raises(ValueError, match="another run is writing"), Store(path).writing():
            pass
        assert time.perf_counter() - began < 5
    finally:
        process.kill()
        process.communicate()
    assert (path / "checkpoint/lock").exists()
    assert simulated(path, resume=True).computed == 0
    assert not (path / "checkpoint/lock").exists()


ARGUMENTS = [
    ("run.zarr", {"resume": False}, "exists; pass resume=True"),
    ("run.hdf5", {}, "ends in .zarr or .npz"),
    ("no/run.zarr", {}, "create the folder first"),
    ("run.npz", {"resume": True}, "cannot be resumed"),
    ("other.zarr", {"span": 1}, "span must be at least 2"),
    ("other.zarr", {"group": 0}, "group must be a positive"),
    ("other.zarr", {"observe": 3}, "observe must be a function"),
    ("other.zarr", {"momenta": np.where(np.arange(BODIES)[:, None] == 3, np.nan, MOMENTA)}, "must be finite"),
    ("broken.zarr", {"resume": True}, r"broken\.zarr is not the store of a run"),
]


def test_bad_arguments_are_named(tmp_path):
    (tmp_path / "run.zarr").mkdir()
    (tmp_path / "broken.zarr").mkdir()
    for out, options, message in ARGUMENTS:
        with pytest.raises(ValueError, match=message):
            simulated(tmp_path / out, **options)
    assert sorted(os.listdir(tmp_path)) == ["broken.zarr", "run.zarr"]


class Unreadable:
    def __array__(self, *options, **names):
        raise RuntimeError("no array")


OWN, KIND = "which the file has itself", "but takes a text, a number, or a list"
BAD = [
    (["file"], "attributes must be a dict"),
    ({"momentum.npy": "x"}, "without .npy"),
    ({"parameters": 3}, f"attributes has the entry 'parameters', {OWN}"),
    ({"momentum": 3}, f"'momentum', {OWN}"),
    ({"midlie_jax": 1}, f"'midlie_jax', {OWN}"),
    ({"a": [[1], [2, 3]]}, f"'a'.*{KIND}"),
    ({"a": Unreadable()}, rf"'a'.*\(RuntimeError\), {KIND}"),
    ({"a": None}, f"'a': None, {KIND}"),
    ({"a": 1j}, f"'a'.*{KIND}"),
    ({"a": 10**30}, f"'a'.*{KIND}"),
]


def test_bad_attributes_are_named_before_the_run(tmp_path, monkeypatch):
    """Users do not have the type checkers that the tests have."""
    monkeypatch.setattr(ml, "simulate", inspect.unwrap(ml.simulate))
    for attributes, message in BAD:
        with pytest.raises(ValueError, match=message):
            simulated(tmp_path / "run.zarr", attributes=attributes)
    mean = ml.observe.Mean(lambda t, state: state.momentum[2])
    with pytest.raises(ValueError, match=f"'variance', {OWN}"):
        simulated(tmp_path / "run.zarr", attributes={"variance": 1}, observe=mean)
    assert os.listdir(tmp_path) == []


GOOD = {
    "title": "three bodies", "file": "a name of an argument of numpy.savez", "compression": True, "self": 3,
    "a/b": [1, 2], "texts": ("x", "yz"), "single": np.float32(3), "of_jax": jnp.arange(3.0, dtype=jnp.float32),
    "of_numpy": np.eye(2), "numbers_of_jax": [jnp.array(1.0), 2.5], "empty": [],
}  # fmt: skip


@pytest.mark.parametrize("kind", ["npz", "zarr"])
def test_attributes_are_read_as_they_were(tmp_path, kind):
    result = simulated(tmp_path / f"run.{kind}", attributes=GOOD, steps=2 * EVERY)
    if kind == "zarr":
        said = zarr.open_group(str(result.out), mode="r").attrs.asdict()
    else:
        with np.load(result.out, allow_pickle=False) as file:
            said = dict(file)
    for name, value in GOOD.items():
        np.testing.assert_array_equal(np.asarray(said[name]), np.asarray(value))
    saved = ml.simulation.saved_path(result.out)
    assert bool(saved.path.ok)
    assert saved.title == "three bodies"


def test_a_run_within_a_traced_function_or_to_a_folder_that_cannot_be_written_is_refused(tmp_path):
    for changes in (lambda x: {"momenta": MOMENTA * x}, lambda x: {}):
        with pytest.raises(ValueError, match=r"simulate needs concrete numbers, but .* traced; call it outside jit"):
            jax.jit(lambda x, changes=changes: simulated(tmp_path / "run.npz", **changes(x)).seconds)(0.1)
    with pytest.raises(OSError, match="run"):
        simulated("/proc/run.zarr")


def start_process(out, cache, *options):
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(cache)}
    environment |= {
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    command = [sys.executable, str(Path(__file__).parent / "simulated.py"), str(out), *map(str, options)]
    # A file, because a pipe that is read late fills up with XLA's messages, and the process would wait for ever.
    errors = Path(tempfile.mkdtemp(dir=out.parent)) / "errors"
    with errors.open("w") as file:
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, text=True, env=environment), errors


def finished(process, errors):
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0, errors.read_text()
    return output


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def optimised(tmp_path_factory, cache):
    """The contents of a run on one device, compiled as users get it and not in the hurry of this process."""
    path = tmp_path_factory.mktemp("optimised") / "run.zarr"
    finished(*start_process(path, cache))
    return contents(path)


@pytest.mark.sample(0)
@pytest.mark.parametrize("seed", [0, *whole(1, 2, 3)])
def test_a_run_killed_within_a_file_ends_with_the_same_bits(tmp_path, cache, optimised, seed):
    """A file of a part is written by half, even where Zarr would have renamed it only when whole."""
    number = CREATED + random.Random(seed).randrange(1, 3 * 16 + 1)
    process, _ = start_process(tmp_path / "run.zarr", cache, "--torn", number)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    found = ml.simulation.inspect(tmp_path / "run.zarr")
    assert not found.damaged
    assert found.done < found.total
    finished(*start_process(tmp_path / "run.zarr", cache))
    assert_same(tmp_path / "run.zarr", optimised)


@pytest.mark.sample(0)
def test_processes_compute_the_same_bits(tmp_path, cache, optimised):
    """Two processes with two devices each write one store."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    options = "--devices", 2, "--processes", 2, "--port", port
    both = [start_process(tmp_path / "run.zarr", cache, *options, "--process", i) for i in range(2)]
    outputs = [finished(*started) for started in both]
    assert all(outputs)
    assert_same(tmp_path / "run.zarr", optimised)
