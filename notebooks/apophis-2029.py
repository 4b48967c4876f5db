# %% [markdown]
# # Apophis, April 2029: what the Earth does to the way it tumbles
#
# On 13 April 2029 the asteroid Apophis, some 340 m long, passes 38,000 km from the centre of the Earth, nearer than
# the geostationary satellites. It does not spin about one axis: it tumbles. While it is near, the Earth pulls its
# near end more strongly than its far end, and for some hours this torque is strong enough to change the tumbling for
# good.
#
# How it changes depends on how the body happens to lie when it passes, and nobody knows this yet. So we fly thousands
# of bodies past the Earth, see what can come out, and then ask which observations would tell in advance.
#
# The periods are those of light curves (27.374 h and 262.2 h, arXiv 2604.24566). The ratios of the moments of inertia
# are from a model of shape and light curves (P. Pravec and others, Icarus 233 (2014) 48), and uncertain by a tenth;
# the distance and the speed are rounded. The brightnesses below are **simulated**, and so are the directions of the
# Sun and of the observer.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.cli.figures import panel

jax.config.update("jax_enable_x64", True)  # sixteen digits

HOUR, DAY, EARTH = 3600.0, 86400.0, 6.378e6  # seconds, seconds, metres
COLOURS, INK = ("#0072B2", "#D55E00", "#009E73"), "#222222"  # told apart with any kind of colour vision

body = ml.RigidBody([0.61, 0.965, 1.0])  # long, middle and short axis; only the ratios matter here
pole = [-0.3320328728817035, -0.4230418832197608, 0.8430834693954098]  # of the momentum, in the frame of the orbit


def tumbling(part, angle):
    """A start a part of the long period after a given one, and turned about the pole by an angle in radians."""
    return ml.asteroids.tumbling(
        body, precession_period=27.374 * HOUR, rotation_period=262.2 * HOUR, axis="short", mode="short",
        pole=pole, phases=(part, angle),
    )  # fmt: skip


start = tumbling(0.3, 2.0)
before = ml.asteroids.tumble(body, start)
print(f"energy over that of the steady rotation   {before.energy_ratio:.4f}")
print(f"effective period, 2 pi |L| / 2 E          {2 * np.pi / before.effective_rate / HOUR:.2f} h")


# %% [markdown]
# Seen from space, the short axis goes round the momentum in 27.4 h; seen from the body, the momentum goes round the
# short axis in 262 h. `ml.asteroids.tumbling` wants to know whose precession the first period is, and `mode="short"`
# says round which axis the momentum goes: two other motions have such periods, with other energies.
#
# ## The pass
#
# The asteroid comes from far away with 5.84 km/s and goes away as fast: its path is a hyperbola. Space is measured
# along the direction of the perigee, the direction of motion there, and the normal of the orbit.

# %%
mu, perigee = 3.986004418e14, 3.8012e7  # m^3/s^2, m
orbit = ml.orbits.KeplerOrbit.from_elements(
    mu=mu, eccentricity=1 + perigee * 5840.0**2 / mu, periapsis=perigee, time_of_periapsis=0.0,
    inclination=0.0, ascending_node=0.0, argument_of_periapsis=0.0,
)  # fmt: skip
places = np.asarray(jax.vmap(orbit)(jnp.linspace(-6 * HOUR, 6 * HOUR, 241))) / EARTH
marks = np.asarray(jax.vmap(orbit)(HOUR * jnp.arange(-6.0, 6.1, 2.0))) / EARTH

figure, axes = plt.subplots(figsize=(9, 4.2), layout="constrained")
angle = np.linspace(0, 2 * np.pi, 200)
axes.fill(np.cos(angle), np.sin(angle), color=COLOURS[0])
axes.plot(6.611 * np.cos(angle), 6.611 * np.sin(angle), color="#999999", linewidth=1)
axes.annotate("geostationary ring", (4.7, -4.7), (6, -4), textcoords="offset points", color="#777777")
axes.annotate("Earth", (0, -1), (0, -4), textcoords="offset points", ha="center", va="top", color=COLOURS[0])
axes.plot(places[:, 1], places[:, 0], color=COLOURS[1])
axes.plot(marks[:, 1], marks[:, 0], "o", color=COLOURS[1])
for hours, place in zip(range(-6, 7, 2), marks, strict=True):
    axes.annotate(
        f"{hours:+d} h", (place[1], place[0]), (0, 8), textcoords="offset points", ha="center", color=COLOURS[1]
    )
