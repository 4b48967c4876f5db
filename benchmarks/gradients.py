"""What a derivative costs: value and gradient over value, first calls and memory, put into docs/reports/speed.md.

    python benchmarks/gradients.py each [--write]    of each of 1000 fast tops P1 over 128 steps, beside diffrax
    python benchmarks/gradients.py sum [--write]     of one sum over many tops

float64 on one core; times are medians of processor time, of programs that take turns. The memory is what the compiled
gradient needs besides arguments and results.

Part `each`: the gradient of |Pi|^2 at the end with respect to the three moments and the weight, for each top; first
calls include tracing and compiling, and the memory is for one top. diffrax's Tsit5 takes as many steps of the same
length, with its default adjoint. Our programs have both options of the compiler (midlie_jax/_xla/compiler.py); Tsit5,
which is faster without the second of them, has the first. Of 128 steps the default, `Checkpointed()`, keeps every
state, as `every=1` does.

Part `sum`: the gradient of the sum over all tops of |Pi|^2 at the end, with respect to the weight, which all
tops share: `jax.value_and_grad` of a loss around `jax.vmap` of `integrate`, with the options of the compiler that
docs/performance.md recommends for many bodies.
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
SIZES = ((128, 1000), (1000, 256), (10_000, 64))  # steps and bodies of the sums
METHODS = ("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]")
SCENE = scenes.scene("P1")
PARAMETERS = (SCENE.body.moments, SCENE.torque.mgl)


def ours(name, adjoint, steps, every=None):
    def end(parameters, start):
        moments, weight = parameters
        run = {"dt": DT, "steps": steps, "save_every": every, "adjoint": adjoint}
        momentum = ml.integrate(name, ml.RigidBody(moments), ml.torques.HeavyTop(weight), start, **run).states.momentum
        return jnp.sum((momentum if every is None else momentum[-1]) ** 2)

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
            ends = [ours(name, adjoint, n, n) for n in LONG]
            gradients = [compiled(jax.grad(end), PARAMETERS, SCENE.start, options={}) for end in ends]
            label = "`Reversible()`" if isinstance(adjoint, ml.adjoints.Reversible) else "`Checkpointed(every=1)`"
            sizes = [f"{gradient.memory / 1e3:.0f} kB" for gradient in gradients]
            yield [*row(name, label, ours(name, adjoint, STEPS, STEPS), compiler_options(BODIES)), *sizes]
    yield [*row("diffrax Tsit5", "`RecursiveCheckpointAdjoint()`", tsit5, vector_width_options()), *("" for _ in LONG)]


def summed(end, starts):
    return lambda weight: jnp.sum(jax.vmap(lambda start: end((SCENE.body.moments, weight), start))(starts))


def sums():
    adjoints = {"`Checkpointed()`": ml.adjoints.Checkpointed(), "`Reversible()`": ml.adjoints.Reversible()}
    for steps, bodies in SIZES:
        starts = scenes.perturbed(SCENE, bodies, 1e-3)
        for name in METHODS:
            losses = [summed(ours(name, adjoint, steps), starts) for adjoint in adjoints.values()]
            weight = float(SCENE.torque.mgl)
            programs = [compiled(f, weight, bodies=bodies) for f in (losses[0], *map(jax.value_and_grad, losses))]
            value, *both = in_turn(programs, 7, 31, longest=2.0)
            for label, program, seconds in zip(adjoints, programs[1:], both, strict=True):
                cells = (
                    f"{seconds / value:.1f}",
                    f"{1e9 * seconds / steps / bodies:.0f}",
                    f"{program.memory / 1e6:.1f} MB",
                )
                yield [f"{steps} x {bodies}", name, label, *cells]


KEY = ["128 x 1000", "JACOBI[EA]"], ["10000 x 64", "JACOBI[EA]"]  # the rows of sums on the page
RATIO = "value and gradient over value", "ns per body-step"
TABLES = {
    "each": Table(
        *("reports/speed.md", "gradients"),
        ("method", "adjoint", *RATIO, "first call", *(f"memory, {steps} steps" for steps in LONG)),
        *(each, "gradients", lambda row: row[0] != "LIEMID[EA]", (0, 1, 2, 3, 6)),
    ),
    "sum": Table(
        *("reports/speed.md", "sums", ("steps x bodies", "method", "adjoint", *RATIO, "memory"), sums),
        *("gradients-of-sums", lambda row: row[:2] in KEY),
    ),
}

if __name__ == "__main__":
    main(__doc__, TABLES)
