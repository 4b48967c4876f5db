"""What each limit of midlie_jax/_xla/budgets.py decides: run times with the limit at half and doubled, over as it is.

    python benchmarks/budgets.py [LONG_TORQUE ...]     by default all

Six runs of 1000 bodies on one core, each in three processes that take turns; medians of processor time. A ratio of 1
means that the limit does not matter for this run, or that the present value is on a plateau.
"""

import os

from harness import Served, asked_in_turn, main, requests, shown

from midlie_jax._xla import budgets

BODIES, TURNS = 1000, 5
RUNS = ("JACOBI[EA]", "GBS12", "orbit from a table", "sunlight on 80 facets", "three bodies", "gradient")
FACTORS = 0.5, 1.0, 2.0


def run_of(name):
    """A compiled run, without arguments."""
    import jax
    import jax.numpy as jnp

    import midlie_jax as ml

    jax.config.update("jax_enable_x64", True)
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
    return lambda: jax.block_until_ready(run(start))


def serve():
    """Answers each request, the name of a run, by its seconds."""
    import one_core  # noqa: F401

    from midlie_jax.advice.timing import timed, user_clock

    name, factor = os.environ["BUDGET"].split()
    value = getattr(budgets, name)
    setattr(budgets, name, type(value)(value * float(factor)))
    runs = {}
    for (asked,) in requests():
        if asked not in runs:
            runs[asked] = run_of(asked)
            runs[asked]()
        print(timed(runs[asked], least=3, most=9, clock=user_clock())[1].seconds, flush=True)


def rows(names):
    for name in names:
        processes = [Served(__file__, os.environ | {"BUDGET": f"{name} {factor}"}) for factor in FACTORS]
        for run in RUNS:
            half, now, double, _ = asked_in_turn(processes, (run,), TURNS)
            yield [name, str(getattr(budgets, name)), run, f"{half / now:.2f}", f"{double / now:.2f}"]
        for process in processes:
            process.process.kill()


def measure(options):
    limits = [name for name, value in vars(budgets).items() if name.isupper() and isinstance(value, int)]
    shown(("limit", "value", "run", "half", "doubled"), rows(options.limits or limits))


if __name__ == "__main__":
    main(__doc__, measure, {"limits": {"nargs": "*", "metavar": "LIMIT", "help": "by default all"}}, serve=serve)