axes.set_aspect("equal")
panel(axes, "Past the Earth", "along the motion at perigee  [Earth radii]", "towards the perigee  [Earth radii]")
plt.show()

# %% [markdown]
# ## One body
#
# `GravityGradient` is the torque of a point mass on a body along an orbit. We begin two days before and end two days
# after; a step of ten minutes is exact to some 1e-9 radians with this method.

# %%
torque = ml.spacecraft.GravityGradient(None, orbit, mu)
METHOD, STEP, SPAN = "JACOBI[SRKN6b]", 600.0, 2 * DAY
path = ml.integrate(METHOD, body, torque, start, dt=STEP, steps=576, t0=-SPAN, save_every=3)
tumble = ml.asteroids.tumble(body, path.states)
hours = np.asarray(path.times) / HOUR

figure, panels = plt.subplots(3, 1, figsize=(9, 7), sharex=True, layout="constrained")
turned = np.degrees(np.arccos(np.clip(np.asarray(tumble.pole) @ np.asarray(pole), -1, 1)))
for axes, values, title, unit in zip(
    panels,
    (tumble.effective_rate / before.effective_rate, tumble.energy_ratio, turned),
    ("Effective rate, over that before", "Energy over that of the steady rotation", "How far the pole has moved"),
    ("", "", "[degrees]"),
    strict=True,
):
    axes.plot(hours, values, color=COLOURS[0])
    axes.axvline(0, color="#bbbbbb", linewidth=1)
    panel(axes, title, "", unit)
panels[-1].set_xlabel("time from the perigee  [h]")
plt.show()
after = jax.tree.map(lambda x: x[-1], tumble)
print(f"effective rate times {after.effective_rate / before.effective_rate:.4f}")
print(f"energy over that of the steady rotation {before.energy_ratio:.4f} -> {after.energy_ratio:.4f}")
print(f"precession of the short axis {before.short_axis_period / HOUR:.1f} h -> {after.short_axis_period / HOUR:.1f} h")
print(f"the pole moved by {turned[-1]:.1f} degrees")

# %% [markdown]
# Everything happens within some six hours. This body comes out turning half as fast again.
#
# ## Four thousand bodies
#
# The two phases at a given time are unknown: light curves give periods to a fraction of a per cent, and years of
# turns are between the observations and the pass. So we take all phases: 80 x 50 of them, in one call.

# %%
parts, angles = np.meshgrid(np.arange(80) / 80, 2 * np.pi * np.arange(50) / 50, indexing="ij")
starts = jax.jit(jax.vmap(tumbling))(parts.ravel(), angles.ravel())
many = ml.ensemble(METHOD, body, torque, starts, dt=STEP, steps=576, t0=-SPAN)
ends = ml.asteroids.tumble(body, many.states)
rate = np.asarray(ends.effective_rate / before.effective_rate).reshape(parts.shape)
moved = np.degrees(np.arccos(np.clip(np.asarray(ends.pole) @ np.asarray(pole), -1, 1))).reshape(parts.shape)
assert np.all(many.ok)

figure, panels = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
for axes, values, title, colours in (
    (panels[0], rate, "Effective rate, over that before", "RdBu_r"),
    (panels[1], moved, "The pole moves by  [degrees]", "viridis"),
):
    limits = {"vmin": 0.4, "vmax": 1.6} if values is rate else {}
    drawn = axes.pcolormesh(parts, np.degrees(angles), values, cmap=colours, shading="nearest", **limits)
    figure.colorbar(drawn, ax=axes, shrink=0.9)
    panel(axes, title, "phase of the rotation  [turns of 262 h]", "")
    axes.grid(False)
panels[0].set_ylabel("angle about the pole  [degrees]")
plt.show()

# %%
low, middle, high = np.percentile(moved, [5, 50, 95])
print(f"the pole moves by {low:.1f}, {middle:.1f}, {high:.1f} degrees at 5, 50 and 95 %")
print(f"by 10 degrees or more in {np.mean(moved >= 10):.0%} of the phases")
print(f"effective rate times {rate.min():.2f} to {rate.max():.2f}")
print(f"energy over that of the steady rotation {np.min(ends.energy_ratio):.3f} to {np.max(ends.energy_ratio):.3f}")

