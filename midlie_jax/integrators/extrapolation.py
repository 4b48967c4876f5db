"""Gragg-Bulirsch-Stoer extrapolation: Gragg's midpoint rule with more and more substeps, extrapolated to length 0.

The rule with n substeps of length d = h/n is z_1 = y + d f(y), z_{i+1} = z_{i-1} + 2 d f(z_i). For even n its error has
even powers of d only, so each further n raises the order by two. Here n = 2, 4, 6, ...; all rules share the first
evaluation. Gragg's smoothing step, which the extrapolation does not need, is left out. The sums are over the
differences z_i - y rather than z_i, so rounding errors are proportional to the change in a step.

A step keeps only two motions and a sum alive, whereas a tableau keeps all stages.

W. B. Gragg, SIAM J. Numer. Anal. 2 (1965) 384; R. Bulirsch, J. Stoer, Numer. Math. 8 (1966) 1; Hairer, Norsett &
Wanner, Solving Ordinary Differential Equations I, II.9.
"""

from fractions import Fraction
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._xla.fusion import begin_step, fuse
from .formula import Pause, Rates
from .system import AnyMotion


class Extrapolation(NamedTuple):
    """The extrapolated midpoint rule: a `Formula`.

    Attributes:
        levels: the number of combined results, with 2, 4, ..., 2 `levels` substeps; the order is 2 `levels`.
        reach: the largest rotation h |Omega| of a step, in radians.
    """

    levels: int
    reach: float

    @property
    def order(self) -> int:
        return 2 * self.levels

    @property
    def evaluations(self) -> int:
        return 1 + sum(n - 1 for n in self.substeps)

    @property
    def substeps(self) -> tuple[int, ...]:
        return tuple(range(2, 2 * self.levels + 1, 2))

    def weight(self, n: int) -> float:
        """The weight of the result with n substeps: the product of n^2 / (n^2 - m^2) over the other numbers m."""
        product = Fraction(1)
        for m in self.substeps:
            if m != n:
                product *= Fraction(n * n, n * n - m * m)
        return float(product)

    def change(self, rates: Rates, pause: Pause, motion: AnyMotion) -> AnyMotion:
        first = rates(0.0, 1.0, motion)
        total = jax.tree.map(jnp.zeros_like, motion)
        for n in self.substeps:
            if n > 2:
                (total, first), motion, _ = pause((total, first), motion, n - 1)
            before, now = None, jax.tree.map(lambda rate, n=n: rate * (1 / n), first)
            for i in range(1, n):
                step = rates(i / n, 2 / n, jax.tree.map(jnp.add, motion, now))
                before, now = now, step if before is None else jax.tree.map(jnp.add, before, step)
            total = jax.tree.map(lambda sum_, change, n=n: sum_ + self.weight(n) * change, total, now)
        return total

    def change_in_loop(self, rates: Rates, motion: AnyMotion, like: Array) -> AnyMotion:
        """`change` as one loop over all substeps of all rules, so the rates are compiled only twice.

        Args:
            rates, motion: as for `change`.
            like: an array of the dtype of the motion.
        """
        first = rates(0.0, 1.0, motion)
        zeros = jax.tree.map(jnp.zeros_like, motion)
        # For each substep: its time and length; 1/n if it is the second of its rule, whose first has f(y); the weight
        # of the result if it is the last.
        substeps = [
            (i / n, 2 / n, 1 / n if i == 1 else 0.0, self.weight(n) if i == n - 1 else 0.0)
            for n in self.substeps
            for i in range(1, n)
        ]
        columns = tuple(jnp.asarray(column, like.dtype) for column in zip(*substeps, strict=True))

        def substep(carry: Any, row: Any) -> tuple[Any, None]:
            before, now, total = begin_step(carry)
            time, part, start, weight = row
            starts = start > 0
            now = jax.tree.map(lambda x, f: jnp.where(starts, start * f, x), now, first)
            before = jax.tree.map(lambda x: jnp.where(starts, jnp.zeros_like(x), x), before)
            step = rates(time, part, jax.tree.map(jnp.add, motion, now))
            after = jax.tree.map(jnp.add, before, step)
            total = jax.tree.map(lambda sum_, change: sum_ + weight * change, total, after)
            return fuse((now, after, total)), None

        (_, _, total), _ = jax.lax.scan(substep, (zeros, zeros, zeros), columns)
        return total
