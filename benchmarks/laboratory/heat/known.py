"""What is known of bodies in a bath: temperatures, correlations, diffusion, and relaxation under strong friction."""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Compiled, Line, Panel, Table, chart, compiled, in_turn
from scipy.linalg import expm

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options
from midlie_jax.plot.style import BLUE, GREY

# ---- free rotors that start at the temperature of the bath keep it, whatever is saved, with the same bits ----
#
# Runs are called as users call them, outside of `jax.jit`. Then the number of steps between saved states is a part of
# the program (`save_every` 1) or an argument of it (33, and None, which saves the end alone).

WARM_BODIES = 20_000
WARM_MOMENTS = 1.0, 1.0, 0.5
WARM_FLIGHTS, WARM_SCHEMES = ("SYMMETRIC", "JACOBI", "DLM"), ("BAOAB", "OBABO", "ABOBA")
WARM_EXPOSURES = 0.1, 0.7  # h G/I, on each axis
WARM_SAVED = 1, 33, None
WARM_STEPS, WARM_STEP, WARM_KT = 99, 0.1, 1.0


def _ends(method: str, exposure: float) -> Iterator[tuple[int | None, Any]]:
    """The states at the end, for each way of saving."""
    moments = np.array(WARM_MOMENTS)
    momentum = np.random.default_rng(0).normal(size=(WARM_BODIES, 3)) * np.sqrt(WARM_KT * moments)
    start = ml.RigidState(momentum, jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (WARM_BODIES, 1)))
    bath = ml.baths.Langevin(WARM_KT, exposure * moments / WARM_STEP, jax.random.split(jax.random.key(1), WARM_BODIES))
    for every in WARM_SAVED:
        run: Any = {"dt": WARM_STEP, "steps": WARM_STEPS, "save_every": every}
        states = ml.ensemble(method, ml.RigidBody(moments), None, start, bath=bath, **run).states
        yield every, states if every is None else jax.tree.map(lambda x: x[:, -1], states)


def _same(one: Any, other: Any) -> bool:
    pairs = zip(*(map(np.asarray, jax.tree.leaves(states)) for states in (one, other)), strict=True)
    return all(a.tobytes() == b.tobytes() for a, b in pairs)


def temperature_rows() -> Iterator[Sequence[str]]:
    for method in (f"{flight}[{scheme}]" for flight in WARM_FLIGHTS for scheme in WARM_SCHEMES):
        for exposure in WARM_EXPOSURES:
            first: Any = None
            for every, end in _ends(method, exposure):
                first = end if first is None else first
                squares = np.asarray(end.momentum) ** 2 / (WARM_KT * np.array(WARM_MOMENTS))
                means, errors = squares.mean(axis=0), squares.std(axis=0, ddof=1) / np.sqrt(WARM_BODIES)
                most = np.max(np.abs(means - 1) / errors)
                cells = [f"{mean:.3f} ± {error:.3f}" for mean, error in zip(means, errors, strict=True)]
                same = "yes" if _same(end, first) else "NO"
                yield [f"`{method}`", f"{exposure:g}", str(every), *cells, f"{most:.1f}", same]


def temperature_words(rows: list[dict[str, str]]) -> list[str]:
    off = max(float(row["largest deviation, standard errors"]) for row in rows)
    same = sum(row["same bits"] == "yes" for row in rows)
    return [
        f"In {len(rows)} runs, no temperature differs from theory by more than {off:.1f} standard errors (0.01).",
        f"The final states have the same bits for every `save_every` in {same} of {len(rows)} runs.",
        "",
    ]


TEMPERATURE = Table(
    *("reports/heat.md", "temperature"),
    (
        *("method", "h G/I", "`save_every`", "⟨Π₁²⟩ / (kT I₁)", "⟨Π₂²⟩ / (kT I₂)", "⟨Π₃²⟩ / (kT I₃)"),
        *("largest deviation, standard errors", "same bits"),
    ),
    *(temperature_rows, "heat-temperature"),
    words=temperature_words,
)


