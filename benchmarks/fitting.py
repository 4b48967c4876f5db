"""Many fits in one call, beside `scipy.optimize.least_squares` around DOP853 on the same data.

    python benchmarks/fitting.py [--fits 1000] [--rivals 5]

Each data set is the tumbling brick's angular velocity at 31 times with noise of 1e-3 of its size; two ratios of moments
and three initial rates are estimated from a guess that is 2 to 5 % off. `fit_arrays` fits all data sets in one vmapped
call. SciPy fits as many as `--rivals` says, one after the other, and its time is scaled to all of them; its runs have a
relative tolerance of 1e-9, and both optimisers stop at 1e-8. The script asserts that both find the same numbers.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

jax.config.update("jax_enable_x64", True)

import midlie_jax as ml  # noqa: E402
from midlie_jax import fitting  # noqa: E402
from midlie_jax.advice.timing import timed  # noqa: E402

MOMENTS = np.array([0.00189422, 0.006211019, 0.007194665])  # NASA NESC check case 2, slug ft^2
RATE = np.deg2rad([10.0, 20.0, 30.0])
TIMES = np.linspace(0.0, 30.0, 31)
NOISE = 1e-3 * np.linalg.norm(RATE)
OFF = MOMENTS * [1.05, 0.97, 1.0]
GUESS = OFF * (MOMENTS.sum() / OFF.sum()), RATE * [1.02, 0.98, 1.01]


def model(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.MomentumState(body.momentum(values["rate"]))


def rates_of(moments, rate):
    """The angular velocities (31, 3) by DOP853."""
    i1, i2, i3 = moments

    def slope(t, w):
        a, b, c = w
        return np.array([(i2 - i3) / i1 * b * c, (i3 - i1) / i2 * c * a, (i1 - i2) / i3 * a * b])

    return solve_ivp(slope, (0, TIMES[-1]), rate, "DOP853", TIMES, rtol=1e-9, atol=1e-12).y.T


def by_scipy(rates):
    """The ratios I1/I3 and I2/I3, and the rates."""

    def residuals(x):
        return ((rates_of((x[0], x[1], 1.0), x[2:]) - rates) / NOISE).ravel()

    start = np.concatenate([GUESS[0][:2] / GUESS[0][2], GUESS[1]])
    return least_squares(residuals, start, x_scale="jac", xtol=1e-8, ftol=1e-8, gtol=1e-8).x


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--fits", type=int, default=1000)
    options.add_argument("--rivals", type=int, default=5)
    chosen = options.parse_args()
    clean = rates_of(MOMENTS, RATE)
    data = clean + NOISE * np.random.default_rng(0).standard_normal((chosen.fits, *clean.shape))
    guess = {"moments": fitting.Moments(GUESS[0], scale="fixed"), "rate": fitting.Free(GUESS[1])}
    plan = fitting.prepare(model, guess, fitting.Rates(TIMES, clean, NOISE), dt=1.0)
    every = jax.vmap(lambda rates: fitting.fit_arrays(plan, guess, fitting.Rates(TIMES, rates, NOISE)))
    began = time.perf_counter()
    compiled = jax.jit(every).lower(jnp.asarray(data)).compile()
    compile_seconds = time.perf_counter() - began
    found = jax.block_until_ready(compiled(jnp.asarray(data)))
    _, timing = timed(lambda: jax.block_until_ready(compiled(jnp.asarray(data))), least=3, most=10, longest=20.0)
    moments = np.asarray(found.values["moments"])
    mine = np.concatenate([moments[:, :2] / moments[:, 2:], np.asarray(found.values["rate"])], axis=1)
    assert np.all(found.ok), f"{np.sum(~np.asarray(found.ok))} fits failed"

    began = time.perf_counter()
    theirs = np.stack([by_scipy(rates) for rates in data[: chosen.rivals]])
    scipy_seconds = (time.perf_counter() - began) / chosen.rivals * chosen.fits
    apart = np.max(np.abs(mine[: chosen.rivals] / theirs - 1))
    assert apart < 1e-5, f"the two programs find numbers {apart:.1e} apart"
    print(f"{chosen.fits} fits of 93 numbers by 5 parameters, on one core where the process has one")
    print(f"  midlie_jax, one vmapped call    {timing.seconds:8.3f} s (compile {compile_seconds:.1f} s, "
          f"most steps {int(np.max(found.steps))}, median {np.median(found.steps):.0f})")  # fmt: skip
    print(f"  scipy.optimize around DOP853    {scipy_seconds:8.1f} s ({chosen.rivals} timed, scaled to {chosen.fits})")
    print(f"  ratio                           {scipy_seconds / timing.seconds:8.0f}; with the compilation "
          f"{scipy_seconds / (timing.seconds + compile_seconds):.0f}")  # fmt: skip
    print(f"  largest relative difference of the estimates {apart:.1e}")


if __name__ == "__main__":
    main()
