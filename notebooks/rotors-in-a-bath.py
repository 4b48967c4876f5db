# %% [markdown]
# # Rotors in a bath
#
# A speck of dust in a gas, a molecule in a liquid, a glass dumbbell in a laser trap: the world around them brakes them
# and shakes them, by equal laws, and so gives them a temperature. Here are such bodies by the thousand, and what one
# measures of them: averages, correlations, a spectrum. Energies are in units of kT unless a cell says otherwise.

# %%
import jax

jax.config.update("jax_enable_x64", True)  # sixteen digits

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import midlie_jax as ml
from midlie_jax.cli.figures import panel

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8a8a8a"
plt.rcParams["figure.dpi"] = 80
kT = 1.0


def keys(count, seed=0):
    return jax.random.split(jax.random.key(seed), count)  # a key for each body


def at_rest(count):
    return ml.RigidState(jnp.zeros((count, 3)), jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (count, 1)))


# %% [markdown]
# ## Warming up
#
# A bath is an argument of a run, `ml.baths.Langevin`: the temperature, the friction (torque per angular velocity) and
# a random key. It needs a method whose step has a stage for it. `BAOAB` is such a scheme: kick (B), flight (A), bath
# (O), flight, kick. Here are four thousand free bricks that start at rest. Each axis ends with half a kT, whatever its
# moment is, and after the time t it has the share 1 - exp(-2 G t/I) of it. The brick tumbles, which mixes the axes.

# %%
moments = jnp.array([1.0, 2.0, 2.5])
brick, many = ml.RigidBody(moments), 4096
bath = ml.baths.Langevin(kT, friction=0.5, key=keys(many))
warming = ml.ensemble("JACOBI[BAOAB]", brick, None, at_rest(many), dt=0.1, steps=160, save_every=4, bath=bath)
temperature = np.mean(np.asarray(warming.states.momentum) ** 2 / moments, axis=0) / kT
print("at the end, on each axis:", temperature[-1].round(3), "+-", round(np.sqrt(2 / many), 3))

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.0))
panel(
    left,
    "Every axis reaches the temperature of the bath",
    "time",
    r"temperature of the axis  $\langle\Pi_i^2\rangle/I_i\,kT$",
)
for i, colour in enumerate((BLUE, ORANGE, GREEN)):
    left.plot(warming.times, temperature[:, i], color=colour)
    left.text(6, 0.5 - 0.1 * i, f"$I_{i + 1}$ = {moments[i]}", color=colour)
panel(right, "The momenta follow Maxwell's distribution", r"momentum  $\Pi_1/\sqrt{I_1\,kT}$", "probability density")
shown = np.linspace(-4, 4, 200)
right.hist(np.asarray(warming.states.momentum[:, -1, 0]), bins=40, density=True, color=BLUE, alpha=0.4)
_ = right.plot(shown, np.exp(-(shown**2) / 2) / np.sqrt(2 * np.pi), color=GREY)

# %% [markdown]
# The stage of the bath is the exact solution of its equations, and so is the flight. So the Maxwell distribution is
# kept at every step that the flight can take: here at steps of one relaxation time of the first axis.

# %%
long = ml.ensemble("JACOBI[BAOAB]", brick, None, at_rest(many), dt=2.0, steps=160, save_every=4, bath=bath).states
print(np.mean(np.asarray(long.momentum[:, -1]) ** 2 / moments, axis=0).round(3))

# %% [markdown]
# ## Dipoles in a field
#
# A field wants to align dipoles, and heat does not let it. Langevin found how far they align: <cos theta> = coth x -
# 1/x, where x is the energy of the dipole in the field over kT. All fields are one ensemble; each body has its own.

# %%
x = jnp.repeat(jnp.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0]), 1000)
top = ml.RigidBody([1.0, 1.0, 0.5])


def in_field(x):
    """A dipole along axis 3 in a field along z: the energy is -x kT cos(theta)."""
    up = jnp.array([0.0, 0.0, 1.0])
    return ml.torques.DipoleInField(moment=up, field=jnp.asarray(x)[..., None] * kT * up)


