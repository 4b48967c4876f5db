"""A tumbling ellipsoid from its light curve, twenty times: put into docs/reports/applications.md.

    python benchmarks/light_curves.py [--write]

500 brightnesses with 1 % noise at random times in 60 hours, about ten turns. Unknown are the ratios of the moments, the
rate and the attitude at the start, and the three semi-axes: eleven numbers. The start of each fit is 10 % off in the
ratios of the moments, in all three rates and in the semi-axes, and by .3 rad about a random axis.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from pages import link, part, put, save, shown  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

import midlie_jax as ml  # noqa: E402
from midlie_jax import fitting, observe  # noqa: E402
from midlie_jax.fitting.parameters import Layout  # noqa: E402

PAGE = "reports/applications.md"
BEGIN, END = "<!-- light curves -->", "<!-- /light curves -->"
SETS, STARTS, BY_SCIPY = 20, 4, 5
POINTS, HOURS, NOISE, DT = 500, 60.0, 0.01, 0.5
MOMENTS = np.array([0.61, 0.965, 1.0])
SEMI_AXES = np.array([1.3, 0.95, 0.81])
TRUTH = {
    "moments": MOMENTS,
    "rate": np.array([0.30, 0.35, 0.9]),  # radians an hour
    "attitude": np.asarray(ml.so3.exp(jnp.array([0.4, -0.7, 1.1]))),
    "semi_axes": SEMI_AXES,
}
SUN = np.array([1.0, 0.0, 0.0])
OPTIONS = {"dt": DT, "absolute_sigma": True, "first_span": 10.0}


def observer(t):
    """The direction of the Earth, which goes from 23 to 52 degrees from that of the Sun."""
    angle = 0.4 + 0.5 * t / HOURS
    return jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)])


def brightness(t, state, body, values):
    del body
    return observe.EllipsoidBrightness(values["semi_axes"], SUN, observer)(t, state)


def model(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.RigidState(body.momentum(values["rate"]), values["attitude"])


def data(rng):
    """One light curve with its noise."""
    times = np.sort(rng.uniform(0, HOURS, POINTS))
    body, _, start = model(jax.tree.map(jnp.asarray, TRUTH))
    states = ml.free_motion(body, start, times).states
    light = np.asarray(jax.vmap(lambda t, s: brightness(t, s, body, TRUTH))(jnp.asarray(times), states))
    return fitting.Observed(times, light * (1 + NOISE * rng.standard_normal(POINTS)), NOISE * light, brightness)


def guess(rng):
    def off(share):
        return 1 + share * rng.choice([-1, 1], 3)

    turn = rng.standard_normal(3)
    attitude = ml.so3.multiply(TRUTH["attitude"], ml.so3.exp(jnp.asarray(0.3 * turn / np.linalg.norm(turn))))
    ratios = MOMENTS * np.array([1 + 0.1 * rng.choice([-1, 1]), 1.0, 1.0])
    return {
        "moments": fitting.Moments(ratios, scale="fixed"),
        "rate": fitting.Free(TRUTH["rate"] * off(0.1)),
        "attitude": fitting.UnitQuaternion(attitude),
        "semi_axes": fitting.Positive(SEMI_AXES * off(0.1)),
    }


def words(values):
    """Ratios of the moments and of the semi-axes, both periods, pole and phases."""
    body, _, start = model(values)
    found = ml.tumble(body, start)
    pole = ml.spatial_momentum(start) / found.momentum
    return {
        "I1/I3": values["moments"][0] / values["moments"][2],
        "I2/I3": values["moments"][1] / values["moments"][2],
        "precession period of the short axis, h": found.short_axis_period,
        "rotation period, h": found.rotation_period,
        "phase of the rotation, turns": found.phases[0],
        "phase of the precession, radians": found.phases[1],
        "pole, x": pole[0],
        "pole, y": pole[1],
        "b/a": values["semi_axes"][1] / values["semi_axes"][0],
        "c/a": values["semi_axes"][2] / values["semi_axes"][0],
    }


def by_scipy(measured, start):
    """The sum of squares that SciPy's trust region reaches around the same compiled model, and the seconds.

    Its Jacobian is by differences, its unknowns are scaled by it, its tolerance is the default; start and spans of time
    are the same.
    """
    layout = Layout(start)

    @jax.jit
    def residuals(vector, span):
        values = layout.values(vector)
        states = fitting.states_at("JACOBI[EA]", *model(values), measured.times, dt=DT).states
        found = measured.residuals(values, model(values)[0], states)
        return jnp.where(measured.times <= span, found, jnp.zeros_like(found))

    vector, span = np.asarray(layout.start()), OPTIONS["first_span"]
    residuals(vector, span)  # compiles
    began = time.perf_counter()
    while True:
        solution = least_squares(lambda x, end=span: np.asarray(residuals(x, end)), vector, x_scale="jac")
        vector = solution.x
        if span >= HOURS:
            return 2 * solution.cost, time.perf_counter() - began
        span *= 2


def study():
    """Of each data set: the words' values and intervals, sums of squares, and seconds of a fit by both."""
    for number in range(SETS):
        rng = np.random.default_rng(number)
        measured, start = data(rng), guess(rng)
        began = time.perf_counter()
        found = ml.fit(model, start, measured, starts=STARTS, seed=number, **OPTIONS)
        taken = time.perf_counter() - began
        began = time.perf_counter()
        one = ml.fit(model, start, measured, **OPTIONS)
        alone = time.perf_counter() - began
        least, others = by_scipy(measured, start) if number < BY_SCIPY else (np.nan, np.nan)
        assert found.ok
        sums = [r.rms**2 * POINTS for r in (found, one)]
        yield found.derived(stacked), (*sums, least), (taken, alone, others)


