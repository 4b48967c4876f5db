# %% [markdown]
# # A satellite in a gravity gradient
#
# The Earth pulls the lower end of a satellite a little more than the upper end. This difference, the *gravity
# gradient*, turns a long satellite upright and then lets it swing like a pendulum, for years. We start from the inertia
# tensor of a drawing, find out how the satellite likes to hang, measure how it swings, place it wrongly and watch it
# tumble, switch on a controller, and follow a fleet for a year.
#
# Units are kilogram, metre and second. Three frames are used:
#
# - the *design frame* of the drawing: X forward, Y across, Z up, origin at the centre of mass;
# - the *body frame*, fixed in the satellite along its principal axes 1, 2, 3. The moments of inertia about them are
#   $I_1 < I_2 < I_3$. Momentum, angular velocity and torque are given in this frame;
# - the *space frame* $x, y, z$, which does not turn: $x$ points from the centre of the Earth to where the satellite is
#   at time 0, $y$ is its direction of flight there, and $z$ is normal to the orbit.

# %%
import jax

jax.config.update("jax_enable_x64", True)  # sixteen digits

import itertools
import tempfile
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize_scalar

import midlie_jax as ml
from midlie_jax.cli.figures import panel

BLUE, ORANGE, GREEN, INK = "#0072B2", "#D55E00", "#009E73", "#222222"
NAMES, COLOURS = ("yaw", "roll", "pitch"), (BLUE, ORANGE, GREEN)  # about the axes 1, 2, 3
plt.rcParams["figure.dpi"] = 80

# %% [markdown]
# ## From the drawing to the principal axes
#
# The drawing gives the inertia tensor $J$ in the design frame. Its entries off the diagonal are $-\int xy\,dm$ and the
# like. (Some CAD programs print them without the minus; a wrong sign tilts the principal axes to the wrong side.)
# `from_tensor` returns the moments in ascending order, and the principal axes as columns in the design frame.

# %%
J = np.array([[198.0, -5.0, 14.0], [-5.0, 229.0, 8.0], [14.0, 8.0, 64.0]])  # kg m², design frame
body, axes = ml.RigidBody.from_tensor(J)
along_zxy = axes[jnp.array([2, 0, 1])]  # the same with components along Z, X, Y
tilts = np.degrees(np.arccos(np.abs(np.diagonal(along_zxy))))
for number, (moment, name, tilt) in enumerate(zip(body.moments, "ZXY", tilts, strict=True), 1):
    print(f"axis {number}: moment {moment:6.1f} kg m², {tilt:4.1f}° from {name}")

# %% [markdown]
# The satellite stands askew in the drawing, and gravity will see the principal axes, not the drawing.
#
# The orbit is a circle, 500 km above the ground. The *orbital frame* goes round with the satellite: up (away from the
# Earth), forward (along the flight), and normal to the orbit. It turns at the orbital rate $n = \sqrt{\mu/r^3}$ about
# the normal. Yaw, roll and pitch are the turns of the body about its axes 1, 2 and 3 away from the orbital frame.

# %%
MU = 3.986004418e14  # gravitational parameter of the Earth, m³/s²
RADIUS = 6_378_137.0 + 500e3  # m
orbit = ml.orbits.CircularOrbit([RADIUS, 0.0, 0.0], [0.0, 1.0, 0.0], MU)
n = float(orbit.rate)
PERIOD = 2 * np.pi / n
print(f"orbital rate n = {n:.4e} rad/s, one orbit takes {PERIOD / 60:.1f} min")

figure, axis = plt.subplots(figsize=(6.5, 3.8), layout="constrained")
axis.add_patch(plt.Circle((0, 0), 0.55, color="#cfe3f1"))
axis.add_patch(plt.Circle((0, 0), 1.0, fill=False, color="#8a8a8a"))
axis.text(0, 0, "Earth", ha="center", va="center")
for angle in np.radians([40, 130, 220, 310]):
    up, forward = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    axis.plot(*np.outer(up, [0.86, 1.14]), color=INK, linewidth=5, solid_capstyle="butt")
    for direction, length, colour in ((up, 0.42, BLUE), (forward, 0.36, ORANGE)):
        axis.annotate("", up + length * direction, up, arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 2})
