"""Gain of the reversible step control of `ml.integrate_variable_step`: errors with as many constant steps.

python benchmarks/adaptive.py      error of the attitude at the end, at equal torque evaluations
"""

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, main

import midlie_jax as ml
from midlie_jax.cli import scenes

METHODS = ("LIEMID[EA]", "JACOBI[EA]", "JACOBI[SRKN6b]")


def satellite(eccentricity, orbits=5.3):
    """A satellite on an eccentric orbit, from the periapsis, in units of the semi-major axis and the period."""
    mu = jnp.array(4 * np.pi**2)
    position = jnp.array([1 - eccentricity, 0.0, 0.0])
    velocity = jnp.array([0.0, 2 * np.pi * jnp.sqrt((1 + eccentricity) / (1 - eccentricity)), 0.0])
    orbit = ml.orbits.KeplerOrbit(position, velocity, mu)
    body = ml.RigidBody(jnp.array([1.0, 1.05, 1.1]))
    torque = ml.spacecraft.GravityGradient(body.moments, orbit, mu)
    start = ml.RigidState(body.moments * jnp.array([0.5, 1.0, 6.0]), ml.so3.exp(jnp.array([0.2, 0.3, 0.4])))
    return body, torque, start, ml.densities.OrbitalDistance(orbit, jnp.array(1.0)), float(orbits)


def bruls_cardona(density):
    scene = scenes.scene("bruls-cardona")
    return scene.body, scene.torque, scene.start, density(scene), scene.duration


def by_torque(scene):
    return ml.densities.TorqueSize(scene.torque, jnp.array(147.15), jnp.array(14.715))


def constant_density(t, state):
    del state
    return jnp.ones_like(t)


CASES = {
    "satellite, eccentricity .6": (satellite(0.6), (200, 800)),
    "satellite, eccentricity .8": (satellite(0.8), (800, 3200)),
    "bruls-cardona, by torque": (bruls_cardona(by_torque), (800, 3200)),
}


def ends(name, case, density, dts, most):
    """Rotation matrices at the end, numbers of steps taken, and `ok`, for each of `dts`."""
    body, torque, start, _, t1 = case

    @jax.jit
    @jax.vmap
    def run(dt):
        path = ml.integrate_variable_step(
            name, body, torque, start, density=density, dt=dt, steps=most, save_every=most, t1=t1
        )
        return ml.so3.to_matrix(path.states.attitude[-1]), path.taken, path.ok

    return [np.asarray(x) for x in run(jnp.asarray(dts))]


def gain():
    for label, (case, ladder) in CASES.items():
        density, t1 = case[3], case[4]
        smallest = t1 / (30 * ladder[-1])
        # The reference, and its uncertainty: the distance between the results with two small steps.
        exact, taken, ok = ends("JACOBI[SRKN6b]", case, density, [smallest, 0.7 * smallest], 1 << 20)
        mean = taken[0] * smallest / t1
        uncertainty = np.linalg.norm(exact[1] - exact[0])
        assert ok.all(), label
        for name in METHODS:
            dts = t1 * mean / np.array(ladder)
            adaptive, taken, ok = ends(name, case, density, dts, 1 << 20)
            constant, constant_taken, constant_ok = ends(name, case, constant_density, t1 / taken, 1 << 20)
            assert (np.abs(constant_taken - taken)[constant_ok & ok] <= 1).all(), (constant_taken, taken)
            for i, count in enumerate(taken):
                adaptive_error, constant_error = (np.linalg.norm(x[i] - exact[1]) for x in (adaptive, constant))
                results = (constant_error, constant_ok[i]), (adaptive_error, ok[i])
                texts = [f"{error:.1e}" if succeeded else "failed" for error, succeeded in results]
                known = ok[i] and constant_ok[i] and min(constant_error, adaptive_error) > 10 * uncertainty
                ratio = f"{constant_error / adaptive_error:.2g}" if known else "not known"
                yield [label, f"`{name}`", str(count), *texts, ratio]
        print(f"(uncertainty of the reference {uncertainty:.0e})", flush=True)


HEADS = "case", "method", "steps", "error, constant step", "error, adaptive", "gain"

if __name__ == "__main__":
    main(__doc__, Table("", "", HEADS, gain))
