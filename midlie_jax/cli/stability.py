"""`midlie stability`: maps of the worst energy error of a method over steps and one property of a scene."""

import argparse
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._xla.compiler import compiler_options
from ..advice.trials import FAST, Facts, stability_limits
from ..drivers.integrate import integrate
from ..integrators.base import Method
from ..integrators.limits import resonance
from ..integrators.registry import DEFAULT
from ..integrators.registry import method as find_method
from ..integrators.splitting import Splitting
from ..model.bodies import RigidBody
from ..model.observables import energy, kinetic_energy
from ..model.states import RigidState
from ..model.torques import TorqueLike, on_body, potential_of
from ..model.torques.base import Torque
from ..plot.style import ORANGE, PURPLE, VERMILLION
from . import chosen
from .figures import INK, heading, new_figure, write
from .scenes import Scene
from .tables import require, show_table

METHODS = (DEFAULT, "JACOBI[SRKN6b]", "LIEMID[EA]", "LIEMID[I]", "AKW", "NMB", "DMV[EA]", "GBS12")
STEPS = 10_000
BLOWN_UP = 1.0  # an energy error of the size of the energy
_SPAN = 50  # steps whose states are in memory at once
_STEPS_RANGE = (0.03, 6.0)  # the smallest and the largest step, times the fastest rate of the scene
_RATES_RANGE = (0.1, 10.0)  # spins and frequencies of the field, over the fastest rate of the scene
_FLATTEST = 0.98  # the end of a sweep of shapes, as a fraction of the path from a ball to the thinnest body
_ORDERS = (1, 2, 3)  # k of the drawn step resonances
_WIDTH, _HEIGHT = 2.0, 2.25  # the size of a panel with its share of the margins, inches
_MARGINS = 0.85, 1.95  # left and right of all panels, above and below them, inches
_LEAST_ERROR = 1e-14
# The colours of Okabe and Ito that are visible on all colours of the map.
_LINES: dict[str, dict[str, Any]] = {
    name: {"label": label, "color": colour, "linestyle": dash, "linewidth": width}
    for name, label, colour, dash, width in (
        ("reach", "reach: largest turn a step", ORANGE, "-", 2.2),
        ("stability", "limit of h ω: unstable, or several solutions", VERMILLION, (0, (4, 1.5)), 2.2),
        ("resonance", "nutation resonances h ω = π, π/2, π/3", "#FFFFFF", (0, (1, 1.2)), 1.6),
    )
}
_NO_SOLUTION: dict[str, Any] = {"facecolor": "#d9d9d9", "edgecolor": "#8a8a8a", "hatch": "////"}


class Scaled(Torque):
    """A torque times a number."""

    factor: Array
    torque: TorqueLike

    def __call__(self, t: Any, state: Any) -> Array:
        return self.factor * self.torque(t, state)

    def potential(self, t: Any, state: Any) -> Array:
        return self.factor * potential_of(self.torque)(t, state)

    def on(self, body: Any) -> Torque:
        return Scaled(self.factor, on_body(self.torque, body))


class Sweep(NamedTuple):
    """A range of values of one property of a scene."""

    name: str
    label: str  # of its axis
    values: np.ndarray  # (n,), ascending
    own: float  # the value of the scene itself
    logarithmic: bool  # whether the axis is
    moments: np.ndarray  # of the bodies, (n, 3)
    momenta: np.ndarray
    factors: np.ndarray  # of the torque, (n,)


class Map(NamedTuple):
    """The result of a method on one sweep; each array has a row for each value and a column for each step."""

    method: str  # its name
    worst: np.ndarray  # the largest |E - E0| over (K0 + |V0|) before a failure, K0 and V0 the energies at the start
    failed: np.ndarray  # whether a solve failed (`ok` was False) before the run blew up
    blown_up: np.ndarray  # whether the error reached 1 or a number stopped being finite before a solve failed


