"""A damaged store: every reader of a changed chunk raises, and a run says what to delete to compute it again."""

import shutil

import jax.numpy as jnp
import pytest
import zarr

import midlie_jax as ml

xarray = pytest.importorskip("xarray")
OBSERVED = {"states": None, "series": ml.observe.Spectrum(ml.observe.Axis(), 3)}


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


def flipped(data):
    return bytes([*data[: len(data) // 2], data[len(data) // 2] ^ 1, *data[len(data) // 2 + 1 :]])


DAMAGES = {"a flipped bit": flipped, "half of it": lambda data: data[: len(data) // 2], "no file": lambda data: None}


def damage(file, how):
    data = DAMAGES[how](file.read_bytes())
    file.unlink() if data is None else file.write_bytes(data)


@pytest.fixture(scope="module", params=OBSERVED)
def stored(request, tmp_path_factory):
    """A store, and what it is to hold."""
    path = tmp_path_factory.mktemp("run") / "run.zarr"
    run(path, request.param)
    with xarray.open_zarr(path) as opened:
        return path, opened.load(), request.param


@pytest.mark.sample(0)
@pytest.mark.parametrize("how", DAMAGES)
def test_damage_to_any_file_is_named(stored, how):
    """Zarr reads a missing file as numbers that are not yet computed; `inspect` alone names it."""
    path, _, observed = stored
    for file in sorted(file for file in path.rglob("*") if file.is_file() and file.name != "zarr.json"):
        whole = file.read_bytes()
        damage(file, how)
        try:
            found = ml.simulation.inspect(path)
            if file.suffix == ".npz" and how == "no file":
                assert found.done < found.total
            else:
                assert len(found.damaged) == 1, file
            if file.suffix == ".npz" and how != "no file":
                with pytest.raises(
                    ValueError, match=rf"{file.name} is damaged .*delete checkpoint/{file.name} and resume"
                ):
                    run(path, observed, resume=True)
            if how != "no file" and file.relative_to(path).parts[0] not in ("checkpoint", "parts"):
                with pytest.raises(ValueError, match="checksum"):
                    xarray.open_zarr(path).load()
        finally:
            file.write_bytes(whole)
    assert ml.simulation.inspect(path).damaged == ()


@pytest.mark.sample(0)
def test_a_damaged_group_is_computed_again_when_its_checkpoint_is_deleted(stored, tmp_path):
    """What belongs to no group, such as the time, is written by every run that resumes."""
    path, expected, observed = stored
    copy = tmp_path / "run.zarr"
    shutil.copytree(path, copy)
    damage(next(file for file in sorted(copy.rglob("c/0/1/**/0")) if file.is_file()), "a flipped bit")
    for name in ("time", "axis", "density"):
        for file in copy.glob(f"{name}/c/**/0"):
            if file.is_file():
                damage(file, "a flipped bit")
    with pytest.raises(ValueError, match=r"of span 1, group 0\. .*delete checkpoint/0\.npz and resume the run"):
        run(copy, observed, resume=True)
    (copy / "checkpoint/0.npz").unlink()
    assert run(copy, observed, resume=True).computed == 2 * 3
    assert ml.simulation.inspect(copy).damaged == ()
    with xarray.open_zarr(copy) as opened:
        assert opened.load().identical(expected)


def test_a_flipped_bit_raises_on_read(tmp_path):
    """Of a body that it belongs to; and the description of the run says which part is damaged."""
    path = tmp_path / "run.zarr"
    result = run(path, "states")
    damage(path / "momentum/c/1/0/0", "a flipped bit")
    with pytest.raises(
        ValueError, match=r"run\.zarr is damaged .*checksum.* Find the damaged part with midlie inspect"
    ):
        result.states()
    with pytest.raises(ValueError, match=r"run\.zarr is damaged .*checksum"):
        ml.simulation.saved_path(path, body=2)
    assert ml.simulation.saved_path(path, body=1).path.ok
    said = str(ml.simulation.inspect(path))
    assert "DAMAGED: momentum of span 0, group 1\nto compute group G again, delete checkpoint/G.npz" in said


def test_a_damaged_description_is_said_and_attributes_may_be_added(tmp_path):
    path = tmp_path / "run.zarr"
    run(path, "states")
    zarr.open_group(path, mode="r+").attrs["remark"] = "tops of May"
    assert ml.simulation.inspect(path).attributes["remark"] == "tops of May"
    assert run(path, "states", resume=True).computed == 0
    damage(path / "zarr.json", "half of it")
    with pytest.raises(ValueError, match=r"not the store of a run, or its description zarr.json is damaged"):
        ml.simulation.inspect(path)
