# %% [markdown]
# # In a diffrax pipeline
#
# You simulate with [diffrax](https://docs.kidger.site/diffrax/) and fit with optimistix or optax, and one part of your
# model is a body that rotates. This notebook changes one line of such a program, the solver, and shows what improves,
# what stays the same, and when the change is not worth it.
#
# The body is a spinning top on a fixed point. Its principal moments of inertia are 0.05, 0.045 and 0.015 kg m², and it
# spins at 50 rad/s about its third axis. Gravity pulls with 0.2 N m: weight times the distance of the centre of mass
# from the fixed point. The *body frame* is fixed to the top, with its axes along the principal axes; in the *space
# frame*, z points up. A state consists of the angular momentum in the body frame (N m s) and of the attitude, a unit
# quaternion (w, x, y, z) that rotates body vectors to the space frame.

# %%
import jax

jax.config.update("jax_enable_x64", True)

import diffrax
import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax
import optimistix

import midlie_jax as ml
from midlie_jax.cli.figures import panel

MOMENTS, WEIGHT = jnp.array([0.05, 0.045, 0.015]), 0.2  # kg m², N m
START = ml.RigidState(
    momentum=jnp.array([0.0, 0.02, 0.75]),  # N m s, body frame
    attitude=ml.so3.exp(jnp.array([0.3, 0.0, 0.0])),  # leaning by 0.3 rad
)
BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"

# %% [markdown]
# ## The line that changes
#
# `RigidBodyTerm` is a diffrax term. diffrax's own solvers take it as it is: they integrate the seven numbers of the
# state. So the program before the change has `diffrax.Tsit5()`, and the program after it has
# `ml.diffrax.LieSolver(...)`, which turns the body by rotations instead. Everything else stays.

# %%
term = ml.diffrax.RigidBodyTerm(ml.RigidBody(MOMENTS), ml.torques.HeavyTop(WEIGHT))


@eqx.filter_jit
def run(solver, dt, duration, saveat, **options):
    options = {"adjoint": diffrax.ForwardMode(), "max_steps": None, **options}
    return diffrax.diffeqsolve(term, solver, 0.0, duration, dt, START, saveat=saveat, **options)


times = jnp.linspace(0.0, 200.0, 401)  # s
before = run(diffrax.Tsit5(), 0.02, 200.0, diffrax.SaveAt(ts=times))
after = run(ml.diffrax.LieSolver("JACOBI[EA]"), 0.02, 200.0, diffrax.SaveAt(ts=times))

# %% [markdown]
# ## What improves: the long run
#
# Both solvers take 10,000 steps of 0.02 s, in each of which the top turns by about one radian. Three quantities are
# constant in the true motion: the energy, the length of the quaternion, and the vertical component of the angular
# momentum in the space frame. The pictures show how far each solution is from them.


# %%
def errors(states):
    energy, vertical = ml.observe.energy(term.body, term.torque, states), ml.observe.spatial_momentum(states)[:, 2]
    length = jnp.linalg.norm(states.attitude, axis=-1)
    return energy / energy[0] - 1, length - 1, vertical / vertical[0] - 1


figure, panels = plt.subplots(1, 3, figsize=(11.5, 3.3), dpi=80, layout="constrained")
titles = ("Energy", "Length of the quaternion", "Vertical angular momentum")
for axes, title, theirs, ours in zip(panels, titles, errors(before.ys), errors(after.ys), strict=True):
    axes.semilogy(times, np.maximum(np.abs(theirs), 1e-17), color=ORANGE)
    axes.semilogy(times, np.maximum(np.abs(ours), 1e-17), color=BLUE)
    panel(axes, title, "time  [s]", "relative error")
    axes.set_ylim(1e-18, 10)
panels[0].annotate("Tsit5", (200, 2e-4), color=ORANGE, ha="right")
panels[0].annotate("JACOBI[EA]", (200, 1e-10), color=BLUE, ha="right")
plt.show()

