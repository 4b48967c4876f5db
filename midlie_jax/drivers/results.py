"""`RESULTS`: why a run failed (`path.result`)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._xla.internals import Tracer
from ..integrators.verdict import FINE, NOT_FINITE, UNREACHED


class RESULTS(eqx.Enumeration):
    """The outcome of a run; compare as in `path.result == midlie_jax.RESULTS.successful`.

    The outcome of a good run prints as "successful", of a failed run as a sentence with the remedy.

    Examples:
        >>> failed = ml.integrate("JACOBI[EA]", body, torque, start, dt=10.0, steps=100)
        >>> bool(failed.result == ml.RESULTS.beyond_reach)  # the step is too long
        True
    """

    successful = "successful"
    not_solved = (
        "A step did not solve its equation. Take a shorter step, which midlie_jax.check finds, or a method without a "
        "solve such as JACOBI; or the torque is not finite."
    )
    beyond_reach = (
        "A step turned the body further than the method reaches. Take a shorter step; midlie_jax.check finds one."
    )
    not_finite = (
        "A number stopped being finite. Look at the torque near the last good state, and at the step with "
        "midlie_jax.check: a run that is unstable grows without bound."
    )
    too_many_steps = "Steps were counted beyond 32 bits. Start a new run from the last state, with its time as t0."
    density_lost = (
        "The steps no longer follow the density: it jumped, is not positive, or the steps are too long. Take a smaller "
        "dt, or a smoother density."
    )
    phase_lost = (
        "A time is so far from the start that rounding leaves no digit of the phase, or the body is so thin that "
        "rounding is magnified. Take times nearer to the start, or float64."
    )
    impossible_body = (
        "No real body has these moments or this mass: one is not positive or not finite, or the largest moment exceeds "
        "the sum of the other two. Check them; RigidBody(moments, physical=False) leaves out the last condition."
    )
    unstable = (
        "The energy grew far beyond what the forces can give: the step exceeds their stability limit. Take a shorter "
        "step; midlie_jax.check finds one."
    )
    end_not_reached = "The run did not reach t1 in its number of steps. Take more steps, or a longer dt."


_Item: Any = type(RESULTS.successful)


class Outcome(_Item):
    """A member of `RESULTS`, or one for each body, that prints as "successful" or as a sentence for each failure."""

    def __repr__(self) -> str:
        value: Any = self._value
        if not isinstance(value, np.ndarray | Array) or isinstance(value, Tracer) or not value.size:
            return f"RESULTS<{RESULTS[self]}>"
        failed = np.asarray(self != RESULTS.successful)
        told = reasons(self, failed) or "successful"
        return f"{np.count_nonzero(failed)} of {failed.size} failed. {told}" if failed.ndim and failed.any() else told


def reasons(result: Any, failed: np.ndarray) -> str:
    codes = np.ravel(jax.tree.leaves(result)[0])
    first = [int(np.flatnonzero((codes == code) & np.ravel(failed))[0]) for code in np.unique(codes[np.ravel(failed)])]
    return " ".join(RESULTS[jax.tree.map(lambda x, i=i: jnp.ravel(x)[i], result)] for i in first)


def result_of(verdict: Array, finite: Array, reached: Array | bool = True) -> Any:
    """The outcome of a run with this verdict, whose states are finite, and which reached its end or did not."""
    of_end = jnp.where(finite, jnp.where(reached, FINE, UNREACHED), NOT_FINITE)
    return Outcome(jnp.where(verdict == FINE, of_end, verdict).astype(jnp.int32), RESULTS)
