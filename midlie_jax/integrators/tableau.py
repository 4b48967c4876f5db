"""Explicit Runge-Kutta methods by tableaux: the classical one, and Dormand and Prince's of order 8."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._xla import budgets
from .formula import Pause, Rates
from .system import AnyMotion


class Tableau(NamedTuple):
    """The tableau of an explicit Runge-Kutta method: a `Formula`.

    Attributes:
        order: order of accuracy.
        stages: for each stage, the weights of the earlier stages by index; the time of a stage is t0 + h times their
            sum.
        weights: the weights of the stages in the step, by index.
        reach: the largest rotation h |Omega| of a step, in radians.
        source: the publication of the tableau.
    """

    order: int
    stages: tuple[dict[int, float], ...]
    weights: dict[int, float]
    reach: float
    source: str

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


RK4 = Tableau(4, ({}, {0: 0.5}, {1: 0.5}, {2: 1.0}), {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}, 2.4, "Kutta 1901")

DOP853 = Tableau(
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
    4.0,
    "Dormand & Prince, as in Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, II.5 and dop853.f",
)
