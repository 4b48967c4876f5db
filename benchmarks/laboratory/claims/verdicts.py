"""The verdicts: what the paper and the registry claim about a method, against what was measured.

The paper claims of its alternating method, LIEMID[EA], that it is explicit in the forcing, conserves momentum, is
symplectic, is of second order, and is the best second-order integrator of its kind. The registry declares of every
method its order, whether it is symmetric and symplectic, whether it keeps the momentum or the energy, and its torque
evaluations.
Two consequences are tried as well: the energy of a symplectic method has no trend.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from midlie_jax.integrators.base import Method
from midlie_jax.integrators.registry import ENTRIES
from midlie_jax.integrators.splitting import Splitting

from .drift import EIGHTHS, Drift
from .measure import Measured

DECLARED = ("order", "momentum", "energy", "symplectic", "area", "symmetric", "no trend", "no drift", "evaluations")
RANK = "rank"
_EPSILON = float(np.finfo(float).eps)
_DEFECT = 1e-11  # of one step; differences leave 1e-13
_WALK = 4.0  # rounding as a random walk: times eps and the root of the number of flights
_PARTS = 2.3  # the sizes of the tops' kinetic and potential energies, which are rounded, over their energy, at most
_RETURN = 8.0  # rounding of a run and its way back, times eps and the number of flights
_FLIGHTS_BACK = 128
_TREND = 0.2  # of the oscillation in the first eighth of a run
_ORDER = 0.25
_SIZE = 0.1  # relative difference from a published drift

# Means of the energy error over the first and the last eighth of the drift test (Bou-Rabee, Ortolan & Saccon).
PUBLISHED_DRIFTS = {
    "LIEMID[EA]": (-6.0e-4, 4.4e-3),
    "AKW": (-6.7e-3, -2.7e-2),
    "SW": (2.6e-3, 2.2e-2),
    "NMB": (-2.6e-3, -1.7e-2),
    "JACOBI[EA]": (-1.05e-3, -1.05e-3),
}


class Verdict(NamedTuple):
    """Attributes:
    method: its name.
    claim: what is claimed.
    measured: what was measured, in words.
    holds: whether the claim holds.
    key: the property that is declared, one of `DECLARED`; `RANK` for a claim that needs rivals; else "".
    """

    method: str
    claim: str
    measured: str
    holds: bool
    key: str = ""


def rounding(found: Measured) -> float:
    """What rounding makes of a constant over the long run, relative."""
    return _WALK * _EPSILON * (found.steps * max(1, found.flights)) ** 0.5


def has_order(found: Measured, order: int) -> bool:
    """Whether the order is `order` at least; the slope of a high order at large steps may exceed it."""
    return found.order > order - _ORDER


def keeps_momentum(found: Measured) -> bool:
    return found.momentum <= rounding(found)


def keeps_energy(found: Measured) -> bool:
    return largest_energy(found) <= _PARTS * rounding(found)


def is_symplectic(found: Measured) -> bool:
    return max(found.symplectic) <= _DEFECT


def keeps_area(found: Measured) -> bool:
    return max(found.area) <= _DEFECT


def comes_back(found: Measured) -> bool:
    return found.reversal <= _RETURN * _FLIGHTS_BACK * max(1.0, found.flights / 2) * _EPSILON


def shifts(found: Measured) -> np.ndarray:
    """How far the mean energy error of the tops moves from the first eighth of the long run to each, (8,): relative,
    root mean square over the tops."""
    means = np.stack([part.mean(axis=0) for part in np.array_split(found.energy, EIGHTHS)])
    return np.sqrt(np.mean((means - means[0]) ** 2, axis=1))


def largest_energy(found: Measured) -> float:
    """The largest energy error of the tops over the long run, relative."""
    return float(np.max(np.abs(found.energy)))


def trend(found: Measured) -> tuple[float, float]:
    """The last of `shifts`, and the root mean square of the energy error in the first eighth, relative."""
    first = np.array_split(found.energy, EIGHTHS)[0]
    return float(shifts(found)[-1]), float(np.sqrt(np.mean(first**2)))


def has_no_trend(found: Measured) -> bool:
    """Whether the mean energy error of the tops stays within a part of its oscillation, or within rounding."""
    shift, oscillation = trend(found)
    return shift <= max(_TREND * oscillation, rounding(found))


def drift_shift(found: Measured) -> float:
    """The change of the mean energy error from the first eighth of the drift test to the last."""
    return float(found.drift.eighths[0, -1] - found.drift.eighths[0, 0])


def has_no_drift(found: Measured) -> bool:
    return abs(drift_shift(found)) <= max(_TREND * float(found.drift.largest[0, 0]), rounding(found))


def is_published_drift(found: Drift, first: float, last: float) -> bool:
    """Whether the mean energy errors of the first and the last eighth have the sign and the size that were published.

    Both to a tenth. Where the copies part ways before the end, the last mean is one draw of many: then the published
    figure must be within two standard deviations of the copies, and of the sign of the last mean on which they agree.
    """
    near = [abs(found.mean[i] - x) <= max(_SIZE * abs(x), 2 * found.spread[i]) for i, x in ((0, first), (-1, last))]
    return all(near) and bool(np.sign(found.mean[found.together]) == np.sign(last))


def is_alternating(method: Method) -> bool:
    """Whether the method is the paper's alternating method, cut at either place."""
    entry = ENTRIES.get(method.name)
    return bool(entry and entry.paper) and isinstance(method, Splitting) and method.order == 2


