# %% [markdown]
# # Ten thousand tops
#
# One top is a curve. Ten thousand tops, each a little different, are a distribution: how many fall over, how many stay
# upright, how sure can we be? This notebook moves thousands of bodies by single calls. It shows which tops fall, draws
# the phase portrait of the free rigid body, watches bodies turn over in weightlessness again and again, and at the end
# interrupts a long run and goes on with it, to the last bit.
#
# Two frames are used. The *body frame* is fixed to the body along its principal axes 1, 2, 3, about which its moments
# of inertia are $I_1, I_2, I_3$. The *space frame* $x, y, z$ does not move, and $z$ points up. The angular momentum
# is $\Pi = (\Pi_1, \Pi_2, \Pi_3)$, the angular velocity $\Omega = (\Pi_1/I_1, \Pi_2/I_2, \Pi_3/I_3)$, both in the
# body frame. Units are kilogram, metre and second: moments of inertia in kg m², momenta in kg m²/s.

# %%
import jax

jax.config.update("jax_enable_x64", True)  # sixteen digits

import tempfile
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray
from matplotlib.collections import LineCollection

import midlie_jax as ml
from midlie_jax.cli.figures import panel

BLUE, ORANGE, GREEN, INK = "#0072B2", "#D55E00", "#009E73", "#222222"
plt.rcParams["figure.dpi"] = 80
plt.rcParams["axes.prop_cycle"] = plt.cycler(color=[BLUE, ORANGE, GREEN])  # told apart with any colour vision
d = ml.distributions

# %% [markdown]
# ## Which tops fall?
#
# A heavy top stands on its tip and spins about its axis, the third axis of the body. If it is spun fast enough it stays
# upright: it *sleeps*. If it is too slow it falls over. A top whose first two moments are equal sleeps exactly if
#
# $$ r = \frac{\Pi_3^2}{4\, I_1\, w} > 1, $$
#
# where $w$ is its weight times the distance of its centre of mass from the tip, in N m. Our tops are turned on a
# lathe, so $I_1 = I_2$, but no two are the same. `ml.scatter` draws for each top the two moments (3 % about 5 and 1
# kg m²), the weight (20 ± 0.5 N m), the spin $\Omega_3$ (21 ± 1.5 rad/s), and the direction in which it is let go:
# 0.02 rad about each axis from upright, about one degree.

# %%
drawn = ml.scatter(
    jax.random.key(2004), 10_000,
    across=d.LogNormal(5.0, 0.03),  # I1 = I2
    along=d.LogNormal(1.0, 0.03),  # I3
    weight=d.Normal(20.0, 0.5),
    spin=d.Normal(21.0, 1.5),
    attitude=d.RotationNear(jnp.array([1.0, 0.0, 0.0, 0.0]), 0.02),
)  # fmt: skip
across, along, weight = drawn["across"], drawn["along"], drawn["weight"]
about_axis = along * drawn["spin"]  # Π3
tops, gravity = ml.RigidBody(jnp.stack([across, across, along], axis=1)), ml.torques.HeavyTop(weight)
starts = ml.RigidState(about_axis[:, None] * jnp.array([0.0, 0.0, 1.0]), drawn["attitude"])
r = np.asarray(about_axis**2 / (4 * across * weight))
print(f"{np.sum(r < 1)} of {len(r)} tops are below the limit")

# %% [markdown]
# One call moves them all for 30 seconds, in steps of 0.02 s. `observe=` says what to keep, every tenth step: not the
# states, but the direction of the axis in space and the energy.

# %%
run = {"dt": 0.02, "steps": 1500, "save_every": 10}
look = {"axis": ml.observe.Axis(), "energy": ml.observe.energy}
path = ml.ensemble("SYMMETRIC[CHIN4A]", tops, gravity, starts, **run, observe=look)
tilt = np.degrees(np.arccos(np.clip(path.states["axis"][..., 2], -1, 1)))  # (10000, 151)
energy = np.asarray(path.states["energy"])
error = np.max(np.abs(energy / energy[:, :1] - 1))
print(f"all runs ok: {bool(path.ok.all())}; largest relative error of an energy: {error:.0e}")

