"""Explicit Runge-Kutta methods with a constant step on momentum and pose; a quaternion is four numbers.

They are not symplectic and do not conserve the spatial momentum of a free body. The energy drifts over a long run
unless each step ends with a projection (`projection.py`). For a run of few rotations under a strong torque they need
the least work of all methods, at any accuracy. The change in a step is a `Formula`: a tableau or an
extrapolation (`formulas.py`). Written on components, the step is one loop over the batch, whose stages stay in
registers and the first-level cache.
"""

import math
from functools import partial
from typing import Any

import equinox as eqx
import jax
from jax import Array

from .._xla import budgets
from .._xla.compiler import exact_jit
from .._xla.fusion import cut, fuse_derivative, fuse_derivative_of_many
from .._xla.platform import on_cpu
from .._xla.rules import count_operations
from ..model.bodies import Body, RigidBody
from . import formulas
from .base import Method
from .formulas import Extrapolation, Formula
from .limits import runge_kutta_limit
from .projection import OPERATIONS, projected
from .system import AnyMotion, Motion, System
from .verdict import of_all, verdict

_OF_PROJECTION = 3  # torque evaluations: for the size of the energy, and its gradient before each group of corrections


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

    def keeps_force(self, system: System) -> bool:
        return False

    def loops_for(self, system: System) -> bool:
        """Whether one copy of the torque suffices, in a loop over the substeps."""
        return isinstance(self.formula, Extrapolation) and (system.kind.several or system.placement.is_compiled_once)

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:

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


RK4 = RungeKutta("RK4", formulas.RK4)
DOP853 = RungeKutta("DOP853", formulas.DOP853)
GBS8 = RungeKutta("GBS8", Extrapolation(4, 4.0))
GBS10 = RungeKutta("GBS10", Extrapolation(5, 4.0))
GBS12 = RungeKutta("GBS12", Extrapolation(6, 5.0))
PGBS8 = RungeKutta("PGBS8", GBS8.formula, projects=True)
PGBS12 = RungeKutta("PGBS12", GBS12.formula, projects=True)