# %% [markdown]
# A published forecast says that the pole likely moves by 10 degrees or more, and that the effective rate could halve
# or double (arXiv 2210.13365). The first is what comes out here. The second is not: with these moments and this pole
# the rate stays between the two numbers above. Other moments and poles within what we could read of their
# uncertainties gave .52 to 1.79.
#
# ## What light says of the moments
#
# A free body's light curve tells the *ratios* of its moments, because they decide how it tumbles. During the pass
# they act a second time: in the torque. So brightness before **and** after, with the pass between, should tell more.
# Ten nights of twenty brightnesses on either side, with 2 % noise:

# %%
SUN, BEFORE, AFTER = ([0.540, 0.841, 0.0], [-0.317, 0.927, 0.199], [0.936, 0.190, -0.296])  # directions, simulated
NOISE, BEGIN = 0.02, -12 * DAY
SUN, BEFORE, AFTER = (np.array(v) / np.linalg.norm(v) for v in (SUN, BEFORE, AFTER))
semi_axes = jnp.array([1.40, 0.90, 0.81])


def brightness(t, state, body, values):
    """An ellipsoid by the law of Lommel and Seeliger; its shape is free, and need not be that of a homogeneous body."""
    earth = jnp.where(t < 0, BEFORE, AFTER)
    return ml.asteroids.EllipsoidBrightness(values["semi_axes"], SUN, lambda t: earth)(t, state)


def model_with(torque):
    def model(values):
        turning = ml.RigidBody(values["moments"])
        momentum = turning.momentum(1e-4 * values["rate"])  # in 1e-4 radians per second
        return turning, torque, ml.RigidState(momentum, values["attitude"])

    return model


back = ml.integrate(METHOD, body, torque, start, dt=-STEP, steps=1440, t0=-SPAN, save_every=None).states
truth = {
    "moments": body.moments,
    "rate": body.velocity(back.momentum) / 1e-4,
    "attitude": back.attitude,
    "semi_axes": semi_axes,
}


def simulated(model, times, seed):
    """Brightnesses with noise, of the true body."""
    states = fitting.states_at("JACOBI[EA]", *model(truth), times, dt=STEP, t0=BEGIN).states
    light = np.asarray(jax.vmap(lambda t, s: brightness(t, s, body, truth))(jnp.asarray(times), states))
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(times))
    return fitting.Observed(times, light * (1 + noise), NOISE * light, brightness)


def nights(first, last, seed):
    """Twenty times in eight hours of each night."""
    rng = np.random.default_rng(seed)
    return np.sort(np.concatenate([DAY * night + rng.uniform(0, 8 * HOUR, 20) for night in range(first, last)]))


def guess_near(values, seed):
    rng = np.random.default_rng(seed)
    off = fitting.UnitQuaternion(ml.so3.multiply(values["attitude"], ml.so3.exp(0.05 * rng.standard_normal(3))))
    return {
        "moments": fitting.Moments(values["moments"] * np.array([1.05, 1.0, 0.97]), scale="fixed"),
        "rate": fitting.Free(values["rate"] * (1 + 0.02 * rng.choice([-1, 1], 3))),
        "attitude": off,
        "semi_axes": fitting.Positive(values["semi_axes"] * (1 + 0.05 * rng.choice([-1, 1], 3))),
    }


def ratios(values):
    return values["moments"][:2] / values["moments"][2]


times = np.concatenate([nights(-12, -2, 1), nights(2, 12, 2)])
past, alone = model_with(torque), model_with(None)
OPTIONS = {"dt": 1200.0, "t0": BEGIN, "absolute_sigma": True, "first_span": 5 * DAY}
campaigns = {
    "before the pass": (past, times[times < 0]),
    "before and after": (past, times),
    "as many nights, without an Earth": (alone, times),
}
for name, (model, at) in campaigns.items():
    found = ml.fit(model, guess_near(truth, 3), simulated(model, at, 4), **OPTIONS)
    values, intervals = found.derived(ratios)
    assert found.ok
    print(f"{name:34s} I1/I3 = {values[0]:.3f} +- {np.ptp(intervals[0]) / 2:.3f}   ", end="")
    print(f"I2/I3 = {values[1]:.4f} +- {np.ptp(intervals[1]) / 2:.4f}")

# %% [markdown]
# The numbers after +- are half of 95 % intervals. The third row is the control: the same nights and noise, but no
# Earth to pull. Most of the gain is that of more nights; beyond it, the pass makes the intervals narrower by the
# quotient of the last two rows.
#
# ## What the observations of 2027 determine
#
# Say that thirty nights, or sixty, of such brightnesses are fitted in April 2027, two years before the pass; or thirty
# nights five months before it. What do they say of April 2029? The fit gives not one body but a cloud of bodies that
# the data allow: `draws`. Each of them moves freely until the pass, in one evaluation, and then past the Earth.