# %% [markdown]
# The axis of each top makes an angle with the vertical, its *tilt*. On the left are its quantiles: the dark band holds
# half of the tops at each time, the light band nine of ten. On the right each dot is a top: the largest tilt in the 30
# seconds against $r$. The black curve is theory. A top that is let go exactly upright and disturbed as little as
# possible falls to the tilt whose cosine is $2r - 1$, and rises again.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11.5, 4.6), layout="constrained", width_ratios=(1, 1))
panel(left, "Tilt of the tops above and below the limit", "time  [s]", "tilt from upright  [degrees]")
left.set_ylim(0, 60)
ml.plot.bands(left, path.times, tilt[r < 1], label="r < 1", colour=ORANGE)
ml.plot.bands(left, path.times, tilt[r > 1], label="r > 1", colour=BLUE)
panel(right, "The largest tilt of each top", "r, the square of the momentum over the limit", "largest tilt [degrees]")
largest = tilt.max(axis=1)
dots = right.scatter(r, largest, c=tilt[:, 0], s=3, cmap="viridis", vmin=0, vmax=4, linewidths=0)
figure.colorbar(dots, ax=right, label="tilt at the start  [degrees]")
limit = np.linspace(max(r.min(), 0.4), 1, 200)
right.plot([*limit, 2.0], [*np.degrees(np.arccos(2 * limit - 1)), 0], color=INK, linewidth=1.2)
right.annotate("theory", (0.62, np.degrees(np.arccos(0.24))), (10, 6), textcoords="offset points", color=INK)
right.annotate("these sleep", (1.35, 16), color=BLUE, fontsize=12)
right.annotate("these fall", (0.55, 40), color=ORANGE, fontsize=12)
right.set(xlim=(0.4, 1.9), ylim=(0, 95))
plt.show()

# %% [markdown]
# The limit is sharp where the start is nearly upright. A tilt of a few degrees at the start blurs it: such a top
# leans visibly even a little above $r = 1$. Nothing here takes energy away, so tops that fall rise again, and the
# orange bands settle although no single top does.
#
# If only the average is wanted, the axes need not be kept either. A *statistic* combines the tops while they move, and
# what comes back is a few numbers for each time, however many tops there are:

# %%
mean = ml.ensemble("SYMMETRIC[CHIN4A]", tops, gravity, starts, **run, observe=ml.observe.Mean(ml.observe.Axis())).states
print(f"kept before: {path.states['axis'].size} numbers; now: {sum(leaf.size for leaf in jax.tree.leaves(mean))}")
heights = path.states["axis"][:, -1, 2]
print("height of the axis after 30 s: mean and standard deviation")
print(f"from the statistic   {mean.mean[-1, 2]:.4f}   {jnp.sqrt(mean.covariance[-1, 2, 2]):.4f}")
print(f"from all axes        {np.mean(heights):.4f}   {np.std(heights, ddof=1):.4f}")

# %% [markdown]
# ## The phase portrait of a free body
#
# Now gravity is gone. With no torque the momentum keeps its length, so in the body frame it moves on a sphere. It keeps
# the energy too, so it runs on one closed curve, called a *polhode*. The phase portrait is all of them. We start 2,000
# bodies with moments 1, 2 and 2.5 kg m², and momenta of length 2 kg m²/s in all directions. The method moves a
# free body exactly, so the step only says how often we look.

# %%
MOMENTS = np.array([1.0, 2.0, 2.5])
I1, I2, I3 = MOMENTS
BODY, LENGTH = ml.RigidBody(MOMENTS), 2.0
around = ml.scatter(jax.random.key(1), 2000, momentum=d.Sphere(LENGTH))["momentum"]


def moved(momenta, **run):
    return ml.ensemble("JACOBI[EA]", BODY, None, ml.MomentumState(momenta), **run).states


polhodes = np.asarray(moved(around, dt=0.25, steps=1200, save_every=1).momentum) / LENGTH  # on the unit sphere
kinetic = np.asarray(ml.observe.kinetic_energy(BODY, ml.MomentumState(around)))  # joules
near = np.mean(np.abs(polhodes[:, :, 1]) > np.cos(np.radians(30)), axis=1)

# %% [markdown]
# We look at the sphere from outside, a little to the side of axis 2, the axis of the middle moment. Each polhode is
# drawn over its first 60 seconds, every 80th in white. On the left the colour is the energy. On the right it is the
# share of 300 seconds for which the momentum is within 30° of axis 2, at either end. The black curves are the
# *separatrix*: the energy is exactly that of a turn about axis 2.

