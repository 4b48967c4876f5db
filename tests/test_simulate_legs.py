"""A part that takes long is kept again and again, and the bits do not depend on when."""

import contextlib
import itertools
import random
import time
from functools import partial
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from simulated import ATTITUDES, BODIES, MOMENTA, STEPS, simulated
from test_simulate import CrashError, assert_same, contents, pulled

import midlie_jax as ml
from midlie_jax.drivers import steps as legs
from midlie_jax.simulation import pipeline
from midlie_jax.simulation.parts import Computation
from midlie_jax.simulation.pipeline import Pace
from midlie_jax.simulation.store import Store

xarray = pytest.importorskip("xarray")
BAD = np.where(np.arange(BODIES)[:, None] == 7, 1e200, np.where(np.arange(BODIES)[:, None] == 33, 400.0, MOMENTA))


def without_force(out, **options):
    """A run of eight bodies by a method that keeps no force, two spans of two groups."""
    start = ml.RigidState(jnp.asarray(MOMENTA[:8]), jnp.asarray(ATTITUDES[:8]))
    given = {"dt": 0.05, "steps": 120, "save_every": 15, "group": 6, "span": 5, "chunk": 4, "progress": False}
    body, torque = ml.RigidBody([1.0, 2.0, 2.5]), ml.torques.HeavyTop(1.0)
    return ml.simulate("LIEMID[E2]", body, torque, start, out=out, **{**given, **options})


OVER_TIMES = ml.observe.Autocorrelation({"p": lambda t, s: s.momentum}, 11, centred=True)
RUNS = {
    "tops": simulated,
    "no force is kept": without_force,
    "statistic, failures": partial(simulated, method="LIEMID[EA]", torque=pulled, momenta=BAD, observe=OVER_TIMES),
}


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("references"), {}

    def reference(name):
        if name not in found:
            RUNS[name](folder / f"{name}.zarr")
            found[name] = contents(folder / f"{name}.zarr")
        return found[name]

    return reference


def stop_after(count):
    """A `progress` that stops the run, as a kill would, at the write with this number."""
    counter = itertools.count(1)

    def progress(work):
        if next(counter) == count:
            raise CrashError

    return progress


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", RUNS)
def test_the_bits_do_not_depend_on_when_a_run_was_late(tmp_path, monkeypatch, references, name):
    """With legs of any length, after stops of which most are in the middle of a part."""
    expected, chance, path = references(name), random.Random(name), tmp_path / "run.zarr"
    result, done, within, writes = None, -1, 0, 1
    while result is None:
        writes = 2 * writes + chance.randrange(2)
        with monkeypatch.context() as patch, contextlib.suppress(CrashError):
            patch.setattr(Pace, "begin", lambda self: chance.choice([1, 2, 5, 10]))
            patch.setattr(Pace, "due", lambda self: chance.random() < 0.7)
            result = RUNS[name](path, resume=True, progress=stop_after(writes))
        found = ml.simulation.inspect(path)
        assert found.damaged == ()
        assert found.done > done or found.done == found.total
        done, within = found.done, within + any(np.load(file)["steps"] > 0 for file in path.glob("checkpoint/*.npz"))
    assert within > 0
    assert_same(path, expected)


@pytest.mark.sample(0)
@pytest.mark.parametrize("price", [13.0, 1e-5])
def test_at_no_time_is_more_than_half_a_minute_lost(tmp_path, monkeypatch, price):
    """Unless two steps cost more; even if each write ends only when the next begins."""
    clock, compute, keep, ended = SimpleNamespace(now=0.0), Computation.compute, Pace.kept, [0.0, 0.0]
    lost, files = [], []
    monkeypatch.setattr(time, "perf_counter", lambda: clock.now)

    def computed(self, part, before, steps, tables):
        after = compute(self, part, before, steps, tables)
        clock.now += price * (after.steps - before.steps)
        lost.append(clock.now - ended[-2])
        return after

    def kept(self):
        ended.append(clock.now)
        keep(self)

    def wrote(self, group, arrays, keep=Store.keep):
        files.append(int(arrays["steps"]))
        keep(self, group, arrays)

    monkeypatch.setattr(Computation, "compute", computed)
    monkeypatch.setattr(Pace, "kept", kept)
    monkeypatch.setattr(Store, "keep", wrote)
    result = simulated(tmp_path / "run.zarr", group=25, span=6)
    assert clock.now == pytest.approx(price * result.computed / 25)
    assert max(lost) <= 30 + 2 * price  # an iteration has two steps
    assert any(files) == (60 * price > pipeline.KEPT + pipeline.LEG)  # a fast run writes its parts alone


def test_ctrl_c_keeps_what_is_computed_of_a_part(tmp_path, monkeypatch, references):
    compute, path, taken = Computation.compute, tmp_path / "run.zarr", []

    def interrupted(self, part, before, steps, tables):
        if len(taken) == 5:
            raise KeyboardInterrupt
        taken.append(compute(self, part, before, 10, tables))
        return taken[-1]

    with monkeypatch.context() as patch:
        patch.setattr(Computation, "compute", interrupted)
        with pytest.raises(KeyboardInterrupt):
            simulated(path)
    assert ml.simulation.inspect(path).done == 16 * 50
    assert simulated(path, resume=True).computed == BODIES * STEPS - 16 * 50
    assert_same(path, references("tops"))


@pytest.mark.sample(0)
def test_long_turns_make_the_same_steps(tmp_path, monkeypatch, references):
    """Those of an accelerator, of which the last one before a saved state is shorter."""
    with monkeypatch.context() as patch:
        patch.setattr(legs, "on_cpu", lambda: False)
        patch.setattr(pipeline, "LEG", 0.0)
        assert legs.iteration(ml.method("SYMMETRIC[EA]"), 80) == 64
        run = partial(simulated, save_every=80, span=3)
        run(tmp_path / "long.zarr")
    run = partial(simulated, save_every=80, span=3, group=17)
    run(tmp_path / "short.zarr")
    assert_same(tmp_path / "long.zarr", contents(tmp_path / "short.zarr"))
