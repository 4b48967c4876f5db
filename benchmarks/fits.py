"""Fits: to published rates, of light curves, and a thousand in one call; docs/reports/applications.md.

    python benchmarks/fits.py published [--write]                each estimate beside the published number
    python benchmarks/fits.py light-curves [--write]             a tumbling ellipsoid from its light curve, twenty times
    python benchmarks/fits.py many [--fits 1000] [--rivals 5]    many fits in one call, beside SciPy around DOP853
    python benchmarks/fits.py search                             starts per second of a search over ranges

Light curves: 500 brightnesses with 1 % noise at random times in 60 hours, about ten turns. Unknown are the ratios of
the moments, the rate and the attitude at the start, and the three semi-axes: eleven numbers. The start of each fit is
10 % off in the ratios of the moments, in all three rates and in the semi-axes, and by 0.3 rad about a random axis.

Many fits: each data set is the tumbling brick's angular velocity at 31 times with noise of 1e-3 of its size; two ratios
of moments and three initial rates are estimated from a guess that is 2 to 5 % off. `fit_arrays` fits all data sets in
one vmapped call. SciPy fits as many as `--rivals` says, one after the other, and its time is scaled to all of them; its
runs have a relative tolerance of 1e-9, and both optimisers stop at 1e-8. Both must find the same numbers.
"""

import math
import sys
import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import ROOT, Table, in_turn, link, main, part, put, save, shown
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.cli import scenes
from midlie_jax.fitting.parameters import Layout
from midlie_jax.fitting.search import minima_of, starts_over

# ---- published rates ----
#
# The tumbling brick of NASA's NESC (check case 2, simulation 1) is a free body: thirteen rows of its rates. The
# satellite of NASA's JEOD (verification case RUN_10A) turns in the gravity gradient of the Earth on a known orbit, from
# a known attitude: only its rates at the start and after 28,800 s are published. All rates are in the body frame.

PAGE = "reports/applications.md"
BRICK = np.array([0.00189422, 0.006211019, 0.007194665])  # slug ft^2
BRICK_TIMES = np.arange(0.0, 30.1, 2.5)  # seconds
BRICK_RATES = np.deg2rad(
    [
        (9.99999999996, 20, 29.9999999999),
        (-4.74028105465, 22.9654461294, 28.4678763351),
        (-16.9394851494, 9.63193937744, 33.4066280794),
        (-15.6333789317, -12.7550023251, 32.6626195391),
        (-2.41890222178, -23.5525695195, 28.12859263),
        (12.0432574252, -18.0549594639, 30.8551539978),
        (18.4372543136, 2.38688029891, 34.3107056116),
        (9.36648383982, 20.4978715829, 29.7627968788),
        (-5.42273467989, 22.7159305765, 28.6082817472),
        (-17.2600824195, 8.64613424581, 33.595702754),
        (-15.1840887012, -13.6177995003, 32.4167961984),
        (-1.72453974837, -23.652730324, 28.0694406586),
        (12.6183907757, -17.3974747618, 31.1195888868),
    ]
)
NOISE = 1e-3 * np.linalg.norm(BRICK_RATES[0])

SATELLITE = np.array([500.0, 12250.0, 12250.0])  # kg m^2
SATELLITE_TIMES = np.array([0.0, 28800.0])  # seconds
SATELLITE_RATES = np.array(  # rad/s
    [
        (-1.97989570839746e-5, -0.001134281491669957, 0.0),
        (-1.97989570839746e-5, -0.001080027400090759, -0.0007098670173048437),
    ]
)
KNOWN_TO = 2.3e-13  # rad/s, to which an independent computation agrees with the published rates at the end
METHOD = "RK4"
BRICK_STEP = 2.5 / 100


def free(values: Any) -> Any:
    body = ml.RigidBody(values["moments"])
    return body, None, ml.MomentumState(body.momentum(values["rate"]))


