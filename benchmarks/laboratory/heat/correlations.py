"""How fast a sphere in a bath forgets its angular velocity, and at strong friction its direction: both are known.

Units of kT and of the moment of inertia. <Omega(0).Omega(t)> = 3 exp(-G t); and for G >> 1 <u(0).u(t)> = exp(-2 t/G)
(P. Debye 1929), or exp(-2 (G t - 1 + exp(-G t))/G^2) if inertia is not quite neglected, which is what is compared.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Table

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.cli.figures import write
from midlie_jax.plot.style import BLUE, GREY, new_figure

BODIES = 100_000
WEAK, STRONG = 1.0, 20.0  # frictions
METHOD = "SYMMETRIC[BAOAB]"
SAVED = 12


class Correlation(NamedTuple):
    """What is correlated at a friction: times, values found with standard errors, and the known function of time."""

    name: str
    friction: float
    times: np.ndarray
    found: np.ndarray
    errors: np.ndarray
    known: Callable[[Any], Any]


def _start(seed: int) -> ml.RigidState:
    a, b = jax.random.split(jax.random.key(seed))
    attitude = jax.random.normal(a, (BODIES, 4), jnp.float32)
    attitude = attitude / jnp.linalg.norm(attitude, axis=-1, keepdims=True)
    return ml.RigidState(jax.random.normal(b, (BODIES, 3), jnp.float32), attitude)


def _measured(
    friction: float, observe: Any, dt: float, every: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, and mean and standard error of the products of an observed vector with what it was at the start."""

    def run(begin: ml.RigidState, keys: Any) -> Any:
        body = ml.RigidBody(jnp.ones(3, jnp.float32))
        bath = ml.baths.Langevin(jnp.float32(1), jnp.float32(friction), keys)
        options: Any = {"dt": jnp.float32(dt), "steps": SAVED * every, "save_every": every, "observe": observe}
        return ml.ensemble(METHOD, body, None, begin, bath=bath, **options).states

    keys = jax.random.split(jax.random.key(seed), BODIES)
    vectors = np.asarray(jax.jit(run, compiler_options=compiler_options(BODIES))(_start(seed + 1), keys), np.float64)
    products = np.sum(vectors[:, :1] * vectors, axis=-1)
    times = dt * every * np.arange(SAVED + 1)
    return times, products.mean(axis=0), products.std(axis=0) / math.sqrt(BODIES)


def _debye(t: Any) -> Any:
    return np.exp(-2 * (STRONG * t - 1 + np.exp(-STRONG * t)) / STRONG**2)


def measured() -> tuple[Correlation, Correlation]:
    velocity = _measured(WEAK, ml.observe.angular_velocity, 0.05, 6, 1)
    direction = _measured(STRONG, ml.observe.Axis(), 0.125 / STRONG, 240, 2)
    return (
        Correlation("velocity", WEAK, *velocity, lambda t: 3 * np.exp(-WEAK * t)),
        Correlation("direction", STRONG, *direction, _debye),
    )


def rows(found: Sequence[Correlation]) -> Iterator[list[str]]:
    for one in found:
        for time, value, error in zip(one.times, one.found, one.errors, strict=True):
            known = float(one.known(time))
            if time > 0:
                numbers = (f"{x:.4f}" for x in (value, error, known))
                yield [one.name, f"{time:.2f}", *numbers, f"{(value - known) / error:+.1f}"]


def draw(found: Sequence[Correlation], out: Path) -> None:
    """A panel for each: points with bars of two standard errors on the known curve."""
    figure = new_figure(9, 4.1)
    titles = "Friction G = 1: the angular velocity", "Friction G = 20: the direction"
    labels = "correlation ⟨Ω(0)·Ω(t)⟩ [kT/I]", "correlation ⟨u(0)·u(t)⟩ [-]"
    curves = "3 exp(-G t)", "exp(-2 (G t - 1 + exp(-G t))/G²)"
    for panel, one, title, label, curve in zip(figure.subplots(1, 2), found, titles, labels, curves, strict=True):
        times = np.linspace(0, one.times[-1], 200)
        panel.plot(times, one.known(times), color=GREY, lw=1.2)
        panel.errorbar(one.times, one.found, yerr=2 * one.errors, fmt="o", ms=4, color=BLUE, capsize=2)
        middle = one.times[SAVED // 3]
        words: Any = {"textcoords": "offset points", "fontsize": 9}
        panel.annotate(curve, (middle, one.known(middle)), xytext=(10, 8), color=GREY, **words)
        panel.annotate("simulated", (one.times[1], one.found[1]), xytext=(8, 2), color=BLUE, **words)
        panel.set_title(title, loc="left", fontsize=11)
        panel.set_xlabel("time [√(I/kT)]")
        panel.set_ylabel(label)
        panel.set_ylim(bottom=0)
        panel.grid(alpha=0.3, color=GREY)
    figure.suptitle("The simulated correlations follow theory", x=0.01, ha="left", fontsize=12, weight="bold")
    figure.set_layout_engine("constrained")
    write(figure, str(out))


def words(rows: list[dict[str, str]]) -> list[str]:
    off = max(abs(float(row["difference, standard errors"])) for row in rows)
    return [f"The largest difference of {len(rows)} values from theory is {off:.1f} standard errors.", ""]


TABLE = Table(
    *("reports/heat.md", "correlations"),
    ("correlation", "time", "simulated", "standard error", "theory", "difference, standard errors"),
    data="heat-correlations",
    words=words,
)


def measure(options: argparse.Namespace) -> None:
    found = measured()
    TABLE.show(options.write, rows(found))
    if options.write:
        draw(found, REPORTS / "heat-correlations.png")