# %%
def before_the_pass(days):
    """The true body so long before the start of the pass: free motion backwards in time."""
    reverse = ml.free_motion(body, ml.RigidState(-start.momentum, start.attitude), [days * DAY]).states
    return {**truth, "rate": -body.velocity(reverse.momentum[0]) / 1e-4, "attitude": reverse.attitude[0]}


def seen(values, count, seed):
    at = nights(0, count, seed)
    states = ml.free_motion(body, alone(values)[2], at).states
    light = np.asarray(jax.vmap(lambda t, s: brightness(t, s, body, values))(jnp.asarray(at), states))
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(at))
    return fitting.Observed(at, light * (1 + noise), NOISE * light, brightness)


def arrival(values, days):
    """The body and its state two days before the perigee."""
    turning, _, begun = alone(values)
    states = ml.free_motion(turning, begun, (days * DAY)[None]).states
    return turning, jax.tree.map(lambda x: x[0], states)


arrivals = jax.jit(jax.vmap(arrival, in_axes=(0, None)))
effective_rates = jax.jit(jax.vmap(lambda turning, state: ml.asteroids.tumble(turning, state).effective_rate))


def rates_after(values, days):
    bodies, arrived = arrivals(values, jnp.asarray(float(days)))
    flown = ml.ensemble(METHOD, bodies, torque, arrived, dt=STEP, steps=576, t0=-SPAN)
    assert np.all(flown.ok)
    return np.asarray(effective_rates(bodies, flown.states) / effective_rates(bodies, arrived))


true_rate = float(after.effective_rate / before.effective_rate)
predicted = {"nothing: all phases alike": rate.ravel()}
for label, count, days in (
    ("30 nights, two years before", 30, 730),
    ("60 nights, two years before", 60, 730),
    ("30 nights, five months before", 30, 150),
):
    there = before_the_pass(days)
    near = guess_near(there, 5)
    found = ml.fit(alone, near, seen(there, count, 6), dt=3 * HOUR, absolute_sigma=True, first_span=5 * DAY)
    assert found.ok
    predicted[label] = rates_after(found.draws(2000, seed=7), days)
for label, values in predicted.items():
    low, high = np.percentile(values, [2.5, 97.5])
    close = np.mean(np.abs(values - true_rate) < 0.1)
    print(f"{label:30s} the rate is multiplied by {low:.2f} to {high:.2f} in 95 %; {close:4.0%} within .1 of the truth")

# %%
figure, axes = plt.subplots(figsize=(9, 4.2), layout="constrained")
bins = np.linspace(0.55, 1.7, 47)
for (label, values), colour in zip(predicted.items(), ("#888888", *COLOURS), strict=True):
    share, _ = np.histogram(values, bins)
    axes.stairs(share / len(values), bins, color=colour, linewidth=2, label=label)
axes.axvline(true_rate, color=INK, linewidth=1)
axes.annotate("the true body", (true_rate, axes.get_ylim()[1]), (-6, -12), textcoords="offset points", ha="right",
              color=INK)  # fmt: skip
axes.legend(frameon=False, loc="upper left", title="known of the tumbling", alignment="left")
panel(axes, "Forecasts of the pass", "effective rate after the pass, over that before", "share of the bodies")
plt.show()

# %% [markdown]
# Two years are 640 turns of the short axis, and a small error of a period becomes a large one of a phase. Thirty nights
# of 2027 leave nearly everything possible. Sixty make the clock finer, and a forecast begins to show. Thirty nights
# five months before the pass tell more than either. Sunlight, which changes the rate a little in two years (YORP), is
# not in this model.
#
# ## What to remember
#
# - A start in the words of light curves: `ml.asteroids.tumbling`; and back: `ml.asteroids.tumble`.
# - Whatever you can write as a function of time, state, body and parameters is a measurement: `fitting.Observed`.
# - A fit says what its data allow, `result.draws(n)`; an ensemble says what follows from it.
#
# More: [orbits](../docs/orbits.md), [surfaces](../docs/surfaces.md), [fitting](../docs/fitting.md), and [the flyby,
# measured](../docs/reports/applications.md#apophis-flyby) beside SciPy.
