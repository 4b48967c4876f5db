"""Apophis past the Earth: errors and times beside SciPy, and steps that know the perigee: docs/reports/applications.md.

    python benchmarks/flyby.py [--write]

1,000 random phases of the tumbling in one call, from two days before the perigee to two days after. Errors are the
largest angle between the attitude at the end and that by 9,216 steps, among the bodies compared. Times are
processor times on one core. `--write` puts the tables into the page.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, in_turn, main, save, shown
from laboratory import flyby

import midlie_jax as ml

PAGE = "reports/applications.md"
COUNT, BY_SCIPY = 1000, 20  # phases; those that SciPy integrates, one by one, for time and error
LADDER = {"JACOBI[EA]": (1152,), "JACOBI[SRKN6b]": (144, 288, 576, 1152), "GBS12": (192,)}
REFERENCE = 9216  # steps of JACOBI[SRKN6b]
TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
DTS = (600.0, 300.0, 150.0)


def ends(method, steps, starts):
    run = {"dt": 2 * flyby.HALF / steps, "steps": steps, "t0": -flyby.HALF}
    began = time.process_time()

    def call():
        return jax.block_until_ready(ml.ensemble(method, flyby.body(), flyby.torque(), starts, **run))

    path = call()
    first = time.process_time() - began
    assert path.ok.all()
    return path, in_turn([call], 6)[0], first


def error_of(path, right):
    return flyby.distance(path.states.attitude, right.states.attitude).max()


def constant(starts, right):
    for method, ladder in LADDER.items():
        for steps in ladder:
            path, seconds, first = ends(method, steps, starts)
            cells = f"{error_of(path, right):.1e}", f"{1e6 * seconds / COUNT:.1f}", f"{first:.1f}"
            yield [f"`{method}`", f"{steps}", f"{2 * flyby.HALF / steps:.0f}", *cells]
    few = [jax.tree.map(lambda x, n=n: np.asarray(x[n]), starts) for n in range(BY_SCIPY)]
    for tolerance in TOLERANCES:
        began = time.process_time()
        found = np.array([flyby.by_scipy(state, tolerance) for state in few])
        seconds = (time.process_time() - began) / BY_SCIPY
        error = flyby.distance(found[:, 3:], right.states.attitude[:BY_SCIPY]).max()
        yield [f"SciPy's DOP853, {tolerance:.0e}", "", "", f"{error:.1e}", f"{1e6 * seconds:.0f}", ""]


def compared(rows):
    """At the error of each row of SciPy: the fastest row of this package with an error as small."""
    own = [(row[0], row[1], float(row[3]), float(row[4])) for row in rows if not row[0].startswith("SciPy")]
    for row in rows:
        if row[0].startswith("SciPy"):
            fast = [one for one in own if one[2] <= float(row[3])]
            if fast:
                name, steps, error, micro = min(fast, key=lambda one: one[3])
                yield [row[0], row[3], name, steps, f"{error:.1e}", f"{float(row[4]) / micro:.0f}"]


def adaptive(starts, right):
    density = ml.densities.OrbitalDistance(flyby.orbit(), flyby.PERIGEE)

    run = {"density": density, "steps": 1024, "save_every": None, "t0": -flyby.HALF, "t1": flyby.HALF}
    case = ("JACOBI[SRKN6b]", flyby.body(), flyby.torque())
    many = jax.jit(jax.vmap(lambda state, dt: ml.integrate_variable_step(*case, state, dt=dt, **run), (0, None)))
    for dt in DTS:
        path = many(starts, jnp.asarray(dt))
        assert path.ok.all()
        (own,) = in_turn([lambda: many(starts, jnp.asarray(dt))], 4)  # noqa: B023  (called here)
        taken = int(path.taken.max())
        same, constant_seconds, _ = ends("JACOBI[SRKN6b]", taken, starts)
        errors = f"{error_of(path, right):.1e}", f"{error_of(same, right):.1e}"
        yield [f"{dt:.0f}", f"{taken}", *errors, *(f"{1e6 * x / COUNT:.1f}" for x in (own, constant_seconds))]


def outcome(starts, right):
    before, after = (ml.asteroids.tumble(flyby.body(), states) for states in (starts, right.states))
    moved = np.degrees(np.arccos(np.clip(np.sum(np.asarray(before.pole) * np.asarray(after.pole), axis=-1), -1, 1)))
    rate = np.asarray(after.effective_rate / before.effective_rate)
    for what, values in (
        ("pole moves by, degrees", moved),
        ("effective rate after / before", rate),
        ("energy ratio after", np.asarray(after.energy_ratio)),
    ):
        yield [what, *(f"{np.quantile(values, q):.3g}" for q in (0, 0.05, 0.5, 0.95, 1))]
    yield ["pole moves by 10 degrees or more", f"{100 * np.mean(moved >= 10):.0f} %", "", "", "", ""]


TABLES = {
    "ratio": Table(
        *(PAGE, "flyby ratio", ["at the error of", "error, rad", "", "steps", "error, rad", "times faster"]),
        data="flyby-ratio",
        columns=(0, 1, 2, 4, 5),
    ),
    "adaptive": Table(
        *(PAGE, "flyby adaptive"),
        ["dt, s", "steps", "error, rad", "the same number of constant steps", "µs per body", "µs, constant"],
    ),
    "outcome": Table(PAGE, "flyby outcome", ["", "least", "5 %", "50 %", "95 %", "most"]),
}


def whole(options):
    starts = jax.jit(flyby.starts, static_argnums=0)(COUNT)
    right, seconds, first = ends("JACOBI[SRKN6b]", REFERENCE, starts)
    print(f"reference: {seconds:.1f} s, first call {first:.1f} s", flush=True)
    rows = list(constant(starts, right))
    lines = shown(["", "steps", "step, s", "error, rad", "µs per body", "first call, s"], rows)
    if options.write:
        save("flyby-constant-steps", lines)
    TABLES["ratio"].show(options.write, compared(rows))
    TABLES["adaptive"].show(options.write, adaptive(starts, right))
    TABLES["outcome"].show(options.write, outcome(starts, right))


if __name__ == "__main__":
    main(__doc__, whole)