def brick_guess() -> dict[str, Any]:
    """Moments in other ratios by 3 to 8 %, with the published sum; rates off by 2 %."""
    moments = BRICK * [1.05, 0.97, 1.0]
    moments = moments * (BRICK.sum() / moments.sum())
    return {
        "moments": fitting.Moments(moments, scale="fixed"),
        "rate": fitting.Free(BRICK_RATES[0] * [1.02, 0.98, 1.01]),
    }


def brick_data(rates: Any = BRICK_RATES) -> fitting.Rates:
    return fitting.Rates(BRICK_TIMES, rates, NOISE)


def fitted_brick() -> Any:
    return ml.fit(free, brick_guess(), brick_data(), method=METHOD, dt=BRICK_STEP)


def satellite(values: Any) -> Any:
    scene: Any = scenes.scene("gravity-gradient")
    body = ml.RigidBody(values["moments"])
    torque = ml.spacecraft.GravityGradient(None, scene.torque.orbit, scene.torque.mu)
    rate = values.get("rate", jnp.asarray(SATELLITE_RATES[0]))
    return body, torque, ml.RigidState(body.momentum(rate), scene.start.attitude)


def satellite_data() -> fitting.Rates:
    return fitting.Rates(SATELLITE_TIMES, SATELLITE_RATES, KNOWN_TO)


def fitted_satellite() -> Any:
    """The first moment of the guess is a fifth too large, and the published sum of the moments is kept."""
    guess = {
        "moments": fitting.Moments([600.0, 12200.0, 12200.0], scale="fixed"),
        "rate": fitting.Free(SATELLITE_RATES[0]),
    }
    return ml.fit(satellite, guess, satellite_data(), method=METHOD, dt=5.0, absolute_sigma=True)


def satellite_without_scale() -> Any:
    """The same with all three moments free, which the data do not determine; the rates at the start are known."""
    guess = {"moments": fitting.Moments([600.0, 12200.0, 12200.0])}
    options: Any = {"method": METHOD, "dt": 5.0, "absolute_sigma": True, "require_rank": False}
    return ml.fit(satellite, guess, satellite_data(), **options)


def ratios(values: Any) -> Any:
    return values["moments"][:2] / values["moments"][2]


def quantities(label: str, result: Any, published: Any, unit: str) -> Iterator[tuple[str, str, Any, Any, Any]]:
    moments, rate = published
    values, intervals = result.derived(ratios)
    for i, name in enumerate(("I1/I3", "I2/I3")):
        yield label, name, moments[i] / moments[2], values[i], np.ptp(intervals[i]) / 2
    values, intervals = result.derived(lambda v: v["rate"])
    for i in range(3):
        yield label, f"Ω{i + 1} at the start, {unit}", rate[i], values[i], np.ptp(intervals[i]) / 2


def published_rows() -> Iterator[list[str]]:
    brick, other = fitted_brick(), fitted_satellite()
    assert brick.ok
    assert other.ok
    for label, name, published, found, half in [
        *quantities("brick", brick, (BRICK, np.deg2rad([10.0, 20.0, 30.0])), "rad/s"),
        *quantities("satellite", other, (SATELLITE, SATELLITE_RATES[0]), "rad/s"),
    ]:
        digits = 1 - math.floor(math.log10(half))
        shown = f"{round(float(found), digits) + 0.0:.{digits}f}"  # no zero with a sign
        yield [label, name, f"{published:.12g}", shown, f"{half:.1e}"]


PUBLISHED = Table(
    *(PAGE, "published fits"),
    ("body", "quantity", "published", "fitted", "half of the 95 % interval"),
    *(published_rows, "published-fits", lambda row: row[1] in ("I1/I3", "I2/I3")),
)


def published(options: Any) -> None:
    PUBLISHED.show(options.write)
    print(satellite_without_scale())


# ---- light curves ----

SETS, STARTS, BY_SCIPY = 20, 4, 5
POINTS, HOURS, LIGHT_NOISE, DT = 500, 60.0, 0.01, 0.5
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
    angle = 0.4 + 0.5 * t / HOURS
    return jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)])


def brightness(t, state, body, values):
    del body
    return ml.asteroids.EllipsoidBrightness(values["semi_axes"], SUN, observer)(t, state)


