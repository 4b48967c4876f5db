"""heyoka: Taylor's method with adaptive step and order, compiled for the equations and for a batch of bodies.

Biscani & Izzo, MNRAS 504 (2021) 2614. At each tolerance several variants of the integrator are timed in turn, and the
point on the chart is the quickest of them. They differ in the number of bodies in a batch, in the option `fast_math`,
and, on processors with AVX-512, in the option `force_avx512`. Which is the quickest depends on the processor and the
tolerance. On a processor with AVX2 it was the recommended number of bodies; `fast_math` changed the time by up to a
tenth, down at large tolerances and up at small ones; twice as many bodies took 0.97 to 1.2 times as long, four times as
many 1 to 1.4 times. On a processor with AVX-512 twice as many bodies with `fast_math` took 0.75 times as long as the
recommended number without it. Left out, because they are never the quickest: `compact_mode` (1.2 times as long and
more), `slp_vectorize`, and the integrator for a single body (twice as long and more). heyoka's `ensemble` functions
spread copies of an integrator over threads, which is of no use on one core.

Each variant is built anew for each tolerance, because the order of the series depends on it. The time of the same
Python loop over batches without integration steps is subtracted, because it is not part of heyoka."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from midlie_jax._xla.compiler import vector_width_options
from midlie_jax.cli.scenes import Scene
from midlie_jax.model.bodies import RigidBody
from midlie_jax.model.rotor import SymmetricRotor

from ..kinds import SPINNING, Kind, orbit_of, orbit_rates, orbit_start
from .problem import Point, Problem, program

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14, 1e-15)
# A variant that takes so many times as long as the quickest, and is not the second, is not built for the smaller
# tolerances. There the series have more terms, and wide batches, which need more registers than there are, fall behind
# further; they are also the variants that take seconds to build.
_HOPELESS = 1.25


class Variant(NamedTuple):
    """A way to build the integrator.

    Attributes:
        width: bodies in a batch.
        fast_math, force_avx512: heyoka's options of these names.
    """

    width: int
    fast_math: bool
    force_avx512: bool = False

    def __str__(self) -> str:
        options = [name for name in ("fast_math", "force_avx512") if getattr(self, name)]
        return ", ".join([f"{self.width} bodies a batch", *options])


def variants(bodies: int) -> list[Variant]:
    """The variants that are worth trying on this machine for so many bodies."""
    width = program("heyoka").recommended_simd_size()
    found = [Variant(width, False), Variant(width, True), Variant(2 * width, True)]
    if vector_width_options():  # the processor has AVX-512, and our programs use it
        found += [Variant(2 * width, True, True), Variant(4 * width, True, True)]
    # A batch cannot be wider than the number of bodies.
    return list(dict.fromkeys(variant._replace(width=min(variant.width, bodies)) for variant in found))


def equations(scene: Scene, kind: Kind, count: int) -> list[Any]:
    """The equations of a state of `count` numbers as heyoka's expressions; an orbit is integrated along with it."""
    heyoka = program("heyoka")

    state = heyoka.make_vars(*(f"s{i}" for i in range(count)))
    orbit, field = orbit_of(scene), kind.rates(scene)
    if orbit is None:
        return list(zip(state, field(state), strict=True))
    orbit_state = heyoka.make_vars("x", "y", "z", "u", "v", "w")
    derivatives = (*field(state, tuple(orbit_state[:3])), *orbit_rates(orbit, orbit_state))
    return list(zip((*state, *orbit_state), derivatives, strict=True))


