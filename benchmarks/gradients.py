"""What a derivative costs: value and gradient over value, first calls, memory, put into docs/reports/speed.md.

    python benchmarks/gradients.py [--write]

1000 fast tops P1 take 128 steps in float64 on one core; the gradient is that of |Pi|^2 at the end with respect to the
three moments and the weight, for each top. Times are medians of processor time, of programs that take turns; first
calls include tracing and compiling. The memory is what the compiled gradient needs besides arguments and results, for
one top. diffrax's Tsit5 takes as many steps of the same length, with its default adjoint. Our programs have both
options of the compiler (midlie_jax/_xla/compiler.py); Tsit5, which is faster without the second of them, has the first.
Of 128 steps the default, `Checkpointed()`, keeps every state, as `every=1` does.
"""

import time

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_enable_x64", True)

from pages import command, publish  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax._xla.compiler import compiler_options, vector_width_options  # noqa: E402
from midlie_jax.advice.timing import timed_in_turn  # noqa: E402
from midlie_jax.cli import scenes  # noqa: E402

BEGIN, END = "<!-- gradients -->", "<!-- /gradients -->"
BODIES, STEPS, DT = 1000, 128, 0.005
LONG = (1_000, 100_000)  # steps of the runs whose memory is compared
METHODS = ("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]")
ADJOINTS = {"`Checkpointed(every=1)`": ml.Checkpointed(every=1), "`Reversible()`": ml.Reversible()}
SCENE = scenes.scene("P1")
PARAMETERS = (SCENE.body.moments, SCENE.torque.weight)
STARTS = scenes.perturbed(SCENE, BODIES, 1e-3)


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


def compiled(function, options):
    """The compiled function of the starts, and the seconds of a first call without the run."""
    began = time.process_time()
    program = jax.jit(jax.vmap(function)).lower(STARTS).compile(compiler_options=options)
    return program, time.process_time() - began


def memory(name, adjoint, steps):
    """Bytes that the gradient of one top needs besides arguments and results."""
    gradient = jax.jit(jax.grad(ours(name, adjoint, steps)))
    analysis = gradient.lower(PARAMETERS, SCENE.start).compile().memory_analysis()
    return analysis.temp_size_in_bytes


def row(label, adjoint, end, options):
    value, _ = compiled(lambda start: end(PARAMETERS, start), options)
    gradient, seconds = compiled(lambda start: jax.value_and_grad(end)(PARAMETERS, start), options)
    calls = [lambda: jax.block_until_ready(value(STARTS)), lambda: jax.block_until_ready(gradient(STARTS))]
    (_, one), (_, both) = timed_in_turn(calls, least=31, most=61)
    nanoseconds = 1e9 * both.seconds / BODIES / STEPS
    return [label, adjoint, f"{both.seconds / one.seconds:.1f}", f"{nanoseconds:.0f}", f"{seconds:.0f} s"]


HEADS = ("method", "adjoint", "value and gradient over value", "ns per body-step", "first call")
HEADS += tuple(f"memory, {steps} steps" for steps in LONG)


def rows():
    for name in METHODS:
        for label, adjoint in ADJOINTS.items():
            sizes = [f"{memory(name, adjoint, steps) / 1e3:.0f} kB" for steps in LONG]
            yield [*row(name, label, ours(name, adjoint, STEPS), compiler_options(BODIES)), *sizes]
    yield [*row("diffrax Tsit5", "`RecursiveCheckpointAdjoint()`", tsit5, vector_width_options()), *("" for _ in LONG)]


def write(lines):
    """Puts the whole table into its data file, and the recommended methods and diffrax into the page."""
    publish("reports/speed.md", BEGIN, END, lines, "gradients", lambda row: row[0] != "LIEMID[EA]", (0, 1, 2, 3, 6))


if __name__ == "__main__":
    command(__doc__, "reports/speed.md", BEGIN, END, HEADS, rows(), write)
