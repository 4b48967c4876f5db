# %% [markdown]
# # Control and learning: five loops
#
# A control loop needs single steps: the controller reads the state, decides, and acts. `ml.stepper` gives the steps of
# a method as pure functions. The loop compiles, runs in batches and has a gradient. This notebook simulates one
# satellite in five loops: thruster pulses, a reaction wheel, a trained policy, a controller that plans, and booms that
# unfold.
# The guide is [Control and learning](../docs/control.md).
#
# Units are kg, m, s and rad. Momentum and torque are in the body frame.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import midlie_jax as ml
from midlie_jax.cli.figures import panel

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8a8a8a"
plt.rcParams["figure.dpi"] = 80

satellite = ml.RigidBody([5.0, 4.0, 3.0])  # kg m^2
start = ml.RigidState([0.10, -0.15, 0.06], ml.so3.exp(jnp.array([0.4, 0.2, -0.3])))  # kg m^2/s; quaternion


def stepper(dt, body=satellite):
    return ml.stepper("JACOBI[EA]", body, lambda t, state: jnp.zeros(3), start, dt=dt)


def angles(attitude):
    """Components of the rotation from the target, the identity, for small angles, rad."""
    return 2 * attitude[1:] * jnp.sign(attitude[0])


# %% [markdown]
# ## Thrusters that fire in pulses
#
# The controller samples the state at 4 Hz. Its command is applied one sample later. On each axis a thruster fires one
# pulse of 20 ms per sample, or none. The controller has hysteresis: an axis that is off starts to fire above 10 mrad,
# and an axis that is on stops below 2 mrad. The loop carries what the controller remembers.
#
# A step of 10 ms fits all of this: a pulse is 2 steps, and the rest of the sample is 23 steps.

# %%
thrusters = stepper(0.01)
PULSE = 0.2  # N m, for 20 ms


def sample(loop, _):
    carry, command, active = loop
    state = thrusters.state(carry)
    error = angles(state.attitude) + 5.0 * satellite.velocity(state.momentum)  # rad
    active = jnp.where(active, jnp.abs(error) > 0.002, jnp.abs(error) > 0.010)
    carry = thrusters.advance(carry, 2, torque=lambda t, state: command)  # the command of the last sample
    carry = thrusters.advance(carry, 23)
    return (carry, jnp.where(active, -PULSE * jnp.sign(error), 0.0), active), (angles(state.attitude), command)


@jax.jit
def fired(carry):
    return jax.lax.scan(sample, (carry, jnp.zeros(3), jnp.zeros(3, bool)), length=480)


(carry, *_), (turned, commands) = fired(thrusters.init())
times = 0.25 * np.arange(480)
pointing = 1e3 * np.asarray(jnp.linalg.norm(turned, axis=1))  # mrad
cycle, pulses = pointing[240:].max(), np.count_nonzero(np.asarray(commands), axis=0)
print(f"ok: {thrusters.ok(carry)}; {pulses.sum()} pulses, on the three axes {pulses}")
early = np.count_nonzero(commands[:240]) / pulses.sum()

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
panel(left, f"Pulses hold the satellite within {cycle:.0f} mrad", "time [s]", "angle from the target [mrad]")
left.semilogy(times, pointing, color=BLUE)
panel(right, f"{100 * early:.0f} % of the pulses fall in the first minute", "time [s]", "pulses so far on the axis")
for i, colour in enumerate((BLUE, ORANGE, GREEN)):
    right.plot(times, np.cumsum(commands[:, i] != 0), color=colour)
    right.text(122, pulses[i], f"axis {i + 1}", color=colour, va="center")
right.set_xlim(0, 138)
plt.show()

# %% [markdown]
# The pointing never settles, because the smallest action is one pulse. This is the limit cycle of every on-off
# controller. A longer delay makes the cycle wider; change the loop to try it.
#
# ## A reaction wheel that saturates
#
# A wheel along axis 3 holds the attitude against a constant torque, such as sunlight on an uneven panel. Its motor
# follows the command with a lag of 0.2 s and gives at most 20 mN m. Its momentum cannot exceed 0.05 N m s. The loop
# carries the motor torque and the wheel momentum. The reaction of the motor and the gyroscopic torque act on the body.

