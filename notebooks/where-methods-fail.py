# %% [markdown]
# # Where methods fail
#
# Every integrator fails when its step is too long. What matters is how: with a flag, with a blow-up that nobody can
# miss, or silently. This notebook shows the three ways on one body, draws the map of the steps that can be trusted,
# and asks for a sane step before a run.
#
# The body is a compass needle: a body with moments of inertia (1, 1, 1.2) and a magnetic moment of 4 along its third
# axis, in a field of strength 1 along the vertical axis $z$ of space. It swings about the field with the frequency
# $\omega = \sqrt{4/1} = 2$ rad per unit of time, by 0.05 rad, and spins slowly, 0.5 rad per unit of time, about its
# third axis. Momentum is in the body frame, in units of moment of inertia over time.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import midlie_jax as ml
from midlie_jax.cli import scenes, stability
from midlie_jax.cli.figures import panel
from midlie_jax.cli.stability import stability_figure

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
compass = scenes.scene("compass")

# %% [markdown]
# ## Three ways to fail
#
# Kicks and flights make Verlet's scheme, which is unstable when $h\omega$ exceeds 2, here for steps above $h = 1$.
# Just below, the energy swings; just above, it grows in every step until the body turns so far in a step that the
# flight says that it cannot follow. A Runge-Kutta extrapolation of order 12 (GBS12) has no such threshold: with a
# step of 1.6 its energy goes wrong slowly, and nothing tells.

# %%
RUNS = (
    ("JACOBI[EA], h = 0.99", "JACOBI[EA]", 0.99, BLUE),
    ("JACOBI[EA], h = 1.02", "JACOBI[EA]", 1.02, ORANGE),
    ("GBS12, h = 1.6", "GBS12", 1.6, GREEN),
)
figure, axes = plt.subplots(figsize=(7.2, 4.2), dpi=80, layout="constrained")
for label, method, dt, colour in RUNS:
    path = ml.integrate(method, compass.body, compass.torque, compass.start, dt=dt, steps=400)
    energy, times, shown = ml.observe.energy(compass.body, compass.torque, path), path.times, int(path.first_bad)
    errors = np.abs(energy / energy[0] - 1)
    axes.semilogy(times[1:shown], np.maximum(errors[1:shown], 1e-16), color=colour, linewidth=1)
    axes.annotate(label, (times[shown - 1], errors[shown - 1]), (10, 0), textcoords="offset points", color=colour)
    if not path.ok:
        axes.plot(times[shown - 1], errors[shown - 1], "x", color=colour, markersize=10)
    print(f"{label}: ok is {bool(path.ok)}, {shown} of {len(times)} states can be trusted")
axes.set_xlim(0, 900)
panel(axes, "At h = 1.02 a flag comes (cross); GBS12 goes wrong without one", "time", "relative energy error")
plt.show()

# %% [markdown]
# `path.ok` is False for a run that failed, and `path.first_bad` is the number of saved states before the failure.
# Neither is an exception, so in a batch of thousands the other bodies go on.
#
# ## The map
#
# In the next picture each point is one run of 2000 steps. To the right the step grows, upwards the spin of the needle
# or the frequency $\omega$ of the field. The colour is the largest error of the energy; hatched runs failed with a
# flag, black ones blew up. The lines are what theory says: dashed $h\omega = 2$, orange the *reach*, the largest turn
# in a step that a flight can make.

# %%
METHODS = ("JACOBI[EA]", "LIEMID[EA]", "AKW", "GBS12")
steps, sweeps = stability.sweeps(compass, 20)
sweeps = [sweep for sweep in sweeps if sweep.name != "anisotropy"]
methods = [ml.method(name) for name in METHODS]
maps = [stability.measure(method, compass, steps, sweeps, 2000) for method in methods]
limits = {(m.name, sweep.name): stability.lines(m, compass, sweep) for m in methods for sweep in sweeps}
figure = stability_figure(
    maps, limits, steps, sweeps, title="Compass needle", note="Each point is one run of 2000 steps.", time_unit=""
)
figure

