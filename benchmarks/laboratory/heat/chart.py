"""Draws the error of the average of a dipole in a field against the step and against the time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from midlie_jax.plot.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SIZE, VERMILLION, new_figure

from .averages import THEIRS, Rung
from .dipole import FIELDS

_COLOURS = {
    "SYMMETRIC[BAOAB]": BLUE,
    "SYMMETRIC[OBABO]": VERMILLION,
    "SYMMETRIC[ABOBA]": GREEN,
    "Heun": "0.25",
    "ShARK": PURPLE,
    "EulerHeun": ORANGE,
}


def draw(found: Sequence[Rung], out: Path) -> None:
    """A column for each field; above against the step, below against the time."""
    figure = new_figure(11, 7.2)
    axes = figure.subplots(2, len(FIELDS), sharey=True)
    for column, x in enumerate(FIELDS):
        own = [rung for rung in found if rung.x == x]
        _panel(axes[0, column], own, "share")
        _panel(axes[1, column], own, "cost")
        axes[0, column].set_title(f"μB/kT = {x:g}", loc="left", fontsize=10)
        axes[0, column].set_xlabel("step, in units of 1/rate")
        axes[1, column].set_xlabel("ns a body and time 1/rate, one core, float32")
    for row in axes:
        row[0].set_ylabel("relative error of ⟨cos θ⟩")
    figure.set_layout_engine("constrained")
    figure.savefig(out, dpi=110)


def _panel(panel: Any, found: Sequence[Rung], across: str) -> None:
    for method in dict.fromkeys(rung.method for rung in found):
        own = sorted((r for r in found if r.method == method), key=lambda r: getattr(r, across))
        x, y = [getattr(r, across) for r in own], [r.error for r in own]
        bars = [[min(r.uncertain, 0.9 * r.error) for r in own], [r.uncertain for r in own]]
        theirs = method in THEIRS
        style: Any = {"linestyle": "--" if theirs else "-", "marker": "s" if theirs else "o", "markersize": 3.5}
        panel.errorbar(x, y, yerr=bars, color=_COLOURS[method], **style)
        name = f"diffrax {method}" if theirs else method
        end = len(own) - 1 if across == "share" else 0
        panel.annotate(
            name,
            (x[end], y[end]),
            xytext=(4, 2),
            textcoords="offset points",
            fontsize=SIZE - 1,
            color=_COLOURS[method],
        )
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.grid(alpha=0.3, color=GREY)
