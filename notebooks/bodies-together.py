# %% [markdown]
# # Bodies together
#
# So far each body moved alone. Here they act on each other: two asteroids by gravity, two molecules and then a box of
# them by their charges, the pieces of an elastic rod by their links. All have the same form: a `CoupledState` with
# arrays `(N, 3)` and `(N, 4)`, moments `(N, 3)` and masses `(N,)`, and one function that returns the torques `(N, 3)`,
# each in the frame of its body, and the forces `(N, 3)` in space. Every method, gradient, ensemble and picture works on
# them as on one body.

# %%
import jax

jax.config.update("jax_enable_x64", True)  # sixteen digits

import sys
import tempfile
import time
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import midlie_jax as ml
from midlie_jax.cli.figures import panel
from midlie_jax.cli.scenes import scene

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8a8a8a"
plt.rcParams["figure.dpi"] = 80
folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## A binary asteroid
#
# Every sixth asteroid near the Earth has a moon. Both are far from being spheres, so each turns the other: the orbit is
# no ellipse, the moon swings about the line to its partner, and the poles wander. The scene `binary-asteroid` is like
# Didymos, whose moon the probe DART hit in 2022: a primary of 780 m and a moon of 180 m, 1.2 km apart, tilted against
# the orbit. Units are kilogram, metre and second. `MutualGravity` expands the gravity of two bodies to the second
# degree of their sizes over their distance, here from the moments of inertia alone.

# %%
asteroids = scene("binary-asteroid")
binary, gravity, start = asteroids.body, asteroids.torque, asteroids.start
DAY, METHOD = 86400.0, "JACOBI[SRKN6b]"
path = ml.integrate(METHOD, binary, gravity, start, dt=60.0, steps=10 * 1440, save_every=12)
print(path.states.position.shape, "ok:", bool(path.ok))

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2))
panel(left, "Both centres", "x  [length]", "y  [length]")
ml.plot.track(left, path)
panel(right, "What should not change", "time  [s]", "relative error")
found = ml.plot.conserved(right, binary, gravity, path)

# %% [markdown]
# Energy and momenta are kept to rounding over ten days, in steps of a minute. The poles, the axes e3 of both bodies, in
# the first two days:

# %%
two_days = path._replace(
    times=path.times[:241], states=jax.tree.map(lambda x: x[:241], path.states), first_bad=jnp.asarray(241)
)
figure = plt.figure(figsize=(7.5, 4.5))
tips = ml.plot.axis_path(figure.add_subplot(projection="3d", elev=55), two_days)

# %% [markdown]
# The movie shows two orbits; each body has
# a colour, and both are drawn as large as they are.

# %%
orbits = ml.integrate(METHOD, binary, gravity, start, dt=60.0, steps=1440, save_every=6)
Image(ml.plot.animate(binary, orbits, folder / "binary.gif", frames=60, size=400, title="a day of a binary asteroid"))

# %% [markdown]
# ## Libration, and what it tells
#
# The *libration* is the angle between the long axis of the moon and the line to the primary, here as seen from above. A
# long moon swings slowly, and the rate depends on its moments: so a telescope that sees the swing weighs the moon's
# inside. `libration` is an ordinary function of a state.


# %%
def libration(state):
    """The angle of the moon's long axis from the line between the bodies, in the plane xy, in radians."""
    way = state.position[1] - state.position[0]
    long_axis = ml.so3.to_matrix(state.attitude[1])[:, 0]
    return jnp.arctan2(way[0] * long_axis[1] - way[1] * long_axis[0], way[0] * long_axis[0] + way[1] * long_axis[1])


angles = jax.vmap(libration)(path.states)
figure, axes = plt.subplots(figsize=(9, 3))
panel(axes, "Libration of the moon", "time  [days]", "angle  [°]")
(line,) = axes.plot(path.times / DAY, np.degrees(angles), color=ORANGE)

# %% [markdown]
# The derivative of the libration after two days with respect to the largest moment of the moon, by automatic
# differentiation through all 2880 steps, beside a difference of two runs:


# %%
def last_libration(factor):
    """The libration after two days if the largest moment of the moon is multiplied by a factor."""
    moments = binary.body.moments.at[1, 2].multiply(factor)
    body = ml.FreeBody(ml.RigidBody(moments), binary.mass)
    end = ml.integrate(METHOD, body, gravity, start, dt=120.0, steps=1440, adjoint=ml.adjoints.Forward())
    return libration(jax.tree.map(lambda x: x[-1], end.states))


began = time.perf_counter()
slope = jax.jit(jax.jacfwd(last_libration))(1.0)
difference = (last_libration(1 + 1e-6) - last_libration(1 - 1e-6)) / 2e-6
print(f"by the gradient {slope:.8f}, by a difference {difference:.8f} rad; {time.perf_counter() - began:.0f} s")

# %% [markdown]
# ## A thousand binaries
#
# We do not know the moon well. A thousand moons whose spin differs by ten percent are one call of `ensemble`; the
# leading axis is that of the copies.

# %%
COPIES, HOURS = 1000, 48
numbers = np.random.default_rng(1).normal(1.0, 0.1, (COPIES, 1, 1))
moon = jnp.asarray(np.concatenate([np.ones_like(numbers), numbers], axis=1))  # the primary stays as it is
starts = jax.vmap(lambda f: ml.CoupledState(f * start.momentum, start.attitude, start.linear, start.position))(moon)
began = time.perf_counter()
many = ml.ensemble(
    METHOD, binary, gravity, starts, dt=120.0, steps=30 * HOURS, save_every=15, observe=lambda t, s: libration(s)
)
print(f"{COPIES} binaries for {HOURS} hours in {time.perf_counter() - began:.1f} s, all ok: {bool(jnp.all(many.ok))}")
figure, axes = plt.subplots(figsize=(9, 3))
panel(axes, "Libration, if the spin of the moon is known to 10 %", "time  [hours]", "angle  [°]")
bands = ml.plot.bands(axes, many.times / 3600, np.degrees(many.states), label="1000 moons", colour=ORANGE)

