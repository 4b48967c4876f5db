"""`make bench`: what a step costs, in one table, as ratios within one run.

    python benchmarks/run.py [--quick | --flights] [--write]

Every figure is a median of five warm runs of the fast top P1; compile times are the first call, tracing included.
`--write` puts the table between the markers in README.md. Pin to one core (`taskset -c 0`) for figures to compare.
"""

import argparse
import os
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)

import midlie_jax as ml  # noqa: E402
from midlie_jax import scenes  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- bench -->", "<!-- /bench -->"


def median_seconds(call, repeats=5):
    def once():
        begin = time.perf_counter()
        jax.block_until_ready(call())
        return time.perf_counter() - begin

    return statistics.median(once() for _ in range(repeats))


def starts(scene, batch):
    return scenes.perturbed(scene, batch, 1e-3)


def compiled(function, argument):
    """The compiled function, and the seconds that tracing and compiling took."""
    begin = time.perf_counter()
    done = jax.jit(function).lower(argument).compile()
    return done, time.perf_counter() - begin


def body_step(run, scene, batch, steps):
    """Seconds a body-step of `run(start)` over a batch of starts (solo for 1), and seconds of compiling."""
    many = starts(scene, batch)
    if batch == 1:
        done, compiling = compiled(run, jax.tree.map(lambda x: x[0], many))
        return median_seconds(lambda: done(jax.tree.map(lambda x: x[0], many))) / steps, compiling
    done, compiling = compiled(jax.vmap(run), many)
    return median_seconds(lambda: done(many)) / (steps * batch), compiling


def ours(name, scene, batch, steps, dtype=jnp.float64, torque=None):
    scene = scenes.scene(scene.name, dtype)
    torque = scene.torque if torque is None else torque

    def run(start):
        return ml.integrate(ml.method(name), scene.body, torque, start, dt=0.005, steps=steps, save_every=steps)

    return body_step(run, scene, batch, steps)


def tsit5(scene, batch, steps):
    """diffrax on the quaternion state, constant step, vmapped."""

    def field(t, y, args):
        del args
        state = ml.RigidState.of(y[:3], y[3:])
        velocity = y[:3] / scene.body.moments
        rate = ml.RigidState.rate(tuple(y[i] for i in range(3, 7)), tuple(velocity))
        return jnp.concatenate([jnp.cross(y[:3], velocity) + scene.torque(t, state), jnp.stack(rate)])

    def run(y):
        term, solver = diffrax.ODETerm(field), diffrax.Tsit5()
        return diffrax.diffeqsolve(
            term,
            solver,
            0.0,
            0.005 * steps,
            None,
            y,
            stepsize_controller=diffrax.StepTo(ts=0.005 * jnp.arange(steps + 1.0)),
            adjoint=diffrax.ForwardMode(),
        ).ys

    many = starts(scene, batch)
    y = jnp.concatenate([many.momentum, many.attitude], axis=-1)
    done, compiling = compiled(jax.vmap(run), y)
    return median_seconds(lambda: done(y)) / (steps * batch), compiling


def through_diffrax(scene, batch, steps):
    """LIEMID[EA] as a solver of diffrax, the steps and the end of `ours`; no derivative asked for."""
    times = 0.005 * jnp.arange(steps + 1.0)

    def run(start):
        return diffrax.diffeqsolve(
            ml.RigidBodyTerm(scene.body, scene.torque),
            ml.LieSolver("LIEMID[EA]"),
            times[0],
            times[-1],
            None,
            start,
            stepsize_controller=diffrax.StepTo(ts=times),
            adjoint=diffrax.ForwardMode(),
            max_steps=None,
        ).ys

    return body_step(run, scene, batch, steps)


def gradient_cost(name, scene, batch, steps):
    """Time of value and gradient (moments, weight) over time of the value; and its compile time."""

    def end(parameters, start):
        moments, weight = parameters
        torque = ml.torques.HeavyTop(weight)
        path = ml.integrate(name, ml.RigidBody(moments), torque, start, dt=0.005, steps=steps, save_every=steps)
        return jnp.sum(path.states.momentum[-1] ** 2)

    parameters = (scene.body.moments, scene.torque.weight)
    many = starts(scene, batch)
    value, _ = compiled(jax.vmap(lambda s: end(parameters, s)), many)
    slope, compiling = compiled(jax.vmap(lambda s: jax.value_and_grad(end)(parameters, s)), many)
    return median_seconds(lambda: slope(many)) / median_seconds(lambda: value(many)), compiling