aligned = ml.ensemble(
    "SYMMETRIC[BAOAB]",
    top,
    in_field(x),
    at_rest(len(x)),
    bath=ml.baths.Langevin(kT, 1.0, keys(len(x), 1)),
    dt=0.1,
    steps=2000,
    save_every=20,
    observe=ml.observe.Axis(),
)
cosine = np.asarray(aligned.states)[:, 10:, 2].mean(1).reshape(6, 1000)
error = cosine.std(1) / np.sqrt(1000)
fields = np.asarray(x[::1000])
langevin = 1 / np.tanh(fields) - 1 / fields
for row in zip(fields, cosine.mean(1), error, langevin, strict=True):
    print("x = {:5.2f}: {:.4f} +- {:.4f}, theory {:.4f}".format(*row))

# %% [markdown]
# A torque costs an error of second order in the step. Which averages it falls on depends on the order of the letters:
# in a harmonic well `BAOAB` and `ABOBA` have the exact distribution of places, and `OBABO` that of momenta. The field
# of a dipole is not quite a harmonic well, so small errors are left. At x = 4 the dipole swings with the frequency 2.

# %%
steps = np.array([0.2, 0.4, 0.6, 0.8])
figure, axes = plt.subplots(figsize=(7, 4.0))
panel(axes, "BAOAB has the smallest error", "step", r"error of $\langle\cos\theta\rangle$ at x = 4")
count, field = 8000, 4.0
for scheme, colour in (("BAOAB", BLUE), ("OBABO", ORANGE), ("ABOBA", GREEN)):
    found = []
    for dt in steps:
        run = {"dt": dt, "steps": 800, "save_every": 8, "observe": ml.observe.Axis()}
        run["bath"] = ml.baths.Langevin(kT, 1.0, keys(count, 2))
        path = ml.ensemble(f"SYMMETRIC[{scheme}]", top, in_field(field), at_rest(count), **run)
        seen = np.asarray(path.states)[:, 25:, 2]
        found.append((seen.mean() - (1 / np.tanh(field) - 1 / field), seen.mean(1).std() / np.sqrt(count)))
    error, bar = np.array(found).T
    axes.errorbar(steps, error, bar, color=colour, capsize=2)
    axes.annotate(scheme, (steps[-1], error[-1]), color=colour, xytext=(6, -3), textcoords="offset points")
axes.axhline(0, color=GREY, lw=0.8)
_ = axes.set_xlim(0, 0.95)

# %% [markdown]
# ## Memory
#
# `ml.observe.Autocorrelation` and `ml.observe.Spectrum` are computed while the run goes, on the device. The angular
# velocity of a free sphere forgets as exp(-G t/I), and under strong friction its axis wanders as exp(-2 D t) with D =
# kT/G.

# %%
count, moment = 4000, 1.0
sphere = ml.RigidBody([moment] * 3)
start = ml.RigidState(np.sqrt(kT * moment) * jax.random.normal(jax.random.key(3), (count, 3)), at_rest(count).attitude)
weak, strong = 0.5, 10.0


def correlation(observable, lags, friction, dt, every):
    """Of 200 values, saved after `every` steps each."""
    bath = ml.baths.Langevin(kT, friction, keys(count))
    observe = ml.observe.Autocorrelation(observable, lags)
    run = {"dt": dt, "steps": 200 * every, "save_every": every, "observe": observe}
    return ml.ensemble("JACOBI[BAOAB]", sphere, None, start, bath=bath, **run).states


velocity = correlation(ml.observe.angular_velocity, 40, weak, dt=0.2, every=1)
axis = correlation(ml.observe.Axis(), 20, strong, dt=0.05, every=20)

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8))
for axes, found, rate, title in (
    (left, velocity, weak / moment, "Angular velocity: simulation follows theory"),
    (right, axis, 2 * kT / strong, "Axis under strong friction: the same"),
):
    panel(axes, title, "time", "correlation")
    axes.errorbar(found.lag, found.correlation, found.error, fmt=".", color=BLUE)
    axes.plot(found.lag, found.correlation[0] * np.exp(-rate * np.asarray(found.lag)), color=GREY)
    axes.annotate(
        "theory",
        (found.lag[8], float(found.correlation[0]) * np.exp(-rate * found.lag[8])),
        color=GREY,
        xytext=(12, 8),
        textcoords="offset points",
    )

