"""A run goes on only as itself: numbers that hide in its code are found, and what cannot be seen is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
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
    """The identity of a run of one body."""
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
