"""What the reversible step control of `ml.integrate_adaptive` is worth, and what it costs.

    python benchmarks/adaptive.py [gain] [energy] [cost]

gain    error of the attitude at the end, by constant steps and by as many that adapt: equal torque evaluations
energy  two tops over a long time, one of them integrable: their energy errors under four step controls
cost    a step beside one of `ml.integrate`, vmapped; and what a batch waits for whose bodies take unequal steps
"""

import sys

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

import midlie_jax as ml  # noqa: E402
from midlie_jax.bench import scenes  # noqa: E402
from midlie_jax.drivers.timing import timed  # noqa: E402
from midlie_jax.methods.system import Motion, System  # noqa: E402  (the control that is not reversible is not in the package)

METHODS = ("LIEMID[EA]", "JACOBI[EA]", "JACOBI[SRKN6b]")


def satellite(eccentricity, orbits=5.3):
    """On an eccentric orbit, from its periapsis, in units of half the orbit's length and of its period."""
    mu = jnp.array(4 * np.pi**2)
    place = jnp.array([1 - eccentricity, 0.0, 0.0])
    speed = jnp.array([0.0, 2 * np.pi * jnp.sqrt((1 + eccentricity) / (1 - eccentricity)), 0.0])
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


def even(t, state):
    del state
    return jnp.ones_like(t)


CASES = {
    "satellite, eccentricity .6": (satellite(0.6), (200, 800)),
    "satellite, eccentricity .8": (satellite(0.8), (800, 3200)),
    "bruls-cardona, by torque": (bruls_cardona(by_torque), (800, 3200)),
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
        exact, taken, ok = ends("JACOBI[SRKN6b]", case, density, [fine, 0.7 * fine], 1 << 20)
        mean = taken[0] * fine / t1
        apart = np.linalg.norm(exact[1] - exact[0])
        assert ok.all(), label
        for name in METHODS:
            dts = t1 * mean / np.array(ladder)
            adapted, taken, ok = ends(name, case, density, dts, 1 << 20)
            constant, same, fine_ok = ends(name, case, even, t1 / taken, 1 << 20)
            assert (np.abs(same - taken)[fine_ok & ok] <= 1).all(), (same, taken)
            for i, count in enumerate(taken):
                ours, theirs = (np.linalg.norm(x[i] - exact[1]) for x in (adapted, constant))
                shown = [f"{e:.1e}" if good else "failed" for e, good in ((theirs, fine_ok[i]), (ours, ok[i]))]
                known = ok[i] and fine_ok[i] and min(theirs, ours) > 10 * apart
                ratio = f"{theirs / ours:.2g}" if known else "not known"
                print(f"| {label} | `{name}` | {count} | {shown[0]} | {shown[1]} | {ratio} |", flush=True)
        print(f"(reference known to {apart:.0e})", flush=True)


def top(moments, momentum, turn, axis, floor):
    """A heavy top whose steps are to be of like angles."""
    body, torque = ml.RigidBody(jnp.array(moments)), ml.torques.HeavyTop(20.0, axis)
    start = ml.RigidState(jnp.array(momentum), ml.so3.exp(jnp.array(turn)))
    return body, torque, start, ml.densities.Spin(body.moments, jnp.array(1.0), jnp.array(floor))


TOPS = {
    "a swinging Lagrange top": top([5.0, 5.0, 1.0], [0.0, 0.0, 1.0], [0.3, 0.0, 0.0], (0.0, 0.0, 1.0), 0.3),
    "an asymmetric top": top([5.0, 6.0, 3.0], [1.0, 2.0, 3.0], [0.5, -0.3, 0.8], (0.48, 0.6, 0.64), 0.3),
}


def looking_back(method, case, dt, steps, every):
    """The control that one writes first: the step from the density at its start."""
    body, torque, start, density = case
    zero = jnp.array(0.0)
    system, motion = System.of(body, torque, start, zero), Motion(*start.parts())

    def advance(carry, _):
        t, motion, force, ok = carry
        h = dt / density(t, type(start).join(*motion))
        motion, force, fine = method.step(system, t, t + h, h, motion, force)
        return (t + h, motion, force, ok & fine), None

    def leap(carry, _):
        carry, _ = jax.lax.scan(advance, carry, length=every)
        return carry, type(start).join(*carry[1])

    force = system.force(zero, motion) if method.keeps_force(system) else None
    (_, _, _, ok), states = jax.lax.scan(leap, (zero, motion, force, jnp.array(True)), length=steps // every)
    return states, ok


def controlled(name, case, duration, tolerance):
    """By diffrax's PIDController: states, whether all went well, steps."""
    body, torque, start, _ = case
    solution = diffrax.diffeqsolve(
        ml.RigidBodyTerm(body, torque),
        ml.LieSolver(name),
        0.0,
        duration,
        0.02,
        start,
        saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, duration, 4097)[1:]),
        stepsize_controller=diffrax.PIDController(rtol=0.0, atol=tolerance, norm=ml.RotationNorm(momentum=10.0)),
        adjoint=diffrax.ForwardMode(),
        max_steps=1 << 20,
        throw=False,
    )
    fine = solution.result == diffrax.RESULTS.successful
    return solution.ys, fine, solution.stats["num_accepted_steps"]