def of_its_kind(method: Method, found: Measured) -> bool:
    """Whether the method is of second order, explicit with one torque a step, and keeps the momentum."""
    return method.order == 2 and found.work.explicit and found.work.evaluations == 1 and keeps_momentum(found)


def of_the_paper(method: Method, found: Measured) -> bool:
    """Whether the method is one of the paper's of second order."""
    del found
    entry = ENTRIES.get(method.name)
    return method.order == 2 and bool(entry and entry.paper)


def ranked(
    one: Measured, methods: Sequence[Method], all_found: Sequence[Measured], kind: Callable[[Method, Measured], bool]
) -> tuple[str, bool] | None:
    """The best rival at the same step on the tops and on P1, in words; and whether `one` is the best on both.

    Rivals are the other methods of the kind, but not the paper's alternating method cut at another place; on the tops
    also not those for two equal moments, which were measured on other tops. None if there is no rival.
    """
    pairs = [(m, f) for m, f in zip(methods, all_found, strict=True) if kind(m, f) and not is_alternating(m)]
    every = [f for _, f in pairs]
    same = [f for m, f in pairs if not (isinstance(m, Splitting) and m.flight.equal_moments)]
    if not same:
        return None
    words, best = [], True
    for scene, error, rivals in (("asymmetric top", "accuracy", same), ("P1", "accuracy_p1", every)):
        rival = min(rivals, key=lambda f: getattr(f, error) if getattr(f, error) > 0 else np.inf)
        ratio = getattr(one, error) / getattr(rival, error)
        best = best and bool(ratio <= 1)
        words.append(f"{scene}: error {getattr(one, error):.1e}, {rival.method} {getattr(rival, error):.1e}")
    return "; ".join(words), best