def sweeps(scene: Scene, count: int) -> tuple[np.ndarray, list[Sweep]]:
    """The steps, (count,), and the sweeps supported by the scene: spin, anisotropy, and stiffness of the field.

    The anisotropy interpolates the moments linearly. It is 0 for a ball with the same sum and 1 for the scene, and ends
    at the thinnest real body on this line, a rod or a disc. Spins keep their axis, and bodies of another shape their
    angular velocity.

    Raises:
        ValueError: the energy of the scene is not constant or not defined, or the body neither spins nor is in a field.
    """
    if not isinstance(scene.body, RigidBody):
        raise ValueError(
            "a stability map needs a rigid body without translation, but the body of scene "
            f"{scene.name!r} is a {type(scene.body).__name__}; choose another scene."
        )
    try:
        energy(scene.body, scene.torque, scene.start)
    except ValueError as error:
        reason = str(error).split(";")[0].split(":")[0]
        raise ValueError(
            f"scene {scene.name!r} has no constant energy to measure ({reason}); choose another."
        ) from error
    moments, momentum = (np.asarray(x, np.float64) for x in (scene.body.moments, scene.start.momentum))
    velocity = momentum / moments
    facts = jax.jit(partial(Facts.of, find_method(DEFAULT), scene.body, scene.torque))
    rates = facts(scene.start, jnp.zeros((), scene.start.momentum.dtype)).rates
    speed, field = float(np.linalg.norm(velocity)), float(np.max(np.abs(rates)))
    fastest = max(speed, field)
    if fastest == 0:
        raise ValueError(f"the body of scene {scene.name!r} is at rest and has no field; choose another scene.")
    steps = np.geomspace(*_STEPS_RANGE, count) / fastest
    alike, still, ones = np.tile(moments, (count, 1)), np.tile(momentum, (count, 1)), np.ones(count)
    found: list[Sweep] = []
    unit = f"rad/{scene.time_unit or 'time'}"

    def around(own: float) -> np.ndarray:
        """Spins or frequencies around the fastest rate of the scene, with the scene's own."""
        return np.geomspace(min(_RATES_RANGE[0] * fastest, own / 2), _RATES_RANGE[1] * fastest, count)

    if speed:
        rates = around(speed)
        spun = rates[:, None] * momentum / speed
        found.append(Sweep("spin", f"spin |Ω|  [{unit}]", rates, speed, True, alike, spun, ones))
    ball = np.full(3, moments.mean())
    if np.ptp(moments) > 1e-6 * moments.max():
        # Along this line the second moments of mass (I_j + I_k - I_i) / 2 reach zero one by one; the first zero is its
        # end.
        slope, start = (moments.sum() / 2 - moments) - (ball.sum() / 2 - ball), ball.sum() / 2 - ball
        end = float(np.min(np.where(slope < 0, -start / np.where(slope < 0, slope, -1), np.inf)))
        shares = np.linspace(0, _FLATTEST * end, count)
        shapes = ball + shares[:, None] * (moments - ball)
        found.append(Sweep("anisotropy", "anisotropy a  [-]", shares, 1.0, False, shapes, shapes * velocity, ones))
    if field:
        rates, label = around(field), f"field frequency ω  [{unit}]"
        found.append(Sweep("stiffness", label, rates, field, True, alike, still, (rates / field) ** 2))
    return steps, found