# %%
SUN, MOST = 2e-4, 0.05  # N m; N m s
wheeled = stepper(0.05)
about_3 = jnp.array([0.0, 0.0, 1.0])


def with_wheel(loop, _, sun=SUN, free=wheeled):
    carry, wheel, motor = loop
    state = free.state(carry)
    error = angles(state.attitude)[2] + 4.0 * satellite.velocity(state.momentum)[2]
    motor = motor + free.dt / 0.2 * (jnp.clip(0.1 * error, -0.02, 0.02) - motor)
    motor = jnp.where(jnp.abs(wheel + motor * free.dt) < MOST, motor, 0.0)  # a saturated wheel gives no torque
    middle = (wheel + motor * free.dt / 2) * about_3

    def torque(t, state):
        return (sun - motor) * about_3 - jnp.cross(satellite.velocity(state.momentum), middle)

    return (free.step(carry, torque=torque), wheel + motor * free.dt, motor), (angles(state.attitude)[2], wheel)


level = ml.RigidState(jnp.zeros(3), [1.0, 0.0, 0.0, 0.0])
begin = wheeled.init(level), jnp.zeros(()), jnp.zeros(())
(carry, *_), (turned, wheel) = jax.jit(lambda loop: jax.lax.scan(with_wheel, loop, length=6000))(begin)
times = 0.05 * np.arange(6000)
full = times[np.argmax(np.asarray(wheel) > 0.99 * MOST)]

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
panel(left, f"The wheel is full after {full:.0f} s", "time [s]", "momentum of the wheel [mN m s]")
left.plot(times, 1e3 * wheel, color=BLUE)
left.plot(times, 1e3 * SUN * times, "--", color=GREY)
left.text(275, 1e3 * SUN * 285, "momentum from the sun", color=GREY, ha="right", va="center")
panel(right, "Then the attitude is lost", "time [s]", "angle about axis 3 [mrad]")
right.plot(times, 1e3 * turned, color=ORANGE)
right.axvline(full, color=GREY, lw=0.8)
right.text(full - 4, 1e3 * float(turned.max()), "wheel full", color=GREY, ha="right", va="top")
plt.show()

# %% [markdown]
# A loop of your own needs a check of its own. Without sunlight, the momentum of body and wheel together is constant in
# space, whatever the motor does. The next cell measures how much it changes when the satellite tumbles and the wheel
# works, at three steps. Half the step divides the error by four: the wheel momentum at mid-step makes the loop second
# order.


# %%
def change_in_the_dark(dt):
    """The change of the momentum of body and wheel in space after 60 s without sunlight, kg m^2/s."""
    free = stepper(dt)

    def dark(loop, _):
        return with_wheel(loop, None, sun=0.0, free=free)

    begin = free.init(), jnp.zeros(()), jnp.zeros(())
    (carry, wheel, _), _ = jax.lax.scan(dark, begin, length=round(60 / dt))
    end = free.state(carry)
    total = ml.so3.rotate(end.attitude, end.momentum + wheel * about_3)
    return float(jnp.linalg.norm(total - ml.so3.rotate(start.attitude, start.momentum)))


changes = np.array([change_in_the_dark(dt) for dt in (0.1, 0.05, 0.025)])
print("change of the total momentum at steps of 0.1, 0.05 and 0.025 s, kg m^2/s:", changes)
print("ratios:", (changes[:-1] / changes[1:]).round(2))

# %% [markdown]
# ## A policy trained through the loop
#
# A small network reads momentum and attitude and commands a torque, which is held for 0.25 s. The cost is the squared
# momentum over 20 s, and a little for the torque. Its gradient runs back through every step of 32 satellites at once.
# Gradient descent with momentum changes the weights. Then 256 new satellites test the policy.

# %%
learned = stepper(0.125)


def policy(weights, state):
    seen = jnp.concatenate([5.0 * state.momentum, state.attitude])
    return 0.1 * weights[2] @ jnp.tanh(weights[1] @ jnp.tanh(weights[0] @ seen))