# ---- how a sphere forgets its angular velocity and, at strong friction, its direction ----
#
# Units of kT and of the moment of inertia. <Omega(0).Omega(t)> = 3 exp(-G t); and for G >> 1 <u(0).u(t)> = exp(-2 t/G)
# (P. Debye 1929), or exp(-2 (G t - 1 + exp(-G t))/G^2) if inertia is not quite neglected, which is what is compared.

SPHERES = 100_000
WEAK, STRONG = 1.0, 20.0  # frictions
METHOD = "SYMMETRIC[BAOAB]"
TIMES = 12


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
    attitude = jax.random.normal(a, (SPHERES, 4), jnp.float32)
    attitude = attitude / jnp.linalg.norm(attitude, axis=-1, keepdims=True)
    return ml.RigidState(jax.random.normal(b, (SPHERES, 3), jnp.float32), attitude)


def _measured(
    friction: float, observe: Any, dt: float, every: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, and mean and standard error of the products of an observed vector with what it was at the start."""

    def run(begin: ml.RigidState, keys: Any) -> Any:
        body = ml.RigidBody(jnp.ones(3, jnp.float32))
        bath = ml.baths.Langevin(jnp.float32(1), jnp.float32(friction), keys)
        options: Any = {"dt": jnp.float32(dt), "steps": TIMES * every, "save_every": every, "observe": observe}
        return ml.ensemble(METHOD, body, None, begin, bath=bath, **options).states

    keys = jax.random.split(jax.random.key(seed), SPHERES)
    vectors = np.asarray(jax.jit(run, compiler_options=compiler_options(SPHERES))(_start(seed + 1), keys), np.float64)
    products = np.sum(vectors[:, :1] * vectors, axis=-1)
    times = dt * every * np.arange(TIMES + 1)
    return times, products.mean(axis=0), products.std(axis=0) / math.sqrt(SPHERES)


def _debye(t: Any) -> Any:
    return np.exp(-2 * (STRONG * t - 1 + np.exp(-STRONG * t)) / STRONG**2)


def _correlations() -> tuple[Correlation, Correlation]:
    velocity = _measured(WEAK, ml.observe.angular_velocity, 0.05, 6, 1)
    direction = _measured(STRONG, ml.observe.Axis(), 0.125 / STRONG, 240, 2)
    return (
        Correlation("velocity", WEAK, *velocity, lambda t: 3 * np.exp(-WEAK * t)),
        Correlation("direction", STRONG, *direction, _debye),
    )


def correlation_rows(found: Sequence[Correlation]) -> Iterator[list[str]]:
    for one in found:
        for time, value, error in zip(one.times, one.found, one.errors, strict=True):
            known = float(one.known(time))
            if time > 0:
                numbers = (f"{x:.4f}" for x in (value, error, known))
                yield [one.name, f"{time:.2f}", *numbers, f"{(value - known) / error:+.1f}"]


def _draw_correlations(found: Sequence[Correlation], out: Path) -> None:
    """A panel for each: points with bars of two standard errors on the known curve."""

    def panel(one: Correlation, title: str, up: str, curve: str) -> Panel:
        times = np.linspace(0, one.times[-1], 200)
        lines = [Line(curve, times, one.known(times), GREY), Line("simulated", one.times, one.found, BLUE, "o")]

        def bars(axes: Any) -> None:
            axes.errorbar(one.times, one.found, yerr=2 * one.errors, fmt="none", color=BLUE, capsize=2)
            axes.set_ylim(bottom=0)

        return Panel(title, "time [√(I/kT)]", up, lines, more=bars)

    panels = [
        panel(found[0], "Friction G = 1: the angular velocity", "correlation ⟨Ω(0)·Ω(t)⟩ [kT/I]", "3 exp(-G t)"),
        panel(
            found[1],
            "Friction G = 20: the direction",
            "correlation ⟨u(0)·u(t)⟩ [-]",
            "exp(-2 (G t - 1 + exp(-G t))/G²)",
        ),
    ]
    chart(out, [panels], (12, 4.6), "The simulated correlations follow theory", bottom=0.13, wspace=0.3)


def correlation_words(rows: list[dict[str, str]]) -> list[str]:
    off = max(abs(float(row["difference, standard errors"])) for row in rows)
    return [f"The largest difference of {len(rows)} values from theory is {off:.1f} standard errors.", ""]


CORRELATIONS = Table(
    *("reports/heat.md", "correlations"),
    ("correlation", "time", "simulated", "standard error", "theory", "difference, standard errors"),
    data="heat-correlations",
    words=correlation_words,
)


def correlations(options: argparse.Namespace) -> None:
    found = _correlations()
    CORRELATIONS.show(options.write, correlation_rows(found))
    if options.write:
        _draw_correlations(found, REPORTS / "heat-correlations.png")


# ---- how fast free bodies diffuse, against the step ----
#
# Units of the friction, the mass and the moment of inertia, so that x = h G/I = h g/m is the step. In the limit of
# short steps the diffusion constant is D = kT/G. The velocities at the ends of steps are exact, with the correlation
# exp(-x) between neighbours, and in each step a body moves by h times a velocity, or the mean of two. The sum of these
# is
#
#     D = kT/G (x/2) coth(x/2)
#
# for BAOAB, OBABO and ABOBA. The temperature is so low that angles are small, and rotations about several axes commute.

WALKERS = 100_000
SCHEMES = "BAOAB", "OBABO", "ABOBA"
WALKS = 0.1, 0.5, 1.0, 2.0, 10.0  # x
KT = 1e-6
_TIME, _PARTS = 100.0, 10  # the time of a run, at least, and the number of saved states


def theory(x: float) -> float:
    return x / 2 / math.tanh(x / 2)


def squares(scheme: str, x: float) -> tuple[np.ndarray, float]:
    """The squares of displacement and rotation angle, (n, 2), that each body gains after the memory of its start.

    The second result is their mean in the limit of short steps.
    """
    zero = jnp.zeros((WALKERS, 3))
    momenta = jax.random.normal(jax.random.key(0), (2, WALKERS, 3)) * math.sqrt(KT)
    start = ml.FreeState(momenta[0], jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (WALKERS, 1)), momenta[1], zero)
    body = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), mass=1.0)
    bath = ml.baths.Langevin(KT, 1.0, jax.random.split(jax.random.key(1), WALKERS), 1.0)

    def observed(t: Any, state: ml.FreeState) -> Any:
        del t
        return jnp.stack([jnp.sum(state.position**2), jnp.sum(ml.so3.log(state.attitude) ** 2)])

    every = max(1, math.ceil(_TIME / x / _PARTS))
    run: Any = {"dt": x, "steps": every * _PARTS, "save_every": every, "observe": observed}
    seen = np.asarray(ml.ensemble(f"SYMMETRIC[{scheme}]", body, None, start, bath=bath, **run).states)
    return seen[:, -1] - seen[:, 1], 6 * KT * x * every * (_PARTS - 1)


def diffusion_rows() -> Iterator[Sequence[str]]:
    for scheme in SCHEMES:
        for x in WALKS:
            gained, exact = squares(scheme, x)
            means, errors = gained.mean(axis=0) / exact, gained.std(axis=0, ddof=1) / exact / math.sqrt(WALKERS)
            cells = [f"{mean:.3f} ± {error:.3f}" for mean, error in zip(means, errors, strict=True)]
            yield [f"`{scheme}`", f"{x:g}", f"{theory(x):.3f}", *cells]


DIFFUSION = Table(
    *("reports/heat.md", "diffusion"),
    ("scheme", "h G/I", "(x/2) coth(x/2)", "D of the position / exact", "D of the rotation / exact"),
    *(diffusion_rows, "heat-diffusion"),
    key=lambda row: row[0] == "`BAOAB`",
    columns=(1, 2, 3, 4),
)


# ---- relaxation of a dipole under strong friction: BROWNIAN, BAOAB with a small moment, Euler-Maruyama ----
#
# The energy is -x kT cos(theta), with x = 2; friction, kT and therefore D = kT/G are 1. All bodies start along the
# field. The exact mean at the time 1/2 comes from the moments of Smoluchowski's equation,
#
#     d<P_l>/dt = l (l + 1) (x (<P_l-1> - <P_l+1>)/(2 l + 1) - <P_l>).
#
# BAOAB has inertia, with G/I = 1000, and needs steps below I/G. Euler-Maruyama adds the random rotation to the
# quaternion and normalises it: weak order 1.

DIPOLES, TIME, FIELD, MOMENT = 400_000, 0.5, 2.0, 1e-3
LADDERS = {"BROWNIAN": (0.125, 0.0625), "Euler-Maruyama": (0.125, 0.0625, 0.03125), "JACOBI[BAOAB]": (0.004, 0.0005)}
_LARGEST = 40  # Legendre polynomials


def relaxed() -> float:
    degree = np.arange(1, _LARGEST + 1)
    strength = degree * (degree + 1.0)
    coupling = FIELD * strength / (2 * degree + 1)
    rates = np.zeros((_LARGEST + 1, _LARGEST + 1))
    rates[degree, degree] = -strength
    rates[degree, degree - 1] = coupling
    rates[degree[:-1], degree[:-1] + 1] = -coupling[:-1]
    return float((expm(rates * TIME) @ np.ones(_LARGEST + 1))[1])


def overdamped(method: str, h: float) -> Callable[..., Any]:
    bath = ml.baths.Langevin(1.0, 1.0, jax.random.split(jax.random.key(1), DIPOLES))
    body, field = ml.RigidBody(MOMENT * jnp.ones(3)), ml.torques.HeavyTop(-FIELD)

    def run(start: ml.RigidState) -> Any:
        return ml.ensemble(method, body, field, start, dt=h, steps=round(TIME / h), bath=bath).states.attitude

    return run


def euler_maruyama(h: float) -> Callable[..., Any]:
    def step(attitude: Any, n: Any) -> tuple[Any, None]:
        up = ml.so3.to_matrix(attitude)[:, 2]
        torque = FIELD * jnp.stack([-up[:, 1], up[:, 0], jnp.zeros(DIPOLES)], -1)
        noise = jax.random.normal(jax.random.fold_in(jax.random.key(1), n), (DIPOLES, 3))
        turn = h * torque + jnp.sqrt(2 * h) * noise
        pure = jnp.concatenate([jnp.zeros((DIPOLES, 1)), turn / 2], axis=-1)
        moved = attitude + ml.so3.multiply(attitude, pure)
        return moved / jnp.linalg.norm(moved, axis=-1, keepdims=True), None

    return lambda start: jax.lax.scan(step, start.attitude, jnp.arange(round(TIME / h)))[0]


def brownian_runs() -> Iterator[tuple[str, float, Compiled]]:
    upright = jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (DIPOLES, 1))
    momenta = jnp.sqrt(MOMENT) * jax.random.normal(jax.random.key(0), (DIPOLES, 3))
    start = ml.RigidState(momenta, upright)
    for name, steps in LADDERS.items():
        for h in steps:
            made = euler_maruyama(h) if name == "Euler-Maruyama" else overdamped(name, h)
            yield name, h, compiled(made, start, bodies=DIPOLES)


def brownian_rows() -> Iterator[Sequence[str]]:
    programs = list(brownian_runs())
    seconds = in_turn([program for _, _, program in programs], 3)
    for (name, h, program), time in zip(programs, seconds, strict=True):
        cosine = np.asarray(ml.so3.to_matrix(program()))[:, 2, 2]
        error, chance = cosine.mean() - relaxed(), cosine.std() / np.sqrt(DIPOLES)
        shown = name if name == "Euler-Maruyama" else f"`{name}`"
        yield [shown, f"{h:g}", f"{error:+.4f} ± {chance:.4f}", f"{time / DIPOLES / TIME * 1e9:.0f}"]


BROWNIAN = Table(
    *("reports/heat.md", "brownian"),
    ("method", "step", "⟨cos θ⟩ - exact", "ns per body and unit of time"),
    *(brownian_rows, "heat-brownian"),
    key=lambda row: row[1] in ("0.0625", "0.0005"),
)