# %% [markdown]
# `midlie stability SCENE` draws such maps of any scene with more methods; the page [stability](../docs/stability.md)
# shows and explains them.
#
# ## Ask before you run
#
# `ml.check` runs the first 10,000 steps: how far they turn the body, how stiff the torque is, how near a resonance,
# whether a step fails or the energy is lost. It says what is wrong, and which step is sane.

# %%
for dt in (0.1, 1.02):
    print(ml.check("JACOBI[EA]", compass.body, compass.torque, compass.start, dt=dt), "\n")

# %% [markdown]
# ## Not a failure: a motion that is sensitive
#
# A body that spins about its middle axis turns over again and again (Dzhanibekov's effect). When it turns over
# depends on the last digits of the start. Below are two starts whose momenta differ by 3 parts in 10⁷, moved by the
# exact flight, which keeps the energy to rounding. They part nevertheless. No method and no step can mend this.

# %%
BRICK = ml.RigidBody([1.0, 1.6, 2.1])
starts = ml.MomentumState(jnp.array([[1e-7, 1.6, 0.0], [6e-7, 1.6, 0.0]]))
tumbling = ml.ensemble("JACOBI[EA]", BRICK, None, starts, dt=0.1, steps=2500, save_every=1)
figure, axes = plt.subplots(figsize=(7.2, 3.4), dpi=80, layout="constrained")
for momentum, colour in zip(tumbling.states.momentum, (BLUE, ORANGE), strict=True):
    axes.plot(tumbling.times, momentum[:, 1] / 1.6, color=colour, linewidth=1.2)
axes.annotate("one start", (49, 0.5), color=BLUE)
axes.annotate("the other", (38, 0.5), color=ORANGE, ha="right")
panel(axes, "A small change of the start moves every flip", "time", r"spin about axis 2, $\Omega_2(t)\,/\,\Omega_2(0)$")
plt.show()

# %% [markdown]
# ## What float32 costs
#
# The last way to fail is rounding. In a good implementation the roundings of different steps are independent, and
# their sum grows like the square root of the number of steps (Brouwer's law). In a bad one it grows like the number
# itself. The picture shows the energy of 64 free bodies in float32 and in float64, root mean square; the dashed lines
# have slope 1/2.

# %%
counts = np.unique(np.geomspace(1, 2000, 12).astype(int))
figure, axes = plt.subplots(figsize=(7.2, 4.2), dpi=80, layout="constrained")
for dtype, colour in ((jnp.float32, ORANGE), (jnp.float64, BLUE)):
    momenta = jnp.asarray(np.random.default_rng(1).normal(size=(64, 3)), dtype)
    body = ml.RigidBody(jnp.asarray(BRICK.moments, dtype))
    start = ml.MomentumState(momenta)
    path = ml.ensemble("JACOBI[EA]", body, None, start, dt=0.1, steps=200_000, save_every=100)
    double = ml.RigidBody(jnp.asarray(body.moments, float))  # the energy itself is computed in float64
    kinetic = ml.observe.kinetic_energy(double, ml.MomentumState(jnp.asarray(path.states.momentum, float)))
    error = np.sqrt(np.mean((kinetic[:, counts] / kinetic[:, :1] - 1) ** 2, axis=0))
    axes.loglog(100 * counts, error, color=colour, marker="o")
    axes.annotate(dtype.__name__, (100 * counts[-1], error[-1]), (6, -3), textcoords="offset points", color=colour)
    axes.loglog(100 * counts, error[-1] * np.sqrt(counts / counts[-1]), color="#bbbbbb", linestyle="--")
axes.margins(x=0.15)
panel(
    axes, "Rounding errors grow as the root of the steps", "number of steps", "relative energy error, root mean square"
)
plt.show()

# %% [markdown]
# ## What to remember
#
# - Look at `path.ok`, and at `path.first_bad` where it is False.
# - Ask `ml.check` for a sane step, and `ml.recommend` for an accurate one.
# - Methods of kicks and flights end at $h\omega = 2$ and at their reach, and say so. Runge-Kutta methods fade without a
#   sign; watch the energy.