# %%
FRONT = np.array([0.5, 1.0, 0.4]) / np.linalg.norm([0.5, 1.0, 0.4])  # towards the viewer, in the body frame
SIDE = np.cross([0.0, 0.0, 1.0], FRONT) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], FRONT))
VIEW = np.stack([SIDE, np.cross(FRONT, SIDE), FRONT])


def visible(points):
    """The pieces of curves (curves, n, 3) in front of the sphere, (pieces, 2, 2), and of which curve each is."""
    seen = points @ VIEW.T
    pieces = np.stack([seen[:, :-1], seen[:, 1:]], axis=2)
    which = np.all(pieces[..., 2] > 0, axis=2)
    return pieces[which][..., :2], np.nonzero(which)[0]


slope = np.sqrt((1 / I1 - 1 / I2) / (1 / I2 - 1 / I3))  # on the separatrix Π3 = ± slope Π1
angle = np.linspace(0, 2 * np.pi, 400)[:, None]
tips = [np.array([1.0, 0.0, sign * slope]) / np.hypot(1, slope) for sign in (1, -1)]
separatrix = np.stack([np.cos(angle) * [0.0, 1.0, 0.0] + np.sin(angle) * tip for tip in tips])


def sphere(axes, values, title, label, cmap):
    pieces, which = visible(polhodes[:, :240])
    lines = LineCollection(pieces, array=values[which], cmap=plt.get_cmap(cmap, 12), linewidths=2.5, antialiaseds=False)
    axes.add_collection(lines)
    some = polhodes[np.argsort(kinetic)[::80], :240]
    axes.add_collection(LineCollection(visible(some)[0], colors="white", linewidths=0.6))
    axes.add_collection(LineCollection(visible(separatrix)[0], colors=INK, linewidths=2.2))
    for number, name in enumerate(("axis 1, smallest moment", "axis 2, middle", "axis 3, largest")):
        x, y, _ = VIEW[:, number]
        axes.plot(x, y, "o", color=INK, markersize=5)
        box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.5}
        axes.annotate(name, (x, y), (0, 8), textcoords="offset points", ha="center", fontsize=9, bbox=box, color=INK)
    axes.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), aspect="equal")
    axes.set_axis_off()
    axes.set_title(title, loc="left", fontsize=11, weight="bold", color=INK)
    figure.colorbar(lines, ax=axes, label=label, shrink=0.8)


figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.5), layout="constrained")
sphere(left, kinetic, "Energy on the sphere of momenta", "kinetic energy  [J]", "viridis")
sphere(right, 100 * near, "Time near the unstable axis", "within 30° of axis 2  [% of the time]", "magma_r")
plt.show()

# %% [markdown]
# Near axes 1 and 3 the polhodes are small rings: a body that spins about one of these axes wobbles, and goes on
# spinning about it. At axis 2 the separatrix crosses itself. A body that starts there leaves, however near it starts,
# arrives at the opposite end of axis 2, and comes back.
#
# ## Turning over, again and again
#
# In space the cosmonaut Vladimir Dzhanibekov saw a spinning wing nut turn over at regular intervals. Here are 10,000
# bodies that spin about axis 2, with a start that is off by between $10^{-5}$ and $0.5$ of the momentum. A *flip* is a
# moment at which $\Pi_2$ changes its sign. How long does it take from one flip to the next?
#
# Let $T$ be the kinetic energy and $L$ the length of the momentum. The *distance from the separatrix* is
# $\varepsilon = |2 T I_2 / L^2 - 1|$. The motion has a closed form in elliptic functions, and `ml.asteroids.tumble`
# knows its periods: in one turn of the momentum seen from the body, `rotation_period`, the body flips twice. Near the
# separatrix the time between flips is $\ln(1/\varepsilon) / \lambda$ and a constant, with the rate
#
# $$ \lambda = \frac{L}{I_2} \sqrt{\frac{(I_3 - I_2)(I_2 - I_1)}{I_1 I_3}}, $$
#
# so a start that is ten times nearer flips only a little later.

