"""Measures error against cost, for the methods of this package and for other programs, on the same bodies.

Each method is compiled once for each scene, with the number of steps and the step as arguments, and run over a ladder
of steps. It uses the loop of `integrate` and moves the bodies in chunks, as `ensemble` does.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from midlie_jax.advice.timing import Load, cost_clock, spread_in_words
from midlie_jax.cli import chosen
from midlie_jax.cli.figures import write
from midlie_jax.cli.scenes import Scene
from midlie_jax.integrators.base import Method
from midlie_jax.integrators.projection import steady_potential
from midlie_jax.integrators.registry import ENTRIES, exact_flight
from midlie_jax.integrators.schemes import SCHEMES
from midlie_jax.model.torques import on_body

from . import scenes
from .frontier import SYMPLECTIC, Ratio, family, ratios
from .frontier_chart import CLOSED, LEGEND, work_precision_figure
from .kinds import kind_of, numbers
from .rivals import RIVALS, Rival
from .rivals.ladder import FREE_MOTION, exact_point, ladder
from .rivals.problem import Point, Problem

BODIES, JUDGED, SIZE = 1024, 16, 1e-3  # bodies moved, bodies whose error is measured, size of the perturbations
SCENES = ("P1", "asymmetric-top", "bruls-cardona", "gravity-gradient-10", "tumbling-brick", "orbit", "axis")
_ROUNDING = 2.3e-16  # rounding error of an entry of a matrix in float64, in which errors are computed


def methods_for(scene: Scene) -> tuple[str, ...]:
    """The names in the chart of a scene: the exact flight of its body with the leading schemes, and a few others.

    A scene without torque has the closed form, `free_motion`, which is no method, as well. Where the energy is not
    constant, methods that keep it are left out, because there they are those that do not.
    """
    flight = exact_flight(scene.body)
    leading = [scheme for scheme in SCHEMES.values() if scheme.leading]
    if scene.torque is None:
        leading = leading[:1]
    charted = [e.method for e in ENTRIES.values() if e.chart and e.method.moves(scene.body)]
    others = [method.name for method in charted if _steady(scene) or not method.keeps_energy]
    closed = () if scene.torque is not None else (FREE_MOTION,)
    return (*closed, *(f"{flight.name}[{scheme.name}]" for scheme in leading), *others)


def _steady(scene: Scene) -> bool:
    """Whether the energy of the body is constant, and known."""
    if scene.torque is None:
        return True
    return steady_potential(on_body(scene.torque, scene.body), jnp.asarray(0.0), scene.start) is not None


def problem(which: str | Scene, bodies: int = BODIES, judged: int = JUDGED, *, quick: bool = False) -> Problem:
    """Perturbed copies of the body of a scene, and the reference ends of the first of them.

    The ends are from the closed form if there is one, otherwise from heyoka's Taylor series in 38 digits.

    Args:
        which: a scene or its name.
        bodies, judged: number of bodies moved, and number of these whose error is measured.
        quick: whether to time fewer and shorter runs.
    """
    scene = scenes.scene(which)
    # Perturbed states are normalised to rounding, because programs differ in the rotations of other quaternions.
    starts = scenes.perturbed(scene.start, bodies, SIZE)
    ends, source, uncertainty = _ends(scene, numbers(starts)[: min(judged, bodies)])
    repeats, longest = (2, 0.2) if quick else (5, 0.3)
    return Problem(scene, kind_of(scene), starts, ends, source, uncertainty, repeats, longest)


def _ends(scene: Scene, states: np.ndarray) -> tuple[np.ndarray, str, float]:
    """The numbers at the end, how they were computed, and their uncertainty."""
    kind = kind_of(scene)
    if exact := kind.exact(scene, states):
        return *exact, 1e-15
    from .rivals.heyoka_taylor import reference

    ends = reference(scene, kind, states)
    change = float(np.max(kind.errors(ends[:1], reference(scene, kind, states[:1], digits=46))))
    return ends, "Taylor series in 38 digits (heyoka, MPFR)", max(change, _ROUNDING)


def measure(
    case: Problem,
    ours: Sequence[str | Method],
    rivals: Sequence[Rival] = RIVALS,
    *,
    said: Callable[[str], None] = print,
) -> tuple[list[Point], list[Point]]:
    """The points of our methods and of the rivals on a problem.

    If a method or program fails, the failure is reported and the others are still measured.

    Args:
        case: from `problem`.
        ours: our methods, as for `chosen.methods`; `FREE_MOTION` is the closed form of a problem without torque.
        said: callback that is called with progress messages and failures.
    """

    def attempt(label: str, points: Callable[[], Iterator[Point]]) -> list[Point]:
        said(label)
        try:
            return list(points())
        except Exception as error:  # the other methods and programs are measured even if one raises an error
            said(f"{label} failed: {type(error).__name__}: {str(error).strip().splitlines()[0]}")
            return []

    closed = [FREE_MOTION] if FREE_MOTION in ours else []
    methods = chosen.methods([one for one in ours if one != FREE_MOTION])
    our_points = [p for name in closed for p in attempt(name, lambda: exact_point(case))]
    our_points += [p for method in methods for p in attempt(method.name, lambda method=method: ladder(method, case))]
    rival_points = [p for rival in rivals for p in attempt(rival.label, lambda rival=rival: rival.measure(case))]
    return our_points, rival_points


class Comparison(NamedTuple):
    """The measurements on a scene.

    Attributes:
        problem: the bodies and their reference ends.
        ratios: times of our methods over those of the rivals.
        in_steps: the same of the methods alone, without the closed form; empty where there is none.
        ours, rivals: points of our methods and of the rivals.
        families: the smallest family of each of our methods, by its name.
        warning: a warning if the machine was busy, else "".
    """

    problem: Problem
    ratios: list[Ratio]
    in_steps: list[Ratio]
    ours: list[Point]
    rivals: list[Point]
    families: dict[str, str]
    warning: str


def compared(
    which: str | Scene,
    ours: Sequence[str | Method] | None = None,
    *,
    quick: bool = False,
    said: Callable[[str], None] = print,
) -> Comparison:
    """Measures our methods and the rivals on a scene.

    Args:
        which: a scene or its name.
        ours: as for `measure`; by default `methods_for` the scene.
        quick: as for `problem`.
        said: as for `measure`.
    """
    load = Load()
    case = problem(which, quick=quick)
    methods = methods_for(case.scene) if ours is None else ours
    our_points, rival_points = measure(case, methods, said=said)
    families, in_steps = families_of(our_points, methods), [p for p in our_points if p.method != FREE_MOTION]
    our_ratios = ratios(our_points, rival_points, families)
    ratios_in_steps = [] if len(in_steps) == len(our_points) else ratios(in_steps, rival_points, families)
    return Comparison(case, our_ratios, ratios_in_steps, our_points, rival_points, families, load.warning())


def families_of(points: Sequence[Point], ours: Sequence[str | Method] = ()) -> dict[str, str]:
    """The smallest family of each method of the points, by the name of the method.

    The closed form is exact to rounding, so it is symplectic and conserves what the body conserves.

    Args:
        points: from `measure`.
        ours: the methods that were measured; needed for those that are not known by their names.
    """
    known = {method.name: method for method in chosen.methods([one for one in ours if one != FREE_MOTION])}
    names = dict.fromkeys(point.method for point in points)
    return {n: SYMPLECTIC if n == FREE_MOTION else family(known.get(n) or chosen.method(n)) for n in names}


def draw(comparison: Comparison, path: str, title: str = "") -> None:
    """Writes the chart; its title is by default the scene and its duration."""
    case = comparison.problem
    figure = work_precision_figure(
        *(comparison.ours, comparison.rivals, comparison.families),
        title=title or f"{case.scene.name}: {case.scene.title}, T = {case.scene.duration:g}",
        note=note(comparison),
        measured=case.kind.measured,
        clock=cost_clock().name,
    )
    write(figure, path)


def note(comparison: Comparison) -> str:
    """The note of a chart: how errors and times were measured."""
    case = comparison.problem
    closed = any(point.method == FREE_MOTION for point in comparison.ours)
    legend = f"{LEGEND} {CLOSED}" if closed else LEGEND
    return f"{case.bodies} bodies, one core, float64. {legend} {timing_note(comparison)}"


def timing_note(comparison: Comparison) -> str:
    """How times were measured, their spread, and a warning if the machine was busy."""
    spread = spread_in_words([point.spread for point in comparison.ours + comparison.rivals])
    return f"Times: medians of {cost_clock().name}, {spread}. {comparison.warning}".strip()
