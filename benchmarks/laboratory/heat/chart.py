"""Draws the error of the average of a dipole in a field against the step and against the time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from midlie_jax.cli.figures import few_colours
from midlie_jax.cli.line_labels import End, label_ends
from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, new_figure

from .averages import OURS, THEIRS, Rung
from .dipole import FIELDS

_COLOURS = dict(zip((*OURS, *THEIRS), (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY), strict=True))
_SIZE = 9.0  # font size of names, points
_LEAST, _MOST = 1e-5, 1.0  # errors that are drawn


def draw(found: Sequence[Rung], out: Path) -> None:
    """A column for each field; above against the step, below against the time."""
    figure = new_figure(13, 8.4)
    axes = figure.subplots(2, len(FIELDS), sharey=True)
    figure.subplots_adjust(left=0.06, right=0.99, top=0.9, bottom=0.07, wspace=0.06, hspace=0.22)
    title = "BAOAB and ABOBA reach a given error in less time than the diffrax solvers"
    figure.suptitle(title, x=0.06, ha="left", fontsize=13, weight="bold")
    for column, x in enumerate(FIELDS):
        own = [rung for rung in found if rung.x == x and rung.error < _MOST]
        steps, times = axes[:, column]
        by_step, by_time = _panel(steps, own, "share"), _panel(times, own, "cost")
        steps.set_title(f"μB/kT = {x:g}", loc="left", fontsize=10)
        steps.set_xlabel("step [1/rate]")
        times.set_xlabel("run time per body and 1/rate of simulated time [ns]")
        label_ends(steps, [_end(lines[-1]) for method, lines in by_step.items() if method != "EulerHeun"], size=_SIZE)
        _name(steps, by_step["EulerHeun"][-1], (0, 9), "center")
        for method, lines in by_time.items():
            theirs = method in THEIRS
            _name(times, lines[-1 if theirs else 0], (6 if theirs else -6, 0), "left" if theirs else "right")
    for row in axes:
        row[0].set_ylabel("relative error of ⟨cos θ⟩ [-]")
    figure.savefig(out, dpi=110)
    out.write_bytes(few_colours(out.read_bytes()))


Place = tuple[str, float, float]  # a method and a point of its line


def _end(place: Place) -> End:
    method, x, y = place
    return End(_name_of(method), _COLOURS[method], x, y)


def _name_of(method: str) -> str:
    return f"diffrax {method}" if method in THEIRS else method.removeprefix("SYMMETRIC[").removesuffix("]")


def _name(panel: Any, place: Place, offset: tuple[float, float], side: str) -> None:
    method, *point = place
    options: Any = {"textcoords": "offset points", "ha": side, "va": "center", "fontsize": _SIZE}
    panel.annotate(_name_of(method), point, xytext=offset, color=_COLOURS[method], **options)


def _panel(panel: Any, found: Sequence[Rung], across: str) -> dict[str, list[Place]]:
    """Draws one panel; returns the places of the points of each method."""
    panel.set_xscale("log")
    panel.set_yscale("log")
    places = dict[str, list[Place]]()
    for method in dict.fromkeys(rung.method for rung in found):
        own = sorted((r for r in found if r.method == method), key=lambda r: getattr(r, across))
        x, y = [getattr(r, across) for r in own], [r.error for r in own]
        bars = [[min(r.uncertain, 0.9 * r.error) for r in own], [r.uncertain for r in own]]
        theirs = method in THEIRS
        style: Any = {"linestyle": "--" if theirs else "-", "marker": "s" if theirs else "o", "markersize": 3.5}
        panel.errorbar(x, y, yerr=bars, color=_COLOURS[method], **style)
        places[method] = [(method, *place) for place in zip(x, y, strict=True)]
    low, high = (end(getattr(r, across) for r in found) for end in (min, max))
    panel.set_xlim(low / (1.2 if across == "share" else 3.5), high * (1.2 if across == "share" else 14))
    panel.set_ylim(_LEAST, _MOST)
    panel.grid(alpha=0.3, color=GREY)
    return places
