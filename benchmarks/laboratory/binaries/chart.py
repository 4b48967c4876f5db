"""Draws the error of a day of a binary against its time, and its energy over ten years."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from .cost import GUBAS, Rung

_RIVAL = "0.35"


def draw(found: dict[int, list[Rung]], out: Path) -> None:
    """One panel for each degree of the gravity; each method is a line, labelled at its end."""
    figure, axes = plt.subplots(1, len(found), figsize=(11, 4.6), sharey=True, layout="constrained")
    for panel, (degree, rungs) in zip(np.atleast_1d(axes), found.items(), strict=True):
        _panel(panel, degree, rungs)
    axes[0].set_ylabel("largest relative error after a day")
    figure.savefig(out, dpi=110)
    plt.close(figure)


def _panel(panel: Any, degree: int, rungs: list[Rung]) -> None:
    for number, method in enumerate(dict.fromkeys(rung.method for rung in rungs)):
        own = sorted((rung for rung in rungs if rung.method == method), key=lambda rung: rung.milliseconds)
        x, y = [rung.milliseconds for rung in own], [rung.error for rung in own]
        panel.loglog(x, y, "o-", color=f"C{number}", markersize=4)
        label: Any = {"xytext": (-6, -3), "textcoords": "offset points", "ha": "right", "fontsize": 9}
        panel.annotate(method, (x[0], y[0]), color=f"C{number}", **label)
    seconds, error = GUBAS[degree]
    panel.loglog([1e3 * seconds], [error], "s", color=_RIVAL)
    place: Any = {"xytext": (-6, 8), "textcoords": "offset points", "ha": "right", "fontsize": 9}
    panel.annotate("GUBAS", (1e3 * seconds, error), color=_RIVAL, **place)
    panel.set_title(f"gravity of degree {degree}", loc="left", fontsize=10)
    panel.set_xlabel("milliseconds a day and binary, one core")
    panel.grid(alpha=0.3)
    panel.margins(0.1)
    panel.set_xlim(left=2e-3)  # room for the labels
