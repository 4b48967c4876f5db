"""What a user writes into the file of a run: checked before the run, and read back as it was."""

import inspect
import os

import jax.numpy as jnp
import numpy as np
import pytest
import zarr

import midlie_jax as ml

BODIES = 3
simulate = inspect.unwrap(ml.simulate)


def simulated(out, attributes, **options):
    body = ml.RigidBody([1.0, 1.0, 2.0])
    start = ml.RigidState(jnp.ones((BODIES, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (BODIES, 1)))
    given = {"dt": 0.1, "steps": 2, "save_every": 1, "progress": False, **options}
    return simulate("SYMMETRIC[EA]", body, None, start, out=out, attributes=attributes, **given)


class Unreadable:
    def __array__(self, *options, **names):
        raise RuntimeError("no array")


HEIGHT = ml.observe.Mean(lambda t, state: state.momentum[2])
OWN = "which the file has itself"
KIND = "but takes a text, a number, or a list"
BAD = {
    "no names": (["file"], {}, "attributes must be a dict"),
    "the name of a file": ({"momentum.npy": "x"}, {}, "without .npy"),
    "a name of the description": ({"parameters": 3}, {}, f"attributes has the entry 'parameters', {OWN}"),
    "a variable": ({"momentum": 3}, {}, f"'momentum', {OWN}"),
    "a statistic": ({"variance": 1}, {"observe": HEIGHT}, f"'variance', {OWN}"),
    "what resuming needs": ({"midlie_jax": 1}, {}, f"'midlie_jax', {OWN}"),
    "a ragged list": ({"a": [[1], [2, 3]]}, {}, f"'a'.*{KIND}"),
    "an object that raises": ({"a": Unreadable()}, {}, rf"'a'.*\(RuntimeError\), {KIND}"),
    "nothing": ({"a": None}, {}, f"'a': None, {KIND}"),
    "a complex number": ({"a": 1j}, {}, f"'a'.*{KIND}"),
    "an integer beyond 64 bits": ({"a": 10**30}, {}, f"'a'.*{KIND}"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_attributes_are_named_before_the_run(tmp_path, case):
    attributes, options, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        simulated(tmp_path / "run.zarr", attributes, **options)
    assert os.listdir(tmp_path) == []


GOOD = {
    "title": "three bodies",
    "file": "a name of an argument of numpy.savez",
    "compression": True,
    "self": 3,
    "a/b": [1, 2],
    "texts": ("x", "yz"),
    "single": np.float32(3),
    "of_jax": jnp.arange(3.0, dtype=jnp.float32),
    "of_numpy": np.eye(2),
    "numbers_of_jax": [jnp.array(1.0), 2.5],
    "empty": [],
}


@pytest.mark.parametrize("kind", ["npz", "zarr"])
def test_attributes_are_read_as_they_were(tmp_path, kind):
    result = simulated(tmp_path / f"run.{kind}", GOOD)
    if kind == "zarr":
        said = zarr.open_group(str(result.out), mode="r").attrs.asdict()
    else:
        with np.load(result.out, allow_pickle=False) as file:
            said = dict(file)
    for name, value in GOOD.items():
        np.testing.assert_array_equal(np.asarray(said[name]), np.asarray(value))
    assert result.states().momentum.shape == (BODIES, 3, 3)
    saved = ml.simulation.saved_path(result.out)
    assert bool(saved.path.ok)
    assert saved.title == "three bodies"