def measure(
    method: str | Method, scene: Scene, steps: np.ndarray, varied: Sequence[Sweep], number: int = STEPS
) -> list[Map]:
    """The maps of a method, one for each sweep: `number` steps of each length for each value, as one batch."""
    (method,) = chosen.methods([method])
    rows = [
        np.concatenate([np.repeat(getattr(s, name), len(steps), axis=0) for s in varied])
        for name in ("moments", "momenta", "factors")
    ]
    moments, momenta, factors = (jnp.asarray(x, scene.start.momentum.dtype) for x in rows)
    starts = RigidState(momenta, jnp.tile(scene.start.attitude, (len(factors), 1)))
    dt = jnp.asarray(np.tile(steps, len(factors) // len(steps)), factors.dtype)
    found = runs(method, scene.torque, moments, starts, factors, dt, number)
    ends = np.cumsum([len(s.values) for s in varied])[:-1]
    parts = (np.split(x.reshape(-1, len(steps)), ends) for x in found)
    return [Map(method.name, *part) for part in zip(*parts, strict=True)]


def runs(
    method: Method,
    torque: TorqueLike | None,
    moments: Array,
    starts: RigidState,
    factors: Array,
    dt: Array,
    number: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`worst`, `failed` and `blown_up` of `Map` for n bodies, each with its moments, factor of the torque, and step."""
    span = min(_SPAN, number)
    spans, method = -(-number // span), method.fitted(RigidBody(moments))

    def of_one(moments: Array, start: RigidState, factor: Array, dt: Array) -> tuple[Array, Array, Array]:
        body = RigidBody(moments)
        scaled = None if torque is None else Scaled(factor, torque)
        first = energy(body, scaled, start)
        kinetic = kinetic_energy(body, start)
        scale = kinetic + abs(first - kinetic)

        def take(carry: Any, n: Array) -> tuple[Any, None]:
            """The worst error while it can be trusted, and whether a failed solve or a blow-up came first."""
            state, worst, failed, blown_up = carry
            path = integrate(method, body, scaled, state, dt=dt, steps=span, first_step=n * span)
            errors = jnp.abs(energy(body, scaled, path.states) - first) / scale
            trusted = jnp.arange(span + 1, dtype=jnp.int32) < path.first_bad
            going_on = ~failed & ~blown_up
            largest = jnp.max(jnp.where(trusted & jnp.isfinite(errors), errors, 0))
            worst = jnp.where(going_on, jnp.maximum(worst, largest), worst)
            infinite = ~jnp.all(jnp.isfinite(jnp.where(trusted, 0, jnp.sum(path.states.momentum, axis=-1))))
            blows_up = going_on & ((largest >= BLOWN_UP) | infinite)
            last = jax.tree.map(lambda leaf: leaf[-1], path.states)
            return (last, worst, failed | (going_on & ~blows_up & ~path.ok), blown_up | blows_up), None

        nothing = jnp.zeros((), bool)
        carry = start, jnp.zeros_like(dt), nothing, nothing
        return jax.lax.scan(take, carry, jnp.arange(spans, dtype=jnp.int32))[0][1:]

    arguments = moments, starts, factors, dt
    compiled = jax.jit(jax.vmap(of_one)).lower(*arguments).compile(compiler_options=compiler_options(len(moments)))
    worst, failed, blown_up = map(np.asarray, compiled(*arguments))
    return worst, failed, blown_up


def lines(method: str | Method, scene: Scene, sweep: Sweep) -> list[tuple[str, np.ndarray]]:
    """The limits of `integrators/limits.py` for each value of a sweep, from the state at the start.

    Each has its kind, "reach", "stability" or "resonance", and the steps, (n,); NaN where there is no limit.
    """
    method = chosen.method(method)
    dtype = scene.start.momentum.dtype

    def facts(moments: Array, momentum: Array, factor: Array) -> Facts:
        torque = None if scene.torque is None else Scaled(factor, scene.torque)
        state = RigidState(momentum, scene.start.attitude)
        return Facts.of(method, RigidBody(moments), torque, state, jnp.zeros((), dtype))

    rows = (jnp.asarray(x, dtype) for x in (sweep.moments, sweep.momenta, sweep.factors))
    found = jax.tree.map(np.asarray, jax.jit(jax.vmap(facts))(*rows))
    rates = np.abs(found.rates)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = method.reach / found.fastest_turn
        stability = np.min(stability_limits(method, found.rates) / rates, axis=-1)
        field = np.max(rates, axis=-1)
        kicked = (field > 0) & (found.nutation > FAST * field) & isinstance(method, Splitting)
        steps = [resonance(found.nutation, k) for k in _ORDERS]
        resonances = [np.where(kicked & (h < reach), h, np.nan) for h in steps]
    limits = [("reach", reach), ("stability", stability), *(("resonance", steps) for steps in resonances)]
    return [(kind, steps) for kind, steps in limits if np.any(np.isfinite(steps))]


def stability(options: argparse.Namespace) -> None:
    require("matplotlib")
    scene, methods = chosen.scene(options.scene), chosen.methods(options.methods or METHODS)
    steps, varied = sweeps(scene, options.grid)
    if options.sweeps:
        there = [sweep.name for sweep in varied]
        if missing := [name for name in options.sweeps if name not in there]:
            raise ValueError(
                f"scene {scene.name!r} has no {' and no '.join(missing)} to vary; it has {', '.join(there)}."
            )
        varied = [sweep for sweep in varied if sweep.name in options.sweeps]
    for method in methods:  # raises for an unsupported method, before any method is measured
        method.fitted(scene.body)
    path = options.out or f"stability-{scene.name}.png"
    maps, rows = [], []
    for method in methods:
        began = time.perf_counter()
        maps.append(measure(method, scene, steps, varied, options.steps))
        seconds = [f"{time.perf_counter() - began:.0f}", *[""] * len(varied)]
        for sweep, found, told in zip(varied, maps[-1], seconds, strict=False):
            shares = (f"{100 * np.mean(x):.0f}" for x in (found.blown_up, found.failed))
            good = found.worst[~(found.failed | found.blown_up)]
            median = np.median(good) if good.size else np.nan
            rows.append([method.name, sweep.name, *shares, f"{median:.0e}", told])
    show_table(["method", "sweep", "blows up [%]", "fails [%]", "median error elsewhere", "time [s]"], rows)
    limits = {(method.name, sweep.name): lines(method, scene, sweep) for method in methods for sweep in varied}
    note = (
        f"Each point of a map is one run of {options.steps} steps from the start of the scene with its spin, shape or "
        "field changed. Lines: theoretical limits for the initial state."
    )
    title = f"{scene.name}: {scene.title}"
    write(stability_figure(maps, limits, steps, varied, title=title, note=note, time_unit=scene.time_unit), path)
    print(f"\nwrote {path}")


def stability_figure(
    maps: Sequence[Sequence[Map]],
    lines: Mapping[tuple[str, str], Sequence[tuple[str, np.ndarray]]],
    steps: np.ndarray,
    sweeps: Sequence[Sweep],
    *,
    title: str,
    note: str,
    time_unit: str,
) -> Any:
    """The picture, a matplotlib figure."""
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Patch
    from matplotlib.patheffects import withStroke

    columns, rows = len(maps), len(sweeps)
    width = max(_WIDTH * columns + _MARGINS[0], 12.2)  # inches, for the legend beside the scale of colours
    height = _HEIGHT * rows + _MARGINS[1]
    figure = new_figure(width, height)
    heading(figure, title, note)
    figure.subplots_adjust(left=0.75 / width, right=1 - 0.15 / width, bottom=1.0 / height, wspace=0.08, hspace=0.16)
    norm = LogNorm(_LEAST_ERROR, BLOWN_UP)
    panels = figure.subplots(rows, columns, sharex=True, sharey="row", squeeze=False)
    drawn: dict[str, Any] = {}
    image: Any = None
    for row, sweep in enumerate(sweeps):
        for column, of_method in enumerate(maps):
            axes, found = panels[row, column], of_method[row]
            image = _map(axes, found, steps, sweep, norm)
            for kind, limit in lines.get((found.method, sweep.name), ()):
                style = _LINES[kind]
                outline = [withStroke(linewidth=style["linewidth"] + 1.4, foreground="black")]
                (drawn[kind],) = axes.plot(limit, sweep.values, zorder=3, path_effects=outline, **style)
            if row == 0:
                axes.set_title(found.method, fontsize=11, weight="bold", color=INK)
            if column == 0:
                axes.set_ylabel(sweep.label, fontsize=9.5, color=INK)
    for axes in panels[-1]:
        axes.set_xlabel(f"step h  [{time_unit or 'time'}]", fontsize=9.5, color=INK)
    scale = figure.add_axes([0.75 / width, 0.42 / height, 2.6 / width, 0.13 / height])
    bar = figure.colorbar(image, cax=scale, orientation="horizontal")
    bar.set_label("worst energy error, of |K| + |V| at the start  [-]", fontsize=8.5, color=INK, labelpad=1)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.set_ticks([1e-14, 1e-10, 1e-6, 1e-2])
    blown_up = Patch(facecolor="black", label="blows up: error over 1")
    failed = Patch(label="a solve fails (ok is False)", **_NO_SOLUTION)
    own = figure.axes[0].plot([], [], color=PURPLE, lw=3, label="the scene's own value")
    handles = [blown_up, failed, *(drawn[kind] for kind in _LINES if kind in drawn), *own]
    style = {"fontsize": 8.5, "facecolor": "#b9c6cc", "edgecolor": "none", "labelcolor": INK, "ncols": 3}
    corner = (1 - 0.1 / width, 0.06 / height)
    figure.legend(handles=handles, loc="lower right", bbox_to_anchor=corner, **style)
    return figure


def _map(axes: Any, found: Map, steps: np.ndarray, sweep: Sweep, norm: Any) -> Any:
    """Draws a map: colours, black where the run blew up, hatched where a solve failed."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    x, y = _edges(steps, True), _edges(sweep.values, sweep.logarithmic)
    axes.set(xscale="log", yscale="log" if sweep.logarithmic else "linear", xlim=x[[0, -1]], ylim=y[[0, -1]])
    axes.tick_params(which="both", labelsize=8, colors=INK)
    # The hatched background is visible where nothing is drawn over it.
    axes.add_patch(Rectangle((0, 0), 1, 1, transform=axes.transAxes, linewidth=0, **_NO_SOLUTION))
    worst = np.ma.masked_where(found.failed | found.blown_up, np.clip(found.worst, _LEAST_ERROR, BLOWN_UP))
    image = axes.pcolormesh(x, y, worst, norm=norm, cmap="viridis", zorder=1.5)
    black = np.ma.masked_where(~found.blown_up, np.ones(found.worst.shape))
    axes.pcolormesh(x, y, black, cmap=ListedColormap(["black"]), zorder=1.6)
    if y[0] < sweep.own < y[-1]:
        axes.plot([0, 0.045], [sweep.own] * 2, color=PURPLE, lw=3, transform=axes.get_yaxis_transform(), zorder=5)
    return image


def _edges(middles: np.ndarray, logarithmic: bool) -> np.ndarray:
    places = np.log(middles) if logarithmic else middles
    half = (places[1] - places[0]) / 2
    edges = np.append(places - half, places[-1] + half)
    return np.exp(edges) if logarithmic else edges