# %% [markdown]
# The length of the quaternion and the vertical momentum stay at rounding: `LieSolver` only multiplies rotations, and
# this torque has no vertical component. The energy is not exact, but its error does not grow, because the method is
# symplectic. With `Tsit5` all three errors grow with time.
#
# ## Work for an accuracy
#
# The next picture compares the attitude after 10 s with a reference by `JACOBI[SRKN14a]` at a quarter of the smallest
# step. The work is counted in evaluations of the torque, which is what grows with your model.

# %%
SOLVERS = {
    "Tsit5": (diffrax.Tsit5(), 6, ORANGE, "s"),
    "JACOBI[EA]": (ml.diffrax.LieSolver("JACOBI[EA]"), 1, BLUE, "o"),
    "JACOBI[SRKN6b]": (ml.diffrax.LieSolver("JACOBI[SRKN6b]"), 6, GREEN, "^"),
}


def end(solver, steps):
    solution = run(solver, jnp.array(10.0 / steps), 10.0, diffrax.SaveAt(t1=True))
    return solution.ys.attitude[-1]


def angle(a, b):
    return float(jnp.linalg.norm(ml.so3.log(ml.so3.multiply(ml.so3.conjugate(a), b / jnp.linalg.norm(b)))))


exact = end(ml.diffrax.LieSolver("JACOBI[SRKN14a]"), 20_000)
figure, axes = plt.subplots(figsize=(6.4, 3.8), dpi=80, layout="constrained")
for name, (solver, evaluations, colour, mark) in SOLVERS.items():
    counts = (625, 1250, 2500, 5000, 10_000)
    found = [angle(end(solver, steps), exact) for steps in counts]
    work = [evaluations * steps for steps in counts]
    axes.loglog(work, found, color=colour, marker=mark)
    axes.annotate(name, (work[0], found[0]), (8, 4), textcoords="offset points", color=colour)
axes.margins(x=0.1, y=0.1)
panel(axes, "Attitude after 10 s", "evaluations of the torque", "error  [rad]")
plt.show()

# %% [markdown]
# Between two torques, both `JACOBI` methods move the body exactly. `JACOBI[EA]`, of second order, needs fewer
# evaluations than `Tsit5` down to an error of about 1e-6 rad. `JACOBI[SRKN6b]`, of fourth order, is at least 10,000
# times as accurate as `Tsit5` at the same work, until its error reaches that of the reference. Ask `ml.recommend` which
# method is cheapest for your body, torque and tolerance.
#
# ## What stays the same
#
# `SaveAt`, events and step size controllers are diffrax's. Dense output consists of unit quaternions; `dense="step"`
# makes it as accurate as the steps, and with it the time of an event. The event below stops the run when the tip of the
# top, which starts in the vertical plane x = 0 and goes to positive x, comes back to this plane. The controller keeps
# the error of a step below 1e-6, with the momentum in units of 0.75 N m s and the attitude in radians.


# %%
def sideways(t, y, args, **kwargs):
    return ml.so3.to_matrix(y.attitude)[0, 2]


tolerances = diffrax.PIDController(rtol=0.0, atol=1e-6, norm=ml.diffrax.RotationNorm(momentum=0.75))
stopped = run(
    ml.diffrax.LieSolver("JACOBI[SRKN6b]", dense="step"),
    0.01,
    20.0,
    diffrax.SaveAt(t1=True),
    stepsize_controller=tolerances,
    event=diffrax.Event(sideways, optimistix.Newton(1e-12, 1e-12), direction=False),
    max_steps=4096,
)
print(f"The tip crosses the plane after {stopped.ts[0]:.6f} s, in {int(stopped.stats['num_accepted_steps'])} steps.")

# %% [markdown]
# ## Gradients: which adjoint for which optimiser
#
# | what you call | what it needs | give diffeqsolve |
# |---|---|---|
# | `optimistix.LevenbergMarquardt`, `jax.jacfwd`, `jax.jvp` | forward mode | `adjoint=diffrax.ForwardMode()` |
# | optax, `jax.grad`, `optimistix.BFGS` | reverse mode | `adjoint=diffrax.RecursiveCheckpointAdjoint()`, the default |
#
# With the default, Levenberg-Marquardt ends in "can't apply forward-mode autodiff (jvp) to a custom_vjp function".
#
# We fit the weight and the first moment of inertia to the three rates of a gyroscope (rad/s, body frame), 41 readings
# in 2 s, each with noise of 0.05 rad/s. The start of the fit is 10 % off in the moment and 20 % in the weight.

