"""The chart of a fit: measured and fitted angular velocities, and the residuals."""

import numpy as np

from ..figures import heading, new_figure, panel, write

_COLOURS = ("#0072B2", "#D55E00", "#009E73")  # of Okabe and Ito


def fit_chart(
    name: str,
    times: np.ndarray,
    rates: np.ndarray,
    curve_times: np.ndarray,
    curves: np.ndarray,
    residuals: np.ndarray,
    unit: str,
    path: str,
) -> None:
    """Writes a PNG of a fit: rates (n, 3) in rad/s, NaN where missing; residuals (n, 3), model minus measurement."""
    figure = new_figure(11.0, 8.0)
    heading(figure, f"{name}: a free body", "Lines: the fitted motion. Dots: the measurements and the residuals.")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    panel(above, "Angular velocity about the principal axes", "", "Ω  [rad/s]")
    panel(below, "Residuals: model minus measurement", "Time t  [s]", f"Residual  [{unit}]")
    for i, colour in enumerate(_COLOURS):
        above.plot(curve_times, curves[:, i], color=colour, linewidth=1.2, label=f"Ω{i + 1}")
        above.plot(times, rates[:, i], ".", color=colour, markersize=4)
        below.plot(times, residuals[:, i], ".", color=colour, markersize=4)
    above.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    write(figure, path)
