"""What a derivative costs: value and gradient over value, first calls and memory, put into docs/reports/speed.md.

    python benchmarks/gradients.py [--write]

float64 on one core; times are medians of processor time, of programs that take turns. The gradient is that of |Pi|^2 at
the end of 128 steps with respect to the three moments and the weight, for each of 1000 fast tops P1. First calls
include tracing and compiling. The memory is what the compiled gradient of one top needs. diffrax's
Tsit5 takes as many steps of the same length, with its default adjoint. Our programs have both options of the compiler
(midlie_jax/_xla/compiler.py); Tsit5, which is faster without the second of them, has the first. Of 128 steps the
default, `Checkpointed()`, keeps every state, as `every=1` does.
"""

import diffrax
import jax
import jax.numpy as jnp
import one_core  # noqa: F401
from harness import Table, compiled, in_turn, main

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options, vector_width_options
from midlie_jax.cli import scenes

BODIES, STEPS, DT = 1000, 128, 0.005
LONG = (1_000, 100_000)  # steps of the runs whose memory is compared
METHODS = ("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]")
SCENE = scenes.scene("P1")
PARAMETERS = (SCENE.body.moments, SCENE.torque.mgl)


def ours(name, adjoint, steps):
    def end(parameters, start):
        moments, weight = parameters
        run = {"dt": DT, "steps": steps, "save_every": steps, "adjoint": adjoint}
        path = ml.integrate(name, ml.RigidBody(moments), ml.torques.HeavyTop(weight), start, **run)
        return jnp.sum(path.states.momentum[-1] ** 2)

    return end


def tsit5(parameters, start):
    moments, weight = parameters

    def field(t, y, args):
        momentum, attitude = y[:3], y[3:]
        velocity = momentum / moments
        up = ml.so3.to_matrix(attitude)[2]
        torque = weight * jnp.stack([up[1], -up[0], 0 * weight])
        turning = 0.5 * ml.so3.multiply(attitude, jnp.concatenate([jnp.zeros(1), velocity]))
        return jnp.concatenate([jnp.cross(momentum, velocity) + torque, turning])

    term = diffrax.ODETerm(field)
    y = jnp.concatenate([start.momentum, start.attitude])
    options = {"stepsize_controller": diffrax.StepTo(ts=DT * jnp.arange(STEPS + 1.0)), "max_steps": STEPS}
    found = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, DT * STEPS, None, y, **options)
    return jnp.sum(found.ys[-1, :3] ** 2)


def each():
    starts = scenes.perturbed(SCENE, BODIES, 1e-3)

    def row(label, adjoint, end, options):
        functions = (lambda start: end(PARAMETERS, start), lambda start: jax.value_and_grad(end)(PARAMETERS, start))
        calls = [compiled(jax.vmap(function), starts, options=options) for function in functions]
        value, both = in_turn(calls, 31, 61)
        nanoseconds = f"{1e9 * both / BODIES / STEPS:.0f}"
        return [label, adjoint, f"{both / value:.1f}", nanoseconds, f"{calls[1].seconds:.0f} s"]

    for name in METHODS:
        for adjoint in (ml.adjoints.Checkpointed(every=1), ml.adjoints.Reversible()):
            ends = [ours(name, adjoint, n) for n in LONG]
            gradients = [compiled(jax.grad(end), PARAMETERS, SCENE.start, options={}) for end in ends]
            label = "`Reversible()`" if isinstance(adjoint, ml.adjoints.Reversible) else "`Checkpointed(every=1)`"
            sizes = [f"{gradient.memory / 1e3:.0f} kB" for gradient in gradients]
            yield [*row(name, label, ours(name, adjoint, STEPS), compiler_options(BODIES)), *sizes]
    yield [*row("diffrax Tsit5", "`RecursiveCheckpointAdjoint()`", tsit5, vector_width_options()), *("" for _ in LONG)]


RATIO = "value and gradient over value", "ns per body-step"
TABLE = Table(
    *("reports/speed.md", "gradients"),
    ("method", "adjoint", *RATIO, "first call", *(f"memory, {steps} steps" for steps in LONG)),
    *(each, "gradients", lambda row: row[0] != "LIEMID[EA]", (0, 1, 2, 3, 6)),
)

if __name__ == "__main__":
    main(__doc__, TABLE)
