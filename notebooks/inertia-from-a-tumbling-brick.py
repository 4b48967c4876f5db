# %% [markdown]
# # The inertia of a tumbling brick, from its gyroscope
#
# A brick tumbles freely in space and a gyroscope fixed in it measures how fast it turns. Can we weigh the brick that
# way? Nearly: the way it tumbles gives away the *ratios* of its moments of inertia, to as many digits as the
# gyroscope has. This page finds them, says how sure they are, and shows what no gyroscope can find.
#
# The data are NASA's: check case 2 of the NESC six-degree-of-freedom comparison, a brick without any torque, computed
# by one of the simulation programs that took part. Thirteen of its 301 rows are quoted below, one for every 2.5
# seconds. They are free of noise. Where this page adds noise, it says so.
#
# Throughout, a vector has its components along the three edges of the brick (the body frame), and $\Omega_1,
# \Omega_2, \Omega_3$ are the components of its angular velocity. The brick's moments of inertia about these edges are
# $I_1$, $I_2$ and $I_3$, in slug ft² (1 slug ft² = 1.356 kg m²).

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.cli.figures import panel

jax.config.update("jax_enable_x64", True)  # sixteen digits

times = np.arange(0.0, 30.1, 2.5)  # seconds
degrees = np.array([  # Ω1, Ω2, Ω3 in degrees per second
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
])  # fmt: skip
rates = np.deg2rad(degrees)  # the library works in radians
published = np.array([0.00189422, 0.006211019, 0.007194665])  # slug ft^2, with which NASA's rows were computed

# %% [markdown]
# ## A first look
#
# With no torque one might expect steady turning. But the brick wobbles: $\Omega_1$ and $\Omega_2$ swing from side to
# side, a quarter of a period apart, and $\Omega_3$ trembles twice as fast. Only the differences between the three
# moments can make it do so.

# %%
COLOURS, INK = ("#0072B2", "#D55E00", "#009E73"), "#222222"  # told apart with any kind of colour vision


def dots(axes, values):
    for i in range(3):
        axes.plot(times, values[:, i], "o", color=COLOURS[i], markersize=5)
        axes.annotate(f"$\\Omega_{i + 1}$", (30.0, values[-1, i]), (8, 0), textcoords="offset points",
                      color=COLOURS[i], fontsize=13, va="center")  # fmt: skip


figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
dots(axes, degrees)
panel(axes, "The published rates", "time  [s]", "angular velocity, body frame  [deg/s]")
plt.show()

# %% [markdown]
# ## The fit
#
# A *model* takes the values of the unknowns and returns a body, the torque on it (none here), and its start. The
# *guess* says which unknowns there are and where the search begins. `Moments` keeps to the moments of bodies that
# exist: each positive, none larger than the sum of the other two. With `scale="fixed"` their sum stays that of the
# guess, for a reason that comes below. We guess moments of a wrong shape, with ratios that are 3 to 8 % off, and
# start from the first row of rates, 1 to 2 % off.


# %%
def model(values):
    body = ml.RigidBody(values["moments"])
    return body, None, ml.MomentumState(body.momentum(values["rate"]))


wrong = published * [1.05, 0.97, 1.0]
wrong = wrong * (published.sum() / wrong.sum())
guess = {
    "moments": fitting.Moments(wrong, scale="fixed"),
    "rate": fitting.Free(rates[0] * [1.02, 0.98, 1.01]),  # at time 0, radians per second
}
clean = ml.fit(model, guess, fitting.Rates(times, rates, sigma=np.deg2rad(1e-6)), dt=1.25)
print(clean)

# %% [markdown]
# The moments are those with which NASA's program computed the rows:

# %%
for name, found, true in zip(("I1", "I2", "I3"), clean.values["moments"], published, strict=True):
    print(f"{name}   published {true:.9f}   fitted {found:.12f}   difference {found - true:+.1e}  slug ft^2")


# %%
def fitted_motion(result, at):
    """Angular velocity (n, 3) of the fitted brick in degrees per second."""
    body, _, start = model(result.values)
    return np.rad2deg(ml.observe.angular_velocity(body, ml.free_motion(body, start, at).states))


def picture(result, values, title, unit, factor):
    fine = np.linspace(0, 30, 600)
    _, (above, below) = plt.subplots(2, 1, figsize=(9, 6), height_ratios=(2, 1), sharex=True, layout="constrained")
    dots(above, values)
    curves, left = fitted_motion(result, fine), values - fitted_motion(result, times)
    for i in range(3):
        above.plot(fine, curves[:, i], color=COLOURS[i], linewidth=1.2)
        below.plot(times + 0.2 * (i - 1), left[:, i] * factor, "o", color=COLOURS[i], markersize=4)
    below.axhline(0, color=INK, linewidth=0.8)
    panel(above, title, "", "angular velocity  [deg/s]")
    panel(below, "What the fit leaves: data minus curve", "time  [s]", f"[{unit}]")
    plt.show()


picture(clean, degrees, "Published rates (dots) and the fitted brick (curves)", "1e-12 deg/s", 1e12)

# %% [markdown]
# Between the dots, 2.5 s apart, nothing was measured: the curves there are the laws of motion. What the fit leaves is
# less than 1e-10 of a degree per second: the last of the digits that were published.
#
# ## What cannot be found
#
# Why was the sum of the moments fixed? A brick of lead and a brick of wood of the same shape tumble alike, since with
# no torque the mass drops out of the equations of motion. Ask for all three moments, and the fit refuses:

# %%
try:
    everything = guess | {"moments": fitting.Moments(wrong)}
    ml.fit(model, everything, fitting.Rates(times, rates, sigma=np.deg2rad(1e-6)), dt=1.25)
