"""Error against what it costs, for the methods of this package and for other programs, on the same bodies.

A method is compiled once a scene, with its number of steps and its step as arguments, and run over a ladder of steps.
The loop is that of `integrate` and the batch is cut as `ensemble` cuts it: `tests/test_work_precision.py` holds them
to the same result.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..drivers.timing import Load, cost_clock, spread_in_words
from ..methods.registry import ENTRIES, exact_flight
from ..methods.registry import method as find_method
from ..methods.schemes import SCHEMES
from . import scenes
from .closed_form import axis_third, exact_ends
from .frontier import Ratio, ratios
from .ladder import ladder
from .rivals import RIVALS, Rival
from .rivals.problem import Point, Problem, matrix
from .scenes import Scene

BODIES, JUDGED, SIZE = 1024, 16, 1e-3
SCENES = ("P1", "asymmetric-top", "bruls-cardona", "gravity-gradient-10", "tumbling-brick")
_ROUNDING = 2.3e-16  # of an entry of a matrix, in the doubles that errors are taken in


def methods_for(scene: Scene) -> tuple[str, ...]:
    """The methods to chart for a scene: the exact flight of its body with the leading schemes, and those beside it."""
    flight = exact_flight(scene.body.moments)
    leading = [scheme for scheme in SCHEMES.values() if scheme.leading]
    if scene.torque is None:
        leading = leading[:1]
    beside = [entry.method.name for entry in ENTRIES.values() if entry.chart]
    return (*(f"{flight.name}[{scheme.name}]" for scheme in leading), *beside)


def problem(name: str, bodies: int = BODIES, judged: int = JUDGED, *, quick: bool = False) -> Problem:
    """The bodies of a scene, a little different from each other, and where the first of them end.

    The ends are those of a closed form where there is one, else of heyoka's Taylor series in 38 digits.

    Args:
        name: of a scene.
        bodies, judged: how many are moved, and how many of these are judged.
        quick: fewer and shorter runs.

    Raises:
        ValueError: unknown scene.
        ImportError: heyoka or mpmath is missing.
    """
    scene = axis_third(scenes.scene(name, jnp.float64))
    starts = scenes.perturbed(scene, bodies, SIZE)
    momentum, attitude = np.asarray(starts.momentum), np.asarray(starts.attitude)
    # To rounding: off the unit sphere programs differ in what an attitude means.
    attitude = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    states = np.concatenate([momentum, attitude], axis=1)[: min(judged, bodies)]
    ends, source, doubt = _ends(scene, states)
    repeats, longest = (2, 0.2) if quick else (5, 0.3)
    return Problem(scene, momentum, attitude, ends, source, doubt, repeats, longest)


def _ends(scene: Scene, states: np.ndarray) -> tuple[np.ndarray, str, float]:
    """Rotation matrices at the end, how they were found, and what they may be wrong by."""
    exact = exact_ends(scene, states)
    if exact is not None:
        return np.stack([matrix(q) for q in exact.attitudes]), exact.source, 1e-15
    from .rivals.heyoka_taylor import reference

    found = reference(scene, states)
    change = float(np.max(np.abs(found[:1] - reference(scene, states[:1], digits=46))))
    return found, "Taylor series in 38 digits (heyoka, MPFR)", max(change, _ROUNDING)


def measure(
    given: Problem, ours: Sequence[str], rivals: Sequence[Rival] = RIVALS, *, said: Callable[[str], None] = print
) -> tuple[list[Point], list[Point]]:
    """The points of our methods and of the rivals; one that fails is said, and the others go on."""

    def tried(label: str, points: Callable[[], Iterator[Point]]) -> list[Point]:
        said(label)
        try:
            return list(points())
        except Exception as error:  # one broken method or program must not cost the user the others
            said(f"{label} failed: {type(error).__name__}: {str(error).strip().splitlines()[0]}")
            return []

    mine = [point for name in ours for point in tried(name, lambda name=name: ladder(find_method(name), given))]
    theirs = [point for r in rivals for point in tried(r.label, lambda r=r: r.measure(given))]
    return mine, theirs


class Comparison(NamedTuple):
    """What was measured on a scene.

    Attributes:
        problem: the bodies.
        ratios: our times over others'.
        ours, rivals: points.
        warning: what the user must know of the machine, or nothing.
    """

    problem: Problem
    ratios: list[Ratio]
    ours: list[Point]
    rivals: list[Point]
    warning: str


def compared(
    name: str, ours: Sequence[str] | None = None, *, quick: bool = False, said: Callable[[str], None] = print
) -> Comparison:
    """Measures a scene."""
    load = Load()
    given = problem(name, quick=quick)
    chosen = methods_for(given.scene) if ours is None else ours
    mine, theirs = measure(given, chosen, said=said)
    return Comparison(given, ratios(mine, theirs, symplectic(mine)), mine, theirs, load.warning())


def symplectic(points: Sequence[Point]) -> list[str]:
    """The names of our methods among the points that are symplectic: kicks, and flights that are."""
    methods = {name: find_method(name) for name in dict.fromkeys(point.method for point in points)}
    return [name for name, method in methods.items() if method.symplectic]


def title(given: Problem) -> str:
    """What moved, for how long."""
    return f"{given.scene.name}: {given.scene.title}, T = {given.scene.duration:g}"


def note(found: Comparison) -> str:
    """How it was measured, for a chart."""
    given = found.problem
    return (
        f"{given.bodies} bodies side by side, one core, float64. Errors against the {given.source}, good to "
        f"{given.uncertainty:.0e}. Wide line: the frontier of our methods (filled marks; dashed if not symplectic). "
        f"Hollow marks: other programs and methods. {timing_note(found)}"
    )


def timing_note(found: Comparison) -> str:
    """How times were taken, how far they spread, and whether the machine was busy."""
    spread = spread_in_words([point.spread for point in found.ours + found.rivals])
    said = (
        f"Times: medians of {cost_clock().name}; ± or bars either way: half the distance between quartiles ({spread})"
    )
    return f"{said}. {found.warning}".strip()