axis.text(1.12, 0.98, "axis 1, up: yaw", color=BLUE)
axis.text(0.62, 1.19, "axis 2, forward: roll", color=ORANGE, ha="center", va="bottom")
axis.text(1.2, 0.6, "axis 3, towards you: pitch", color=GREEN)
axis.set(xlim=(-1.45, 2.3), ylim=(-1.35, 1.45), aspect="equal")
axis.set_title("The orbit, seen from its normal (not to scale)", loc="left", fontsize=11, weight="bold")
axis.set_axis_off()
plt.show()

# %% [markdown]
# ## The torque, as you would write it
#
# Let $u$ be the unit vector from the Earth to the satellite, in the body frame. To first order in the size of the
# satellite over the radius of the orbit, the torque is $3 n^2\, u \times I u$ (P. C. Hughes, *Spacecraft Attitude
# Dynamics*, section 8.1). A torque is any function of the time and the state that returns three numbers in the body
# frame. `attitude` is the unit quaternion that takes body components to space components.


# %%
def orbital_frame(t):
    """The quaternion that takes components in the orbital frame (up, forward, normal) to space components."""
    return ml.so3.exp(jnp.stack([0.0 * t, 0.0 * t, n * t], axis=-1))


def gravity_gradient(t, state):
    up = ml.so3.rotate(orbital_frame(t), jnp.array([1.0, 0.0, 0.0]))
    u = ml.so3.rotate(ml.so3.conjugate(state.attitude), up)
    return 3 * n**2 * jnp.cross(u, body.moments * u)


gravity = ml.spacecraft.GravityGradient(None, orbit, MU)  # the library's: None means the moments of the body of the run
drawn = ml.scatter(
    jax.random.key(0), 1000, attitude=ml.distributions.Rotation(), t=ml.distributions.Uniform(0.0, PERIOD)
)
anywhere = ml.RigidState(jnp.zeros((1000, 3)), drawn["attitude"])
mine, theirs = (jax.vmap(torque)(drawn["t"], anywhere) for torque in (gravity_gradient, gravity.on(body)))
print(f"largest torque {np.max(np.abs(theirs)):.1e} N m; largest difference {np.max(np.abs(mine - theirs)):.0e} N m")

# %% [markdown]
# They agree to rounding. The library's torque also has a potential energy, which will be useful.
#
# ## Which method, which step?
#
# We let go of the satellite at rest in the orbital frame, a few degrees off. `ml.recommend` tries the methods on this
# motion, here for ten orbits, and returns the fastest one whose attitude at the end is right within a tolerance.
# `ml.check` tries a step: how far it turns the body, and how near the limit of the method is.


# %%
def at_rest(attitude, body=body):
    """At rest in the orbital frame at time 0."""
    rate = ml.so3.rotate(ml.so3.conjugate(attitude), jnp.array([0.0, 0.0, n]))  # rad/s, body frame
    return ml.RigidState(body.momentum(rate), attitude)


def released(*degrees):
    """At rest; the rotation vector from the orbital frame is (yaw, roll, pitch) in degrees."""
    return at_rest(ml.so3.exp(jnp.radians(jnp.array(degrees))))


start = released(6.0, 4.0, 5.0)
found = ml.recommend(body, gravity, start, tolerance=1e-8, duration=10 * PERIOD)
print(f"{found.method}, dt = {found.dt:.1f} s: error {found.error:.1e} after ten orbits\n")
print(ml.check(found.method, body, gravity, start, dt=found.dt))

# %% [markdown]
# ## How it swings
#
# Linear theory takes three lines. Let $\alpha, \beta, \gamma$ be small angles of yaw, roll and pitch. Euler's
# equations with the torque above become, to first order,
#
# $$ \ddot\gamma + 3n^2 \tfrac{I_2 - I_1}{I_3}\, \gamma = 0, $$
# $$ \ddot\beta + 4n^2 k_r\, \beta + n (1 - k_r)\, \dot\alpha = 0, \qquad
#    \ddot\alpha + n^2 k_y\, \alpha - n (1 - k_y)\, \dot\beta = 0, $$
#
# with $k_r = (I_3 - I_1)/I_2$ and $k_y = (I_3 - I_2)/I_1$ (Hughes, chapter 9). Pitch swings alone, at
# $n\sqrt{3(I_2 - I_1)/I_3}$. Roll and yaw are coupled because the frame turns; their two frequencies $\omega$ solve
# $(\omega/n)^4 - (1 + 3k_r + k_r k_y)(\omega/n)^2 + 4 k_r k_y = 0$.
#
# To measure them we let go 0.01° off about each axis, follow 60 orbits, and look for the peaks of the spectra.


