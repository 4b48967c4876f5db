"""A run goes on only as itself: numbers that hide in its code are found, and what cannot be seen is refused."""

import shutil

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import zarr
from hiding import SEEN, called_back, in_a_jit, in_two_jits

import midlie_jax as ml
from midlie_jax.drivers.ensemble import as_batch
from midlie_jax.drivers.observe import as_observe
from midlie_jax.simulation.identity import UNSEEN, differences, identity
from midlie_jax.simulation.plan import Plan

BODY = ml.RigidBody([2.0, 2.0, 1.0])
START = ml.RigidState(jnp.array([[0.1, 0.2, 3.0]]), jnp.array([[1.0, 0.0, 0.0, 0.0]]))
PLAN = Plan(1, 3, 1, 1, 2, 1)


def found(torque=None, observe=None):
    batch = as_batch("SYMMETRIC[EA]", BODY, torque, START, 0.1, 0.0)
    return identity(batch, as_observe(observe), PLAN)


CHANGED = np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, np.nextafter(0.3, 1)])


@pytest.mark.sample(2)
@pytest.mark.parametrize("hide", SEEN)
def test_a_number_is_found_wherever_it_hides(hide):
    """One that differs in its last bit is another run, in `observe` and in the torque; the same number is not."""
    before, again, after = (found(observe=lambda t, s, x=x: hide(x)(s.momentum)) for x in (*CHANGED[:1], *CHANGED))
    assert differences(before, again) == []
    assert len(differences(before, after)) == 1
    torques = [lambda t, s, x=x: hide(x)(s.attitude[1:]) * jnp.array([0.0, 0.0, 1.0]) for x in CHANGED]
    assert len(differences(*map(found, torques))) == 1


def test_a_long_array_is_read_to_its_end():
    long = np.arange(5000.0)
    other = np.where(np.arange(5000) == 2500, long + 1e-12, long)
    before, after = (found(observe=lambda t, s, x=x: in_a_jit(x)(s.momentum[0] + 0 * x)) for x in (long, other))
    assert len(differences(before, after)) == 1


def test_what_a_statistic_does_is_part_of_the_run():
    def weighed(factor):
        class Weighed(ml.observe.Mean):
            def part(self, values, good):
                return super().part(jax.tree.map(lambda x: factor * x, values), good)

        return Weighed(ml.observe.angular_velocity)

    assert differences(found(observe=weighed(1.0)), found(observe=weighed(1.0))) == []
    assert len(differences(found(observe=weighed(1.0)), found(observe=weighed(2.0)))) == 1


def test_code_of_jax_itself_is_known_printing_changes_no_number_and_a_callback_cannot_be_seen():
    assert "callback" in found(observe=lambda t, s: jax.jit(called_back(CHANGED[0]))(s.momentum))[UNSEEN]

    def observe(t, state):
        jax.debug.print("{t}", t=t)
        return jnp.linalg.solve(jnp.eye(3) + jnp.outer(state.momentum, state.momentum), state.momentum)

    assert UNSEEN not in found(observe=observe)


def test_a_random_key_can_be_a_parameter():
    class Noisy(eqx.Module):
        key: jax.Array

        def __call__(self, t, state):
            return jax.random.normal(self.key, (3,), state.momentum.dtype)

    before, after = (found(Noisy(jax.random.key(seed))) for seed in (0, 1))
    assert "torque.key" in " ".join(differences(before, after))


@pytest.mark.sample(1)
@pytest.mark.parametrize("hide", [in_two_jits, called_back], ids=["closed over", "called back"])
def test_a_run_is_not_mixed_with_another(tmp_path, hide):
    """As `simulate` itself refuses it, after a stop in the middle; the file is left as it was."""

    def stop(work):
        raise KeyboardInterrupt

    def run(x, **options):
        ml.simulate(
            *("SYMMETRIC[EA]", BODY, None, START),
            **{"out": tmp_path / "run.zarr", "dt": 0.1, "steps": 8, "save_every": 1, "span": 2, **options},
            observe=lambda t, s: hide(x)(s.momentum),
        )

    with pytest.raises(KeyboardInterrupt):
        run(CHANGED[0], progress=stop)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    message = "cannot be resumed: the torque or observe calls" if hide is called_back else "program .* was"
    with pytest.raises(ValueError, match=message):
        run(1000 * CHANGED[0], resume=True)
    assert before == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}


def test_flags_of_the_compiler_are_part_of_the_run(monkeypatch):
    before = found()
    monkeypatch.setenv("XLA_FLAGS", f"{before['XLA_FLAGS']} --xla_force_host_platform_device_count=3")
    assert differences(before, found()) == []
    monkeypatch.setenv("XLA_FLAGS", f"{before['XLA_FLAGS']} --xla_cpu_enable_fast_math=true")
    assert len(differences(before, found())) == 1


# ---- a damaged store: readers of a changed chunk raise, and a run says what to delete ----

xarray = pytest.importorskip("xarray")
OBSERVED = {"states": None, "series": ml.observe.Spectrum(ml.observe.Axis(), 3)}


def three_bodies(out, observed, **options):
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
    path = tmp_path_factory.mktemp("run") / "run.zarr"
    three_bodies(path, request.param)
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
                    three_bodies(path, observed, resume=True)
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
        three_bodies(copy, observed, resume=True)
    (copy / "checkpoint/0.npz").unlink()
    assert three_bodies(copy, observed, resume=True).computed == 2 * 3
    assert ml.simulation.inspect(copy).damaged == ()
    with xarray.open_zarr(copy) as opened:
        assert opened.load().identical(expected)


@pytest.mark.sample(0)
def test_a_flipped_bit_raises_on_read(tmp_path):
    """Of a body that it belongs to; and the description of the run says which part is damaged."""
    path = tmp_path / "run.zarr"
    result = three_bodies(path, "states")
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


@pytest.mark.sample(0)
def test_a_damaged_description_is_said_and_attributes_may_be_added(tmp_path):
    path = tmp_path / "run.zarr"
    three_bodies(path, "states")
    zarr.open_group(path, mode="r+").attrs["remark"] = "tops of May"
    assert ml.simulation.inspect(path).attributes["remark"] == "tops of May"
    assert three_bodies(path, "states", resume=True).computed == 0
    damage(path / "zarr.json", "half of it")
    with pytest.raises(ValueError, match=r"not the store of a run, or its description zarr.json is damaged"):
        ml.simulation.inspect(path)
