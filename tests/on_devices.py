"""Runs on a mesh of four CPU devices, in a process that `test_shard_map.py` starts; it judges what is printed."""

import json
import os
import re
import sys
import traceback
from functools import partial

os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=4"

import conftest  # noqa: F401  (float64)
import jax
import jax.numpy as jnp
import numpy as np
from cases import loop_bodies, quick
from jax.sharding import AxisType, NamedSharding
from jax.sharding import PartitionSpec as P

import midlie_jax as ml

MESH = jax.make_mesh((2, 2), ("rows", "columns"), axis_types=(AxisType.Auto, AxisType.Auto))
EACH, ALL = P(("rows", "columns")), P()
COMMUNICATION = r" (?:all-reduce|all-gather|all-to-all|collective-permute|reduce-scatter)(?:-start)?\("

COUNT = 8
RNG = np.random.default_rng(5)
BODIES = ml.RigidBody(jnp.asarray(2 + RNG.uniform(size=(COUNT, 3))))
WEIGHTS = jnp.asarray(RNG.uniform(1, 2, size=COUNT))
STARTS = ml.RigidState(jnp.asarray(RNG.normal(size=(COUNT, 3))), ml.so3.exp(jnp.asarray(RNG.normal(size=(COUNT, 3)))))
BODY, WEIGHT, START = jax.tree.map(lambda x: x[0], (BODIES, WEIGHTS, STARTS))


def pull(weight, t, state):
    """A torque written on arrays, with constants and indices, that is zero along one axis."""
    up = ml.so3.to_matrix(state.attitude)[2]
    return weight * jnp.cross(up[jnp.array([1, 2, 0])], jnp.array([0.0, 1.0, 0.0])).at[1].set(0.0) + jnp.cos(t)


def leaf(weight):
    return jax.tree_util.Partial(pull, weight)


def closure(weight):
    """Which the run cannot see among its arguments; nor what its derivative would be summed over."""
    return ml.torques.FromPotential(lambda t, state: weight * ml.so3.to_matrix(state.attitude)[2, 2])


def damping(weight):
    return ml.torques.BodyTorque(lambda t, state, body: -weight * body.velocity(state.momentum))


def run(method, torque, body, weight, start):
    return ml.integrate(method, body, torque(weight), start, dt=0.01, steps=6, save_every=3)


def adaptive(body, weight, start):
    def density(t, state):
        return 1 + weight * jnp.sum(state.momentum**2)

    path = ml.integrate_variable_step(
        "LIEMID[EA]", body, leaf(weight), start, density=density, dt=0.02, t1=0.1, steps=64
    )
    return path.times, path.states, path.ok, path.taken


def ensemble(body, weight, start):
    return ml.ensemble("LIEMID[EA]", body, leaf(weight), start, dt=0.01, steps=6, chunk=1)


def energy(body, weight, start):
    paths = jax.vmap(partial(run, "LIEMID[EA]", leaf), (None, None, 0))(body, weight, start)
    return jnp.sum(paths.states.momentum[:, -1] ** 2)


def slope(spread):
    """By what all devices share and by what each has: the former is a sum over the devices."""
    part = partial(on_mesh, lambda *given: jax.lax.psum(energy(*given), ("rows", "columns")))
    return jax.grad(part((ALL, ALL, EACH), ALL) if spread else energy, (0, 1, 2))


def on_mesh(function, specs, out, **options):
    return jax.shard_map(function, mesh=MESH, in_specs=specs, out_specs=out, **options)


def on_rows(function):
    """The other axis of the mesh is left to the compiler."""
    rows = P("rows")
    return on_mesh(function, rows, ml.Path(ALL, *[rows] * 5), axis_names={"rows"})


def mapped(function, *axes):
    return jax.vmap(function, axes, ml.Path(None, 0, 0, 0, 0, 0))


PATH = ml.Path(ALL, *[EACH] * 5)
EVERY, SHARED, STARTED = (BODIES, WEIGHTS, STARTS), (BODY, WEIGHT, STARTS), (BODY, WEIGHTS, START)
METHODS = ["LIEMID[I]", "JACOBI[SRKN6b]", "RK4", "SLIEMID[EA]", "JACOBI[EA]"]


def sharded(function, arguments, out):
    """What is the same for all devices is one row of what is given to each."""
    specs = tuple(EACH if jax.tree.leaves(x)[0].shape[:1] == (COUNT,) else ALL for x in arguments)
    return function, on_mesh(function, specs, out), arguments


EVERYTHING = mapped(partial(run, "LIEMID[E2]", leaf), 0, 0, 0)
CHECKS = {
    "rows": (EVERYTHING, on_rows(EVERYTHING), EVERY),
    **{name: sharded(mapped(partial(run, name, leaf), 0, 0, 0), EVERY, PATH) for name in METHODS},
    "damping": sharded(mapped(partial(run, "LIEMID[EA]", damping), None, 0, None), STARTED, PATH),
    "closure": sharded(mapped(partial(run, "LIEMID[EA]", closure), None, 0, None), STARTED, PATH),
    "adaptive": sharded(jax.vmap(adaptive, (None, 0, None)), STARTED, EACH),
    "ensemble": sharded(ensemble, SHARED, PATH),
    "slope": (slope(False), slope(True), SHARED),
}


def compared(alone, spread, arguments):
    program = quick(spread).lower(*arguments).compile()
    pairs = zip(jax.tree.leaves(program(*arguments)), jax.tree.leaves(quick(alone)(*arguments)), strict=True)
    gaps = [float(np.max(np.abs(np.asarray(x, float) - np.asarray(y, float)))) for x, y in pairs]
    text = program.as_text()
    return {
        "gap": max(gaps),
        "messages": len(re.findall(COMMUNICATION, text)),
        "in loops": len(re.findall(COMMUNICATION, "\n".join(loop_bodies(text)))),
    }


def typed_by_the_mesh():
    """Without `shard_map`, on a mesh whose axes are part of every array's type."""
    mesh = jax.make_mesh((4,), ("rows",), axis_types=(AxisType.Explicit,))
    alone = mapped(partial(run, "LIEMID[EA]", leaf), None, 0, 0)
    with jax.set_mesh(mesh):
        weights, starts = jax.device_put((WEIGHTS, STARTS), NamedSharding(mesh, P("rows")))
        return compared(alone, alone, (ml.RigidBody(jnp.asarray(np.asarray(BODY.moments))), weights, starts))


def main(names):
    results, checks = {}, {**{n: partial(compared, *c) for n, c in CHECKS.items()}, "typed": typed_by_the_mesh}
    for name, check in ((name, checks[name]) for name in names):
        try:
            results[name] = check()
        except Exception:
            results[name] = {"error": traceback.format_exc(limit=-1)}
    print(json.dumps(results))


if __name__ == "__main__":
    main(sys.argv[1:])