# %%
readings = jnp.linspace(0.0, 2.0, 41)
grid = diffrax.StepTo(ts=jnp.linspace(0.0, 2.0, 201))  # steps of 0.01 s


def rates(factors, adjoint, times=readings):
    """The rates for the true moment and weight times `factors`."""
    moments = MOMENTS * jnp.stack([factors[0], 1.0, 1.0])
    weighed = ml.diffrax.RigidBodyTerm(ml.RigidBody(moments), torque_of_args=ml.torques.HeavyTop)
    solution = diffrax.diffeqsolve(
        weighed,
        ml.diffrax.LieSolver("LIEMID[EA]"),
        0.0,
        2.0,
        None,
        START,
        factors[1] * WEIGHT,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=grid,
        adjoint=adjoint,
    )
    return solution.ys.momentum / moments


noise = 0.05 * jax.random.normal(jax.random.key(0), (41, 3))
true, guess = jnp.array([1.0, 1.0]), jnp.array([1.1, 0.8])
data = rates(true, diffrax.ForwardMode()) + noise


def residuals(factors, _):
    return (rates(factors, diffrax.ForwardMode()) - data) / 0.05


fitted = optimistix.least_squares(residuals, optimistix.LevenbergMarquardt(1e-8, 1e-8), guess)
print(f"first moment {0.05 * fitted.value[0]:.5f} kg m² (true 0.05), weight {0.2 * fitted.value[1]:.5f} N m (true 0.2)")


# %%
def loss(factors):
    return jnp.mean((rates(factors, diffrax.RecursiveCheckpointAdjoint()) - data) ** 2) / 0.05**2


descend = optax.adam(0.03)


@jax.jit
def improve(factors, memory):
    value, gradient = jax.value_and_grad(loss)(factors)
    updates, memory = descend.update(gradient, memory)
    return optax.apply_updates(factors, updates), memory, value


factors, memory, values = guess, descend.init(guess), []
for _ in range(100):
    factors, memory, value = improve(factors, memory)
    values.append(float(value))

figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 3.5), dpi=80, layout="constrained")
fine = jnp.linspace(0.0, 2.0, 201)
left.plot(readings, data[:, 0], "o", color=ORANGE, markersize=4, label="readings")
left.plot(fine, rates(guess, diffrax.ForwardMode(), fine)[:, 0], ":", color="#666666", label="before the fit")
left.plot(fine, rates(fitted.value, diffrax.ForwardMode(), fine)[:, 0], color=BLUE, label="after the fit")
left.set_ylim(-0.5, 0.65)
left.legend(frameon=False, ncols=3, loc="upper center", fontsize=9)
panel(left, "Rate about the first axis, body frame", "time  [s]", "rate  [rad/s]")
right.plot(values, color=GREEN)
right.set_ylim(0, None)
panel(right, "Adam: mean square of residual over noise", "iteration", "loss")
plt.show()
print(f"Adam after 100 iterations: {0.05 * factors[0]:.5f} kg m², {0.2 * factors[1]:.5f} N m")

# %% [markdown]
# ## When not to use it
#
# - The body turns by a few radians in all and you need twelve digits: an explicit Runge-Kutta method of high order,
#   such as `diffrax.Dopri8`, needs no structure for that.
# - The rotation is coupled to other states in one large differential equation, such as a flexible body or a motor.
#   `LieSolver` moves bodies, also such that travel or act on each other, and nothing else.
# - The step has to vary all the time in a long run. A varying step destroys the long-time behaviour shown above.
# - You need nothing else of diffrax: `ml.integrate` and `ml.ensemble` are faster, and `ml.fit` has measurements,
#   parameters that stay physical, and intervals.
