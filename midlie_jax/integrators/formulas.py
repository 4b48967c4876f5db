"""The change of momentum and pose in a Runge-Kutta step, for any equations of motion: by a tableau or an extrapolation.

Gragg-Bulirsch-Stoer extrapolation is Gragg's midpoint rule with more and more substeps, extrapolated to length 0.

The rule with n substeps of length d = h/n is z_1 = y + d f(y), z_{i+1} = z_{i-1} + 2 d f(z_i). For even n its error has
even powers of d only, so each further n raises the order by two. Here n = 2, 4, 6, ...; all rules share the first
evaluation. Gragg's smoothing step, which the extrapolation does not need, is left out. The sums are over the
differences z_i - y rather than z_i, so rounding errors are proportional to the change in a step.

A step keeps only two motions and a sum alive, whereas a tableau keeps all stages.

W. B. Gragg, SIAM J. Numer. Anal. 2 (1965) 384; R. Bulirsch, J. Stoer, Numer. Math. 8 (1966) 1; Hairer, Norsett &
Wanner, Solving Ordinary Differential Equations I, II.9.
"""

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from .._xla import budgets
from .._xla.fusion import begin_step, fuse
from .system import AnyMotion

# `rates(time, part, motion)` is `part` times h times the right-hand side of the equations of motion, at the time t0 +
# `time` h of a step from t0.
Rates = Callable[[float, float, AnyMotion], AnyMotion]
# `pause(fresh, older, evaluations)` returns `fresh` and `older` unchanged, and whether a loop ends there. It marks a
# point of a step where few numbers are alive, before a part with this many evaluations. A loop that would become too
# long for the compiler ends there: in a step for `fresh`, the numbers computed since the last end; in its derivative
# for both.
Pause = Callable[[Any, Any, int], tuple[Any, Any, bool]]


class Tableau(NamedTuple):
    """The tableau of an explicit Runge-Kutta method: a `Formula`.

    Attributes:
        order: order of accuracy.
        stages: for each stage, the weights of the earlier stages by index; the time of a stage is t0 + h times their
            sum.
        weights: the weights of the stages in the step, by index.
        reach: the largest rotation h |Omega| of a step, in radians.
    """

    order: int
    stages: tuple[dict[int, float], ...]
    weights: dict[int, float]
    reach: float

    @property
    def evaluations(self) -> int:
        return len(self.stages)

    def change(self, rates: Rates, pause: Pause, motion: AnyMotion) -> AnyMotion:
        changes: list[AnyMotion] = []
        begun = 0  # the first change that the present loop computes
        for row in self.stages:
            if len(self.stages) > budgets.LOOP_STAGES:
                fresh, (older, motion), ended = pause(changes[begun:], (changes[:begun], motion), 1)
                changes = older + fresh
                begun = len(changes) if ended else begun
            stage_motion = jax.tree.map(jnp.add, motion, _total(row, changes)) if row else motion
            changes.append(rates(sum(row.values(), start=0.0), 1.0, stage_motion))
        return _total(self.weights, changes)


def _total(weights: dict[int, float], changes: list[AnyMotion]) -> AnyMotion:
    def entry(*entries: Any) -> Any:
        first, *rest = (c * change for c, change in zip(weights.values(), entries, strict=True))
        return sum(rest, start=first)

    return jax.tree.map(entry, *(changes[j] for j in weights))


RK4 = Tableau(4, ({}, {0: 0.5}, {1: 0.5}, {2: 1.0}), {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}, 2.4)  # Kutta 1901


def _weights(text: str) -> dict[int, float]:
    """The weights that are not zero, by index."""
    return {j: weight for j, weight in enumerate(map(float, text.split())) if weight}


# Dormand & Prince, as in Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, II.5 and dop853.f: the
# stages after the first, and the step.
_DOP853 = """
0.05260015195876773;
0.0197250569845379 0.0591751709536137;
0.02958758547680685 0 0.08876275643042054;
0.2413651341592667 0 -0.8845494793282861 0.924834003261792;
0.037037037037037035 0 0 0.17082860872947386 0.12546768756682242;
0.037109375 0 0 0.17025221101954405 0.06021653898045596 -0.017578125;
0.03709200011850479 0 0 0.17038392571223998 0.10726203044637328 -0.015319437748624402 0.008273789163814023;
0.6241109587160757 0 0 -3.3608926294469414 -0.868219346841726 27.59209969944671 20.154067550477894 -43.48988418106996;
0.47766253643826434 0 0 -2.4881146199716677 -0.590290826836843 21.230051448181193 15.279233632882423
-33.28821096898486 -0.020331201708508627;
-0.9371424300859873 0 0 5.186372428844064 1.0914373489967295 -8.149787010746927 -18.52006565999696 22.739487099350505
2.4936055526796523 -3.0467644718982196;
2.273310147516538 0 0 -10.53449546673725 -2.0008720582248625 -17.9589318631188 27.94888452941996 -2.8589982771350235
-8.87285693353063 12.360567175794303 0.6433927460157636;
0.054293734116568765 0 0 0 0 4.450312892752409 1.8915178993145003 -5.801203960010585 0.3111643669578199
-0.1521609496625161 0.20136540080403034 0.04471061572777259
"""
*_STAGES, _STEP = _DOP853.split(";")
DOP853 = Tableau(8, ({}, *map(_weights, _STAGES)), _weights(_STEP), 4.0)


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
        """`change` as one loop over all substeps of all rules, in the dtype of `like`; it holds the rates twice."""
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


Formula = Tableau | Extrapolation
