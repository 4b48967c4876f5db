"""Levenberg and Marquardt's method, one step as a pure function.

A run of a body and its derivative take seconds to compile, so the step holds their only copy: it computes the Jacobian
at each place where it evaluates the residuals. The first Jacobian gives the scale of the unknowns, the last one the
covariance. `fit` calls the compiled step from Python, where it can be stopped and show progress; `fit_arrays` calls it
in a loop.

The trust region is that of N. I. M. Gould, D. Orban, A. Sartenaer, Ph. L. Toint, 4OR 3 (2005) 227.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from .identifiability import lengths_of
from .residuals import Data, Problem, jacobian_of

_GOOD, _POOR = 0.99, 0.01  # a step is good or poor by the decrease of the loss over that of the linear model
_WIDER, _NARROWER = 3.5, 0.25


class Search(eqx.Module):
    """Where a search for the least sum of squares stands.

    The unknowns are scaled such that at the start a change of one unknown by 1 changes the vector of residuals by a
    length of one standard deviation. So neither the units nor the number of data matter for the tolerances and for the
    damping, which starts at the diagonal of J^T J. A weaker damping would save steps near the optimum, but from guesses
    further off it leads to other minima.

    Leading axes, if any, are those of several starts.

    Attributes:
        start: (u,), the unknowns at the start.
        lengths: (u,), the scale: `start + place / lengths` are the unknowns at a place.
        place: (u,), the best place so far.
        residuals: (r,), the residuals at the best place.
        triangle: (u, u), the triangular factor R of the scaled Jacobian at the best place, J = Q R.
        turned: (u,), Q^T times the residuals.
        good: whether every step of the run at the best place was good.
        trial: (u,), the place where the next step evaluates the residuals.
        promised: the change of the loss at the trial according to the linear model; negative.
        size: one over the damping.
        relative, absolute: changes that count as none, relative to a number and in absolute terms.
        steps: how often the search has evaluated the residuals.
        converged: whether the place is the optimum.
        finished: whether the search is over: it converged, or the run from the start is not finite.
    """

    start: Float[Array, "*s u"]
    lengths: Float[Array, "*s u"]
    place: Float[Array, "*s u"]
    residuals: Float[Array, "*s r"]
    triangle: Float[Array, "*s u u"]
    turned: Float[Array, "*s u"]
    good: Bool[Array, "*s"]
    trial: Float[Array, "*s u"]
    promised: Float[Array, "*s"]
    size: Float[Array, "*s"]
    relative: float = eqx.field(static=True)
    absolute: Float[Array, "*s"]
    steps: Int[Array, "*s"]
    converged: Bool[Array, "*s"]
    finished: Bool[Array, "*s"]

    @classmethod
    def begin(cls, start: Float[Array, " u"], count: int, relative: float, absolute: Float[Array, ""]) -> "Search":
        """A search that has evaluated nothing yet, for `count` residuals."""
        dtype, zeros = start.dtype, jnp.zeros_like(start)
        zero, no = jnp.zeros((), dtype), jnp.zeros((), bool)
        return cls(
            start, zeros + 1, zeros, jnp.zeros(count, dtype), jnp.zeros((start.size, start.size), dtype), zeros, no,
            zeros, zero, zero + 1, relative, absolute.astype(dtype), jnp.zeros((), jnp.int32), no, no,
        )  # fmt: skip

    @property
    def vector(self) -> Float[Array, "*s u"]:
        """The unknowns at the best place."""
        return self.start + self.place / self.lengths

    @property
    def loss(self) -> Float[Array, "*s"]:
        """Half the sum of squares."""
        return jnp.sum(self.residuals**2, axis=-1) / 2


def look(search: Search, data: Data, problem: Problem) -> Search:
    """The search after it has evaluated the residuals at its trial; the same search if it was finished."""
    first = search.steps == 0
    trial = search.start + search.trial / search.lengths
    found, good, jacobian = jacobian_of(trial, data, problem)
    lengths = jnp.where(first, lengths_of(jacobian), search.lengths)
    change = jnp.sum(found**2) / 2 - search.loss
    finite = jnp.all(jnp.isfinite(found)) & jnp.all(jnp.isfinite(jacobian))
    accepted = finite & (first | (change <= _POOR * search.promised))

    factor = jnp.linalg.qr(jnp.concatenate([jacobian / lengths[None], found[:, None]], axis=1), mode="r")
    count = trial.size
    residuals = jnp.where(accepted, found, search.residuals)
    triangle = jnp.where(accepted, factor[:count, :count], search.triangle)
    turned = jnp.where(accepted, factor[:count, count], search.turned)
    place = jnp.where(accepted, search.trial, search.place)
    one = jnp.ones_like(search.size)
    wider = jnp.where((change < _GOOD * search.promised) & ~first, _WIDER * one, one)
    size = search.size * jnp.where(accepted, wider, _NARROWER * one)

    step = _damped(triangle, turned, size)
    ahead = triangle @ step + turned
    promised = jnp.sum(ahead**2) / 2 - jnp.sum(turned**2) / 2

    settled = accepted & ~first & _small(search.trial - search.place, search.trial, search)
    settled = settled & _small(found - search.residuals, found, search)
    # A further step could gain less than the rounding of the sum of squares.
    hidden = ~accepted & (jnp.abs(search.promised) <= 8 * jnp.finfo(trial.dtype).eps * search.loss)
    converged = settled | hidden
    after = Search(
        search.start, lengths, place, residuals, triangle, turned, jnp.where(accepted, good, search.good),
        place + step, promised, size, search.relative, search.absolute, search.steps + 1, converged,
        converged | (first & ~finite),
    )  # fmt: skip
    return jax.tree.map(lambda old, new: jnp.where(search.finished, old, new), search, after)


def _damped(triangle: Float[Array, "u u"], turned: Float[Array, " u"], size: Float[Array, ""]) -> Float[Array, " u"]:
    """The step d that minimises |R d + q|^2 + |d|^2 / size."""
    count = turned.size
    damping = jnp.eye(count, dtype=turned.dtype) / jnp.sqrt(size)
    stacked = jnp.concatenate(
        [jnp.concatenate([triangle, turned[:, None]], axis=1), jnp.pad(damping, ((0, 0), (0, 1)))], axis=0
    )
    factor = jnp.linalg.qr(stacked, mode="r")
    return -jax.scipy.linalg.solve_triangular(factor[:count, :count], factor[:count, count])


def _small(change: Array, value: Array, search: Search) -> Bool[Array, ""]:
    """Whether the change of every entry counts as none."""
    return jnp.all(jnp.abs(change) < search.absolute + search.relative * jnp.abs(value))
