"""Draws the error of a day of a binary against its run time."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from midlie_jax.plot.style import BLUE, GREEN, ORANGE, VERMILLION

from .cost import GUBAS, Rung

_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION)
_RIVAL = "0.35"


def draw(found: dict[int, list[Rung]], out: Path) -> None:
    """One panel for each degree of the gravity; each method is a line, labelled at its end."""
    figure, axes = plt.subplots(1, len(found), figsize=(11, 4.6), sharey=True, layout="constrained")
    for panel, (degree, rungs) in zip(np.atleast_1d(axes), found.items(), strict=True):
        _panel(panel, degree, rungs)
    axes[0].set_ylabel("largest relative error after a simulated day")
    figure.savefig(out, dpi=110)
    plt.close(figure)


def _panel(panel: Any, degree: int, rungs: list[Rung]) -> None:
    for number, method in enumerate(dict.fromkeys(rung.method for rung in rungs)):
        own = sorted((rung for rung in rungs if rung.method == method), key=lambda rung: rung.milliseconds)
        x, y = [rung.milliseconds for rung in own], [rung.error for rung in own]
        panel.loglog(x, y, "o-", color=_COLOURS[number], markersize=4)
        label: Any = {"xytext": (-6, -3), "textcoords": "offset points", "ha": "right", "fontsize": 9}
        panel.annotate(method, (x[0], y[0]), color=_COLOURS[number], **label)
    seconds, error = GUBAS[degree]
    panel.loglog([1e3 * seconds], [error], "s", color=_RIVAL)
    place: Any = {"xytext": (-6, 8), "textcoords": "offset points", "ha": "right", "fontsize": 9}
    panel.annotate("GUBAS", (1e3 * seconds, error), color=_RIVAL, **place)
    faster = 1e3 * seconds / min(rung.milliseconds for rung in rungs if rung.error <= error)
    words = f"gravity of degree {degree}: {float(f'{faster:.1g}'):,.0f} times faster than GUBAS"
    panel.set_title(words, loc="left", fontsize=11, weight="bold")
    panel.set_xlabel("run time per simulated day and binary, one core [ms]")
    panel.grid(alpha=0.3)
    panel.margins(0.1)
    panel.set_xlim(left=3e-4)  # room for the labels
