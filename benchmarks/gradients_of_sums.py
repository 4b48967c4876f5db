"""What the gradient of one sum over many bodies costs, put into docs/reports/speed.md.

    python benchmarks/gradients_of_sums.py [--write]

Fast tops P1 in float64 on one core. The gradient is that of one number, the sum over all tops of |Pi|^2 at the end,
with respect to the weight, which all tops share: `jax.value_and_grad` of a loss around `jax.vmap` of `integrate`. Times
are medians of processor time, of programs that take turns, with the options of the compiler that docs/performance.md
recommends for many bodies. The memory is what the compiled gradient needs besides arguments and results.
"""

from midlie_jax.advice.timing import pin

pin()  # before XLA counts the cores

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_enable_x64", True)

from pages import command, publish  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax._xla.compiler import compiler_options  # noqa: E402
from midlie_jax.advice.timing import timed_in_turn  # noqa: E402
from midlie_jax.cli import scenes  # noqa: E402

BEGIN, END = "<!-- sums -->", "<!-- /sums -->"
SIZES = ((128, 1000), (1000, 256), (10_000, 64))  # steps and bodies
METHODS = ("SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]")
ADJOINTS = {"`Checkpointed()`": ml.Checkpointed(), "`Reversible()`": ml.Reversible()}
SCENE = scenes.scene("P1")
WEIGHT = float(SCENE.torque.weight)


def sum_at_end(name, adjoint, steps, starts):
    def loss(weight):
        run = {"dt": 0.005, "steps": steps, "save_every": None, "adjoint": adjoint}
        torque = ml.torques.HeavyTop(weight)
        end = jax.vmap(lambda start: ml.integrate(name, SCENE.body, torque, start, **run))(starts)
        return jnp.sum(end.states.momentum**2)

    return loss


def compiled(function, bodies):
    return jax.jit(function).lower(WEIGHT).compile(compiler_options=compiler_options(bodies))


def rows():
    for steps, bodies in SIZES:
        starts = scenes.perturbed(SCENE, bodies, 1e-3)
        for name in METHODS:
            losses = [sum_at_end(name, adjoint, steps, starts) for adjoint in ADJOINTS.values()]
            programs = [compiled(f, bodies) for f in (losses[0], *map(jax.value_and_grad, losses))]
            calls = [lambda program=program: jax.block_until_ready(program(WEIGHT)) for program in programs]
            value, *both = (timing.seconds for _, timing in timed_in_turn(calls, least=7, most=31, longest=2.0))
            for label, program, seconds in zip(ADJOINTS, programs[1:], both, strict=True):
                memory = f"{program.memory_analysis().temp_size_in_bytes / 1e6:.1f} MB"
                nanoseconds = f"{1e9 * seconds / steps / bodies:.0f}"
                yield [f"{steps} x {bodies}", name, label, f"{seconds / value:.1f}", nanoseconds, memory]


HEADS = ("steps x bodies", "method", "adjoint", "value and gradient over value", "ns per body-step", "memory")


KEY = ["128 x 1000", "JACOBI[EA]"], ["10000 x 64", "JACOBI[EA]"]


def write(lines):
    """Puts the whole table into its data file, and one method into the page."""
    publish("reports/speed.md", BEGIN, END, lines, "gradients-of-sums", lambda row: row[:2] in KEY)


if __name__ == "__main__":
    command(__doc__, "reports/speed.md", BEGIN, END, HEADS, rows(), write)
