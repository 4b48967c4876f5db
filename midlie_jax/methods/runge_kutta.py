"""Runge-Kutta methods with a constant step on momentum and pose, as if the quaternion were any four numbers.

They keep neither the spatial momentum of a free body nor the energy, and are not symplectic. Written on components and
fused stage by stage, a high order is all the same the least work for a short run to many digits under a strong torque.
All stages of all bodies stay alive through a step: few bodies at a time, that fit the first cache, go several times as
fast (`midlie_jax.ensemble(..., chunk=64)`; `docs/work-precision.md`).
"""

from itertools import accumulate
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._kernel import components as cp
from .._kernel.fusion import fuse
from ..model.bodies import RigidBody
from .base import Method
from .system import AnyMotion, Motion, System


class Table(NamedTuple):
    """An explicit tableau.

    Attributes:
        order: its order.
        stages: for each stage, the weights of the earlier ones by index; a stage's time is the sum of its weights.
        weights: of the stages in the step.
        loops: how many stages the compiler takes in each loop, in turn: one a loop waits for memory, and more than
            this repeats work (`python benchmarks/work_precision.py --scene asymmetric-top`).
        source: where it is from.
    """

    order: int
    stages: tuple[dict[int, float], ...]
    weights: dict[int, float]
    loops: tuple[int, ...]
    source: str


_RK4 = Table(4, ({}, {0: 0.5}, {1: 0.5}, {2: 1.0}), {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}, (2, 2), "Kutta 1901")

_DOP853 = Table(
    8,
    (
        {},
        {0: 0.05260015195876773},
        {0: 0.0197250569845379, 1: 0.0591751709536137},
        {0: 0.02958758547680685, 2: 0.08876275643042054},
        {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
        {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
        {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
        {
            0: 0.03709200011850479,
            3: 0.17038392571223998,
            4: 0.10726203044637328,
            5: -0.015319437748624402,
            6: 0.008273789163814023,
        },
        {
            0: 0.6241109587160757,
            3: -3.3608926294469414,
            4: -0.868219346841726,
            5: 27.59209969944671,
            6: 20.154067550477894,
            7: -43.48988418106996,
        },
        {
            0: 0.47766253643826434,
            3: -2.4881146199716677,
            4: -0.590290826836843,
            5: 21.230051448181193,
            6: 15.279233632882423,
            7: -33.28821096898486,
            8: -0.020331201708508627,
        },
        {
            0: -0.9371424300859873,
            3: 5.186372428844064,
            4: 1.0914373489967295,
            5: -8.149787010746927,
            6: -18.52006565999696,
            7: 22.739487099350505,
            8: 2.4936055526796523,
            9: -3.0467644718982196,
        },
        {
            0: 2.273310147516538,
            3: -10.53449546673725,
            4: -2.0008720582248625,
            5: -17.9589318631188,
            6: 27.94888452941996,
            7: -2.8589982771350235,
            8: -8.87285693353063,
            9: 12.360567175794303,
            10: 0.6433927460157636,
        },
    ),
    {
        0: 0.054293734116568765,
        5: 4.450312892752409,
        6: 1.8915178993145003,
        7: -5.801203960010585,
        8: 0.3111643669578199,
        9: -0.1521609496625161,
        10: 0.20136540080403034,
        11: 0.04471061572777259,
    },
    (3, 2, 2, 1, 1, 1, 1, 1),
    "Dormand & Prince, as in Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, II.5 and dop853.f",
)


_REACH = 2.4  # radians of h |Omega| at the start of a step, as of the other methods


class RungeKutta(Method):
    """One step of a tableau; the pose is brought back to unit length at its end, by one step of Newton's.

    Says False where the step begins with more than 2.4 radians: a long way before that the result is of no use.

    Attributes:
        table: the tableau.
    """

    table: Table = eqx.field(static=True)
    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    symmetric: bool = eqx.field(static=True)
    symplectic: bool = eqx.field(static=True)
    keeps_momentum: bool = eqx.field(static=True)
    bodies: type = eqx.field(static=True)
    evaluations: int = eqx.field(static=True)

    def __init__(self, name: str, table: Table):
        self.table = table
        self.name = name
        self.order = table.order
        self.symmetric = self.symplectic = self.keeps_momentum = False
        self.bodies = RigidBody
        self.evaluations = len(table.stages)

    def __hash__(self) -> int:
        return hash((type(self), self.name))

    @property
    def chunk(self) -> int:
        # All stages of all bodies stay alive through a step: where they fit the first cache, it is four times as fast.
        return 64

    def keeps_force(self, system: System) -> bool:
        return False

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        del force
        changes: list[AnyMotion] = []
        turn = cp.scale(h, system.velocity(motion.momentum))

        def total(weights: dict[int, float]) -> AnyMotion:
            """The sum of the changes found so far, with these weights."""

            def entry(*changes: Array) -> Array:
                first, *rest = (c * change for c, change in zip(weights.values(), changes, strict=True))
                return sum(rest, start=first)

            return jax.tree.map(entry, *(changes[j] for j in weights))

        ends, done = set(accumulate(self.table.loops)), 0
        for row in self.table.stages:
            part = sum(row.values())
            time = t0 if not row else t1 if abs(part - 1) < 1e-12 else t0 + part * h
            here = jax.tree.map(jnp.add, motion, total(row)) if row else motion
            force = None if system.torque is None else system.force(time, here)
            changes.append(system.rates(here, h, force))
            if len(changes) in ends:
                changes[done:] = fuse(changes[done:])
                done = len(changes)
        whole = total(self.table.weights)
        pose = system.kind.shift(motion.pose, whole.pose, h == 0, t0)
        ok = cp.dot(turn, turn) <= _REACH**2
        return Motion(cp.accumulate(motion.momentum, whole.momentum, t0), pose), None, ok


RK4 = RungeKutta("RK4", _RK4)
DOP853 = RungeKutta("DOP853", _DOP853)
