"""Measures the integrators through diffrax: a table for each name.

    python benchmarks/diffrax_pipeline.py [solvers] [energy] [events] [adjoints] [--write]

solvers  one term with five solvers of diffrax and two of ours: error, order, drift of a free body's spatial momentum
energy   energy error of an asymmetric top over a long time, with a constant step and with a PIDController
events   a crossing of the fast top P1 by both kinds of dense output, against the closed form
adjoints  first and later calls of the derivatives that optimisers need

--write puts the tables solvers, events and adjoints into docs/reports/speed.md, and whole into its data files.
"""

import time
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from harness import Table, main
from scipy.optimize import brentq

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.cli.oracle import exact_motion

jax.config.update("jax_enable_x64", True)
MOMENTS, WEIGHT, AXIS = (1.0, 2.0, 2.5), 2.0, (0.48, 0.6, 0.64)


def start(dtype=jnp.float64):
    turn = ml.so3.exp(jnp.array([0.5, -0.3, 0.8], dtype))
    return ml.RigidState(jnp.array([1.0, 0.8, -1.3], dtype), turn)


def top(weight):
    return ml.torques.HeavyTop(weight, AXIS)


TERM = ml.diffrax.RigidBodyTerm(ml.RigidBody(jnp.array(MOMENTS)), torque_of_args=top)


def numbers(state):
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state)])


def solver_rows():
    @eqx.filter_jit
    def end(solver, weight, dt):
        return diffrax.diffeqsolve(TERM, solver, 0.0, 1.0, dt, start(), weight).ys

    exact = numbers(end(diffrax.Dopri8(), jnp.array(WEIGHT), jnp.array(1 / 64)))
    before = np.asarray(ml.observe.spatial_momentum(start()))
    newton = optimistix.Newton(rtol=1e-11, atol=1e-11)
    for solver in (
        diffrax.Heun(),
        diffrax.Bosh3(),
        diffrax.Tsit5(),
        diffrax.Dopri8(),
        diffrax.Kvaerno5(root_finder=newton),
        ml.diffrax.LieSolver("LIEMID[EA]"),
        ml.diffrax.LieSolver("SLIEMID4[SRKN6b]"),
    ):
        errors = [
            np.max(np.abs(numbers(end(solver, jnp.array(WEIGHT), jnp.array(h))) - exact)) for h in (1 / 8, 1 / 16)
        ]
        free = jax.tree.map(lambda x: x[0], end(solver, jnp.array(0.0), jnp.array(1 / 4)))
        drift = np.max(np.abs(ml.observe.spatial_momentum(free) - before))
        name = (
            f'LieSolver("{solver.method.name}")' if isinstance(solver, ml.diffrax.LieSolver) else type(solver).__name__
        )
        yield [f"`{name}`", f"{errors[0]:.1e}", f"{np.log2(errors[0] / errors[1]):.2f}", f"{drift:.1e}"]


def energy_rows(duration=2000.0, parts=8):
    weight = jnp.array(WEIGHT)
    first = ml.observe.energy(TERM.body, top(weight), start())

    @eqx.filter_jit
    def run(solver, dt, controller):
        def saved(t, y, args):
            del t
            return ml.observe.energy(TERM.body, top(args), y)

        saveat = diffrax.SaveAt(steps=True, fn=saved)
        return diffrax.diffeqsolve(
            TERM,
            solver,
            0.0,
            duration,
            dt,
            start(),
            weight,
            saveat=saveat,
            stepsize_controller=diffrax.ConstantStepSize() if controller is None else controller,
            adjoint=diffrax.ForwardMode(),
            max_steps=1 << 17,
        )

    def parts_of(solution):
        steps = int(solution.stats["num_accepted_steps"])
        which = np.minimum((np.asarray(solution.ts[:steps]) * parts / duration).astype(int), parts - 1)
        errors = np.abs(np.asarray(solution.ys[:steps]) / float(first) - 1)
        return steps, [errors[which == part].max() for part in range(parts)]

    for name, tolerance in (("LIEMID[EA]", 1e-4), ("SLIEMID[EA]", 1e-4)):
        solver = ml.diffrax.LieSolver(name)
        controller = diffrax.PIDController(rtol=0.0, atol=tolerance, norm=ml.diffrax.RotationNorm())
        steps, varying = parts_of(run(solver, 0.01, controller))
        same, constant = parts_of(run(solver, duration / steps, None))
        for label, count, errors in (("PIDController", steps, varying), ("constant step", same, constant)):
            yield [f"`{name}`", label, str(count), *(f"{e:.1e}" for e in errors)]


