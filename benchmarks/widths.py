"""What vectors of 512 bits gain over XLA's default of 256, put into docs/performance.md.

    python benchmarks/widths.py [--write]

1000 fast tops P1 on one core, by `ml.ensemble`, in two processes that take turns: one starts with
`XLA_FLAGS=--xla_cpu_prefer_vector_width=256`, the other without, so that the package asks for 512 bits. Medians of
processor time. Only on a processor with AVX-512, elsewhere the script says so and ends.
"""

import os
import sys

from pages import command
from served import Served, asked_in_turn, requests

BEGIN, END = "<!-- widths -->", "<!-- /widths -->"
METHODS = {"LIEMID[EA]": 400, "JACOBI[EA]": 1000, "SYMMETRIC[EA]": 3000, "DOP853": 400, "JACOBI[SRKN14a]": 100}  # steps
DTYPES = ("float64", "float32")
BODIES, DT, TURNS = 1000, 0.005, 7
NARROW = {"XLA_FLAGS": "--xla_cpu_prefer_vector_width=256"}


def serve():
    """Answers each request, a method and a dtype, by the millions of body-steps a second."""
    from midlie_jax.drivers.timing import pin

    pin()  # before XLA counts the cores
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp

    import midlie_jax as ml
    from midlie_jax.bench import scenes
    from midlie_jax.drivers.timing import timed, user_clock

    scene, runs = scenes.scene("P1"), {}

    def run_of(name, dtype):
        body = ml.RigidBody(jnp.asarray(scene.body.moments, dtype))
        torque = ml.torques.HeavyTop(jnp.asarray(scene.torque.weight, dtype))
        starts = jax.tree.map(lambda x: x.astype(dtype), scenes.perturbed(scene, BODIES, 1e-3))
        given = {"dt": jnp.asarray(DT, dtype), "steps": METHODS[name], "save_every": METHODS[name]}
        return lambda: jax.block_until_ready(ml.ensemble(name, body, torque, starts, **given))

    for key in requests():
        name, dtype = key
        if key not in runs:
            runs[key] = run_of(name, dtype)
            runs[key]()
        seconds = timed(runs[key], least=3, most=9, clock=user_clock())[1].seconds
        print(BODIES * METHODS[name] / seconds / 1e6, flush=True)


def rows():
    inherited = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    narrow, wide = Served(__file__, inherited | NARROW), Served(__file__, inherited)
    for name in METHODS:
        found = [asked_in_turn(narrow, wide, (name, dtype), TURNS) for dtype in DTYPES]
        yield [name, *(f"{figure:.{digits}f}" for row in found for figure, digits in zip(row, (1, 1, 2), strict=True))]


HEADS = ("M body-steps/s", *(f"{dtype}, {what}" for dtype in DTYPES for what in ("256", "512", "gain")))

if __name__ == "__main__":
    if "--serve" in sys.argv:
        serve()
    else:
        from midlie_jax._kernel.width import vector_width_options

        if not vector_width_options():
            sys.exit("this processor has no AVX-512, or XLA_FLAGS sets the width of vectors: nothing to compare.")
        command(__doc__, "performance.md", BEGIN, END, HEADS, rows())
