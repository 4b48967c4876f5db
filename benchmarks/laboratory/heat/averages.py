"""The errors of averages against the step and against the time: the dipole of `dipole` by our schemes and by diffrax."""

import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from midlie_jax.advice.timing import timed_in_turn

from . import diffrax_sde, dipole
from .dipole import FIELDS, Average, exact, step

OURS = {f"SYMMETRIC[{scheme}]": (0.25, 0.5, 0.75, 1.0, 1.5) for scheme in ("BAOAB", "OBABO", "ABOBA")}
THEIRS = {"Heun": (0.125, 0.25, 0.375, 0.5), "ShARK": (0.25, 0.375, 0.5), "EulerHeun": (0.0625, 0.125, 0.25)}
_RUNS = {"Heun": 8, "ShARK": 8, "EulerHeun": 2}
_OUR_RUNS = 24
_STEPS, _ROUNDS = 300, 5  # of the runs that are timed
HEADS = "x", "method", "slope of the error", "slope of that of T", "step for 1 %", "ns a body and unit of time", "ratio"
_SURE = 3.0  # standard errors from which an error counts as measured
_LARGEST = 1.0  # steps for the slopes, in units of 1/rate
SHOWN = 0.01  # the relative error at which costs are compared


class Rung(NamedTuple):
    """One method with one step in one field.

    Attributes:
        method, x, share: the step is this share of 1/rate.
        nanoseconds: of a body and a step.
        found: the averages.
    """

    method: str
    x: float
    share: float
    nanoseconds: float
    found: Average

    @property
    def error(self) -> float:
        """Relative error of <cos(theta)>."""
        return abs(self.found.cosine / exact(self.x) - 1)

    @property
    def uncertain(self) -> float:
        return self.found.cosine_error / exact(self.x)

    @property
    def warmth(self) -> float:
        """Relative error of the kinetic temperature."""
        return abs(self.found.temperature - 1)

    @property
    def cost(self) -> float:
        """Nanoseconds of a body and a unit of time, 1/rate."""
        return self.nanoseconds / self.share


def costs() -> dict[str, float]:
    """Nanoseconds of a body and a step, float32, without observations; the programs take turns."""
    names = [*OURS, *THEIRS]
    place = 2.0, step(2.0, 0.25), _STEPS
    runs = [(dipole if name in OURS else diffrax_sde).timed(name, *place) for name in names]
    timings = timed_in_turn(runs, least=_ROUNDS, most=_ROUNDS)
    scale = 1e9 / _STEPS / dipole.BODIES
    return {name: scale * timing.seconds for name, (_, timing) in zip(names, timings, strict=True)}


def extend(kept: Path, seconds: float) -> list[Rung]:
    """Measures what is not in the file yet, for some time, and puts it there; returns all that is there."""
    data = json.loads(kept.read_text()) if kept.exists() else {"costs": costs(), "rungs": []}
    began, done = time.monotonic(), {(method, share) for method, _, share, _ in data["rungs"]}
    for method, shares in (OURS | THEIRS).items():
        for share in shares:
            if (method, share) not in done and time.monotonic() - began < seconds:
                run = dipole.ours(method, share) if method in OURS else diffrax_sde.theirs(method, share)
                for x in FIELDS:
                    found = dipole.averaged(run, x, share, _RUNS.get(method, _OUR_RUNS))
                    data["rungs"].append((method, x, share, found))
                kept.write_text(json.dumps(data))
    named = data["costs"]
    return [Rung(method, x, share, named[method], Average(*found)) for method, x, share, found in data["rungs"]]


def slope(steps: Sequence[float], errors: Sequence[float], uncertain: Sequence[float]) -> tuple[float, float]:
    """The slope of log error against log step, and its standard error; NaN of fewer than two."""
    if len(steps) < 2:
        return math.nan, math.nan
    x, y = np.log(steps), np.log(errors)
    weights = (np.array(errors) / np.array(uncertain)) ** 2
    x = x - np.average(x, weights=weights)
    scatter = np.sum(weights * x * x)
    return float(np.sum(weights * x * y) / scatter), float(scatter**-0.5)


def slopes(found: Sequence[Rung]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Those of one method in one field: of <cos(theta)> and of the temperature; errors lost in the noise are left out."""
    small = [r for r in found if r.share <= _LARGEST and math.isfinite(r.error)]
    sure = [r for r in small if r.error > _SURE * r.uncertain]
    warm = [r for r in small if r.warmth > _SURE * r.found.temperature_error]
    of_cosine = slope([r.share for r in sure], [r.error for r in sure], [r.uncertain for r in sure])
    errors = [r.found.temperature_error for r in warm]
    return of_cosine, slope([r.share for r in warm], [r.warmth for r in warm], errors)


def step_at(found: Sequence[Rung], error: float, kind: str = "error") -> float:
    """The largest step with this error, between the measured ones by their logarithms; NaN if none is as bad."""
    ordered = sorted(found, key=lambda r: r.share)
    values = [max(getattr(r, kind), 1e-9) for r in ordered]
    for (a, low), (b, high) in reversed(list(zip(zip(ordered, values), zip(ordered[1:], values[1:])))):
        if low <= error < high:
            part = math.log(error / low) / math.log(high / low)
            return math.exp((1 - part) * math.log(a.share) + part * math.log(b.share))
    return math.nan


RUNG_HEADS = "x", "method", "step", "ns a step", "<cos>", "s.e.", "relative error", "T", "s.e."


def row(rung: Rung) -> list[str]:
    a = rung.found
    cells = [f"{rung.x:g}", f"`{rung.method}`", f"{rung.share:g}", f"{rung.nanoseconds:.1f}", f"{a.cosine:.5f}"]
    return [*cells, f"{a.cosine_error:.5f}", f"{rung.error:.1e}", f"{a.temperature:.4f}", f"{a.temperature_error:.4f}"]
