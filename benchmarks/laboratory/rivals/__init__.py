"""Other programs and methods on the same problems, each through its public interface, in its own file.

They are only measured: no other part of the package uses them, and each imports its program only when it runs.
`work_precision` compares them with the methods of this package. A new rival needs a file here and a line in `RIVALS`.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import diffrax

from . import heyoka_taylor, mujoco_steps, runge_kutta
from .ladder import ladder
from .lie_group import CF4, RKMK4
from .problem import Point, Problem


class Rival(NamedTuple):
    """A program, or one of its methods.

    Attributes:
        label: its name in charts and tables.
        needs: the packages that it imports.
        measure: yields a point for each tolerance or step, and none for a problem that the program cannot solve.
    """

    label: str
    needs: tuple[str, ...]
    measure: Callable[[Problem], Iterator[Point]]


def _diffrax(name: str, solver: Any, stages: int) -> Rival:
    return Rival(name, (), partial(runge_kutta.measure, solver=solver, name=name, stages=stages))


def _mujoco(name: str, integrator: str, evaluations: int) -> Rival:
    run = partial(mujoco_steps.measure, integrator=integrator, name=name, evaluations=evaluations)
    return Rival(name, ("mujoco",), run)


RIVALS = (
    Rival("heyoka", ("heyoka",), heyoka_taylor.measure),
    _diffrax("diffrax Tsit5", diffrax.Tsit5(), 6),
    _diffrax("diffrax Dopri8", diffrax.Dopri8(), 13),
    Rival("SciPy DOP853", ("scipy",), runge_kutta.dop853),
    _mujoco("MuJoCo RK4", "RK4", 4),
    _mujoco("MuJoCo implicitfast", "implicitfast", 1),
    Rival("RKMK4", (), partial(ladder, RKMK4())),
    Rival("CF4", (), partial(ladder, CF4())),
    Rival(heyoka_taylor.LABEL, ("heyoka",), heyoka_taylor.measure_spinning),
)


def require(rivals: tuple[Rival, ...] = RIVALS) -> None:
    """Checks that the packages of the rivals are installed, before minutes are spent on measuring."""
    missing = [name for name in dict.fromkeys(n for r in rivals for n in r.needs) if find_spec(name) is None]
    if missing:
        raise ImportError(f"the rivals need {' and '.join(missing)}: pip install 'midlie_jax[bench]'.")