# %%
off = ml.scatter(jax.random.key(2), 10_000, power=d.Uniform(-5.0, -0.3), angle=d.Uniform(0.0, 2 * np.pi))
distance = 10.0 ** off["power"]
momenta = LENGTH * jnp.stack(
    [distance * jnp.cos(off["angle"]), jnp.sqrt(1 - distance**2), distance * jnp.sin(off["angle"])], axis=1
)
second = np.asarray(moved(momenta, dt=0.2, steps=900, save_every=1, observe=lambda t, state: state.momentum[1]))  # Π2

changes = second[:, :-1] * second[:, 1:] < 0
flipped = changes.sum(axis=1) >= 2
places = np.argsort(~changes[flipped], axis=1, kind="stable")[:, :2]  # of the first two changes of sign
before, after = (np.take_along_axis(second[flipped], places + k, axis=1) for k in (0, 1))
measured = np.diff(0.2 * (places + before / (before - after)), axis=1)[:, 0]  # by straight lines
expected = np.asarray(ml.asteroids.tumble(BODY, ml.MomentumState(momenta)).rotation_period)[flipped] / 2
print(f"{np.sum(flipped)} of {len(flipped)} bodies flipped at least twice in 180 s")
print(f"largest relative difference from the closed form: {np.max(np.abs(measured / expected - 1)):.0e}")

# %% [markdown]
# Each dot is one body in a hundred, and the curve is the closed form. Over twelve powers of ten it can hardly be told
# from a straight line.

# %%
x, y, z = np.asarray(momenta).T / LENGTH
epsilon = np.abs(x**2 * (1 - I2 / I1) + z**2 * (1 - I2 / I3))[flipped]  # 1 - 2 T I2 / L², without loss of digits
order = np.argsort(epsilon)
figure, axes = plt.subplots(figsize=(7.5, 4), layout="constrained")
axes.semilogx(epsilon[order], expected[order], color=INK, linewidth=0.8)
axes.plot(epsilon[::100], measured[::100], "o", color=BLUE, markersize=4)
later = np.log(10) * np.sqrt(I1 * I3 / ((I3 - I2) * (I2 - I1))) / (LENGTH / I2)  # ln 10 / λ
axes.annotate(f"ten times nearer:\n{later:.2f} s longer", (3e-7, 48), color=INK, fontsize=11)
panel(axes, "Time between flips", "distance from the separatrix ε", "time between flips  [s]")
plt.show()
fitted = np.polyfit(np.log10(epsilon[epsilon < 1e-3]), measured[epsilon < 1e-3], 1)
print(f"ten times nearer to the separatrix: {-fitted[0]:.3f} s longer, from the bodies; {later:.3f} s, from ln 10 / λ")

# %% [markdown]
# Real starts are scattered. Let 10,000 bodies start with a momentum of $(0, 2, 0)$ kg m²/s, with a standard deviation
# of 0.02 in each component, and watch $\Pi_2 / |\Pi|$, the cosine of the angle between axis 2 and the momentum: 1 is
# upright, -1 upside down. `Histogram` counts, at each time, how many bodies are in each of 60 bins.

# %%
scattered = ml.scatter(jax.random.key(3), 10_000, momentum=d.Normal([0.0, LENGTH, 0.0], [0.02] * 3))["momentum"]


def upright(t, state):
    return state.momentum[1] / jnp.linalg.norm(state.momentum)


edges = np.linspace(-1, 1, 61)
often = {"dt": 0.2, "steps": 750, "save_every": 2}
counted = moved(scattered, observe=ml.observe.Histogram(upright, edges), **often)
average = moved(scattered, observe=ml.observe.Mean(upright), **often).mean[:, 0]
times = 0.4 * np.arange(len(average))  # s
figure, axes = plt.subplots(figsize=(9.5, 4), layout="constrained")
share = 100 * np.asarray(counted).T / len(scattered)
image = axes.pcolormesh(times, edges, np.maximum(share[:, :-1], 0.01), cmap="magma_r", norm="log")
axes.plot(times, average, color="#56B4E9", linewidth=2)
axes.annotate("mean", (times[-1], average[-1]), (5, 0), textcoords="offset points", annotation_clip=False)
figure.colorbar(image, ax=axes, label="bodies in the bin  [%]")
panel(axes, "10,000 bodies turn over, and lose step", "time  [s]", "$\\Pi_2 / |\\Pi|$")
plt.show()

