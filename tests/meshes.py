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

from cases import QUICK, loop_bodies  # noqa: E402
from on_devices import COMMUNICATION  # noqa: E402
from simulated import ATTITUDES, MOMENTA, MOMENTS, WEIGHTS  # noqa: E402

import midlie_jax as ml  # noqa: E402

START = ml.RigidState(jnp.asarray(MOMENTA), jnp.asarray(ATTITUDES))
BODY, TOP = ml.RigidBody(jnp.asarray(MOMENTS)), ml.torques.HeavyTop(jnp.asarray(WEIGHTS))


def mesh(size, kind=AxisType.Auto):
    return Mesh(np.array(jax.devices()[:size]), ("bodies",), axis_types=(kind,))


def ensemble(method, body, torque, start=START, **options):
    return ml.ensemble(method, body, torque, start, dt=0.05, steps=20, chunk=6, **options)


TOPS = partial(ensemble, "SYMMETRIC[EA]", BODY, TOP)
BATH = ml.baths.Langevin(0.7, 1.3, jax.random.split(jax.random.key(0), len(MOMENTA)))
RELAXATION = ml.observe.Autocorrelation(ml.observe.Axis(), 5, centred=True, normalised=True)
CHECKS = {
    "tops": partial(TOPS, save_every=10),
    "heated": partial(ensemble, "SYMMETRIC[BAOAB]", BODY, TOP, bath=BATH),  # with a key for each body
    "mean": partial(TOPS, save_every=2, observe=ml.observe.Mean(lambda t, state: jnp.sum(state.momentum**2))),
    "autocorrelation": partial(TOPS, save_every=2, observe=RELAXATION),
}


def compared(function):
    """Whether `function(mesh)` is the same on one device and on four, and how often the loops there send anything."""
    alone, four = (jax.tree.leaves(function(mesh=mesh(size))) for size in (1, 4))
    same = all(np.array_equal(np.asarray(x), np.asarray(y)) for x, y in zip(four, alone, strict=True))
    text = jax.jit(lambda: function(mesh=mesh(4)), compiler_options=QUICK).lower().compile().as_text()
    return {"same": same, "messages in loops": len(re.findall(COMMUNICATION, "\n".join(loop_bodies(text))))}


def explicit():
    """Arrays that are spread beforehand, and a mesh whose axes are part of every array's type."""
    spread = NamedSharding(mesh(4), P("bodies"))
    start = jax.tree.map(lambda x: jax.device_put(x[:48], spread), START)
    body, torque = ml.RigidBody(BODY.moments[:48]), ml.torques.HeavyTop(TOP.mgl[:48])
    found = ensemble("SYMMETRIC[EA]", body, torque, start, mesh=mesh(4, AxisType.Explicit))
    return {"same": np.array_equal(found.states.momentum, TOPS().states.momentum[:48]), "messages in loops": 0}


def with_variable_steps(body, torque, start):
    run = {"density": ml.densities.Spin([1.0, 1.0, 2.0], reference=3.0, floor=1.0), "dt": 0.05, "steps": 20}
    return ml.integrate_variable_step("JACOBI[EA]", body, torque, start, **run).states


def carries(body, torque, start):
    body, torque, first = ml.RigidBody([1.0, 1.0, 2.0]), ml.torques.HeavyTop(1.5), jax.tree.map(lambda x: x[0], START)
    one = ml.stepper("JACOBI[EA]", body, torque, first, dt=0.05)
    return jax.vmap(one.state)(jax.vmap(one.step)(jax.vmap(one.init)(start)))


def mean_of(body, torque, start):
    return ensemble("JACOBI[EA]", body, torque, start, observe=ml.observe.Mean(ml.observe.energy)).states


def slope(body, torque, start):
    def size(torque):
        return sum(jnp.sum(x**2) for x in jax.tree.leaves(ensemble("JACOBI[EA]", body, torque, start).states))

    return jax.grad(size)(torque)


def slope_by_moments(body, torque, start):
    def size(moments):
        return jnp.sum(ensemble("GBS8", ml.RigidBody(moments), ml.torques.HeavyTop(2.0), start).states.momentum ** 2)

    return jax.grad(size)(jnp.array([2.0, 2.0, 1.0]))


def typed():
    """Each way to take steps, in the user's own program, on arrays that are spread over an explicit mesh."""
    where, same = mesh(4, AxisType.Explicit), []
    arguments = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[:48]), (BODY, TOP, START))
    for way in (jax.vmap(with_variable_steps), carries, mean_of, slope, slope_by_moments):
        run = jax.jit(way, compiler_options=QUICK)
        alone = run(*arguments)
        with jax.set_mesh(where):
            found = run(*jax.device_put(arguments, NamedSharding(where, P("bodies"))))
        pairs = zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True)
        same += [np.allclose(np.asarray(x), np.asarray(y), rtol=1e-11, atol=1e-11) for x, y in pairs]
    return {"same": all(same), "messages in loops": 0}


if __name__ == "__main__":
    found = {name: compared(check) for name, check in CHECKS.items()}
    print(json.dumps({**found, "explicit": explicit(), "typed": typed()}))
