"""Runge-Kutta methods with a constant step on momentum and pose, which treat the quaternion as any four numbers.

They conserve neither the spatial momentum of a free body nor the energy, and are not symplectic. Written on components
and fused stage by stage, a method of high order still needs the least work for a short run at high accuracy under a
strong torque. A step keeps all stages of all bodies in memory. A chunk of few bodies, whose stages fit the first-level
cache, therefore runs several times as fast; `midlie_jax.ensemble` takes such chunks unless told otherwise.
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
    """The tableau of an explicit Runge-Kutta method.

    Attributes:
        order: order of accuracy.
        stages: for each stage, the weights of the earlier stages by index; the time of a stage is t0 + h times their
            sum.
        weights: the weights of the stages in the step, by index.
        loops: how many stages each compiled loop holds, in order. Loops of one stage each wait for memory; loops of
            more stages than given here repeat work (`python benchmarks/work_precision.py --scene asymmetric-top`).
        source: the publication of the tableau.
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


_LARGEST_TURN = 2.4  # the largest h |Omega| at the start of a step, in radians, as for the other methods


class RungeKutta(Method):
    """The Runge-Kutta method of a tableau. Each step ends by scaling the pose back to unit length, by one Newton step.

    A step reports False in `ok` where h |Omega| at its start exceeds 2.4 radians; its result is useless at far smaller
    values already.

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
        # A step keeps all stages of all bodies in memory; it is four times as fast if they fit the first-level cache.
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
            """The sum of the changes computed so far, with these weights."""

            def entry(*changes: Array) -> Array:
                first, *rest = (c * change for c, change in zip(weights.values(), changes, strict=True))
                return sum(rest, start=first)

            return jax.tree.map(entry, *(changes[j] for j in weights))

        ends, fused_count = set(accumulate(self.table.loops)), 0
        for row in self.table.stages:
            part = sum(row.values())
            time = t0 if not row else t1 if abs(part - 1) < 1e-12 else t0 + part * h
            stage_motion = jax.tree.map(jnp.add, motion, total(row)) if row else motion
            force = None if system.torque is None else system.force(time, stage_motion)
            changes.append(system.rates(stage_motion, h, force))
            if len(changes) in ends:
                changes[fused_count:] = fuse(changes[fused_count:])
                fused_count = len(changes)
        change = total(self.table.weights)
        pose = system.kind.shift(motion.pose, change.pose, h == 0, t0)
        ok = cp.dot(turn, turn) <= _LARGEST_TURN**2
        return Motion(cp.accumulate(motion.momentum, change.momentum, t0), pose), None, ok


RK4 = RungeKutta("RK4", _RK4)
DOP853 = RungeKutta("DOP853", _DOP853)
