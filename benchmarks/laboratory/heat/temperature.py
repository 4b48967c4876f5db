"""Free rotors that start at the temperature of the bath: they keep it, whatever is saved, and have the same bits.

Runs are called as users call them, outside of `jax.jit`. Then the number of steps between saved states is a part of the
program (`save_every` 1) or an argument of it (33, and None, which saves the end alone).
"""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Table

import midlie_jax as ml

BODIES = 20_000
MOMENTS = 1.0, 1.0, 0.5
FLIGHTS, SCHEMES = ("SYMMETRIC", "JACOBI", "DLM"), ("BAOAB", "OBABO", "ABOBA")
EXPOSURES = 0.1, 0.7  # h G/I, on each axis
SAVED = 1, 33, None
STEPS, STEP, KT = 99, 0.1, 1.0


def _ends(method: str, exposure: float) -> Iterator[tuple[int | None, Any]]:
    """The states at the end, for each way of saving."""
    moments = np.array(MOMENTS)
    momentum = np.random.default_rng(0).normal(size=(BODIES, 3)) * np.sqrt(KT * moments)
    start = ml.RigidState(momentum, jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (BODIES, 1)))
    bath = ml.baths.Langevin(KT, exposure * moments / STEP, jax.random.split(jax.random.key(1), BODIES))
    for every in SAVED:
        run: Any = {"dt": STEP, "steps": STEPS, "save_every": every}
        states = ml.ensemble(method, ml.RigidBody(moments), None, start, bath=bath, **run).states
        yield every, states if every is None else jax.tree.map(lambda x: x[:, -1], states)


def _same(one: Any, other: Any) -> bool:
    pairs = zip(*(map(np.asarray, jax.tree.leaves(states)) for states in (one, other)), strict=True)
    return all(a.tobytes() == b.tobytes() for a, b in pairs)


def rows() -> Iterator[Sequence[str]]:
    for method in (f"{flight}[{scheme}]" for flight in FLIGHTS for scheme in SCHEMES):
        for exposure in EXPOSURES:
            first: Any = None
            for every, end in _ends(method, exposure):
                first = end if first is None else first
                squares = np.asarray(end.momentum) ** 2 / (KT * np.array(MOMENTS))
                means, errors = squares.mean(axis=0), squares.std(axis=0, ddof=1) / np.sqrt(BODIES)
                most = np.max(np.abs(means - 1) / errors)
                cells = [f"{mean:.3f} ± {error:.3f}" for mean, error in zip(means, errors, strict=True)]
                same = "yes" if _same(end, first) else "NO"
                yield [f"`{method}`", f"{exposure:g}", str(every), *cells, f"{most:.1f}", same]


def words(rows: list[dict[str, str]]) -> list[str]:
    off = max(float(row["largest deviation, standard errors"]) for row in rows)
    same = sum(row["same bits"] == "yes" for row in rows)
    return [
        f"In {len(rows)} runs, no temperature differs from theory by more than {off:.1f} standard errors (0.01).",
        f"The final states have the same bits for every `save_every` in {same} of {len(rows)} runs.",
        "",
    ]


TABLE = Table(
    *("reports/heat.md", "temperature"),
    (
        *("method", "h G/I", "`save_every`", "⟨Π₁²⟩ / (kT I₁)", "⟨Π₂²⟩ / (kT I₂)", "⟨Π₃²⟩ / (kT I₃)"),
        *("largest deviation, standard errors", "same bits"),
    ),
    *(rows, "heat-temperature"),
    words=words,
)
