"""Every file of a store: its loss or damage is said in words, and a run that is said to be well can be opened."""

import shutil

import jax.numpy as jnp
import numpy as np
import pytest
import zarr
from zarr.codecs import Crc32cCodec

import midlie_jax as ml

xarray = pytest.importorskip("xarray")
DAMAGES = {
    "a flipped bit": lambda data: bytes(
        [*data[: len(data) // 2], data[len(data) // 2] ^ 1, *data[len(data) // 2 + 1 :]]
    ),
    "half of it": lambda data: data[: len(data) // 2],
    "nothing of it": lambda data: b"",
    "no file": lambda data: None,
}
OBSERVED = {
    "states": None,
    "statistic": ml.observe.Mean(ml.observe.Axis()),
    "series": ml.observe.Spectrum(ml.observe.Axis(), 3),
}


def run(out, observed, **options):
    """Three bodies in two groups; two spans."""
    start = ml.RigidState(
        jnp.array([[0.1, 0.0, 3.0], [0.2, 0.1, 2.0], [0.0, 0.3, 1.0]]), jnp.tile(jnp.eye(4)[0], (3, 1))
    )
    return ml.simulate(
        *("SYMMETRIC[EA]", ml.RigidBody([2.0, 2.0, 1.0]), ml.torques.HeavyTop(jnp.array([1.0, 2.0, 3.0])), start),
        **{"out": out, "dt": 0.1, "steps": 3, "save_every": 1, "group": 2, "span": 2, "progress": False, **options},
        observe=OBSERVED[observed],
    )


@pytest.fixture(scope="module", params=OBSERVED)
def stored(request, tmp_path_factory):
    """A store, and what it is to hold."""
    path = tmp_path_factory.mktemp("run") / "run.zarr"
    run(path, request.param)
    with xarray.open_zarr(path) as opened:
        return path, opened.load(), request.param


def damage(file, how):
    data = DAMAGES[how](file.read_bytes())
    file.unlink() if data is None else file.write_bytes(data)


@pytest.mark.sample(0)
@pytest.mark.parametrize("how", DAMAGES)
def test_damage_to_any_file_is_said_in_words(stored, tmp_path, how):
    path, expected, _ = stored
    files = sorted(file for file in path.rglob("*") if file.is_file())
    silent = 0
    for file in files:
        whole = file.read_bytes()
        damage(file, how)
        try:
            found, error = inspected(path)
            if found is None:
                assert file == path / "zarr.json"
                assert "description zarr.json is damaged" in error
            elif not found.damaged and found.done == found.total:
                silent += 1
                with xarray.open_zarr(path) as opened:
                    assert opened.load().identical(expected), file
        finally:
            file.write_bytes(whole)
    assert silent <= (2 if how == "a flipped bit" else 0)  # a space in a description may become another one
    assert ml.simulation.inspect(path).damaged == ()


def test_damage_to_the_first_bad_states_of_a_run_that_is_not_complete_is_said(tmp_path):
    """They may be ahead of the last commit, so they are compared with both that are kept beside the states."""
    path, written = tmp_path / "run.zarr", []

    def stop(work):
        written.append(work)
        if len(written) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(path, "states", steps=9, progress=stop)
    found = ml.simulation.inspect(path)
    assert 0 < found.done < found.total
    assert found.damaged == ()
    zarr.open_group(path, mode="r+")["first_bad"][:2] = [10, 7]
    assert ml.simulation.inspect(path).damaged == ("first_bad of group 0",)


@pytest.fixture
def of_earlier_versions(monkeypatch):
    """Lets stores be written as by earlier versions, with a checksum at the end of each file of numbers as well."""
    create = zarr.Group.create_array

    def checked(group, name, **options):
        sums = {"compressors": [Crc32cCodec()]} if options.get("compressors", "") is None else {}
        return create(group, name, **{**options, **sums})

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Group, "create_array", checked)
        yield


@pytest.mark.parametrize("how", DAMAGES)
def test_a_store_of_an_earlier_version_is_read_checked_and_mended(tmp_path, of_earlier_versions, how):
    path = tmp_path / "run.zarr"
    run(path, "states")
    file = path / "momentum/c/1/0/0"
    assert file.stat().st_size == 2 * 2 * 3 * 8 + 4
    with xarray.open_zarr(path) as opened:
        expected = opened.load()
    assert ml.simulation.inspect(path).damaged == ()
    damage(file, how)
    assert ml.simulation.inspect(path).damaged == ("momentum of span 0, group 1",)
    assert run(path, "states", resume=True).repaired == ("momentum of span 0, group 1",)
    with xarray.open_zarr(path) as opened:
        assert opened.load().identical(expected)


def inspected(path):
    try:
        return ml.simulation.inspect(path), ""
    except ValueError as error:
        return None, str(error)


@pytest.mark.sample(3)
def test_resuming_mends_descriptions_names_and_spare_states(stored, tmp_path):
    path, expected, observed = stored
    copy = tmp_path / "run.zarr"
    shutil.copytree(path, copy)
    named = [file for file in copy.rglob("zarr.json") if file.parent != copy]
    broken = [*named, copy / "checkpoint/carried_float64/c/0/0/0", *copy.glob("quaternion/c/0")]
    broken += [*copy.glob("axis/c/0"), *copy.glob("mean/c/0/0")]
    for file in broken:
        damage(file, "no file")
    result = run(copy, observed, resume=True)
    said = str(result)
    for file in named:
        assert f"damaged, and mended: {file.relative_to(copy)}" in said
    names = ["spare states after span 0, group 0"]
    for name in names + (["quaternion", "axis"] if observed == "states" else ["mean"]):
        assert name in said
    assert result.computed == 0
    assert ml.simulation.inspect(copy).damaged == ()
    with xarray.open_zarr(copy, consolidated=False) as opened:
        assert opened.load().equals(expected)
    assert run(copy, observed, resume=True).repaired == ()


def test_attributes_of_the_readers_own_may_be_added(stored, tmp_path):
    copy = tmp_path / "run.zarr"
    shutil.copytree(stored[0], copy)
    zarr.open_group(copy, mode="r+").attrs["remark"] = "tops of May"
    assert ml.simulation.inspect(copy).damaged == ()
    zarr.open_group(copy, mode="r+").attrs["dt"] = np.pi
    with pytest.raises(ValueError, match=r"description zarr.json is damaged"):
        ml.simulation.inspect(copy)
