"""Explicit Runge-Kutta methods with a constant step on momentum and pose; a quaternion is four numbers.

They are not symplectic and do not conserve the spatial momentum of a free body. The energy drifts over a long run
unless each step ends with a projection (`projection.py`). For a run of few rotations under a strong torque they need
the least work of all methods, at any accuracy. The change in a step is a `Formula`: a tableau, or Gragg-Bulirsch-Stoer
extrapolation, Gragg's midpoint rule with more and more substeps, extrapolated to length 0.

The rule with n substeps of length d = h/n is z_1 = y + d f(y), z_{i+1} = z_{i-1} + 2 d f(z_i). For even n its error has
even powers of d only, so each further n raises the order by two. Here n = 2, 4, 6, ...; all rules share the first
evaluation. Gragg's smoothing step, which the extrapolation does not need, is left out. The sums are over the
differences z_i - y, so rounding errors are proportional to the change in a step.

W. B. Gragg, SIAM J. Numer. Anal. 2 (1965) 384; R. Bulirsch, J. Stoer, Numer. Math. 8 (1966) 1; Hairer, Norsett &
Wanner, Solving Ordinary Differential Equations I, II.9.
"""

import math
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._xla import budgets
from .._xla.compiler import exact_jit
from .._xla.fusion import begin_step, cut, fuse, fuse_derivative, fuse_derivative_of_many
from .._xla.platform import on_cpu
from .._xla.rules import count_operations
from ..model.bodies import Body, RigidBody
from .base import Method
from .limits import runge_kutta_limit
from .projection import OPERATIONS, projected
from .system import AnyMotion, Motion, Stepped, System
from .verdict import of_all, verdict

_OF_PROJECTION = 3  # torque evaluations: for the size of the energy, and its gradient before each group of corrections

# `rates(time, part, motion)` is `part` h times the right-hand side of the equations of motion, at t0 + `time` h.
Rates = Callable[[float, float, AnyMotion], AnyMotion]
# `pause(fresh, older, evaluations)` returns `fresh` and `older` unchanged, and whether a loop ends there. It marks a
# point of a step where few numbers are alive, before a part with this many evaluations. A loop that would become too
# long for the compiler ends there: in a step for `fresh`, the numbers computed since the last end; in its derivative
# for both.
Pause = Callable[[Any, Any, int], tuple[Any, Any, bool]]


class Tableau(NamedTuple):
    """The tableau of an explicit Runge-Kutta method: a `Formula`."""

    order: int  # order of accuracy
    # for each stage, the weights of the earlier stages by index; the time of a stage is t0 + h times their sum
    stages: tuple[dict[int, float], ...]
    weights: dict[int, float]  # the weights of the stages in the step, by index
    reach: float  # the largest rotation h |Omega| of a step, in radians

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


class Extrapolation(NamedTuple):
    """The extrapolated midpoint rule: a `Formula`."""

    levels: int  # the number of combined results, with 2, 4, ..., 2 `levels` substeps; the order is 2 `levels`
    reach: float  # the largest rotation h |Omega| of a step, in radians

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
        return float(math.prod(Fraction(n * n, n * n - m * m) for m in self.substeps if m != n))

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


