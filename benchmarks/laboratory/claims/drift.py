"""The drift test of Bou-Rabee, Ortolan and Saccon: means of the energy error over the eighths of a run to T = 1e4.

A method that is reversible but not symplectic may show a drift here that 40,000 steps of .25 make visible. The runs are
copies of the scene `drift-test` whose momenta differ by rounding, 1e-14: where the motion by a method becomes chaotic,
they part ways, and their spread tells how far a late mean is one draw of many.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from midlie_jax.cli.scenes import scene
from midlie_jax.drivers.integrate import integrate
from midlie_jax.integrators.base import Method
from midlie_jax.model.observables import energy
from midlie_jax.model.states import RigidState

COPIES, EIGHTHS = 8, 8
_AGREE = 0.1


class Drift(NamedTuple):
    """Attributes:
    eighths: mean energy errors E - E(0), (copies, 8); the first copy is the scene itself.
    largest: the largest |E - E(0)| of each eighth, (copies, 8).
    ok: whether no step failed.
    """

    eighths: np.ndarray
    largest: np.ndarray
    ok: bool

    @property
    def mean(self) -> np.ndarray:
        """The mean over the copies, (8,)."""
        return self.eighths.mean(axis=0)

    @property
    def spread(self) -> np.ndarray:
        """The standard deviation of the copies, (8,)."""
        return self.eighths.std(axis=0)

    @property
    def together(self) -> int:
        """The last eighth up to which the copies agree to a tenth."""
        apart = np.flatnonzero(self.spread > _AGREE * np.abs(self.mean))
        return int(apart[0]) - 1 if len(apart) else EIGHTHS - 1


def drift(method: Method) -> Drift:
    """Runs the drift test."""
    test = scene("drift-test")
    momentum = np.asarray(test.start.momentum)
    momenta = momentum + 1e-14 * np.random.default_rng(0).standard_normal((COPIES, 3))
    momenta[0] = momentum
    fitted = method.fitted(test.body)

    def run(momentum: Any) -> Any:
        start = RigidState(momentum, test.start.attitude)
        path = integrate(fitted, test.body, test.torque, start, dt=test.dt, steps=test.steps)
        energies = energy(test.body, test.torque, path.states)
        errors = (energies[1:] - energies[0]).reshape(EIGHTHS, -1)
        return errors.mean(-1), jnp.abs(errors).max(-1), path.ok

    eighths, largest, ok = jax.jit(jax.vmap(run))(jnp.asarray(momenta))
    return Drift(np.asarray(eighths), np.asarray(largest), bool(np.all(ok)))