# %%
def linear_theory(moments):
    """The frequencies of pitch, and of roll and yaw, slow and fast, over n."""
    yaw, roll, pitch = moments
    kr, ky = (pitch - yaw) / roll, (pitch - roll) / yaw
    b, product = 1 + 3 * kr + kr * ky, kr * ky
    root = np.sqrt(b**2 - 16 * product)
    return np.sqrt(3 * (roll - yaw) / pitch), np.sqrt((b - root) / 2), np.sqrt((b + root) / 2)


def offset(t, state):
    """The rotation vector (yaw, roll, pitch) from the orbital frame to the body frame, radians."""
    return ml.so3.log(ml.so3.multiply(ml.so3.conjugate(orbital_frame(t)), state.attitude))


def spectrum(times, values, frequencies):
    """The amplitude at each frequency (over n), through a window that keeps the peaks apart."""
    window = np.hanning(len(times)) ** 2
    return 2 * np.abs(np.exp(-1j * np.outer(frequencies, n * times)) @ (window * values)) / np.sum(window)


def peak(times, values, near):
    """The frequency, over n, at which the spectrum is largest, within 5 % of `near`."""
    return minimize_scalar(
        lambda f: -spectrum(times, values, [f])[0], bounds=(0.95 * near, 1.05 * near), options={"xatol": 1e-9}
    ).x


small = ml.integrate("JACOBI[SRKN6b]", body, gravity, released(0.01, 0.01, 0.01), dt=PERIOD / 60, steps=60 * 60)
swing = np.degrees(offset(small.times, small.states))
theory = linear_theory(body.moments)
for name, column, expected in zip(
    ("pitch", "yaw and roll, slow", "yaw and roll, fast"), (2, 0, 1), theory, strict=True
):
    measured = peak(small.times, swing[:, column], expected)
    print(f"{name:18}  theory {expected:.6f} n   measured {measured:.6f} n   difference {measured - expected:+.0e} n")


figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
frequencies = np.linspace(0.4, 2.2, 700)
for column, colour in enumerate(COLOURS):
    axis.semilogy(frequencies, spectrum(np.asarray(small.times), swing[:, column], frequencies), color=colour)
for expected, text, colour in zip(theory, ("pitch", "yaw", "roll"), (GREEN, BLUE, ORANGE), strict=True):
    axis.axvline(expected, color=INK, linestyle=":", linewidth=1)
    axis.annotate(text, (expected, 0.03), (-6, 0), textcoords="offset points", ha="right", color=colour, fontsize=11)
axis.set_ylim(1e-9, 0.1)
panel(axis, "Spectra of small swings; dotted: linear theory", "frequency / orbital rate n", "amplitude  [degrees]")
plt.show()

# %% [markdown]
# Theory and motion agree. The low peaks beside the three frequencies are sums and differences of them: the first sign
# of what linear theory leaves out.
#
# ## Which way round?
#
# The same equations say which shapes hang quietly: those whose frequencies are real. In terms of $k_r$ and $k_y$, which
# lie between -1 and 1 for every body, this is $k_r > k_y$ and $k_r k_y > 0$ and $1 + 3k_r + k_r k_y > 4\sqrt{k_r k_y}$
# (D. B. DeBra and R. H. Delp, *J. Astronaut. Sci.* 8 (1961) 14). Theory is linear; what do bodies do? Here are 4,900
# of them, each with moments of its own, released 1° off about each axis and followed for 20 orbits. The colour is the
# largest turn away from the orbital frame. The six dots are our satellite, put into orbit in six ways: the label names
# the principal axes that point up and forward.

# %%
side = (np.arange(70) + 0.5) / 35 - 1
kr, ky = (grid.ravel() for grid in np.meshgrid(side, side))
shapes = ml.RigidBody(jnp.stack([1 - kr, 1 - ky, 1 - kr * ky], axis=1))  # yaw, roll, pitch
starts = at_rest(ml.so3.exp(jnp.radians(jnp.ones((len(kr), 3)))), shapes)
run = {"dt": PERIOD / 60, "steps": 60 * 20, "save_every": 4}
turned = ml.ensemble("JACOBI[EA]", shapes, gravity, starts, **run, observe=offset)
largest = np.degrees(np.max(np.linalg.norm(turned.states, axis=-1), axis=1))

