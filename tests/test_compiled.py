"""What the compiler makes of a step: read from the compiled HLO, so that a lost fusion fails here.

Every array the size of the batch that a step computes costs a pass over memory; the explicit methods make one.
"""

import re

import jax
import jax.numpy as jnp
import pytest

import midlie_jax as ml

BATCH = 517  # a number that nothing else in the program has

# Loops over the batch a step, where not one. The implicit methods have a loop over Newton's steps between (see
# solve.newton): a few before and after, one inside.
LOOPS = {"LIEMID[I]": 4, "SW": 4}
BODY = (2.0, 3.0, 4.0)


def written_on_arrays(t, state):
    del t
    down = ml.so3.to_matrix(state.attitude)[2]
    return 20 * jnp.cross(down, jnp.eye(3, dtype=down.dtype) @ jnp.array([0, 0, 1], down.dtype))


TORQUES = {
    "components": ml.torques.HeavyTop(20.0),
    "arrays": written_on_arrays,
    "potential": ml.torques.FromPotential(lambda t, state: 20 * ml.so3.to_matrix(state.attitude)[2, 2]),
    "none": None,
}


def loops(name, torque, dtype):
    """The number of fused loops over the batch in the loop over steps, and the text of that loop."""

    def run(momentum):
        start = ml.RigidState(momentum, jnp.array([1, 0, 0, 0], dtype))
        return ml.integrate(ml.method(name), ml.RigidBody(jnp.array(BODY, dtype)), torque, start, dt=0.01, steps=7)

    text = jax.jit(jax.vmap(run)).lower(jnp.ones((BATCH, 3), dtype)).compile().as_text()
    bodies = set(re.findall(r"body=%?([\w.\-]+)", text))
    computations = {c.split()[0].lstrip("%"): c for c in re.split(r"\n}\n+", text) if c.split()}
    counts = {name: len(re.findall(rf"\[{BATCH}\].* fusion\(", computations[name])) for name in bodies}
    busiest = max(counts, key=counts.__getitem__)
    return counts[busiest], computations[busiest]


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize("name", [n for n in ml.methods() if ml.method(n).bodies is ml.RigidBody])
def test_a_step_is_as_many_loops_as_it_should_be(name, dtype):
    count, text = loops(name, TORQUES["components"], dtype)
    assert count == LOOPS.get(name, 1)
    assert not re.search(r"\b(dot|convolution|custom-call|gather)\(", text)


@pytest.mark.parametrize("torque", ["arrays", "potential", "none"])
def test_any_way_of_writing_the_torque_gives_one_loop(torque):
    count, _ = loops("LIEMID[EA]", TORQUES[torque], jnp.float64)
    assert count == 1


@pytest.mark.parametrize("name", ["LIEMID[EA]", "LIEMID[I]"])
def test_no_float64_trigonometry_in_a_step(name):
    dtype = jnp.float64
    body, kind = ml.RigidBody(jnp.array(BODY, dtype)), jnp.array([1, 0, 0, 0], dtype)
    start = ml.RigidState(jnp.ones(3, dtype), kind)
    program = jax.jit(lambda s: ml.integrate(name, body, TORQUES["components"], s, dt=0.01, steps=7)).lower(start)
    assert not re.search(r"stablehlo\.(sine|cosine|power|tan)\b", program.as_text())
