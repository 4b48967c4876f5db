"""Common style of all pictures: colours for any colour vision, font size of names, and an empty figure.

Text has the colour of the axis labels, and everything except the subject is grey, so both are legible on a light and a
dark background. matplotlib is an optional dependency and is imported only when something is drawn.
"""

from typing import Any

import numpy as np

# M. Okabe and K. Ito, Color Universal Design (2008).
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"  # the first three lines: contrast above 3 on white and black
SKY, ORANGE, PURPLE, BLACK = "#56B4E9", "#E69F00", "#CC79A7", "#000000"
PLANET = "#9fb4c4"  # a pale blue, visible on white and on black, on which all bodies are visible
GREY = "#8a8a8a"  # for everything except the subject
_SEVERAL = (BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE)
FEW = len(_SEVERAL)  # number of bodies whose colours can be distinguished
SIZE = 8.5  # font size of names in a panel, points


def new_figure(width: float, height: float) -> Any:
    """An empty matplotlib figure; width and height in inches. An ImportError if matplotlib is missing."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("charts need matplotlib: pip install 'midlie_jax[plot]'.") from error
    figure = Figure(figsize=(width, height), dpi=110)
    FigureCanvasAgg(figure)
    return figure


def colours_of(count: int) -> list[str]:
    """A colour for each body; more than `FEW` range from blue through purple to orange, ever lighter, in order."""
    if count <= FEW:
        return list(_SEVERAL[:count])
    ends = np.array([[int(end[i : i + 2], 16) for i in (1, 3, 5)] for end in (BLUE, PURPLE, ORANGE)])
    mixed = np.stack([np.interp(np.linspace(0, 2, count), range(3), column) for column in ends.T], axis=1)
    return ["#" + "".join(f"{round(part):02x}" for part in colour) for colour in mixed.tolist()]


def circle(count: int) -> np.ndarray:
    """Points (count, 3) around the unit circle in the xy plane."""
    angle = np.linspace(0, 2 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def time_text(t: float) -> str:
    """A time as text on a picture: with four digits, or whole if it is large."""
    return f"{t:,.0f}" if 1e4 <= abs(t) < 1e7 else f"{t:.4g}"


def ink(axes: Any) -> Any:
    """The colour of text on a panel, which is the colour of its axis labels."""
    return axes.xaxis.label.get_color()


def is_3d(axes: Any) -> bool:
    return getattr(axes, "name", "") == "3d"


def remark(axes: Any, text: str) -> None:
    """Writes a small text at the lower left of a panel, above earlier remarks; nothing for ""."""
    mark = "midlie_jax.plot.remark"
    above = sum(other.get_gid() == mark for other in axes.texts)
    place = {"xytext": (4.0, 4.0 + 1.4 * SIZE * above), "xycoords": "axes fraction", "textcoords": "offset points"}
    if text:
        axes.annotate(text, (0.0, 0.0), fontsize=SIZE, color=ink(axes), gid=mark, **place)


def name_in_legend(axes: Any) -> None:
    style = {"fontsize": SIZE, "labelcolor": ink(axes), "markerscale": 2.0, "framealpha": 0.7, "edgecolor": "none"}
    axes.legend(loc="upper left" if is_3d(axes) else "best", **style)