def model(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.RigidState(body.momentum(values["rate"]), values["attitude"])


def data(rng):
    times = np.sort(rng.uniform(0, HOURS, POINTS))
    body, _, start = model(jax.tree.map(jnp.asarray, TRUTH))
    states = ml.free_motion(body, start, times).states
    light = np.asarray(jax.vmap(lambda t, s: brightness(t, s, body, TRUTH))(jnp.asarray(times), states))
    return fitting.Observed(
        times, light * (1 + LIGHT_NOISE * rng.standard_normal(POINTS)), LIGHT_NOISE * light, brightness
    )


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
    found = ml.asteroids.tumble(body, start)
    pole = ml.observe.spatial_momentum(start) / found.momentum
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
    """The sum of squares that SciPy's trust region reaches around the same compiled model, and the seconds."""
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


def light_curves(options):
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
        save("light-curves", lines)
        key = part(lines, lambda row: row[0].startswith(("I1", "I2", "precession", "rotation")))
        put("reports/applications.md", "light curves", [*key, "", link("light-curves"), "", *fits])


# ---- many fits ----

RATE = np.deg2rad([10.0, 20.0, 30.0])
TIMES = np.linspace(0.0, 30.0, 31)
SPREAD = 1e-3 * np.linalg.norm(RATE)
OFF = BRICK * [1.05, 0.97, 1.0]
GUESS = OFF * (BRICK.sum() / OFF.sum()), RATE * [1.02, 0.98, 1.01]


def rates_of(moments, rate):
    i1, i2, i3 = moments

    def slope(t, w):
        a, b, c = w
        return np.array([(i2 - i3) / i1 * b * c, (i3 - i1) / i2 * c * a, (i1 - i2) / i3 * a * b])

    return solve_ivp(slope, (0, TIMES[-1]), rate, "DOP853", TIMES, rtol=1e-9, atol=1e-12).y.T


def rates_by_scipy(rates):
    def residuals(x):
        return ((rates_of((x[0], x[1], 1.0), x[2:]) - rates) / SPREAD).ravel()

    start = np.concatenate([GUESS[0][:2] / GUESS[0][2], GUESS[1]])
    return least_squares(residuals, start, x_scale="jac", xtol=1e-8, ftol=1e-8, gtol=1e-8).x


def many(options):
    clean = rates_of(BRICK, RATE)
    data = clean + SPREAD * np.random.default_rng(0).standard_normal((options.fits, *clean.shape))
    first = {"moments": fitting.Moments(GUESS[0], scale="fixed"), "rate": fitting.Free(GUESS[1])}
    plan = fitting.prepare(free, first, fitting.Rates(TIMES, clean, SPREAD), dt=1.0)
    every = jax.vmap(lambda rates: fitting.fit_arrays(plan, first, fitting.Rates(TIMES, rates, SPREAD)))
    began = time.perf_counter()
    compiled = jax.jit(every).lower(jnp.asarray(data)).compile()
    compile_seconds = time.perf_counter() - began
    found = jax.block_until_ready(compiled(jnp.asarray(data)))
    (seconds,) = in_turn([lambda: compiled(jnp.asarray(data))], 3, 10, longest=20.0)
    moments = np.asarray(found.values["moments"])
    mine = np.concatenate([moments[:, :2] / moments[:, 2:], np.asarray(found.values["rate"])], axis=1)
    assert np.all(found.ok), f"{np.sum(~np.asarray(found.ok))} fits failed"

    began = time.perf_counter()
    theirs = np.stack([rates_by_scipy(rates) for rates in data[: options.rivals]])
    scipy_seconds = (time.perf_counter() - began) / options.rivals * options.fits
    apart = np.max(np.abs(mine[: options.rivals] / theirs - 1))
    assert apart < 1e-5, f"the two programs find numbers {apart:.1e} apart"
    print(f"{options.fits} fits of 93 numbers by 5 parameters, on one core")
    print(f"  midlie_jax, one vmapped call    {seconds:8.3f} s (compile {compile_seconds:.1f} s, "
          f"most steps {int(np.max(found.steps))}, median {np.median(found.steps):.0f})")  # fmt: skip
    print(
        f"  scipy.optimize around DOP853    {scipy_seconds:8.1f} s ({options.rivals} timed, scaled to {options.fits})"
    )
    print(f"  ratio                           {scipy_seconds / seconds:8.0f}; with the compilation "
          f"{scipy_seconds / (seconds + compile_seconds):.0f}")  # fmt: skip
    print(f"  largest relative difference of the estimates {apart:.1e}")


# ---- a search over ranges: starts per second, on one core without compilation ----
#
# The scene is the one of tests/photometry_scene.py, made by NumPy and SciPy alone: eight nights and sparse values, nine
# zero points, 2 % noise, 3 % outliers. 19 numbers are unknown, and ranges are 30 %. A published search of this kind
# took 3.2 h for 1e5 starts of nine unknowns.

SEARCH_STARTS, SEEDS, SPAN, PUBLISHED_SPEED = 512, (1, 2), 56.0, 1e5 / (3.2 * 3600)
SEARCH_GUESS = {
    "moments": fitting.Moments([0.5, 0.9, 1.0], scale="fixed"),
    "precession": fitting.Positive(7.9),
    "rotation": fitting.Positive(46.0),
    "pole": fitting.UnitVector([0.0, 0.0, 1.0]),
    "phases": fitting.Periodic([0.0, 0.0], period=[1.0, 2 * np.pi]),
    "axes": fitting.Positive([1.4, 1.1]),
}
RANGES = {"precession": 0.3, "rotation": 0.3, "moments": 0.3, "axes": 0.3, "pole": "all", "phases": "all"}


def tumbling(values):
    body, (s, phi) = ml.RigidBody(values["moments"]), values["phases"]
    return body, None, ml.asteroids.tumbling(
        body, precession_period=values["precession"], rotation_period=values["rotation"], axis="short",
        pole=values["pole"], phases=(s, phi), mode="short",
    )  # fmt: skip


def light(values, sun, observer):
    return ml.asteroids.EllipsoidBrightness(jnp.append(values["axes"], 0.85), sun, observer)


def searches():
    sys.path.insert(0, str(ROOT / "tests"))
    import photometry_scene

    for seed in SEEDS:
        scene = photometry_scene.scene(seed)
        given = {name: scene[name] for name in ("sun", "observer", "night", "light_time")}
        seen = ml.asteroids.Photometry(scene["times"], scene["values"], photometry_scene.SIGMA, light, **given)
        plan = fitting.prepare(tumbling, SEARCH_GUESS, seen, method="free_motion", t0=250.0, loss="huber")
        layout = Layout(SEARCH_GUESS)

        def run(count, layout=layout, plan=plan, seen=seen):
            drawn = starts_over(layout, RANGES, count, 0)
            began = time.process_time()
            found = minima_of(plan.problem, layout, (seen,), drawn, SPAN, progress=False)
            return time.process_time() - began, found

        run(64)  # compiles
        seconds, minima = run(SEARCH_STARTS)
        best = minima[0].values
        errors = [
            abs(float(best[name]) / truth - 1)
            for name, truth in zip(("precession", "rotation"), photometry_scene.PERIODS, strict=True)
        ]
        yield (
            str(seed), str(SEARCH_STARTS), f"{seconds:.0f}", f"{SEARCH_STARTS / seconds:.1f}",
            f"{SEARCH_STARTS / seconds / PUBLISHED_SPEED:.1f}",
            f"{errors[0]:.1e}, {errors[1]:.1e}", f"{minima[0].chi_squared:.0f}",
        )  # fmt: skip


SEARCH_HEADS = (
    "noise seed", "starts", "seconds", "starts per second", "relative to the published search",
    "relative errors of the periods", "least chi-squared",
)  # fmt: skip
SEARCH = Table("", "", SEARCH_HEADS, searches)

ARGUMENTS = {"--fits": {"type": int, "default": 1000}, "--rivals": {"type": int, "default": 5}}

if __name__ == "__main__":
    main(__doc__, {"published": published, "light-curves": light_curves, "many": many, "search": SEARCH}, ARGUMENTS)