def episode(weights, first):
    def act(carry, _):
        action = policy(weights, learned.state(carry))
        carry = learned.advance(carry, 2, torque=lambda t, state: action)
        momentum = learned.state(carry).momentum
        return carry, (jnp.sum(momentum**2) + jnp.sum(action**2), jnp.linalg.norm(momentum))

    return jax.lax.scan(act, learned.init(first), length=80)[1]


def tumbling(key, count):
    spins, turns = 0.2 * jax.random.normal(key, (2, count, 3))
    return ml.RigidState(spins, ml.so3.exp(5 * turns))


@jax.jit
def train(weights, starts):
    def cost(weights):
        return jnp.mean(jax.vmap(lambda first: episode(weights, first)[0])(starts))

    def descend(loop, _):
        weights, speeds = loop
        value, slopes = jax.value_and_grad(cost)(weights)
        speeds = [0.9 * speed - 0.02 * slope for speed, slope in zip(speeds, slopes, strict=True)]
        return ([weight + speed for weight, speed in zip(weights, speeds, strict=True)], speeds), value

    return jax.lax.scan(descend, (weights, [0 * weight for weight in weights]), length=100)


keys = jax.random.split(jax.random.key(0), 5)
shapes = (16, 7), (16, 16), (3, 16)
untrained = [0.3 * jax.random.normal(key, shape) for key, shape in zip(keys, shapes, strict=False)]
(trained, _), costs = train(untrained, tumbling(keys[3], 32))

tests = tumbling(keys[4], 256)
momenta = [jax.jit(jax.vmap(lambda first, w=w: episode(w, first)[1]))(tests) for w in (untrained, trained)]
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
panel(left, f"Training divides the cost by {costs[0] / costs[-1]:.0f}", "gradient step", "mean cost of 32 satellites")
left.semilogy(costs, color=BLUE)
rest = np.median(momenta[1][:, -1]) / np.median(np.linalg.norm(tests.momentum, axis=1))
panel(
    right,
    f"The policy removes {100 * (1 - rest):.0f} % of the momentum",
    "time [s]",
    "momentum, median and 90 % [kg m²/s]",
)
for name, colour, found in (("untrained", GREY, momenta[0]), ("trained", BLUE, momenta[1])):
    low, middle, high = np.quantile(found, (0.05, 0.5, 0.95), axis=0)
    seconds = 0.25 * np.arange(1, 81)
    right.fill_between(seconds, low, high, color=colour, alpha=0.25, lw=0)
    right.semilogy(seconds, middle, color=colour)
    right.annotate(name, (20, middle[-1]), (5, 0), textcoords="offset points", color=colour, va="center")
right.set_xlim(0, 25)
plt.show()

# %% [markdown]
# ## A controller that plans
#
# Model-predictive control plans the torques of the next 10 s, applies the first, and plans again. Each torque is held
# for 0.5 s. The plan minimises squares of the angles, the torques and the final momentum. A step of Gauss and Newton
# improves it; its matrix is the derivative of the loop. The plan assumes the satellite above. The real one is 30 %
# heavier and has a constant disturbing torque. So a plan that is made once misses, and a plan that is renewed every
# 0.5 s corrects itself.

# %%
heavier = ml.RigidBody(1.3 * satellite.moments)
model, plant = stepper(0.25), stepper(0.25, heavier)
DISTURBANCE = jnp.array([2e-3, -1e-3, 1e-3])  # N m


def residuals(plan, state):
    def hold(carry, u):
        carry = model.advance(carry, 2, torque=lambda t, state: u)
        return carry, angles(model.state(carry).attitude)

    carry, errors = jax.lax.scan(hold, model.init(state), plan)
    return jnp.concatenate([errors.ravel(), 5.0 * plan.ravel(), 10.0 * model.state(carry).momentum])


def improved(plan, state, times):
    def newton(_, plan):
        slopes = jax.jacfwd(residuals)(plan, state).reshape(-1, plan.size)
        return plan - jnp.linalg.lstsq(slopes, residuals(plan, state))[0].reshape(plan.shape)

    return jax.lax.fori_loop(0, times, newton, plan)


def apply(carry, u):
    return plant.advance(carry, 2, torque=lambda t, state: u + DISTURBANCE)


