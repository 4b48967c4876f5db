"""Gain and cost of the reversible step control of `ml.integrate_variable_step`.

    python benchmarks/adaptive.py [gain] [energy]

gain    error of the attitude at the end, with constant steps and with as many adaptive steps: equal torque evaluations
energy  energy errors of two tops, one of them integrable, over a long time under four step controls
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, main

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.integrators.system import Motion, System  # for a step control that is not in the package
from midlie_jax.integrators.verdict import is_fine

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


def top(moments, momentum, turn, axis, floor):
    """A heavy top, with a density by which it turns through similar angles in all steps."""
    body, torque = ml.RigidBody(jnp.array(moments)), ml.torques.HeavyTop(20.0, axis)
    start = ml.RigidState(jnp.array(momentum), ml.so3.exp(jnp.array(turn)))
    return body, torque, start, ml.densities.Spin(body.moments, jnp.array(1.0), jnp.array(floor))


TOPS = {
    "a swinging Lagrange top": top([5.0, 5.0, 1.0], [0.0, 0.0, 1.0], [0.3, 0.0, 0.0], (0.0, 0.0, 1.0), 0.3),
    "an asymmetric top": top([5.0, 6.0, 3.0], [1.0, 2.0, 3.0], [0.5, -0.3, 0.8], (0.48, 0.6, 0.64), 0.3),
}


def density_at_start(method, case, dt, steps, every):
    """States and `ok` under the simplest control, dt / density at the start of the step; it is not reversible."""
    body, torque, start, density = case
    zero = jnp.array(0.0)
    system, motion = System.of(body, torque, start, zero), Motion(*start.parts())

    def advance(carry, _):
        t, motion, force, ok = carry
        h = dt / density(t, start.kind.join(motion.momentum, motion.pose))
        motion, force, step_ok = method.step(system, t, t + h, h, motion, force)
        return (t + h, motion, force, ok & is_fine(step_ok)), None

    def save_interval(carry, _):
        carry, _ = jax.lax.scan(advance, carry, length=every)
        return carry, start.kind.join(carry[1].momentum, carry[1].pose)

    force = system.force(zero, motion) if method.keeps_force(system) else None
    (_, _, _, ok), states = jax.lax.scan(save_interval, (zero, motion, force, jnp.array(True)), length=steps // every)
    return states, ok


def pid_controlled(name, case, duration, tolerance):
    """States, `ok` and number of steps under diffrax's PIDController."""
    body, torque, start, _ = case
    solution = diffrax.diffeqsolve(
        ml.diffrax.RigidBodyTerm(body, torque),
        ml.diffrax.LieSolver(name),
        0.0,
        duration,
        0.02,
        start,
        saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, duration, 4097)[1:]),
        stepsize_controller=diffrax.PIDController(
            rtol=0.0, atol=tolerance, norm=ml.diffrax.RotationNorm(momentum=10.0)
        ),
        adjoint=diffrax.ForwardMode(),
        max_steps=1 << 20,
        throw=False,
    )
    ok = solution.result == diffrax.RESULTS.successful
    return solution.ys, ok, solution.stats["num_accepted_steps"]


def energy(name="JACOBI[EA]", dt=0.1, steps=1 << 18, every=16):
    for label, case in TOPS.items():
        body, torque, start, _ = case

        def row(control, count, states, ok, label=label, body=body, torque=torque, start=start):
            error = (
                np.asarray(ml.observe.energy(body, torque, states)) / float(ml.observe.energy(body, torque, start)) - 1
            )
            first, *_, last = np.array_split(error, 8)
            numbers = [np.abs(first).max(), np.abs(last).max(), first.mean(), last.mean()]
            note = "" if ok else " (failed)"
            return [label, f"{control}{note}", str(count), *(f"{e:.1e}" for e in numbers)]

        adaptive = jax.jit(
            lambda case=case: ml.integrate_variable_step(
                name, *case[:3], density=case[3], dt=dt, steps=steps, save_every=every
            )
        )()
        lengths = np.diff(np.asarray(adaptive.times))
        duration = adaptive.times[-1]
        yield row("reversible", steps, adaptive.states, adaptive.ok)
        states, ok = jax.jit(lambda case=case: density_at_start(ml.method(name), case, dt, steps, every))()
        yield row("density at the start of a step", steps, states, ok)
        path = jax.jit(lambda d, case=case: ml.integrate(name, *case[:3], dt=d / steps, steps=steps, save_every=every))(
            duration
        )
        yield row("constant step", steps, path.states, path.ok)
        for tolerance in (3e-4, 1e-4):
            states, ok, count = eqx.filter_jit(pid_controlled)(name, case, duration, tolerance)
            yield row(f"`PIDController`, atol {tolerance:g}", int(count), states, ok)
        shortest, longest = lengths.min() / every, lengths.max() / every
        print(f"({label}: {float(duration):.0f} time units, steps from {shortest:.3f} to {longest:.3f})", flush=True)


PRINTED = "", ""  # these tables are on no page
TABLES = {
    "gain": Table(*PRINTED, ("case", "method", "steps", "error, constant step", "error, adaptive", "gain"), gain),
    "energy": Table(
        *PRINTED,
        ("top", "control", "steps", "largest energy error, first eighth", "last eighth", "its mean, first", "last"),
        energy,
    ),
}

if __name__ == "__main__":
    main(__doc__, TABLES)