def event_rows(dt=0.01):
    """Errors and costs of the moment at which the axis of the top first falls through the plane x = 0."""
    scene = scenes.scene("P1")
    moments, weight = np.asarray(scene.body.moments), float(scene.torque.mgl)
    term = ml.diffrax.RigidBodyTerm(scene.body, scene.torque)

    def east(t, y, args, **kwargs):
        del t, args, kwargs
        return ml.so3.to_matrix(y.attitude)[0, 2]

    def exact(t):
        begun = scene.start.momentum, scene.start.attitude
        (momentum,), (attitude,) = exact_motion(moments, *begun, [t], weight=weight)
        return ml.RigidState(jnp.asarray(momentum), jnp.asarray(attitude))

    event = diffrax.Event(east, optimistix.Newton(1e-13, 1e-13), direction=False)
    for name in ("SYMMETRIC[EA]", "SYMMETRIC[SRKN6b]", "SYMMETRIC[SRKN14a]"):
        for dense in ("cubic", "step"):

            @jax.jit
            def crossing(y, name=name, dense=dense):
                solver = ml.diffrax.LieSolver(name, dense=dense)
                options = {"event": event, "adjoint": diffrax.ForwardMode(), "max_steps": None}
                found = diffrax.diffeqsolve(term, solver, 0.0, 10.0, dt, y, **options)
                return found.ts[0], jax.tree.map(lambda x: x[0], found.ys)

            seconds = []
            for _ in range(10):
                began = time.process_time()
                moment, state = jax.block_until_ready(crossing(scene.start))
                seconds.append(time.process_time() - began)
            near = float(moment)
            crossed: Any = brentq(lambda t: float(east(t, exact(t), None)), near - dt / 9, near + dt / 9, xtol=1e-15)
            true = float(crossed)
            turn = ml.so3.multiply(ml.so3.conjugate(exact(true).attitude), state.attitude)
            moved = jnp.linalg.norm(state.momentum - exact(true).momentum)
            figures = (f"{error:.1e}" for error in (abs(near - true), moved, 2 * jnp.linalg.norm(turn[1:])))
            costs = f"{seconds[0]:.1f} s", f"{1e3 * np.median(seconds[1:]):.2f} ms"
            yield [f"`{name}`", f'`"{dense}"`', *figures, *costs]


LENGTH, STEPS, SAVED = 1.0, 200, 11  # of the run that is differentiated


def readings(parameters, solver, controller, adjoint):
    """The momenta of a fast top at 11 times, for these moments and this weight."""
    moments, weight = parameters
    fast = ml.RigidState(jnp.array([0.0, 0.0, 50.0]), ml.so3.exp(jnp.array([0.05, 0.0, 0.0])))
    term = ml.diffrax.RigidBodyTerm(ml.RigidBody(moments), torque_of_args=ml.torques.HeavyTop)
    first = None if isinstance(controller, diffrax.StepTo) else LENGTH / STEPS
    options = {"saveat": diffrax.SaveAt(ts=jnp.linspace(0.0, LENGTH, SAVED)), "adjoint": adjoint}
    options["stepsize_controller"] = controller
    return diffrax.diffeqsolve(term, solver, 0.0, LENGTH, first, fast, weight, **options).ys.momentum


def first_and_later(function, parameters, calls=9):
    """The first call in wall time and in processor time, and the median of later ones in processor time."""
    program, walls, seconds = jax.jit(function), [], []
    for _ in range(1 + calls):
        wall, began = time.perf_counter(), time.process_time()
        jax.block_until_ready(program(parameters))
        seconds.append(time.process_time() - began)
        walls.append(time.perf_counter() - wall)
    return f"{walls[0]:.1f} s ({seconds[0]:.1f} s)", f"{1e3 * np.median(seconds[1:]):.1f} ms"


def derivatives():
    fixed = diffrax.StepTo(ts=LENGTH / STEPS * jnp.arange(STEPS + 1.0))
    adaptive = diffrax.PIDController(rtol=0.0, atol=1e-6, norm=ml.diffrax.RotationNorm(momentum=50.0))
    ours = [ml.diffrax.LieSolver(name) for name in ("LIEMID[EA]", "JACOBI[EA]", "SYMMETRIC[EA]")]
    cases = [(solver, "200 equal steps", fixed) for solver in (*ours, diffrax.Tsit5())]
    cases.append((ours[0], "adaptive", adaptive))
    reverse, forward = diffrax.RecursiveCheckpointAdjoint(), diffrax.ForwardMode()
    for solver, steps, controller in cases:
        name = solver.method.name if isinstance(solver, ml.diffrax.LieSolver) else f"diffrax {type(solver).__name__}"
        moments = jnp.array([5.0, 5.0, 1.0] if name.startswith("SYMMETRIC") else [5.0, 4.0, 1.0])

        def run(adjoint, parameters, solver=solver, controller=controller):
            return readings(parameters, solver, controller, adjoint)

        def loss(parameters, run=run):
            return jnp.mean(run(reverse, parameters) ** 2)

        parameters = moments, jnp.array(20.0)
        gradient = first_and_later(jax.value_and_grad(loss), parameters)
        jacobian = first_and_later(jax.jacfwd(lambda p, run=run: run(forward, p)), parameters)
        yield f"`{name}`", steps, *gradient, *jacobian


TABLES = {
    "solvers": Table(
        *("reports/speed.md", "solvers"),
        ("solver", "error at h = 1/8", "measured order", "drift of the spatial momentum, free body, h = 1/4"),
        *(solver_rows, "diffrax-solvers", lambda row: row[0].strip("`") not in ("Heun", "Bosh3", "Kvaerno5")),
    ),
    "energy": Table(
        "", "", ("largest |E/E0 - 1| of each eighth", "control", "steps", *map(str, range(1, 9))), energy_rows
    ),
    "events": Table(
        *("reports/speed.md", "events"),
        ("method", "`dense`", "error of the time", "of the momentum", "of the attitude", "first call", "later calls"),
        *(event_rows, "diffrax-events", lambda row: "6b" not in row[0], (0, 1, 2, 3, 4, 6)),
    ),
    "adjoints": Table(
        *("reports/speed.md", "adjoints"),
        ("solver", "steps", "`value_and_grad`: first call", "later calls", "`jacfwd`: first call", "later calls"),
        *(derivatives, "diffrax-adjoints", lambda row: "JACOBI" not in row[0]),
    ),
}

if __name__ == "__main__":
    main(__doc__, TABLES)
