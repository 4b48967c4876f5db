"""What torques of many operations cost, as neural networks are: first calls, and the time of a step.

    python benchmarks/networks.py [--write]

The torque is an MLP of the attitude with two hidden layers and tanh, or a formula on arrays whose numbers are fitted.
The package chooses whether it is evaluated on scalars within the step or on arrays apart from it. Value and
gradient with respect to all weights are those of |Pi|^2 at the end: of one body by `ml.integrate`, and of 1000 by
`ml.ensemble`, in float64, on one core. First calls include tracing and compiling. Times of a step are medians, for one
body. All are processor time.
"""

import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import one_core  # noqa: F401
from harness import Table, in_turn, main

import midlie_jax as ml

METHOD, BODIES, DT = "JACOBI[EA]", 1000, 0.005
WIDTHS = 1, 2, 4, 8, 16, 32, 64, 128
STEPS = {"integrate": 2000, "ensemble": 64}
BODY = ml.RigidBody(jnp.array([1.0, 2.0, 2.5]))


class Network(eqx.Module):
    layers: eqx.nn.MLP

    def __call__(self, t, state):
        del t
        return self.layers(state.attitude)


class Formula(eqx.Module):
    """A torque written on arrays, with its numbers."""

    numbers: jax.Array
    function: Callable = eqx.field(static=True)

    def __call__(self, t, state):
        return self.function(self.numbers, t, ml.so3.to_matrix(state.attitude))


def facets(normals, t, rotation):
    """The pressure of light on flat faces."""
    normals = normals.reshape(-1, 3)
    lit = jnp.maximum(normals @ (rotation.T @ jnp.array([1.0, 0.0, 0.0])), 0.0)
    return jnp.cross(0.3 * normals, -lit[:, None] * normals).sum(0)


def gradient_of_gravity(tensor, t, rotation):
    down = rotation.T @ jnp.array([jnp.cos(t), jnp.sin(t), 0 * t])
    return 3 * jnp.cross(down, tensor.reshape(3, 3) @ down)


FORMULAS = {"gradient of gravity": (gradient_of_gravity, 9), "4 facets": (facets, 12), "12 facets": (facets, 36)}


def formula(name):
    function, count = FORMULAS[name]
    return Formula(jax.random.normal(jax.random.key(2), (count,)), function)


def network(width):
    return Network(eqx.nn.MLP(4, 3, width, depth=2, activation=jnp.tanh, key=jax.random.key(0)))


def run_of(driver):
    turns = 0.1 * jax.random.normal(jax.random.key(1), (BODIES, 3))
    states = jax.vmap(lambda turn: ml.RigidState(jnp.array([1.0, 0.8, -1.3]), ml.so3.exp(turn)))(turns)
    steps = STEPS[driver]

    def end(torque):
        if driver == "integrate":
            one = jax.tree.map(lambda x: x[0], states)
            momentum = ml.integrate(METHOD, BODY, torque, one, dt=DT, steps=steps, save_every=steps).states.momentum[-1]
        else:
            run = ml.ensemble(METHOD, BODY, torque, states, dt=DT, steps=steps, torque_axes=None)
            momentum = run.states.momentum
        return jnp.sum(momentum**2)

    return end, steps * (1 if driver == "integrate" else BODIES)


def measured(transform, function, torque, body_steps):
    """Seconds of the first call, and nanoseconds of a step of one body."""
    arrays, rest = eqx.partition(torque, eqx.is_array)
    program = jax.jit(transform(lambda arrays: function(eqx.combine(arrays, rest))))
    began = time.process_time()
    jax.block_until_ready(program(arrays))
    first = time.process_time() - began
    (later,) = in_turn([lambda: program(arrays)], 3, 9, longest=2.0)
    return f"{first:.1f} s", f"{1e9 * later / body_steps:.0f} ns"


KEY = ("gradient of gravity", "network of width 16", "network of width 128", "12 facets")


def rows():
    networks = {f"network of width {width}": network(width) for width in WIDTHS}
    torques = networks | {name: formula(name) for name in FORMULAS}
    end, _ = run_of("integrate")
    measured(lambda f: f, end, ml.torques.HeavyTop(1.0), 1)  # what every program compiles once
    for name, torque in torques.items():
        for driver in STEPS:
            end, body_steps = run_of(driver)
            value = measured(lambda f: f, end, torque, body_steps)
            both = measured(jax.value_and_grad, end, torque, body_steps)
            yield [name, f"`{driver}`", *value, *both]


TABLE = Table(
    *("reports/speed.md", "networks"),
    ("torque", "driver", "value: first call", "time per step", "value and gradient: first call", "time per step"),
    rows,
    data="networks",
    key=lambda row: row[0] in KEY and row[1] == "`ensemble`",
    columns=(0, 2, 3, 4, 5),
)


if __name__ == "__main__":
    main(__doc__, TABLE)