# %% [markdown]
# ## A dumbbell in a laser trap
#
# A nanodumbbell in polarised light points along the polarisation, here z, and librates about it in two directions, of
# which one is a little stiffer. In a thin gas it also spins about its long axis, which the light does not hold: the
# gas drives this spin. The spin couples the two librations as it does those of a top, and pushes their frequencies
# apart. So each line gets a shoulder on its outer side: the Maxwell distribution of the spin, made visible.

# %%
across, along, depth, difference = 1.0, 2 / 7, 400.0, 0.04  # moments of two touching spheres; the trap in kT
libration = np.sqrt(2 * depth * kT / across)


def light(t, state):
    _, y, z = ml.so3.to_matrix(state.attitude)[:, 2]
    return depth * kT * (1 - z**2 + difference * y**2)


count, period = 400, 2 * np.pi / libration
gas = ml.baths.Langevin(kT, friction=1e-3, key=keys(count, 4))
spread = jnp.sqrt(kT * jnp.array([across, across, along]))
hot = ml.RigidState(spread * jax.random.normal(jax.random.key(5), (count, 3)), at_rest(count).attitude)
seen = ml.ensemble(
    "SYMMETRIC[BAOAB]",
    ml.RigidBody([across, across, along]),
    ml.torques.FromPotential(light),
    hot,
    bath=gas,
    dt=period / 60,
    steps=15 * 8192,
    save_every=15,
    observe=ml.observe.Spectrum(lambda t, s: ml.so3.to_matrix(s.attitude)[0, 2], segment=2048),
).states
frequency, density = np.asarray(seen.frequency) * period, np.asarray(seen.density) / period
figure, axes = plt.subplots(figsize=(8, 4.0))
panel(
    axes,
    "Each line has a shoulder on its outer side",
    "frequency / softer libration",
    "spectral density of x  [period]",
)
axes.semilogy(frequency, density, color=BLUE)
for place, name, side in ((1.0, "softer, along x ", "right"), (np.sqrt(1 + difference), " stiffer, along y", "left")):
    axes.axvline(place, color=GREY, lw=0.8)
    axes.text(place, 2 * density.max(), name, color=GREY, ha=side)
axes.set_xlim(0.93, 1.09)
_ = axes.set_ylim(density.max() * 1e-4, density.max() * 5)

# %% [markdown]
# ## The same noise twice
#
# The random numbers depend on the key and on the index of the step, and on nothing else. So a run that stops goes on as
# if it had not stopped, and two runs with one key differ by what you changed and not by chance. That makes derivatives
# of averages cheap: here that of <cos theta> with respect to the field, by one reverse pass along the paths.

# %%
field, count, number = 2.0, 8000, 150


def mean_cosine(x):
    bath = ml.baths.Langevin(kT, 1.0, keys(count, 6))
    run = ml.ensemble("SYMMETRIC[BAOAB]", top, in_field(x), at_rest(count), dt=0.1, steps=number, bath=bath)
    return ml.so3.to_matrix(run.states.attitude)[:, 2, 2].mean()


value, slope = jax.value_and_grad(mean_cosine)(field)
print(f"<cos theta> = {value:.3f}; its derivative {slope:.3f}, theory {1 / field**2 - 1 / np.sinh(field) ** 2:.3f}")

# %% [markdown]
# Things to try: a friction that is larger along one axis (`friction=[...]` or a tensor); a temperature that falls with
# time (`kT=lambda t: ...`), which anneals the dipoles; a dumbbell on an `AxisState`, `ml.SymmetricRotor(across,
# along)`, in half the time; bodies that travel (`linear_friction`) or act on each other. [Heat](../docs/heat.md) tells
# the rest.