def stacked(values):
    return jnp.stack(list(words(values).values()))


def write(intervals, fits):
    """Writes all intervals to a data file; moments, periods and the table of fits go into the page."""
    save("light-curves", intervals)
    key = part(intervals, lambda row: row[0].startswith(("I1", "I2", "precession", "rotation")))
    put(PAGE, BEGIN, END, [*key, "", link("light-curves"), "", *fits])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"put the tables into docs/{PAGE}")
    options = parser.parse_args()
    truth = words(jax.tree.map(jnp.asarray, TRUTH))
    true = np.array(list(truth.values()))
    found, sums, seconds = zip(*study(), strict=True)
    intervals = np.array([interval for (_, interval) in found])
    held = np.sum((intervals[..., 0] <= true) & (true <= intervals[..., 1]), axis=0)
    halves = np.median(np.ptp(intervals, axis=-1), axis=0) / 2
    rows = [
        (name, f"{value:.4g}", f"{half:.1g}", f"{count} of {SETS}")
        for name, value, half, count in zip(truth, true, halves, held, strict=True)
    ]
    lines = shown(("quantity", "truth", "half of the 95 % interval", "intervals that hold it"), rows)
    print()
    sums, seconds = np.array(sums), np.array(seconds)
    best = np.sum(sums <= np.nanmin(sums, axis=1, keepdims=True) * (1 + 1e-6), axis=0)
    names = (f"`ml.fit`, {STARTS} starts", "`ml.fit`, one start", "`scipy.optimize.least_squares`, one start")
    times = np.nanmedian(seconds, axis=0)
    rows = [
        (name, f"{count} of {tried}", f"{taken:.2g}", f"{taken / times[1]:.2g}")
        for name, count, tried, taken in zip(names, best, (SETS, SETS, BY_SCIPY), times, strict=True)
    ]
    heads = ("fit", "reaches least sum of squares", "seconds, median", "relative to `ml.fit`, one start")
    fits = shown(heads, rows)
    if options.write:
        write(lines, fits)


if __name__ == "__main__":
    main()