except ValueError as error:
    print(error)

# %% [markdown]
# It does not guess this from the absence of a torque: it looks at how each unknown changes the rates, and finds a
# direction in which nothing changes. The same in a picture: multiply all moments by one factor, and the disagreement
# with the data does not move. Multiply $I_1$ alone, and it shoots up.


# %%
def disagreement(moments):
    """Root mean square of model minus data over the thirteen rows, in degrees per second."""
    body = ml.RigidBody(moments)
    start = ml.MomentumState(body.momentum(jnp.asarray(rates[0])))
    rows = ml.observe.angular_velocity(body, ml.free_motion(body, start, times).states)
    return jnp.rad2deg(jnp.sqrt(jnp.mean((rows - rates) ** 2)))


factors = np.linspace(0.9, 1.1, 81)
together = jax.vmap(lambda f: disagreement(f * published))(factors)
alone = jax.vmap(lambda f: disagreement(published * jnp.stack([f, jnp.ones_like(f), jnp.ones_like(f)])))(factors)
figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
axes.plot(factors, alone, color=COLOURS[1])
axes.plot(factors, together, color=COLOURS[0])
axes.annotate(
    "$I_1$ alone", (factors[12], alone[12]), (10, 4), textcoords="offset points", color=COLOURS[1], fontsize=12
)
axes.annotate("all three together", (factors[8], 0), (0, 8), textcoords="offset points", color=COLOURS[0], fontsize=12)
panel(axes, "Disagreement with the data", "factor on the moments", "root mean square  [deg/s]")
plt.show()

# %% [markdown]
# To find the scale as well, something must act on the brick whose strength you know: a torque, or a wheel inside it.
#
# ## Noise
#
# A real gyroscope is not that good. Here the published rates get **simulated** noise: normal, independent in each
# number, with a standard deviation of 0.04 deg/s, a thousandth of the speed of the brick. The fit is told this
# *sigma*.

# %%
sigma = 1e-3 * np.linalg.norm(rates[0])
noise = sigma * np.random.default_rng(4).standard_normal((1000, *rates.shape))
noisy = ml.fit(model, guess, fitting.Rates(times, rates + noise[0], sigma), dt=1.25)
print(noisy)
picture(noisy, np.rad2deg(rates + noise[0]), "Rates with simulated noise, and the fitted brick", "deg/s", 1.0)

# %% [markdown]
# The residuals look like the noise: no trend, no wave, and as large as sigma (the table's "rms of residuals / sigma"
# is near 1). That is the check that the model is right. A wave in this picture would say that something is missing
# from it.
#
# Each number now has a 95 % interval. So has everything that follows from the numbers, such as a ratio; `derived`
# takes into account that the errors of the moments go together:

# %%
ratio, (low, high) = noisy.derived(lambda values: values["moments"][0] / values["moments"][2])
true_ratio = published[0] / published[2]
print(f"I1/I3   published {true_ratio:.5f}   fitted {ratio:.5f}   95 % interval {low:.5f} to {high:.5f}")

# %% [markdown]
# ## Do the intervals keep their promise?
#
# "95 %" means: repeat the experiment many times, and 95 of 100 intervals hold the truth. So let us repeat it a
# thousand times, each with simulated noise of its own. `fit_arrays` is the fit as a pure function; `jax.vmap` makes
# it a thousand fits, and `jax.jit` one program.

# %%
plan = fitting.prepare(model, guess, fitting.Rates(times, rates, sigma), dt=1.25)


def one_experiment(values):
    found = fitting.fit_arrays(plan, guess, fitting.Rates(times, values, sigma))
    moments = found.values["moments"]
    return moments[0] / moments[2], moments, found.intervals[:3], found.ok


ratios, moments, intervals, ok = jax.jit(jax.vmap(one_experiment))(rates + noise)
held = np.mean((intervals[:, :, 0] <= published) & (published <= intervals[:, :, 1]), axis=0)
print(f"{int(np.sum(ok))} of 1000 fits converged")
for name, share in zip(("I1", "I2", "I3"), held, strict=True):
    print(f"the interval of {name} holds the published moment in {share:.1%} of them")

# %%
figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
axes.hist(np.asarray(ratios), bins=40, color=COLOURS[0], alpha=0.6)
top = axes.get_ylim()[1]
axes.axvline(true_ratio, color=INK)
axes.annotate("published", (true_ratio, 1.3 * top), (6, -14), textcoords="offset points", color=INK)
axes.plot([low, high], [1.05 * top] * 2, color=COLOURS[1], linewidth=4, solid_capstyle="butt")
axes.annotate("95 % interval of the one fit above", ((low + high) / 2, 1.05 * top), (0, 6), textcoords="offset points",
              color=COLOURS[1], ha="center")  # fmt: skip
axes.set_ylim(0, 1.3 * top)
panel(axes, "The ratio of moments in 1000 simulated experiments", "$I_1 / I_3$", "fits")
plt.show()

# %% [markdown]
# The estimates scatter about the published ratio, and the one interval from the single noisy experiment is as wide as
# this scatter: the thousand experiments confirm what one fit said about itself.
#
# ## What to remember
#
# - Rates of a free body give the ratios of its moments, and nothing gives more without a known torque.
# - The fit tells you what cannot be found, by name, instead of returning a number.
# - Look at the residuals before you believe the intervals.
#
# More: [the page on fitting](../docs/fitting.md) has other instruments, forced bodies, and hard problems; the command
# `midlie fit DATA.csv` does the first half of this page for a file of your own.