figure, axis = plt.subplots(figsize=(6.6, 5), layout="constrained")
image = axis.pcolormesh(side, side, largest.reshape(70, 70), cmap="magma_r", norm="log", vmin=2, vmax=180)
bar = figure.colorbar(image, ax=axis, label="largest turn in 20 orbits  [degrees]", ticks=[2, 5, 10, 30, 90, 180])
bar.ax.set_yticklabels(["2", "5", "10", "30", "90", "180"])
bar.ax.minorticks_off()
X, Y = np.meshgrid(np.linspace(-1, 1, 800), np.linspace(-1, 1, 800))
quiet = (X > Y) & (X * Y > 0) & (4 * np.sqrt(np.maximum(X * Y, 0)) < 1 + 3 * X + X * Y)
axis.contour(X, Y, quiet, [0.5], colors="#56B4E9", linewidths=1.8)
for order in itertools.permutations(range(3)):  # the principal axes that point up, forward and along the normal
    yaw, roll, pitch = (float(body.moments[k]) for k in order)
    x, y = (pitch - yaw) / roll, (pitch - roll) / yaw
    axis.plot(x, y, "o", color="white", markeredgecolor=INK, markersize=8)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1}
    above = 9 if order[0] != 0 else -17
    axis.annotate(
        f"{order[0] + 1} up, {order[1] + 1} forward", (np.clip(x, -0.7, 0.7), y), (0, above), ha="center",
        textcoords="offset points", fontsize=9, color=INK, bbox=box,
    )  # fmt: skip
panel(axis, "4,900 shapes; outlined: stable by linear theory", "$k_r = (I_{pitch} - I_{yaw}) / I_{roll}$",
      "$k_y = (I_{pitch} - I_{roll}) / I_{yaw}$")  # fmt: skip
axis.grid(visible=False)
plt.show()

# %% [markdown]
# The bodies confirm the outline. Two faint lines inside its large part are resonances, where swings feed each other:
# the frequency of pitch is twice the slow one of yaw and roll, or the fast one is the sum of the two others. Of the six
# ways to fly our satellite only one is inside the outline: "1 up, 2 forward".
#
# ## Placed wrongly
#
# Now the satellite flies with its long axis forward: axis 2 up and axis 1 forward. It is released 5° off about the
# vertical and 0.01° off about the normal of the orbit, six times, with starts that differ by a ten-thousandth of a
# degree. The picture shows the angle between the long axis and the vertical.

# %%
long_forward = ml.so3.from_matrix(jnp.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))  # columns: axes


def from_vertical(t, state):
    """The angle between axis 1 and the vertical, degrees."""
    x = jnp.array([1.0, 0.0, 0.0])
    axis, up = ml.so3.rotate(state.attitude, x), ml.so3.rotate(orbital_frame(t), x)
    return np.degrees(np.arccos(np.clip(np.sum(axis * up, axis=-1), -1, 1)))


off = jnp.radians(jnp.array([[5.0, 0.0, 0.01 + 1e-4 * copy] for copy in range(6)]))  # about vertical, flight, normal
copies = at_rest(ml.so3.multiply(ml.so3.exp(off), long_forward))
tumbling = ml.ensemble("JACOBI[SRKN6b]", body, gravity, copies, dt=PERIOD / 200, steps=200 * 16, save_every=4)
figure, axis = plt.subplots(figsize=(9.5, 3.4), layout="constrained")
falls = from_vertical(tumbling.times, tumbling.states)
for row, colour in zip(falls, plt.get_cmap("viridis")(np.linspace(0, 0.9, 6)), strict=True):
    axis.plot(tumbling.times / PERIOD, row, color=colour, linewidth=1)
axis.set(ylim=(-5, 185), yticks=[0, 45, 90, 135, 180])
title = "The long axis falls, and six copies lose each other"
panel(axis, title, "time  [orbits]", "angle from the vertical  [degrees]")
plt.show()

# %% [markdown]
# The fall itself is simple, and the tumbling after it is chaotic: starts that cannot be told apart lose each other
# within a few orbits, and even which end comes to swing about the upward vertical (0°) is a matter of chance. No method
# can mend that. What can still be trusted is what the motion conserves. The field goes round with the orbit, so neither
# the energy $E$ is constant nor the momentum $L_z$ about the normal, but $E - n L_z$ is:


