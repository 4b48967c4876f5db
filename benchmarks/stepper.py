"""Steps inside programs of users: in their own `jax.jit`, `jax.grad` and `lax.scan`, and with a controller in the loop.

    python benchmarks/stepper.py [jit] [gradient] [hessian] [loops] [craft] [--write]

All ratios are of runs that take turns on one core. `XLA_FLAGS` must not be set.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, in_turn, main
from kinds_of_state import model
from laboratory.rivals import program

import midlie_jax as ml

METHODS = "SYMMETRIC[EA]", "JACOBI[EA]", "LIEMID[EA]", "JACOBI[SRKN14a]", "GBS12"
MOMENTS = {"SYMMETRIC[EA]": [5.0, 5.0, 1.0]}


def seconds(*calls: Callable[[], Any]) -> list[float]:
    return in_turn(calls, 5, 15)


def tops(method: str, count: int, dtype: str = "float64") -> tuple[ml.RigidBody, ml.RigidState]:
    rng = np.random.default_rng(0)
    momentum = rng.normal(size=(count, 3)) + np.array([0, 0, 9])
    attitude = np.tile([1.0, 0, 0, 0], (count, 1))
    body = ml.RigidBody(jnp.asarray(MOMENTS.get(method, [5.0, 4.0, 1.0]), dtype))
    return body, ml.RigidState(jnp.asarray(momentum, dtype), jnp.asarray(attitude, dtype))


def rk4(slope: Callable[[Any], Any], y: Any, h: Any) -> Any:
    """A step by hand; the second part of y is a unit quaternion."""

    def moved(k: Any, h: Any) -> Any:
        return jax.tree.map(lambda a, b: a + h * b, y, k)

    k1 = slope(y)
    k2 = slope(moved(k1, h / 2))
    k3 = slope(moved(k2, h / 2))
    k4 = slope(moved(k3, h))
    first, q, *rest = moved(jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4), h)
    return first, q / jnp.linalg.norm(q), *rest


def end(method: str, body: Any, weight: Any, start: Any, steps: int) -> Any:
    torque = ml.torques.HeavyTop(weight)
    return ml.integrate(method, body, torque, start, dt=0.01, steps=steps, save_every=None).states


def in_jit() -> Iterator[list[str]]:
    steps = 256
    for method in METHODS:
        for dtype in ("float64", "float32"):
            for count in (64, 1024):
                body, starts = tops(method, count, dtype)
                weight = jnp.asarray(20.0, dtype)
                torque = ml.torques.HeavyTop(weight)
                users = jax.jit(jax.vmap(lambda s, m=method, b=body, w=weight: end(m, b, w, s, steps)))
                times = seconds(
                    partial(users, starts),
                    lambda m=method, b=body, t=torque, s=starts: ml.ensemble(m, b, t, s, dt=0.01, steps=steps),
                )
                own, ours = (1e9 * t / steps / count for t in times)
                yield [method, dtype, str(count), f"{own:.1f}", f"{ours:.1f}", f"{own / ours:.2f}"]


def gradients() -> Iterator[list[str]]:
    for method in ("SYMMETRIC[EA]", "JACOBI[EA]", "JACOBI[SRKN6b]", "DOP853", "GBS12"):
        for steps, count in ((128, 1000), (1000, 256), (10000, 64))[: 3 if "EA" in method else 1]:
            body, starts = tops(method, count)

            def of_weight(weight: Any, m: str = method, b: Any = body, s: Any = starts, n: int = steps) -> Any:
                return jnp.sum(jax.vmap(lambda one: end(m, b, weight, one, n).momentum)(s) ** 2)

            def of_moments(moments: Any, loss: Any = of_weight) -> Any:
                return loss(20.0, b=ml.RigidBody(moments))

            for parameter, loss, x in (("weight", of_weight, 20.0), ("moments", of_moments, body.moments)):
                both, alone = seconds(partial(jax.jit(jax.value_and_grad(loss)), x), partial(jax.jit(loss), x))
                size = f"{steps} x {count}"
                yield [method, parameter, size, f"{1e9 * both / steps / count:.1f}", f"{both / alone:.1f}"]


def hessians() -> Iterator[list[str]]:
    """Second derivatives by the weight and the moments of one top, 100 steps: the time to compile, and of a call."""
    _, starts = tops("JACOBI[EA]", 1)
    start = jax.tree.map(lambda x: x[0], starts)

    def with_package(method: str, x: Any) -> Any:
        states = end(method, ml.RigidBody(x[1:]), x[0], start, 100)
        return jnp.sum(states.momentum**2) + jnp.sum(states.attitude**3)

    def by_hand(x: Any) -> Any:
        def slope(y: Any) -> Any:
            momentum, q = y
            rate = momentum / x[1:]
            down = ml.so3.rotate(q * jnp.array([1.0, -1.0, -1.0, -1.0]), jnp.array([0.0, 0.0, -1.0]))
            turn = jnp.cross(momentum, rate) + x[0] * jnp.cross(jnp.array([0.0, 0.0, 1.0]), down)
            return turn, 0.5 * ml.so3.multiply(q, jnp.concatenate([jnp.zeros(1), rate]))

        begin = start.momentum, start.attitude
        momentum, q = jax.lax.scan(lambda y, _: (rk4(slope, y, 0.01), None), begin, length=100)[0]
        return jnp.sum(momentum**2) + jnp.sum(q**3)

    at = jnp.array([20.0, 5.0, 4.0, 1.0])
    losses = {method: partial(with_package, method) for method in ("JACOBI[EA]", "LIEMID[EA]", "RK4")}
    for name, loss in (losses | {"RK4 by hand": by_hand}).items():
        begin = time.perf_counter()
        traced = jax.jit(jax.hessian(loss)).trace(at)
        between = time.perf_counter()
        compiled = traced.lower().compile()
        first, tracing = time.perf_counter() - begin, between - begin
        yield [name, f"{first:.0f} s", f"{tracing:.0f} s", f"{1e3 * seconds(partial(compiled, at))[0]:.2f} ms"]


def loops() -> Iterator[list[str]]:
    count, steps = 1024, 400
    for method in METHODS[:3]:
        body, starts = tops(method, count)

        def stepped(start: Any, m: str = method, b: Any = body) -> Any:
            one = ml.stepper(m, b, ml.torques.HeavyTop(20.0), start, dt=0.01)
            carry = jax.lax.scan(lambda c, _: (one.step(c), None), one.init(), length=steps, unroll=2)[0]
            return one.state(carry)

        plain = jax.jit(jax.vmap(lambda s, m=method, b=body: end(m, b, 20.0, s, steps)))
        own = jax.jit(jax.vmap(stepped))
        same = all(jax.tree.leaves(jax.tree.map(lambda x, y: bool(jnp.all(x == y)), own(starts), plain(starts))))
        scan, ours = seconds(partial(own, starts), partial(plain, starts))
        yield [f"{method}, `stepper.step` in `lax.scan`", f"{scan / ours:.2f} of `integrate`", "yes" if same else "no"]
    body, starts = tops("JACOBI[EA]", 1000)
    free = ml.stepper("JACOBI[EA]", body, lambda t, state: jnp.zeros(3), jax.tree.map(lambda x: x[0], starts), dt=0.02)
    samples, each = 40, 13  # of 20 ms: about 4 Hz

    def controlled(start: Any) -> Any:
        def sample(loop: Any, _: None) -> tuple[Any, None]:
            carry, applied, on = loop
            rate = body.velocity(free.state(carry).momentum)
            on = jnp.where(on, jnp.linalg.norm(rate) > 0.02, jnp.linalg.norm(rate) > 0.05)
            wanted = jnp.where(on, -5.0 * jnp.sign(rate), 0.0)
            carry = free.step(carry, torque=lambda t, state: applied)  # a pulse of 20 ms, of the last sample
            return (free.advance(carry, each - 1), wanted, on), None

        begin = free.init(start), jnp.zeros(3), jnp.array(False)
        return free.state(jax.lax.scan(sample, begin, length=samples)[0][0])

    many = jax.jit(jax.vmap(controlled))
    run = {"dt": 0.02, "steps": samples * each}
    times = seconds(partial(many, starts), lambda: ml.ensemble("JACOBI[EA]", body, None, starts, **run))
    yield ["JACOBI[EA], 1000 craft, controller of 4 Hz with pulses", f"{times[0] / times[1]:.2f} of `ensemble`", ""]


QUADROTORS = 4096


def craft() -> Iterator[list[str]]:
    """Quadrotors in float32 at 200 Hz: thrust and torque are the action, with and without a policy."""
    rng = np.random.default_rng(1)
    f32 = partial(np.asarray, dtype=np.float32)
    inertia = f32([0.006, 0.006, 0.011])
    body = ml.FreeBody(ml.RigidBody(inertia), f32(0.5))
    zeros, attitude = f32(np.zeros((QUADROTORS, 3))), f32(np.tile([1.0, 0, 0, 0], (QUADROTORS, 1)))
    starts = ml.FreeState(f32(1e-3 * rng.normal(size=(QUADROTORS, 3))), attitude, zeros, zeros)
    actions = f32(rng.normal(size=(QUADROTORS, 4)) * [0.5, 1e-3, 1e-3, 1e-3] + [4.9, 0, 0, 0])
    weights = [f32(0.1 * rng.normal(size=shape)) for shape in ((64, 13), (64, 64), (4, 64))]
    steps, dt = 200, np.float32(0.005)
    weight = f32([0.0, 0.0, -9.81 * 0.5])

    def policy(momentum: Any, attitude: Any, linear: Any, position: Any, action: Any) -> Any:
        seen = jnp.concatenate([momentum, attitude, linear, position])
        hidden = jnp.tanh(weights[1] @ jnp.tanh(weights[0] @ seen))
        return action + np.float32(1e-3) * jnp.tanh(weights[2] @ hidden)

    def wrench(action: Any) -> Any:
        def force(t: Any, state: Any) -> Any:
            up = ml.so3.rotate(state.attitude, jnp.stack([0 * action[0], 0 * action[0], action[0]]))
            return ml.torques.Wrench(action[1:], up + weight)

        return force

    def with_stepper(method: str, learned: bool) -> Any:
        def run(start: Any, action: Any) -> Any:
            one = ml.stepper(method, body, wrench(action), start, dt=dt)

            def act(carry: Any, _: None) -> tuple[Any, None]:
                if not learned:
                    return one.step(carry), None
                s: Any = one.state(carry)
                command = policy(s.momentum, s.attitude, s.linear, s.position, action)
                return one.step(carry, torque=wrench(command)), None

            return one.state(jax.lax.scan(act, one.init(), length=steps, unroll=1 if learned else 2)[0])

        return jax.jit(jax.vmap(run))

    moments = np.asarray(inertia)

    def slope(y: Any, action: Any) -> Any:
        momentum, q, linear, _ = y
        rate = momentum / moments
        spin = jnp.concatenate([jnp.zeros(1, jnp.float32), rate])
        up = ml.so3.rotate(q, jnp.stack([0 * action[0], 0 * action[0], action[0]]))
        turn = jnp.cross(momentum, rate) + action[1:]
        return turn, np.float32(0.5) * ml.so3.multiply(q, spin), up + weight, linear / np.float32(0.5)

    def by_hand(learned: bool) -> Any:
        def run(start: Any, action: Any) -> Any:
            def act(y: Any, _: None) -> tuple[Any, None]:
                command = policy(*y, action) if learned else action

                return rk4(partial(slope, action=command), y, dt), None

            begin = start.momentum, start.attitude, start.linear, start.position
            return jax.lax.scan(act, begin, length=steps)[0]

        return jax.jit(jax.vmap(run))

    def with_mjx(integrator: str, learned: bool) -> Any:
        mjx = program("mujoco.mjx")
        with jax.enable_x64(False):
            made = mjx.put_model(model(body, integrator, mass=0.5, gravity=9.81, dt=0.005))
            data = mjx.make_data(made)

        def run(start: Any, action: Any) -> Any:
            def act(data: Any, _: None) -> tuple[Any, None]:
                place, q = data.qpos[:3], data.qpos[3:]
                linear, momentum = np.float32(0.5) * data.qvel[:3], moments * data.qvel[3:]
                command = policy(momentum, q, linear, place, action) if learned else action
                up = ml.so3.rotate(q, jnp.stack([0 * command[0], 0 * command[0], command[0]]))
                return mjx.step(made, data.replace(qfrc_applied=jnp.concatenate([up, command[1:]]))), None

            velocity = jnp.concatenate([start.linear / np.float32(0.5), start.momentum / moments])
            first = data.replace(qpos=jnp.concatenate([start.position, start.attitude]), qvel=velocity)
            last = jax.lax.scan(act, first, length=steps)[0]
            return last.qpos, last.qvel

        return jax.enable_x64(False)(jax.jit(jax.vmap(run)))

    makers = {name: partial(with_stepper, name) for name in ("JACOBI[EA]", "SYMMETRIC[EA]", "RK4")}
    makers |= {"RK4 by hand, on arrays": by_hand}
    makers |= {f"MJX, {integrator}": partial(with_mjx, integrator) for integrator in ("Euler", "RK4")}
    for name, maker in makers.items():
        times = seconds(*(partial(maker(learned), starts, actions) for learned in (False, True)))
        yield [name, *(f"{QUADROTORS * steps / t / 1e6:.1f}" for t in times)]


PAGE = "reports/speed.md"
JIT = "method", "dtype", "bodies", "custom `jit(vmap)`, ns", "`ml.ensemble`, ns", "ratio"
GRADIENT = "method", "with respect to", "steps x bodies", "value and gradient, ns", "over value"
HESSIAN = "method", "until it runs", "of this, tracing", "a call"
CRAFT = "method", "million steps per second", "with the policy"
TABLES = {
    "jit": Table(PAGE, "jit", JIT, in_jit, "custom-programs", lambda row: row[1:3] == ["float64", "1024"]),
    "gradient": Table(PAGE, "gradient", GRADIENT, gradients, "custom-gradients", lambda row: row[2] == "128 x 1000"),
    "hessian": Table(PAGE, "hessian", HESSIAN, hessians),
    "loops": Table(PAGE, "loops", ("loop", "time", "same bits"), loops),
    "craft": Table(PAGE, "craft", CRAFT, craft),
}

if __name__ == "__main__":
    main(__doc__, TABLES)
