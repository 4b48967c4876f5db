"""What the options and the limits gain that the package gives to XLA's compiler: docs/reports/speed.md.

    python benchmarks/compiler_options.py options [--write]   without the options, with one, and with both
    python benchmarks/compiler_options.py limits              with each of midlie_jax/_xla/budgets.py halved, doubled

Each row has three processes on one core that take turns; medians of processor time. `options` runs 1000 fast tops P1 by
`ml.ensemble`: without the options, so that a sort keeps steps in vectors; with the option for that in its place; and
with vectors of 512 bits besides. It needs a processor with AVX-512. `limits` prints ratios of times for six runs of
1000 bodies: 1 means that the limit does not matter for this run, or that its value is on a plateau.
"""

import os
import sys

from harness import Served, Table, asked_in_turn, main, requests

from midlie_jax._xla import budgets

METHODS = {"LIEMID[EA]": 400, "JACOBI[EA]": 1000, "SYMMETRIC[EA]": 3000, "DOP853": 400, "JACOBI[SRKN14a]": 100}  # steps
DTYPES = ("float64", "float32")
BODIES, DT, OPTION_TURNS, LIMIT_TURNS = 1000, 0.005, 7, 5
NARROW = "--xla_cpu_prefer_vector_width=256"
NEITHER = f"{NARROW} --xla_disable_hlo_passes=none"  # a flag that is named holds, and the package adds nothing to it
RUNS = ("JACOBI[EA]", "GBS12", "orbit from a table", "sunlight on 80 facets", "three bodies", "gradient")
FACTORS = 0.5, 1.0, 2.0


def of_a_method(name, dtype):
    """A run without arguments, and its body-steps."""
    import jax
    import jax.numpy as jnp

    import midlie_jax as ml
    from midlie_jax.cli import scenes

    scene = scenes.scene("P1")
    body = ml.RigidBody(jnp.asarray(scene.body.moments, dtype))
    torque = ml.torques.HeavyTop(jnp.asarray(scene.torque.mgl, dtype))
    starts = jax.tree.map(lambda x: x.astype(dtype), scenes.perturbed(scene, BODIES, 1e-3))
    given = {"dt": jnp.asarray(DT, dtype), "steps": METHODS[name], "save_every": METHODS[name]}
    return lambda: jax.block_until_ready(ml.ensemble(name, body, torque, starts, **given)), BODIES * METHODS[name]


def of_a_limit(name):
    """A compiled run without arguments, and its body-steps."""
    import jax
    import jax.numpy as jnp

    import midlie_jax as ml

    body, steps = ml.RigidBody([1.0, 1.8, 2.3]), 200
    momenta = 0.3 * jax.random.normal(jax.random.key(0), (BODIES, 3))
    start = ml.RigidState(momenta, jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (BODIES, 1)))
    method, torque = name if name == "GBS12" else "JACOBI[EA]", ml.torques.HeavyTop(0.9)
    if name == "orbit from a table":
        times = jnp.linspace(0.0, 20.0, 400)
        orbit = ml.orbits.TableOrbit(times, 3.0 * jnp.stack([jnp.cos(times), jnp.sin(times), 0 * times], -1))
        torque = ml.spacecraft.GravityGradient(None, orbit, 27.0)
    elif name == "sunlight on 80 facets":
        torque = ml.asteroids.Sunlight(ml.Surface.ellipsoid([3.0, 2.0, 1.0], 80), jnp.array([1.0, 0.0, 0.0]), 1.0)
        steps = 40
    elif name == "three bodies":
        three = lambda x: jnp.repeat(x[:, None], 3, 1)  # noqa: E731
        places = jnp.broadcast_to(2.0 * jnp.eye(3), (BODIES, 3, 3))
        start = ml.CoupledState(three(momenta), three(start.attitude), 0 * places, places)
        body, torque, steps = ml.FreeBody(body, 1.0), ml.asteroids.MutualGravity(0.1), 40

    def end(start):
        return ml.ensemble(method, body, torque, start, dt=0.01, steps=steps).states

    run = jax.jit(jax.grad(lambda start: jnp.sum(end(start).momentum)) if name == "gradient" else end)
    return lambda: jax.block_until_ready(run(start)), BODIES * steps


def serve():
    """Answers each request, the name of a run or a method and a dtype, by the millions of body-steps a second."""
    import one_core  # noqa: F401

    from midlie_jax.advice.timing import timed, user_clock

    if changed := os.environ.get("BUDGET"):
        name, factor = changed.split()
        value = getattr(budgets, name)
        setattr(budgets, name, type(value)(value * float(factor)))
    runs = {}
    for asked in requests():
        if asked not in runs:
            runs[asked] = of_a_method(*asked) if len(asked) == 2 else of_a_limit(*asked)
            runs[asked][0]()
        run, body_steps = runs[asked]
        print(body_steps / timed(run, least=3, most=9, clock=user_clock())[1].seconds / 1e6, flush=True)


def option_rows():
    from midlie_jax._xla.compiler import vector_width_options

    if not vector_width_options():
        sys.exit("this processor has no AVX-512, or XLA_FLAGS sets the width of vectors: nothing to compare.")
    inherited = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    processes = [Served(__file__, inherited | flags) for flags in ({"XLA_FLAGS": NEITHER}, {"XLA_FLAGS": NARROW}, {})]
    for name in METHODS:
        cells = []
        for dtype in DTYPES:
            *speeds, gain = asked_in_turn(processes, (name, dtype), OPTION_TURNS)
            cells += [*(f"{speed:.1f}" for speed in speeds), f"{gain:.2f}"]
        yield [name, *cells]


def limit_rows():
    for name in [name for name, value in vars(budgets).items() if name.isupper() and isinstance(value, int)]:
        processes = [Served(__file__, os.environ | {"BUDGET": f"{name} {factor}"}) for factor in FACTORS]
        for run in RUNS:
            half, now, double, _ = asked_in_turn(processes, (run,), LIMIT_TURNS)
            yield [name, str(getattr(budgets, name)), run, f"{now / half:.2f}", f"{now / double:.2f}"]
        for process in processes:
            process.process.kill()


COLUMNS = ("sort, 256 bits", "option, 256 bits", "option, 512 bits", "gain")
TABLES = {
    "options": Table(
        *("reports/speed.md", "compiler options"),
        ("M body-steps/s", *(f"{dtype}, {what}" for dtype in DTYPES for what in COLUMNS)),
        *(option_rows, "compiler-options", lambda row: "14a" not in row[0], (0, 2, 3, 4)),
    ),
    "limits": Table("", "", ("limit", "value", "run", "half", "doubled"), limit_rows),
}

if __name__ == "__main__":
    main(__doc__, TABLES, serve=serve)