def energy(name="JACOBI[EA]", dt=0.1, steps=1 << 18, every=16):
    print("| top | control | steps | largest energy error, first eighth | last eighth | its mean, first | last |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for label, case in TOPS.items():
        body, torque, start, _ = case

        def show(control, count, states, ok, label=label, body=body, torque=torque, start=start):
            error = np.asarray(ml.energy(body, torque, states)) / float(ml.energy(body, torque, start)) - 1
            first, *_, last = np.array_split(error, 8)
            numbers = [np.abs(first).max(), np.abs(last).max(), first.mean(), last.mean()]
            note = "" if ok else " (failed)"
            print(f"| {label} | {control}{note} | {count} |", *(f"{e:.1e} |" for e in numbers), flush=True)

        ours = jax.jit(
            lambda case=case: ml.integrate_adaptive(
                name, *case[:3], density=case[3], dt=dt, steps=steps, save_every=every
            )
        )()
        lengths = np.diff(np.asarray(ours.times))
        duration = ours.times[-1]
        show("reversible", steps, ours.states, ours.ok)
        states, ok = jax.jit(lambda case=case: looking_back(ml.method(name), case, dt, steps, every))()
        show("density at the start of a step", steps, states, ok)
        path = jax.jit(lambda d, case=case: ml.integrate(name, *case[:3], dt=d / steps, steps=steps, save_every=every))(
            duration
        )
        show("constant step", steps, path.states, path.ok)
        for tolerance in (3e-4, 1e-4):
            states, ok, count = eqx.filter_jit(controlled)(name, case, duration, tolerance)
            show(f"`PIDController`, atol {tolerance:g}", int(count), states, ok)
        shortest, longest = lengths.min() / every, lengths.max() / every
        print(f"({label}: {float(duration):.0f} time units, steps from {shortest:.3f} to {longest:.3f})", flush=True)


def seconds(function, *arguments):
    """The median of some runs after the first, which compiles."""
    return timed(lambda: jax.block_until_ready(function(*arguments)), most=8)[1].seconds


def cost(count=2048, steps=128):
    """On one body repeated for (a step), and on satellites of eccentricities 0 to .8 for (a batch)."""
    print("| a step, vmapped over 2048 bodies | method | density | time, by that of `ml.integrate` |")
    print("|---|---|---|---|", flush=True)
    swinging, eccentric = TOPS["a swinging Lagrange top"], satellite(0.6)
    by_torque = ml.densities.TorqueSize(swinging[1], jnp.array(20.0), jnp.array(5.0))
    for label, density, (body, torque, start, *_) in (
        ("a heavy top", swinging[3], swinging),
        ("a heavy top", by_torque, swinging),
        ("a satellite", eccentric[3], eccentric),
    ):
        starts = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), start)
        for name in METHODS[1:]:
            # A step for each body, lest all be at one time and share one orbit.
            dts = jnp.linspace(1e-3, 2e-3, count)
            given = {"steps": steps, "save_every": steps}

            def even_steps(s, dt, name=name, body=body, torque=torque, given=given):
                return ml.integrate(name, body, torque, s, dt=dt, **given)

            def ours(s, dt, name=name, body=body, torque=torque, given=given, density=density):
                return ml.integrate_adaptive(name, body, torque, s, density=density, dt=dt, **given)

            times = [seconds(jax.jit(jax.vmap(f)), starts, dts) for f in (ours, even_steps)]
            kind = type(density).__name__
            print(f"| {label} | `{name}` | `{kind}` | {times[0] / times[1]:.2f} |", flush=True)

    def until(eccentricity, reverse):
        body, torque, start, density, _ = satellite(eccentricity)
        path = ml.integrate_adaptive(
            "JACOBI[EA]",
            body,
            torque,
            start,
            density=density,
            dt=0.01,
            steps=1024,
            save_every=1024,
            t1=2.0,
            reverse=reverse,
        )
        return path.taken, path.ok

    print(
        "\n| up to t1, satellites of eccentricities 0 to .8 | steps of the slowest | mean steps | time a useful step |"
    )
    print("|---|---|---|---|", flush=True)
    eccentricities = jnp.linspace(0.0, 0.8, count)
    for label, batch, reverse in (
        ("all alike (.4)", jnp.full(count, 0.4), False),
        ("all in one batch", eccentricities, False),
        ("all in one batch, reverse=True, of 1024", eccentricities, True),
    ):
        run = jax.jit(jax.vmap(lambda e, reverse=reverse: until(e, reverse)))
        spent = seconds(run, batch)
        taken, ok = map(np.asarray, run(batch))
        assert ok.all()
        useful = spent / taken.sum() * 1e6
        print(f"| {label} | {taken.max()} | {taken.mean():.0f} | {useful:.2f} us |", flush=True)


TABLES = {"gain": gain, "energy": energy, "cost": cost}

if __name__ == "__main__":
    for table in sys.argv[1:] or TABLES:
        TABLES[table]()
