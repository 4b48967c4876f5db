"""What the options gain that the package gives to XLA's compiler, put into docs/reports/speed.md.

    python benchmarks/compiler_options.py [--write]

1000 fast tops P1 on one core, by `ml.ensemble`, in three processes that take turns: without the options, so that a sort
keeps steps in vectors; with the option for that in its place; and with vectors of 512 bits besides, as the package asks
for. Medians of processor time. Needs a processor with AVX-512; otherwise the script prints this and ends.
"""

import os
import sys

from harness import Served, Table, asked_in_turn, main, requests

METHODS = {"LIEMID[EA]": 400, "JACOBI[EA]": 1000, "SYMMETRIC[EA]": 3000, "DOP853": 400, "JACOBI[SRKN14a]": 100}  # steps
DTYPES = ("float64", "float32")
BODIES, DT, TURNS = 1000, 0.005, 7
NARROW = "--xla_cpu_prefer_vector_width=256"
NEITHER = f"{NARROW} --xla_disable_hlo_passes=none"  # a flag that is named holds, and the package adds nothing to it


def serve():
    """Answers each request, a method and a dtype, by the millions of body-steps a second."""
    import jax
    import jax.numpy as jnp
    import one_core  # noqa: F401

    import midlie_jax as ml
    from midlie_jax.advice.timing import timed, user_clock
    from midlie_jax.cli import scenes

    scene, runs = scenes.scene("P1"), {}

    def run_of(name, dtype):
        body = ml.RigidBody(jnp.asarray(scene.body.moments, dtype))
        torque = ml.torques.HeavyTop(jnp.asarray(scene.torque.mgl, dtype))
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
    from midlie_jax._xla.compiler import vector_width_options

    if not vector_width_options():
        sys.exit("this processor has no AVX-512, or XLA_FLAGS sets the width of vectors: nothing to compare.")
    inherited = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    processes = [Served(__file__, inherited | flags) for flags in ({"XLA_FLAGS": NEITHER}, {"XLA_FLAGS": NARROW}, {})]
    for name in METHODS:
        cells = []
        for dtype in DTYPES:
            *speeds, gain = asked_in_turn(processes, (name, dtype), TURNS)
            cells += [*(f"{speed:.1f}" for speed in speeds), f"{gain:.2f}"]
        yield [name, *cells]


COLUMNS = ("sort, 256 bits", "option, 256 bits", "option, 512 bits", "gain")
HEADS = ("M body-steps/s", *(f"{dtype}, {what}" for dtype in DTYPES for what in COLUMNS))


TABLE = Table(
    *("reports/speed.md", "compiler options", HEADS, rows),
    *("compiler-options", lambda row: "14a" not in row[0], (0, 2, 3, 4)),
)

if __name__ == "__main__":
    main(__doc__, TABLE, serve=serve)