# %%
def invariant(t, states, body=body):
    return ml.observe.energy(body, gravity, states, t) - n * ml.observe.spatial_momentum(states)[..., 2]  # joules


kept = invariant(tumbling.times, tumbling.states)
depth = 1.5 * n**2 * (body.moments[2] - body.moments[0])  # of the potential, joules
print(f"largest change of E - n Lz in 16 orbits, over the depth: {jnp.max(jnp.abs(kept - kept[:, :1])) / depth:.0e}")

# %% [markdown]
# ## Control
#
# The payload wants Z of the *drawing* up, not axis 1. So we stay in the design frame: `ml.TensorBody` takes the tensor
# as it is, and then state and torque are in the frame of the tensor. A controller with quaternion feedback turns the
# design frame to the orbital frame, Z up and X forward: a proportional part on the error, and a derivative part on the
# rate relative to the orbital frame. (The library's `ml.spacecraft.PDControl` does this for a target that is fixed in
# space; our target turns.) This torque reads the momentum. A run detects that by itself.

# %%
craft = ml.TensorBody(J)
upright = jnp.array([0.5, 0.5, 0.5, 0.5])  # takes X to forward, Y to the normal, Z to up
STIFFNESS = 0.06  # N m/rad
DAMPING = 5.0  # N m s/rad


def error(t, state):
    """The rotation vector from where the design frame should be to where it is, radians, along X, Y, Z."""
    return ml.so3.log(ml.so3.multiply(ml.so3.conjugate(ml.so3.multiply(orbital_frame(t), upright)), state.attitude))


def control(t, state):
    orbital_rate = ml.so3.rotate(ml.so3.conjugate(state.attitude), jnp.array([0.0, 0.0, n]))
    return -STIFFNESS * error(t, state) - DAMPING * (craft.velocity(state.momentum) - orbital_rate)


far_off = ml.so3.exp(jnp.radians(jnp.array([-60.0, 30.0, 45.0])))
start = at_rest(ml.so3.multiply(far_off, upright), craft)
held = ml.integrate("JACOBI[EA]", craft, gravity + control, start, dt=2.0, steps=450, save_every=5)
torques = 1e3 * control(held.times, held.states)  # mN m
errors = np.degrees(error(held.times, held.states))
print(f"after a quarter of an hour the design frame is {np.linalg.norm(errors[-1]):.3f}° from where it should be")
figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 3.6), layout="constrained")
for name, colour, column, shift in zip(NAMES, COLOURS, (2, 0, 1), ((12, 2), (26, 2), (14, -2)), strict=True):
    left.plot(held.times / 60, errors[:, column], color=colour)  # yaw is about Z, roll about X, pitch about Y
    left.annotate(name, (held.times[1] / 60, errors[1, column]), shift, textcoords="offset points", color=colour)
    right.plot(held.times / 60, torques[:, column], color=colour)
panel(left, "Attitude of the design frame", "time  [min]", "turn from the orbital frame  [degrees]")
panel(right, "Control torque about Z, X, Y, same colours", "time  [min]", "torque, design frame  [mN m]")
plt.show()

# %% [markdown]
# What is left is the price of a controller without an integral part: gravity pulls axis 1 upright with a steady
# torque, and the proportional part needs an error to hold against it.
#
# And the method? A symplectic method of kicks and flights is built for torques that depend on the attitude. A torque
# that reads the momentum is evaluated twice in each kick, and every scheme is then of second order at most:


# %%
def measured_order(method, torque):
    """From the attitudes after half an orbit in 240, 480 and 7680 steps."""

    def end(steps):
        run = {"dt": PERIOD / 2 / steps, "steps": steps, "save_every": None}
        return ml.integrate(method, craft, torque, start, **run).states.attitude

    exact = ml.so3.conjugate(end(7680))
    errors = [jnp.linalg.norm(ml.so3.log(ml.so3.multiply(exact, end(steps)))) for steps in (240, 480)]
    return np.log2(errors[0] / errors[1]), errors[1]


for method in ("JACOBI[EA]", "JACOBI[SRKN6b]"):
    for torque, name in ((gravity, "gravity alone"), (gravity + control, "with control")):
        order, last = measured_order(method, torque)
        print(f"{method:15} {name:14} order {order:.1f}, error in steps of 5.9 s {last:.0e} rad")