@jax.jit
def planned_again(carry, plan):
    def act(loop, _):
        carry, plan = loop
        plan = improved(plan, plant.state(carry), 1)
        carry = apply(carry, plan[0])
        return (carry, jnp.concatenate([plan[1:], plan[-1:]])), plant.state(carry)  # shifted for the next plan

    return jax.lax.scan(act, (carry, plan), length=40)[1]


@jax.jit
def planned_once(carry, plan):
    return jax.lax.scan(lambda carry, u: (apply(carry, u),) * 2, carry, plan)[1]


plan = jax.jit(improved, static_argnums=2)(jnp.zeros((20, 3)), start, 5)
renewed = planned_again(plant.init(), plan)
once = jax.vmap(plant.state)(planned_once(plant.init(), jnp.concatenate([plan, jnp.zeros((20, 3))])))
figure, axes = plt.subplots(figsize=(7.5, 4.0), layout="constrained")
ends = []
for name, colour, states in (("planned once", ORANGE, once), ("planned every 0.5 s", BLUE, renewed)):
    miss = 1e3 * np.linalg.norm(ml.so3.log(states.attitude), axis=1)
    ends.append(miss[-1])
    axes.plot(0.5 * np.arange(1, 41), miss, color=colour)
    axes.annotate(name, (20, miss[-1]), (5, 0), textcoords="offset points", color=colour, va="center")
axes.set_xlim(0, 26)
axes.set_ylim(0, None)
title = f"Planning again ends {ends[0] / ends[1]:.0f} times nearer the target"
panel(axes, title, "time [s]", "angle from the target [mrad]")
plt.show()

# %% [markdown]
# ## Booms that unfold
#
# A spinning satellite unfolds two booms within 30 s, and its moments of inertia grow. `step(carry, body=...)` uses the
# body at the middle of each step. The momentum in space stays, so the spin slows.


# %%
def unfolding(t):
    share = jnp.clip((t - 10) / 30, 0, 1)
    smooth = share**2 * (3 - 2 * share)
    return ml.RigidBody(satellite.moments + smooth * jnp.array([0.5, 6.0, 6.0]))


spinning = ml.RigidState([0.05, 0.02, 0.9], start.attitude)
free = stepper(0.05)


def unfold(carry, _):
    carry = free.step(carry, body=unfolding(free.time(carry) + free.dt / 2))
    state = free.state(carry)
    rate = unfolding(free.time(carry)).velocity(state.momentum)
    return carry, (rate, ml.so3.rotate(state.attitude, state.momentum))


_, (rates, momenta) = jax.jit(lambda carry: jax.lax.scan(unfold, carry, length=1200))(free.init(spinning))
drift = np.abs(np.asarray(momenta) - np.asarray(ml.so3.rotate(spinning.attitude, spinning.momentum))).max()
print(f"the momentum in space changes by {drift:.0e} kg m^2/s at most")
seconds = 0.05 * np.arange(1, 1201)
figure, axes = plt.subplots(figsize=(7.5, 4.0), layout="constrained")
for i, colour in enumerate((BLUE, ORANGE, GREEN)):
    axes.plot(seconds, rates[:, i], color=colour)
axes.set_xlim(0, 68)
for i, colour in enumerate((BLUE, ORANGE, GREEN)):
    axes.text(61, float(rates[-1, i]) + (0.015, -0.015, 0)[i], f"axis {i + 1}", color=colour, va="center")
axes.axvspan(10, 40, color=GREY, alpha=0.15, lw=0)
axes.text(25, 0.27, "the booms unfold", color=GREY, ha="center")
title = f"The booms slow the spin from {rates[0, 2]:.2f} to {rates[-1, 2]:.2f} rad/s"
panel(axes, title, "time [s]", "angular velocity [rad/s]")
plt.show()

# %% [markdown]
# Things to try: a delay of two samples; a wheel on each axis; a policy that must also point; a plan with a limit on the
# torque (`jnp.clip` inside `hold`); a body that burns fuel. How fast such loops run is in the
# [benchmark of steppers and control loops](../docs/reports/speed.md#custom-programs-and-steppers).
