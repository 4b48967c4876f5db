"""How far one step on spins is from symplectic, and from preserving volumes, from its derivative by autodiff.

The form on the product of spheres is w(u, v) = sum S . (u x v) over tangent vectors. In a right-handed orthonormal
basis of the tangent plane of each spin its matrix is the canonical J. With M, the derivative of the step in such bases
at both ends, a symplectic step has M^T J M = J, and one that keeps volumes det M = 1.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from harness import REPORTS, Line, Panel, Table, chart

import midlie_jax as ml
from midlie_jax.plot.style import BLUE, GREEN, ORANGE, PURPLE, VERMILLION

from . import random

STEPS = 0.8, 0.4, 0.2, 0.1
STARTS = 8
HALVES = jnp.array([1.0, 0.5, 0.2]) / 2  # of the energy S . diag(1, .5, .2) S / 2
ONE = "one spin"
COUPLED = "four coupled spins"


class Case(NamedTuple):
    """A method on a system."""

    system: str
    method: str


METHODS: tuple[str, ...] = (
    "spherical midpoint",
    "Lie midpoint of spins",
    "SUBLATTICES[EA]",
    "SUBLATTICES[SRKN6b]",
    "SUBLATTICES[KL6]",
)
CASES = [*(Case(ONE, method) for method in METHODS[:2]), *(Case(COUPLED, method) for method in METHODS)]


def _field(system: str) -> Any:
    if system == ONE:
        return ml.torques.FromPotential(lambda t, state: jnp.sum(HALVES * state.spin**2))
    return ml.spins.Exchange(1.0, periodic=False)


def _basis(spin: np.ndarray) -> np.ndarray:
    """Two tangent vectors of each spin (n, 3), with u x v = S: columns (3 n, 2 n)."""
    columns = np.zeros((len(spin), 3, len(spin), 2))
    for i, s in enumerate(spin):
        u = np.cross(s, np.eye(3)[np.argmin(np.abs(s))])
        u /= np.linalg.norm(u)
        columns[i, :, i] = np.stack([u, np.cross(s, u)], axis=1)
    return columns.reshape(3 * len(spin), 2 * len(spin))


def defects(case: Case, steps: Sequence[float] = STEPS, starts: int = STARTS) -> np.ndarray:
    """For each step the largest entry of |M^T J M - J| and the largest |det M - 1| over some starts, (steps, 2).

    NaN where an implicit method finds no solution from some start.
    """
    field, body = _field(case.system), ml.spins.Spins()
    shape = () if case.system == ONE else (4,)

    def end(spin: Any, dt: Any) -> Any:
        start = ml.spins.SpinState.unchecked(spin=spin)
        run = ml.integrate(case.method, body, field, start, dt=dt, steps=1, adjoint=ml.Forward())
        return run.states.spin[-1], (run.states.spin[-1], run.ok)

    derivative = jax.jit(jax.jacfwd(end, has_aux=True))
    found = np.zeros((len(steps), 2))
    for seed in range(starts):
        spin = random(shape, seed).spin
        count = max(1, spin.size // 3)
        canonical = np.kron(np.eye(count), np.array([[0, 1], [-1, 0]]))
        for row, dt in zip(found, steps, strict=True):
            matrix, (after, ok) = derivative(spin, jnp.asarray(dt))
            if not bool(jnp.all(ok)):
                row[:] = np.nan
                continue
            before, after = (np.asarray(x).reshape(count, 3) for x in (spin, after))
            m = _basis(after).T @ np.asarray(matrix).reshape(3 * count, 3 * count) @ _basis(before)
            own = np.abs(m.T @ canonical @ m - canonical).max(), abs(np.linalg.det(m) - 1)
            row[:] = np.maximum(row, own)  # NaN stays
    return found


def measured() -> dict[Case, np.ndarray]:
    return {case: defects(case) for case in CASES}


def _order(errors: np.ndarray) -> str:
    """The slope of the two shortest steps, or nothing at rounding."""
    return "rounding" if errors[-2:].max() < 1e-13 else f"{np.log2(errors[-2] / errors[-1]):.1f}"


def rows(found: dict[Case, np.ndarray]) -> Iterator[list[str]]:
    for case, errors in found.items():
        for name, column in zip(("symplectic", "volume"), errors.T, strict=True):
            if case.system == COUPLED or name == "symplectic":
                cells = [f"{x:.1e}" if np.isfinite(x) else "no solution" for x in column]
                yield [case.system, f"`{case.method}`", name, *cells, _order(column)]


def draw(found: dict[Case, np.ndarray], out: Path, steps: Sequence[float] = STEPS) -> None:
    """The defect of a step against its length: one spin on the left, four coupled spins on the right."""
    colours = dict(zip(METHODS, (GREEN, VERMILLION, BLUE, ORANGE, PURPLE), strict=True))

    def lines(system: str) -> Iterator[Line]:
        for case, errors in found.items():
            if case.system == system:
                solved = np.isfinite(errors[:, 0])
                x, y = np.asarray(steps)[solved][::-1], errors[solved, 0][::-1]
                yield Line(case.method, x, y, colours[case.method], "o-", options={"markersize": 4})

    def ticks(axes: Any) -> None:
        axes.set_xticks(steps, [f"{h:g}" for h in steps])
        axes.minorticks_off()

    options: Any = {"xscale": "log", "yscale": "log", "xlim": (steps[-1] / 1.15, steps[0] * 1.15)}
    words = "step [ħ/J]", "symplectic defect of one step [-]"
    panels = [Panel(system, *words, list(lines(system)), options, ticks) for system in (ONE, COUPLED)]
    title = "Only the spherical midpoint rule is symplectic"
    chart(out, [panels], (9.6, 4.4), title, left=0.09, bottom=0.13, wspace=0.2)


TABLE = Table(
    *("reports/heat.md", "area", ("system", "method", "defect", *(f"h = {h:g}" for h in STEPS), "order in h")),
    data="spins-area",
    key=lambda row: row[0] != ONE and row[2] == "symplectic",
    columns=(1, 5, 7),
)


def measure(options: Any) -> None:
    found = measured()
    if options.write:
        draw(found, REPORTS / "spins-area.png")
    TABLE.show(options.write, rows(found))