class _Integrator:
    """A variant of the integrator, built for a tolerance, and the batches that it moves."""

    def __init__(self, variant: Variant, system: list[Any], states: np.ndarray, tolerance: float):
        width = variant.width
        self.variant = variant
        self.batches = [np.ascontiguousarray(states[i : i + width].T) for i in range(0, len(states) - width + 1, width)]
        options = {"fast_math": variant.fast_math, "force_avx512": variant.force_avx512}
        build = program("heyoka").taylor_adaptive_batch
        self.taylor = build(system, self.batches[0].copy(), tol=tolerance, **options)

    @property
    def bodies(self) -> int:
        return self.variant.width * len(self.batches)

    def loop(self, end: float) -> None:
        """Moves all bodies to the time `end`."""
        state, set_time, propagate = self.taylor.state, self.taylor.set_time, self.taylor.propagate_until
        for batch in self.batches:
            set_time(0.0)
            state[:] = batch
            propagate(end)

    def ends(self, end: float, bodies: int) -> tuple[np.ndarray, float]:
        """The numbers of at least the first `bodies` bodies at the time `end`, and the mean number of steps."""
        ends, steps = [], []
        for batch in self.batches[: -(-bodies // self.variant.width)]:
            self.taylor.set_time(0.0)
            self.taylor.state[:] = batch
            self.taylor.propagate_until(end)
            ends.append(self.taylor.state.T.copy())
            steps.append(np.mean([outcome[3] for outcome in self.taylor.propagate_res]))
        return np.concatenate(ends), float(np.mean(steps))


def measure(problem: Problem, tolerances: tuple[float, ...] = TOLERANCES, label: str = "heyoka") -> Iterator[Point]:
    """A point for each tolerance, of the variant that is quickest there; `tolerances` must decrease."""
    end, orbit, states = problem.scene.duration, orbit_of(problem.scene), problem.states
    count = states.shape[1]
    system = equations(problem.scene, problem.kind, count)
    if orbit is not None:
        states = np.concatenate([states, np.tile(orbit_start(orbit), (len(states), 1))], axis=1)
    promising = variants(len(states))
    for tolerance in tolerances:
        integrators = [_Integrator(variant, system, states, tolerance) for variant in promising]
        loops = [lambda it=it, end=time: it.loop(end) for time in (end, 0.0) for it in integrators]
        timings = problem.timed_in_turn(loops)
        found: list[tuple[float, float, _Integrator]] = []  # seconds for one body, spread, of which integrator
        for integrator, timing, idle in zip(integrators, timings, timings[len(integrators) :], strict=False):
            part = max(1 - idle.seconds / timing.seconds, 0.5)  # heyoka's fraction of the time of the loop
            found.append((part * timing.seconds / integrator.bodies, timing.spread / part, integrator))
        found.sort(key=lambda entry: entry[0])
        cost, spread, best = found[0]
        promising = [
            it.variant for rank, (seconds, _, it) in enumerate(found) if rank < 2 or seconds < _HOPELESS * cost
        ]
        ends, steps = best.ends(end, len(problem.ends))
        setting = f"tol {tolerance:.0e}, {best.variant}"
        yield Point(label, setting, problem.error(ends[:, :count]), cost, float("nan"), steps, spread)


def reference(scene: Scene, kind: Kind, states: np.ndarray, digits: int = 38) -> np.ndarray:
    """The numbers (m, k) at the end of a scene from those at its start, by Taylor's method in `digits` digits."""
    heyoka = program("heyoka")

    bits = int(digits * 3.33) + 2
    exact = np.vectorize(lambda x: heyoka.real(float(x), prec=bits), otypes=[object])
    orbit = orbit_of(scene)
    orbit_state = np.zeros(0) if orbit is None else orbit_start(orbit)
    system = equations(scene, kind, states.shape[1])
    first = np.array(list(exact(np.concatenate([states[0], orbit_state]))))
    integrator = heyoka.taylor_adaptive(system, first, fp_type=heyoka.real, prec=bits, compact_mode=True)
    ends = []
    for start in states:
        integrator.time = heyoka.real(0.0, prec=bits)
        for i, x in enumerate(np.concatenate([start, orbit_state])):
            integrator.state[i] = heyoka.real(float(x), prec=bits)
        integrator.propagate_until(heyoka.real(scene.duration, prec=bits))
        ends.append(np.array([float(x) for x in integrator.state[: states.shape[1]]]))
    return np.stack(ends)


# ---- the seven equations of a whole top, where only its axis is asked for: what a program pays for the spin ----

LABEL = "heyoka, with the spin"


def whole(problem: Problem) -> Problem:
    """The problem of the axis, to be solved with momentum and attitude in the body frame."""
    scene: Any = problem.scene
    starts: Any = problem.starts
    rotor = scene.body
    moments = jnp.stack([rotor.moment, rotor.moment, rotor.known_along])
    start = scene.start.with_attitude()
    as_body = Scene(
        *(scene.name, scene.title, RigidBody(moments), scene.torque, start),
        *(scene.dt, scene.duration, scene.source, scene.units),
    )
    return problem._replace(scene=as_body, kind=SPINNING, starts=starts.with_attitude())


def measure_spinning(problem: Problem) -> Iterator[Point]:
    """A point for each tolerance; none where the state is not an axis."""
    if isinstance(problem.scene.body, SymmetricRotor):
        yield from measure(whole(problem), label=LABEL)
