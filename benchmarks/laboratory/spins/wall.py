"""A domain wall driven by a field along the easy axis: its speed beside Walker's closed form.

A chain with exchange J, easy axis z, hard axis x,

    H = -J sum S_i . S_i+1 - K sum z^2 + K' sum x^2 - B sum z.

In the continuum a wall between z = 1 on the left and z = -1 on the right, with its spins at the azimuth p from x, is
tan(theta/2) = exp((position - X)/d) with the width d = sqrt(J/(2 (K + K' cos^2 p))). In S' = gamma B x S + alpha S x S'
it moves by theta' = -sin(theta) X'/d, and

    theta' = gamma K' sin(theta) sin 2p - alpha sin(theta) p',    sin(theta) p' = gamma B sin(theta) + alpha theta'.

Below the field alpha K' the azimuth rests:

    X' = gamma d B / alpha,    sin 2p = -B / (alpha K')

(N. L. Schryer and L. R. Walker, J. Appl. Phys. 45, 1974, 5406). Above, the wall precesses:

    (1 + alpha^2) p' = gamma (B + alpha K' sin 2p),    X' = d (gamma B - p') / alpha,

which neglects that the width changes while it does.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Table

import midlie_jax as ml
from midlie_jax.cli.figures import write
from midlie_jax.plot.style import BLUE, GREY, VERMILLION, new_figure

J, EASY, HARD, DAMPING = 1.0, 0.02, 0.004, 0.2
WALKER = DAMPING * HARD
SHARES = 0.25, 0.5, 0.75, 0.9, 1.5, 2.0, 3.0, 4.0, 6.0  # of Walker's field
METHOD, DT, TIME, SPINS = "SUBLATTICES[SRKN6b]", 0.5, 8000.0, 320
SAVED = 400


class Speed(NamedTuple):
    """The mean speed of a wall in a field, lattice constants over time: found, and known."""

    field: float
    found: float
    known: float


def width(azimuth: Any) -> Any:
    return np.sqrt(J / (2 * (EASY + HARD * np.cos(azimuth) ** 2)))


def _resting(field: float) -> float:
    """The azimuth of the wall below Walker's field; above, that of the widest wall."""
    return math.pi / 2 + (0.5 * math.asin(field / WALKER) if field <= WALKER else 0.0)


def known(field: float) -> float:
    """The mean speed in the continuum."""
    if field <= WALKER:
        return float(width(_resting(field)) * field / DAMPING)
    azimuth = np.linspace(0, math.pi, 4000, endpoint=False)
    turning = (field + DAMPING * HARD * np.sin(2 * azimuth)) / (1 + DAMPING**2)
    return float(np.mean(width(azimuth) * (field - turning) / DAMPING / turning) / np.mean(1 / turning))


def found(field: float, *, method: str = METHOD, spins: int = SPINS, time: float = TIME, saved: int = SAVED) -> float:
    """The mean speed on the chain after a tenth of the time, over whole half turns if the wall precesses."""
    place = np.arange(spins) - 40.0
    azimuth = _resting(field)
    theta = 2 * np.arctan(np.exp(np.minimum(place / width(azimuth), 300)))
    along, across = np.cos(azimuth) * np.sin(theta), np.sin(azimuth) * np.sin(theta)
    start = np.stack([along, across, np.cos(theta)], axis=-1)
    torque = (
        ml.spins.Exchange(J, periodic=False)
        + ml.spins.Anisotropy(EASY)
        + ml.spins.Anisotropy(-HARD, (1.0, 0.0, 0.0))
        + ml.spins.AppliedField(jnp.array([0.0, 0.0, field]))
    )
    every = max(1, round(time / DT) // saved)
    run: Any = {"dt": DT, "steps": every * saved, "save_every": every}
    path = ml.integrate(method, ml.spins.Spins(DAMPING), torque, ml.spins.SpinState(jnp.asarray(start)), **run)
    assert bool(jnp.all(path.ok))
    spin = np.asarray(path.states.spin)
    where = spin[..., 2].sum(axis=1) / 2
    azimuth = np.unwrap(np.arctan2(spin[..., 1].sum(axis=1), spin[..., 0].sum(axis=1)))
    first, last = saved // 10, saved
    if field > WALKER:
        turns = np.floor((azimuth[-1] - azimuth[first]) / math.pi)
        last = int(np.argmin(np.abs(azimuth - azimuth[first] - turns * math.pi)))
    return float((where[last] - where[first]) / ((last - first) * every * DT))


def measured(shares: Sequence[float] = SHARES, **options: Any) -> list[Speed]:
    return [Speed(share * WALKER, found(share * WALKER, **options), known(share * WALKER)) for share in shares]


def rows(speeds: Sequence[Speed]) -> Iterator[list[str]]:
    for one in speeds:
        cells = f"{one.found:.5f}", f"{one.known:.5f}", f"{one.found / one.known - 1:+.1e}"
        yield [f"{one.field / WALKER:g}", *cells]


def draw(speeds: Sequence[Speed], out: Path) -> None:
    figure = new_figure(7.2, 3.8)
    panel = figure.subplots()
    figure.subplots_adjust(left=0.12, right=0.98, top=0.9, bottom=0.14)
    panel.set_title("Above Walker's field a wall slows down", loc="left", fontsize=11, weight="bold")
    most = max(one.field for one in speeds) / WALKER
    for part in (np.linspace(0, 1, 100), np.linspace(1.0001, 1.05 * most, 400)):
        panel.plot(part, [known(x * WALKER) for x in part], color=VERMILLION, lw=1.2)
    panel.plot([one.field / WALKER for one in speeds], [one.found for one in speeds], "o", ms=5, color=BLUE)
    words: Any = {"textcoords": "offset points", "fontsize": 9}
    panel.annotate("theory: gamma d B / alpha", (1.0, known(WALKER)), xytext=(8, -8), color=VERMILLION, **words)
    panel.annotate("theory: the wall precesses", (2.6, known(2.6 * WALKER)), xytext=(0, 14), color=VERMILLION, **words)
    panel.annotate("simulated", (speeds[-1].field / WALKER, speeds[-1].found), xytext=(0, 12), ha="right",
                   color=BLUE, **words)  # fmt: skip
    panel.set_xlabel("field [Walker's field alpha K']")
    panel.set_ylabel("speed [lattice constants per ħ/J]")
    panel.set_ylim(bottom=0)
    panel.set_xlim(left=0)
    panel.grid(alpha=0.3, color=GREY)
    write(figure, str(out))


def words(rows: list[dict[str, str]]) -> list[str]:
    off = max(abs(float(row["simulated / theory - 1"])) for row in rows)
    return [f"The simulated speeds agree with theory within {off:.1e} (relative), below and above Walker's field.", ""]


TABLE = Table(
    *("reports/heat.md", "wall", ("B / (alpha K')", "simulated speed", "theory", "simulated / theory - 1")),
    data="spins-wall",
    words=words,
)


def measure(options: Any) -> None:
    found = measured()
    if options.write:
        draw(found, REPORTS / "spins-wall.png")
    TABLE.show(options.write, rows(found))