# %% [markdown]
# The first flip is nearly a parade: around 24 s most bodies are upside down together. Then the different times between
# flips tell, and later the mean says nothing about any one of the bodies. Each of them still spends most of its time
# near +1 or -1, as the dark edges show, and turns over quickly in between.
#
# ## A run too long for one sitting
#
# Some runs last for days, and machines are switched off. `ml.simulate` is `ml.ensemble` for such runs: it computes in
# parts, writes each to a file as soon as it is done, and can be stopped at any moment.
#
# Here 1,000 fast tops lean by 0.3 rad, all to the same side. Each *precesses*: its axis goes slowly round the
# vertical, at about $w / \Pi_3$ = 0.5 rad/s. Their spins differ by 3 %. For the demonstration we interrupt the run as
# ctrl-C does, after six parts. A part is 500 tops for 100 saved times.

# %%
spun = ml.scatter(jax.random.key(4), 1000, spin=d.Normal(40.0, 1.2))["spin"]
leaning = ml.so3.exp(jnp.tile(jnp.array([0.3, 0.0, 0.0]), (1000, 1)))
top, pull = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
long_starts = ml.RigidState(spun[:, None] * jnp.array([0.0, 0.0, 1.0]), leaning)  # I3 = 1
folder = tempfile.TemporaryDirectory()
out = Path(folder.name) / "tops.zarr"


def long_run(out, **options):
    return ml.simulate(
        "SYMMETRIC[CHIN4A]", top, pull, long_starts, out=out, dt=0.02, steps=15_000, save_every=15,
        observe=ml.observe.Axis(), group=500, span=100, **options,
    )  # fmt: skip


written = []


def interrupt(work):
    written.append(work)  # body-steps of the part that has just been written
    if len(written) == 6:
        raise KeyboardInterrupt


try:
    long_run(out, progress=interrupt)
except KeyboardInterrupt:
    print(f"interrupted after {sum(written):,} of {1000 * 15_000:,} body-steps")

# %% [markdown]
# The next morning the same call, with `resume=True`, finds what is there and goes on:

# %%
result = long_run(out, resume=True, progress=False)
print(f"computed in the second sitting: {result.computed:,} body-steps; all tops ok: {bool(result.ok.all())}")

# %% [markdown]
# Parts that were under way when the interruption came had still been written, so the second sitting had less to do than
# the first had left. The file is a Zarr store, which xarray opens with the times and all parameters of the run. Three
# lines make a picture of the mean direction of all axes, in the space frame; two more name its axes:

# %%
stored = xarray.open_zarr(out)
mean_axis = stored.observed.mean("body").assign_coords(observed_1=["x", "y", "z"])
mean_axis.plot.line(x="time", figsize=(9, 3.8))
panel(plt.gca(), "The mean axis of 1,000 precessing tops", "time  [s]", "component, space frame")
plt.gca().get_legend().set_title("")
plt.show()

# %% [markdown]
# At first all axes go round together. The spins differ, so they spread over the whole ring, and the mean axis points
# straight up although each top leans as before.
#
# Is the interrupted run the run that we would have had? The whole run again, without a stop, and a comparison of
# every bit of every number:

# %%
whole = Path(folder.name) / "never-stopped.zarr"
long_run(whole, progress=False)
one, other = (xarray.open_zarr(path).observed.values for path in (out, whole))
different = np.sum(one.view(np.int64) != other.view(np.int64))
assert different == 0
folder.cleanup()
print(f"{one.size:,} numbers, of which {different} differ in any bit")

# %% [markdown]
# None differs. That is a promise of `ml.simulate`, at whatever instant a run is stopped, and the tests stop runs at
# random instants to hold it to that.
#
# ## What to remember
#
# - `ml.scatter` draws the bodies, `ml.ensemble` moves them, and `observe=` keeps what you ask for and nothing else.
# - Statistics such as `ml.observe.Mean` and `ml.observe.Histogram` cost a few numbers for each time, for any number of
#   bodies.
# - Near a separatrix, small differences between bodies become large ones, and only the distribution is worth knowing.
# - A long run belongs in `ml.simulate`: stop it when you must, and call it again with `resume=True`.
#
# More: [scattered inputs](../docs/scatter.md) and [where methods fail](where-methods-fail.ipynb).
