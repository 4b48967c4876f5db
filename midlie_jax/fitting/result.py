"""`Result`: how a fit ended."""

from enum import Enum

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Int


class Result(Enum):
    """How a fit ended, and what this means; `Fit.message` says more about a particular fit.

    If several of them apply, the result is the first in the sequence RUN_FAILED, NOT_CONVERGED, MISFIT, UNDETERMINED.

    Examples:
        >>> ml.fitting.Result.of(0) is ml.fitting.Result.FITTED
        True
        >>> ml.fitting.Result.NOT_CONVERGED.code, ml.fitting.Result.NOT_CONVERGED.value
        (2, 'the optimiser did not converge within its most steps')
    """

    FITTED = "the optimiser converged, the residuals can be noise, and the measurements determine all parameters"
    RUN_FAILED = "a run of the model failed: a solve, a turn too large for a step, or a number that is not finite"
    NOT_CONVERGED = "the optimiser did not converge within its most steps"
    UNDETERMINED = "the measurements do not determine all parameters"
    MISFIT = "the residuals cannot be noise: they exceed the known sigmas, or are not small relative to the signal"

    @property
    def code(self) -> int:
        """The number of this result in `Estimate.result`; 0 is FITTED."""
        return list(Result).index(self)

    @classmethod
    def of(cls, code: int) -> "Result":
        """The result that a number stands for."""
        return list(cls)[code]


def code_of(
    run: Bool[Array, ""], converged: Bool[Array, ""], fits: Bool[Array, ""], determined: Bool[Array, ""]
) -> Int[Array, ""]:
    """The code of the first condition that is False; 0 if none is."""
    code = jnp.zeros((), jnp.int32)
    for result, holds in (
        (Result.UNDETERMINED, determined),
        (Result.MISFIT, fits),
        (Result.NOT_CONVERGED, converged),
        (Result.RUN_FAILED, run),
    ):
        code = jnp.where(holds, code, result.code)
    return code
