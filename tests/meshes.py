"""Ensembles on meshes of up to four CPU devices, in a process of its own; `test_spread.py` judges what it prints.

Each is compared with the same ensemble on one device, and searched for communication between devices in its loops.
"""

import json
import os
import re
from functools import partial

os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=4"

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

jax.config.update("jax_enable_x64", True)

from on_devices import COMMUNICATION, in_loops  # noqa: E402
from simulated import ATTITUDES, MOMENTA, MOMENTS, WEIGHTS  # noqa: E402

import midlie_jax as ml  # noqa: E402

START = ml.RigidState(jnp.asarray(MOMENTA), jnp.asarray(ATTITUDES))
BODIES, TOPS = ml.RigidBody([1.0, 1.0, 2.0]), ml.torques.HeavyTop(1.5)
BODY, TOP = ml.RigidBody(jnp.asarray(MOMENTS)), ml.torques.HeavyTop(jnp.asarray(WEIGHTS))


def mesh(size, kind=AxisType.Auto):
    return Mesh(np.array(jax.devices()[:size]), ("bodies",), axis_types=(kind,))


def compared(function):
    """Whether `function(mesh)` is the same on 1, 2 and 4 devices, and how often the loops on four send anything."""
    alone = jax.tree.leaves(function(mesh(1)))
    same = all(
        np.array_equal(np.asarray(x), np.asarray(y))
        for size in (2, 4)
        for x, y in zip(jax.tree.leaves(function(mesh(size))), alone, strict=True)
    )
    text = jax.jit(lambda: function(mesh(4))).lower().compile().as_text()
    return {"same": same, "messages in loops": len(re.findall(COMMUNICATION, in_loops(text)))}


def tops(where):
    return ml.ensemble("SYMMETRIC[EA]", BODY, TOP, START, dt=0.05, steps=20, save_every=10, chunk=6, mesh=where)


def orbit(where):
    """With inputs that all bodies share."""
    ellipse = ml.orbits.KeplerOrbit([1.0, 0.0, 0.0], [0.0, 1.1, 0.0], 1.0)
    torque = ml.spacecraft.GravityGradient(jnp.array([1.0, 1.5, 2.0]), ellipse, 1.0)
    body = ml.RigidBody(jnp.array([1.0, 1.5, 2.0]))
    return ml.ensemble("JACOBI[EA]", body, torque, START, dt=0.05, steps=20, chunk=6, mesh=where)


def heated(where):
    """In a heat bath, with a key for each body."""
    bath = ml.baths.Langevin(0.7, 1.3, jax.random.split(jax.random.key(0), len(MOMENTA)))
    return ml.ensemble("SYMMETRIC[BAOAB]", BODY, TOP, START, dt=0.05, steps=20, chunk=6, mesh=where, bath=bath)


def energy(t, state):
    return jnp.sum(state.momentum**2)


OBSERVED = {
    "mean": ml.observe.Mean(energy),
    "autocorrelation": ml.observe.Autocorrelation(ml.observe.Axis(), 5, centred=True, normalised=True),
    "spectrum": ml.observe.Spectrum(ml.observe.Axis(), 4),
}


def observed(observe, where):
    run = {"dt": 0.05, "steps": 20, "save_every": 2, "chunk": 6}
    return ml.ensemble("SYMMETRIC[EA]", BODY, TOP, START, **run, mesh=where, observe=observe)


def explicit():
    """Arrays that are spread beforehand, and a mesh whose axes are part of every array's type."""
    spread = NamedSharding(mesh(4), P("bodies"))
    start = jax.tree.map(lambda x: jax.device_put(x[:48], spread), START)
    body, torque = ml.RigidBody(BODY.moments[:48]), ml.torques.HeavyTop(TOP.mgl[:48])
    run = {"dt": 0.05, "steps": 20, "chunk": 6}
    found = ml.ensemble("SYMMETRIC[EA]", body, torque, start, **run, mesh=mesh(4, AxisType.Explicit))
    alone = ml.ensemble("SYMMETRIC[EA]", BODY, TOP, START, **run)
    same = np.array_equal(np.asarray(found.states.momentum), np.asarray(alone.states.momentum)[:48])
    return {"same": same, "messages in loops": 0}


def integrated(body, torque, start):
    return ml.integrate("JACOBI[EA]", body, torque, start, dt=0.05, steps=20, save_every=10).states


def with_variable_steps(body, torque, start):
    run = {"density": ml.densities.Spin([1.0, 1.0, 2.0], reference=3.0, floor=1.0), "dt": 0.05, "steps": 20}
    return ml.integrate_variable_step("JACOBI[EA]", body, torque, start, **run).states


def carries(body, torque, start):
    one = ml.stepper("JACOBI[EA]", BODIES, TOPS, jax.tree.map(lambda x: x[0], START), dt=0.05)
    return jax.vmap(one.state)(jax.vmap(one.step)(jax.vmap(one.init)(start)))


def ensemble_of(body, torque, start):
    return ml.ensemble("JACOBI[EA]", body, torque, start, dt=0.05, steps=20, save_every=10, chunk=6).states


def mean_of(body, torque, start):
    observe = ml.observe.Mean(ml.observe.energy)
    return ml.ensemble("JACOBI[EA]", body, torque, start, dt=0.05, steps=20, observe=observe).states


def slope_of(run):
    def size(torque, body, start):
        return sum(jnp.sum(x**2) for x in jax.tree.leaves(run(body, torque, start)))

    return lambda body, torque, start: jax.grad(size)(torque, body, start)


def slope_by_moments(body, torque, start):
    def size(moments):
        top = ml.torques.HeavyTop(2.0)
        return jnp.sum(ml.ensemble("GBS8", ml.RigidBody(moments), top, start, dt=0.05, steps=20).states.momentum ** 2)

    return jax.grad(size)(jnp.array([2.0, 2.0, 1.0]))


def in_a_program_of_arrays_with_a_mesh_in_their_type():
    """Each way to take steps, in the user's own program, on arrays that are spread over an explicit mesh."""
    ways = [jax.vmap(integrated), jax.vmap(with_variable_steps), carries, mean_of]
    ways += [slope_of(jax.vmap(integrated)), slope_of(ensemble_of), slope_by_moments]
    where, same = mesh(4, AxisType.Explicit), True
    arguments = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[:48]), (BODY, TOP, START))
    for way in ways:
        alone = jax.jit(way)(*arguments)
        with jax.set_mesh(where):
            spread = jax.device_put(arguments, NamedSharding(where, P("bodies")))
            found = jax.jit(way)(*spread)
        pairs = zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True)
        same = same and all(np.allclose(np.asarray(x), np.asarray(y), rtol=1e-11, atol=1e-11) for x, y in pairs)
    return {"same": same, "messages in loops": 0}


if __name__ == "__main__":
    checks = {
        "tops": tops,
        "orbit": orbit,
        "heated": heated,
        **{name: partial(observed, observe) for name, observe in OBSERVED.items()},
    }
    typed = {"explicit": explicit(), "typed": in_a_program_of_arrays_with_a_mesh_in_their_type()}
    print(json.dumps({**{name: compared(check) for name, check in checks.items()}, **typed}))