def with_xla_option():
    """The same LIEMID[EA] figure in a process that has XLA's own multi-output fusion on."""
    option = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=true"
    environment = {**os.environ, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {option}".strip()}
    command = [sys.executable, __file__, "--quick", "--only-first"]
    out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    return float(re.findall(r"RESULT ([\d.eE+-]+)", out)[0])


def flight_rows(scene, batch, steps):
    """Each beside LIEMID[EA], in turn, so that the machine's changes of pace strike both."""

    def ready(name):
        def run(start):
            return ml.integrate(name, scene.body, scene.torque, start, dt=0.005, steps=steps, save_every=steps)

        many = starts(scene, batch)
        done, compiling = compiled(jax.vmap(run), many)
        return lambda: done(many), compiling

    beside, _ = ready("LIEMID[EA]")
    flights = ("SLIEMID", "SLIEMID4", "JACOBI", "SYMMETRIC", "NEARSYM", "DLM", "DMV", "DMV6")
    for name in (*(f"{flight}[EA]" for flight in flights), "SLIEMID4[SRKN6b]", "JACOBI[CHIN4A]", "JACOBI[SRKN6b]"):
        call, compiling = ready(name)
        ratio = statistics.median(median_seconds(beside, 1) / median_seconds(call, 1) for _ in range(7))
        yield name, "", f"{ratio:.2f}", f"{compiling:.1f} s"


def rows(scene, quick):
    batch, steps = 4096, 100 if quick else 400
    reference, compiling = ours("LIEMID[EA]", scene, batch, steps)
    yield "LIEMID[EA]", f"{1e-6 / reference:.1f} M body-steps/s", "1", f"{compiling:.1f} s"
    for label, torque in (
        ("a torque written on arrays", lambda t, s: 20 * jnp.cross(ml.so3.to_matrix(s.attitude)[2], jnp.eye(3)[2])),
        ("a torque from a potential", ml.torques.FromPotential(lambda t, s: 20 * ml.so3.to_matrix(s.attitude)[2, 2])),
    ):
        cost, compiling = ours("LIEMID[EA]", scene, batch, steps, torque=torque)
        yield f"LIEMID[EA], {label}", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    cost, compiling = ours("LIEMID[EA]", scene, batch, steps, jnp.float32)
    yield "LIEMID[EA], float32", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    if not quick:
        yield "LIEMID[EA], XLA's multi-output fusion on", "", f"{reference / with_xla_option():.2f}", ""
    others = [n for n in ml.methods() if ml.method(n).bodies is ml.RigidBody and n != "LIEMID[EA]"]
    for name in others:
        cost, compiling = ours(name, scene, batch, steps)
        yield name, "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    yield from flight_rows(scene, batch, steps)
    cost, compiling = tsit5(scene, batch, steps)
    yield "diffrax Tsit5, vmapped, constant step", "", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    for many in (1, 100, 10_000, 100_000):
        cost, compiling = ours("LIEMID[EA]", scene, many, 100_000 // many if many < 1000 else 40)
        yield f"LIEMID[EA], {many} bodies", f"{1e6 * cost:.3f} us a body-step", f"{reference / cost:.2f}", ""
    for many in (1, 1000, 100_000):
        steps = 100_000 // many if many < 1000 else 40
        alone, _ = ours("LIEMID[EA]", scene, many, steps)
        cost, compiling = through_diffrax(scene, many, steps)
        label = f"LIEMID[EA] through diffrax, {many} bodies"
        yield label, f"{cost / alone:.2f} times `ml.integrate`", f"{reference / cost:.2f}", f"{compiling:.1f} s"
    for name in ("LIEMID[EA]", "JACOBI[EA]"):
        cost, compiling = gradient_cost(name, scene, 1024, 100)
        yield f"{name}, value and gradient over value", f"{cost:.1f} times", "", f"{compiling:.1f} s"


def table(lines):
    head = ("LIEMID[EA] on P1, batch 4096, float64, unless said", "", "speed, relative", "first call")
    text = [head, ("---",) * 4, *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in text)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--flights", action="store_true", help="only the rows that compare flights and schemes")
    parser.add_argument("--only-first", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    scene = scenes.scene("P1")
    if options.only_first:
        print("RESULT", ours("LIEMID[EA]", scene, 4096, 100)[0])
        return
    lines = []
    for line in flight_rows(scene, 4096, 100) if options.flights else rows(scene, options.quick):
        print(" | ".join(line), flush=True)
        lines.append(line)
    if options.write and not options.flights:
        readme = ROOT / "README.md"
        text = readme.read_text()
        head, tail = text.split(BEGIN)[0], text.split(END)[1]
        readme.write_text(f"{head}{BEGIN}\n{table(lines)}\n{END}{tail}")


if __name__ == "__main__":
    main()