# %% [markdown]
# ## Two molecules
#
# A rigid molecule is a body with charges at fixed points. `ml.molecules.sites` gives the places of the points in space;
# the potential energy is written on them, and `FromPotential` makes torques and forces of it. Two waters of the model
# SPC/E, in nanometres, picoseconds and atomic mass units, so energies are in kJ/mol:

# %%
from midlie_jax.cli.scene_forces import WATER

body = ml.FreeBody(ml.RigidBody(np.tile(WATER.moments, (2, 1))), np.full(2, WATER.mass))
charges = 138.935457644 * np.outer([-0.8476, 0.4238, 0.4238], [-0.8476, 0.4238, 0.4238])


def energy(t, state):
    """Electrostatic energy of all pairs of sites, and the Lennard-Jones energy of the two oxygens."""
    first, second = ml.molecules.sites(state, jnp.asarray(WATER.points))
    distance = jnp.sqrt(jnp.sum((first[:, None] - second[None]) ** 2, axis=-1))
    sixth = (0.3166 / distance[0, 0]) ** 6
    return jnp.sum(charges / distance) + 4 * 0.650 * (sixth**2 - sixth)


pull = ml.torques.FromPotential(energy)
two = ml.integrate("JACOBI[EA]", body, pull, scene("dimer").start, dt=0.001, steps=2000, save_every=10)
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3))
panel(left, "Distance of the molecules", "time  [ps]", "distance  [nm]")
left.plot(two.times, np.linalg.norm(two.states.position[:, 1] - two.states.position[:, 0], axis=1), color=BLUE)
panel(right, "What should not change", "time  [ps]", "relative error")
found = ml.plot.conserved(right, body, pull, two)

# %% [markdown]
# `points=` draws the atoms in place of boxes. The hydrogen bond holds the two together while they turn:

# %%
Image(ml.plot.animate(body, two, folder / "dimer.gif", frames=60, size=400, points=WATER.points, title="two waters"))

# %% [markdown]
# ## A box of water
#
# 216 molecules at 300 K, periodic, under `ml.molecules.PairForces`: Lennard-Jones and damped Coulomb forces.
# `ml.molecules.integrate` keeps the list of neighbours up to date. A quarter of a picosecond in steps of 2 fs:

# %%
sys.path.insert(0, str(Path.cwd().parent / "benchmarks"))
import molecules as water

box, edge = water.box()
bodies, forces, began = water.molecules(216), water.forces(edge), time.perf_counter()
seen = {"state": lambda t, state: state, "energy": ml.observe.energy}
path = ml.molecules.integrate("JACOBI[EA]", bodies, forces, box, dt=0.002, steps=125, save_every=5, observe=seen)
print(f"125 steps of 216 molecules with compilation: {time.perf_counter() - began:.0f} s")
movie, energy = path._replace(states=path.states["state"]), path.states["energy"]
print(f"energy {energy[-1]:.1f} kJ/mol, standard deviation {np.std(energy):.2f}")
Image(
    ml.plot.animate(
        bodies, movie, folder / "box.gif", frames=26, size=420, rate=10, points=water.POINTS,
        title="216 waters, a quarter of a picosecond",
    )
)  # fmt: skip

# %% [markdown]
# ## An elastic rod
#
# Many bodies in a chain, with springs against stretch, shear, bending and twist between neighbours, are an elastic rod.
# `straight_rod` makes bodies, forces and start from length, radius and material. This one flies, bends and twists:

# %%
thrown = scene("rod")
flight = ml.integrate("JACOBI[EA]", thrown.body, thrown.torque, thrown.start, dt=0.01, steps=1000, save_every=10)
Image(ml.plot.animate(thrown.body, flight, folder / "rod.gif", frames=60, size=400, title="a rod"))

# %% [markdown]
# And a cantilever, held at one end: a load at the tip, with damping, until it rests. The deflection of a short beam is
# known (S. Timoshenko): $FL/(kGA) + FL^3/(3EI)$, the first term from shear. It holds for small loads, so the load is a
# thousandth of that in PyElastica's example, and the deflection is shown for the whole.

# %%
ELEMENTS, LENGTH, RADIUS, E, G, LOAD = 20, 3.0, 0.25, 1e6, 1e4, 15.0
beam, springs, straight = ml.molecules.straight_rod(
    ELEMENTS, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0],
    length=LENGTH, radius=RADIUS, density=5000.0, youngs_modulus=E, shear_modulus=G, clamped=True,
)  # fmt: skip
weight = jnp.zeros((ELEMENTS, 3)).at[-1, 2].set(-LOAD / 1000)


def load_and_damping(t, state):
    return ml.torques.Wrench(-1.0 * state.momentum, weight - 1.0 * state.linear)


rest = ml.integrate(
    "JACOBI[EA]", beam, springs + ml.torques.VelocityDependent(load_and_damping), straight,
    dt=0.005, steps=12000, save_every=60,
)  # fmt: skip
tip = -1000 * np.asarray(rest.states.position[:, -1, 2])
area, second = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
known = LOAD * LENGTH / (27 / 28 * G * area) + LOAD * LENGTH**3 / (3 * E * second)
figure, axes = plt.subplots(figsize=(9, 3))
panel(axes, "Deflection of the tip", "time", "deflection")
axes.plot(rest.times, tip, color=BLUE)
axes.axhline(known, color=GREY, linewidth=1)
print(f"at rest {tip[-1]:.6f}, known {known:.6f}; the difference is of second order in the length of the elements")
