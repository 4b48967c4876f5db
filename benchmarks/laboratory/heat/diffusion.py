"""How fast free bodies diffuse in a bath, against the step: averages are exact at every step, and dynamics are not.

Units of the friction, the mass and the moment of inertia, so that x = h G/I = h g/m is the step. In the limit of short
steps the diffusion constant is D = kT/G. The velocities at the ends of steps are exact, with the correlation exp(-x)
between neighbours, and in each step a body moves by h times a velocity, or the mean of two. The sum of these is

    D = kT/G (x/2) coth(x/2)

for BAOAB, OBABO and ABOBA. The temperature is so low that angles are small, and rotations about several axes commute.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from harness import Table

import midlie_jax as ml

BODIES = 100_000
SCHEMES = "BAOAB", "OBABO", "ABOBA"
STEPS = 0.1, 0.5, 1.0, 2.0, 10.0  # x
KT = 1e-6
_TIME, _PARTS = 100.0, 10  # the time of a run, at least, and the number of saved states


def theory(x: float) -> float:
    return x / 2 / math.tanh(x / 2)


def squares(scheme: str, x: float) -> tuple[np.ndarray, float]:
    """The squares of displacement and rotation angle, (n, 2), that each body gains after the memory of its start.

    The second result is their mean in the limit of short steps.
    """
    zero = jnp.zeros((BODIES, 3))
    momenta = jax.random.normal(jax.random.key(0), (2, BODIES, 3)) * math.sqrt(KT)
    start = ml.FreeState(momenta[0], jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (BODIES, 1)), momenta[1], zero)
    body = ml.FreeBody(ml.RigidBody([1.0, 1.0, 1.0]), mass=1.0)
    bath = ml.baths.Langevin(KT, 1.0, jax.random.split(jax.random.key(1), BODIES), 1.0)

    def observed(t: Any, state: ml.FreeState) -> Any:
        del t
        return jnp.stack([jnp.sum(state.position**2), jnp.sum(ml.so3.log(state.attitude) ** 2)])

    every = max(1, math.ceil(_TIME / x / _PARTS))
    run: Any = {"dt": x, "steps": every * _PARTS, "save_every": every, "observe": observed}
    seen = np.asarray(ml.ensemble(f"SYMMETRIC[{scheme}]", body, None, start, bath=bath, **run).states)
    return seen[:, -1] - seen[:, 1], 6 * KT * x * every * (_PARTS - 1)


def rows() -> Iterator[Sequence[str]]:
    for scheme in SCHEMES:
        for x in STEPS:
            gained, exact = squares(scheme, x)
            means, errors = gained.mean(axis=0) / exact, gained.std(axis=0, ddof=1) / exact / math.sqrt(BODIES)
            cells = [f"{mean:.3f} ± {error:.3f}" for mean, error in zip(means, errors, strict=True)]
            yield [f"`{scheme}`", f"{x:g}", f"{theory(x):.3f}", *cells]


TABLE = Table(
    *("reports/heat.md", "diffusion"),
    ("scheme", "h G/I", "(x/2) coth(x/2)", "D of the position / exact", "D of the rotation / exact"),
    *(rows, "heat-diffusion"),
    key=lambda row: row[0] == "`BAOAB`",
    columns=(1, 2, 3, 4),
)