# %% [markdown]
# So with control take the cheapest scheme, `JACOBI[EA]`, or a Runge-Kutta method if you need many digits of a short
# run. Nothing is lost by it in the long run: a controller forgets errors, and there is no conserved quantity left to
# guard, since the controller changes $E - n L_z$. What remains to be watched is the step, which must be short against
# the controller:

# %%
print(ml.check("JACOBI[EA]", craft, gravity + control, start, dt=2.0))
kept = 1e3 * invariant(held.times, held.states, craft)
print(f"E - n Lz: {kept[0]:.3f} mJ at the start, {kept[-1]:.3f} mJ at the end")

# %% [markdown]
# ## A year
#
# Without control the structure of the method is worth most. A fleet of 24 satellites is released in the stable
# attitude, about 3° off about each axis, and followed for a year: half a million steps of one minute, of which every
# 360th is kept. A year of results belongs in a file: `ml.simulate` writes it in parts, and goes on after a power cut
# when it is called again with `resume=True`. [Ten thousand tops](ten-thousand-tops.ipynb) tries that.
#
# At rest in the orbital frame $E - n L_z$ is least; what a satellite has more than that is the energy of its swing.
# Nothing here damps it, so it should stay. The picture compares the year with one by the classical Runge-Kutta method
# RK4 at steps of four minutes, which takes as many evaluations of the torque.

# %%
QUARTERS = 1463  # of a day: one year and a few hours
off = ml.scatter(jax.random.key(1), 24, off=ml.distributions.Normal(jnp.zeros(3), jnp.full(3, 3.0)))["off"]
starts = at_rest(ml.so3.exp(jnp.radians(off)))
with tempfile.TemporaryDirectory() as folder:
    run = {"dt": 60.0, "steps": 360 * QUARTERS, "save_every": 360, "progress": False}
    year = ml.simulate("JACOBI[EA]", body, gravity, starts, out=Path(folder) / "fleet.zarr", **run)
    kept = year.states()
by_rk4 = ml.ensemble("RK4", body, gravity, starts, dt=240.0, steps=90 * QUARTERS, save_every=90)
least = invariant(0.0, released(0.0, 0.0, 0.0))
days = by_rk4.times / 86_400
figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 3.8), layout="constrained")
for states, name, colour in ((by_rk4.states, "RK4, 4 min", ORANGE), (kept, "JACOBI[EA], 1 min", BLUE)):
    swing = invariant(by_rk4.times, states) - least
    share = 100 * np.mean(swing / swing[:, :1], axis=0)
    left.plot(days, share, color=colour)
    left.annotate(name, (days[-1], share[-1]), (-4, 6), textcoords="offset points", ha="right", color=colour)
    turned = np.degrees(np.linalg.norm(offset(by_rk4.times, states), axis=-1))
    typical = np.sqrt(np.mean(turned.reshape(24, 12, 122) ** 2, axis=(0, 2)))
    right.plot(np.arange(1, 13), typical, color=colour, marker="o", markersize=4)
    right.annotate(name, (12, typical[-1]), (-4, -18), textcoords="offset points", ha="right", color=colour)
left.set_ylim(0, 115)
right.set_ylim(0, 6)
panel(left, "Energy of the swing, mean of 24", "time  [days]", "share of the start  [%]")
panel(right, "Turn from the orbital frame, root mean square", "month", "angle  [degrees]")
plt.show()

# %% [markdown]
# RK4 takes most of the energy out of the swing, smoothly and without a sign. It looks like a damper that the satellite
# does not have. `JACOBI[EA]` keeps the swing. Its error is in the frequencies, of second order in the step: after a
# year it says how far a satellite swings, but not where in its swing it is on a given day.
#
# ## What to remember
#
# - `from_tensor` takes a tensor of a drawing to principal axes; `TensorBody` stays in the frame of the drawing.
# - A torque is a function of the time and the state, in the body frame. Give `None` to `GravityGradient` and it reads
#   the moments of the body.
# - Ask `ml.recommend` for method and step, and `ml.check` whether a step is sane.
# - A torque that reads the momentum, such as control, makes every scheme second order and ends the conservation of
#   $E - nL_z$. Take the cheapest scheme then.
# - Long runs go to a file by `ml.simulate`, and go on with `resume=True`.
#
# More: [choosing a method](../docs/choosing-a-method.md), [conventions](../docs/conventions.md) on frames and torques,
# and [ensembles](../docs/ensembles.md).