class RungeKutta(Method):
    """The Runge-Kutta method of a formula. At the end of each step, one Newton step rescales the pose to unit length.

    A step reports False in `ok` if h |Omega| at its start exceeds the reach of the formula, or if it is too long for a
    projection (`projects`, see `projection.py`) to restore the energy to rounding.
    """

    formula: Formula = eqx.field(static=True)
    projects: bool = eqx.field(static=True)

    def __init__(self, name: str, formula: Formula, *, projects: bool = False):
        self.symmetric = self.symplectic = self.keeps_momentum = False
        self.name, self.formula, self.order, self.projects = name, formula, formula.order, projects
        self.bodies = RigidBody if projects else Body
        self.evaluations = formula.evaluations + (_OF_PROJECTION if projects else 0)

    def __hash__(self) -> int:
        return hash((type(self), self.name))

    @property
    def keeps_energy(self) -> bool:
        return self.projects

    @property
    def several(self) -> bool:
        return not self.projects

    @property
    def unroll(self) -> int:
        return 1 if on_cpu() else max(1, budgets.KERNEL_EVALUATIONS // self.evaluations)

    @property
    def reach(self) -> float:
        return self.formula.reach

    def stability_limit(self, direction: complex) -> float:
        return runge_kutta_limit(self.formula, direction)

    def loops_for(self, system: System) -> bool:
        """Whether one copy of the torque suffices, in a loop over the substeps."""
        return isinstance(self.formula, Extrapolation) and (system.kind.several or system.placement.is_compiled_once)

    def step(self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any) -> Stepped:

        def rates(time: Any, part: Any, motion: AnyMotion) -> AnyMotion:
            known = isinstance(part, float)  # in a loop they are traced, and the time is not at an end of the step
            t = t0 if known and time == 0 else t1 if known and abs(time - 1) < 1e-12 else t0 + time * h
            return _rates(system, t, h if known and part == 1.0 else part * h, motion)

        longest = budgets.LOOP_OPERATIONS if on_cpu() else budgets.KERNEL_OPERATIONS
        in_loop = in_derivative = in_many = 0
        per_evaluation = count_operations(jax.make_jaxpr(lambda motion: rates(0.5, 0.5, motion))(motion))
        # Evaluations whose derivative fits one loop. A stage of a tableau reads the others.
        stages = math.inf if isinstance(self.formula, Extrapolation) else budgets.LOOP_STAGES
        most = min(stages, longest / (budgets.DERIVATIVE_OPERATIONS * per_evaluation))
        most_of_many = min(stages, longest / (budgets.DERIVATIVE_OPERATIONS_OF_MANY * per_evaluation))

        def pause(fresh: Any, older: Any, evaluations: int) -> tuple[Any, Any, bool]:
            nonlocal in_loop, in_derivative, in_many, system
            alone = evaluations == 1 and per_evaluation > budgets.LONG_TORQUE  # a stage of a tableau reads the others
            ends = alone or (in_loop + evaluations) * per_evaluation > longest
            in_loop = evaluations if ends else in_loop + evaluations
            long = ends or in_derivative + evaluations > most
            long_of_many = long or in_many + evaluations > most_of_many
            in_derivative = evaluations if long else in_derivative + evaluations
            in_many = evaluations if long_of_many else in_many + evaluations
            fresh = cut(fresh) if ends else fresh
            if long:  # the derivatives by the constants of the system are sums over all stages
                system, (fresh, older) = system.begun(fuse_derivative, (fresh, older))
            elif long_of_many:
                few = len(jax.tree.leaves((fresh, older))) + budgets.FEW_PARAMETERS
                system, (fresh, older) = system.begun(partial(fuse_derivative_of_many, few=few), (fresh, older))
            return fresh, older, ends

        turn = system.inertia.square_of_turn(h, motion.momentum)
        if isinstance(self.formula, Extrapolation) and self.loops_for(system):
            change = self.formula.change_in_loop(rates, motion, h)
        else:
            change = self.formula.change(rates, pause, motion)
        if self.projects:
            change, motion, _ = pause(change, motion, OPERATIONS // per_evaluation)
        end = system.pushed(motion, change.momentum)
        end = Motion(end.momentum, system.kind.shift(end.pose, change.pose, h == 0))
        kept: Array | bool = True
        if self.projects:
            end, kept = projected(system, t0, t1, h, motion, end)
        return end, None, of_all(verdict(kept, (turn, self.formula.reach**2)))


@exact_jit
def _rates(system: System, t: Array, h: Array, motion: AnyMotion) -> AnyMotion:
    return system.rates(motion, h, None if system.torque is None else system.force(t, motion))


_KUTTA = Tableau(4, ({}, {0: 0.5}, {1: 0.5}, {2: 1.0}), {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}, 2.4)  # 1901
RK4 = RungeKutta("RK4", _KUTTA)


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
DOP853 = RungeKutta("DOP853", Tableau(8, ({}, *map(_weights, _STAGES)), _weights(_STEP), 4.0))


GBS8 = RungeKutta("GBS8", Extrapolation(4, 4.0))
GBS10 = RungeKutta("GBS10", Extrapolation(5, 4.0))
GBS12 = RungeKutta("GBS12", Extrapolation(6, 5.0))
PGBS8 = RungeKutta("PGBS8", GBS8.formula, projects=True)
PGBS12 = RungeKutta("PGBS12", GBS12.formula, projects=True)