def registry_verdicts(method: Method, found: Measured) -> list[Verdict]:
    """What the registry declares of a method, and what follows for the energy."""
    gradients = isinstance(method, Splitting) and any(method.scheme.gradients) and not method.scheme.displaced
    claims = [
        (DECLARED[0], f"order {method.order}", f"{found.order:.2f}", has_order(found, method.order), True),
        (DECLARED[1], "momentum", f"{found.momentum:.1e}", keeps_momentum(found), method.keeps_momentum),
        (DECLARED[2], "energy", f"{largest_energy(found):.1e}", keeps_energy(found), method.keeps_energy),
        (DECLARED[3], "symplectic", _defects(found.symplectic), is_symplectic(found), method.symplectic),
        (DECLARED[4], "area", _defects(found.area), keeps_area(found), method.symplectic),
        (DECLARED[5], "symmetric", f"{found.reversal:.1e}", comes_back(found), method.symmetric),
        (DECLARED[6], "no trend on the top", _trend_words(found), has_no_trend(found), method.symplectic),
        (DECLARED[7], "no drift", _drift_words(found), has_no_drift(found), method.symplectic),
        (
            DECLARED[8],
            f"{method.evaluations} torque evaluations",
            f"{found.work.evaluations}",
            found.work.evaluations == method.evaluations,
            not gradients,  # a gradient is a derivative of the torque, which the registry does not count
        ),
    ]
    return [Verdict(found.method, claim, words, ok, key) for key, claim, words, ok, claimed in claims if claimed]


def paper_verdicts(methods: Sequence[Method], all_found: Sequence[Measured]) -> list[Verdict]:
    """The five claims of the paper about its alternating method, and what follows for the energy."""
    verdicts: list[Verdict] = []
    for method, found in zip(methods, all_found, strict=True):
        if not is_alternating(method):
            continue
        explicit = f"{found.work.evaluations} evaluation per step, outside the {found.solves} solves"
        claims = [
            ("explicit in the forcing", explicit, found.work.explicit),
            ("conserves momentum", f"spatial momentum moves by {found.momentum:.1e}", keeps_momentum(found)),
            ("second order", f"order {found.order:.2f}", has_order(found, 2)),
            ("symplectic on T*SO(3)", f"defect {_defects(found.symplectic)}", is_symplectic(found)),
            ("preserves area on the momentum sphere", f"defect {_defects(found.area)}", keeps_area(found)),
            (
                "as of a symplectic method, no trend of the energy: top",
                _trend_words(found),
                has_no_trend(found),
            ),
            (
                "as of a symplectic method, no trend of the energy: drift test",
                _drift_words(found),
                has_no_drift(found),
            ),
        ]
        verdicts += [Verdict(found.method, claim, words, ok) for claim, words, ok in claims]
        for claim, kind in (
            ("best of the paper's second-order methods", of_the_paper),
            ("best second-order integrator of its kind", of_its_kind),
        ):
            rank = ranked(found, methods, all_found, kind)
            verdicts += [] if rank is None else [Verdict(found.method, claim, *rank, RANK)]
    return verdicts


def published_verdicts(all_found: Sequence[Measured]) -> list[Verdict]:
    """The published drifts of the methods that were measured."""
    verdicts: list[Verdict] = []
    for found in all_found:
        if found.method in PUBLISHED_DRIFTS:
            first, last = PUBLISHED_DRIFTS[found.method]
            drift = found.drift
            words = f"{drift.mean[0]:.2e} -> {drift.mean[-1]:.2e}"
            if drift.together < len(drift.mean) - 1:
                words += f" ± {drift.spread[-1]:.0e}; the copies agree up to eighth {drift.together + 1}, "
                words += f"{drift.mean[drift.together]:.2e}"
            claim, holds = f"drift {first:.2e} -> {last:.2e}", is_published_drift(drift, first, last)
            verdicts.append(Verdict(found.method, claim, words, holds))
    return verdicts


def _trend_words(found: Measured) -> str:
    shift, oscillation = trend(found)
    return f"mean moves by {shift:.1e}, oscillation {oscillation:.1e}"


def _drift_words(found: Measured) -> str:
    drifts = found.drift.eighths[0]
    return f"{drifts[0]:.1e} -> {drifts[-1]:.1e}"


def _defects(defects: Sequence[float]) -> str:
    """The defect at the smallest step, with its order in the step if it is not rounding."""
    if max(defects) <= _DEFECT:
        return f"{defects[-1]:.0e}"
    order = f", order {np.log2(defects[-2] / defects[-1]):.1f}" if defects[-1] > _DEFECT else ""
    return f"{defects[-1]:.1e} at h = 0.1{order}"
