"""What the reversible step control of `ml.integrate_adaptive` is worth, and what it costs.

    python benchmarks/adaptive.py [gain] [energy] [cost]

gain    error of the attitude at the end, by constant steps and by as many that adapt: equal torque evaluations
energy  a slow top that swings through, over a long time: its energy error under four step controls
cost    a step beside one of `ml.integrate`, vmapped; and what a batch waits for whose bodies take unequal steps
"""

import sys
import time

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

import midlie_jax as ml  # noqa: E402
from midlie_jax import scenes  # noqa: E402
from midlie_jax.stepper import Motion, System  # noqa: E402

METHODS = ("LIEMID[EA]", "JACOBI[EA]", "JACOBI[SRKN6b]")


def satellite(eccentricity, orbits=5):
    """A satellite on an eccentric orbit, from its periapsis, in units of its mean distance and of the orbit's period."""
    mu = jnp.array(4 * np.pi**2)
    place = jnp.array([1 - eccentricity, 0.0, 0.0])
    speed = jnp.array([0.0, 2 * np.pi * np.sqrt((1 + eccentricity) / (1 - eccentricity)), 0.0])
    orbit = ml.orbits.KeplerOrbit(place, speed, mu)
    body = ml.RigidBody(jnp.array([1.0, 1.05, 1.1]))
    torque = ml.torques.GravityGradient(body.moments, orbit, mu)
    start = ml.RigidState(body.moments * jnp.array([0.5, 1.0, 6.0]), ml.so3.exp(jnp.array([0.2, 0.3, 0.4])))
    return body, torque, start, ml.densities.OrbitalDistance(orbit, jnp.array(1.0)), float(orbits)


def bruls_cardona(density):
    scene = scenes.scene("bruls-cardona")
    return scene.body, scene.torque, scene.start, density(scene), scene.duration


def by_torque(scene):
    return ml.densities.TorqueSize(scene.torque, jnp.array(147.15), jnp.array(14.715))


def slow_top():
    scene = scenes.scene("slow-top")
    moments = scene.body.moments
    return scene.body, scene.torque, scene.start, ml.densities.Spin(moments, jnp.array(1.0), jnp.array(0.2)), 20.0


def even(t, state):
    del state
    return jnp.ones_like(t)


CASES = {
    "satellite, eccentricity .6": (satellite(0.6), (100, 200, 400, 800)),
    "satellite, eccentricity .8": (satellite(0.8), (100, 200, 400, 800)),
    "bruls-cardona, by torque": (bruls_cardona(by_torque), (400, 800, 1600, 3200)),
}


def ends(name, case, density, dts, most):
    """The last states, steps taken and whether all went well, for some steps side by side."""
    body, torque, start, _, t1 = case

    @jax.jit
    @jax.vmap
    def run(dt):
        path = ml.integrate_adaptive(
            name, body, torque, start, density=density, dt=dt, steps=most, save_every=most, t1=t1
        )
        return ml.so3.to_matrix(path.states.attitude[-1]), path.taken, path.ok

    return [np.asarray(x) for x in run(jnp.asarray(dts))]


def gain():
    print("| case | method | steps | error, constant step | error, adaptive | gain |")
    print("|---|---|---|---|---|---|", flush=True)
    for label, (case, ladder) in CASES.items():
        density, t1 = case[3], case[4]
        fine = t1 / (30 * ladder[-1])
        # The best that is known, and how far it is from the same at another step.
        mean = 1.0
        exact, taken, ok = ends("JACOBI[SRKN6b]", case, density, [fine, 0.7 * fine], 1 << 20)
        mean = taken[0] * fine / t1
        apart = np.linalg.norm(exact[1] - exact[0])
        assert ok.all(), label
        for name in METHODS:
            dts = t1 * mean / np.array(ladder)
            adapted, taken, ok = ends(name, case, density, dts, 1 << 20)
            constant, same, fine_ok = ends(name, case, even, t1 / taken, 1 << 20)
            assert (np.abs(same - taken) <= 1).all(), (same, taken)
            for i, count in enumerate(taken):
                ours, theirs = (np.linalg.norm(x[i] - exact[1]) for x in (adapted, constant))
                shown = [f"{e:.1e}" if good else "failed" for e, good in ((theirs, fine_ok[i]), (ours, ok[i]))]
                ratio = f"{theirs / ours:.1f}" if ok[i] and fine_ok[i] else ""
                print(f"| {label} | `{name}` | {count} | {shown[0]} | {shown[1]} | {ratio} |", flush=True)
        print(f"(reference known to {apart:.0e})", flush=True)


TABLES = {"gain": gain}

if __name__ == "__main__":
    for table in sys.argv[1:] or TABLES:
        TABLES[table]()
