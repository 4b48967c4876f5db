"""Other programs and methods on the same problems, each through its public interface, in its own file.

They are only measured: no other part of the package uses them, and each imports its program only when it runs.
`work_precision` compares them with the methods of this package. A new rival needs a file here and a line in `RIVALS`.
"""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import NamedTuple

from . import heyoka_taylor, lie_group, mujoco_steps, runge_kutta
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


RIVALS = (
    Rival("heyoka", ("heyoka",), heyoka_taylor.measure),
    Rival("diffrax Tsit5", (), runge_kutta.tsit5),
    Rival("diffrax Dopri8", (), runge_kutta.dopri8),
    Rival("SciPy DOP853", ("scipy",), runge_kutta.dop853),
    Rival("MuJoCo RK4", ("mujoco",), mujoco_steps.rk4),
    Rival("MuJoCo implicitfast", ("mujoco",), mujoco_steps.implicitfast),
    Rival("RKMK4", (), lie_group.rkmk4),
    Rival("CF4", (), lie_group.cf4),
    Rival(heyoka_taylor.LABEL, ("heyoka",), heyoka_taylor.measure_spinning),
)


def require(rivals: tuple[Rival, ...] = RIVALS) -> None:
    """Checks that the packages of the rivals are installed, before minutes are spent on measuring."""
    missing = [name for name in dict.fromkeys(n for r in rivals for n in r.needs) if find_spec(name) is None]
    if missing:
        raise ImportError(f"the rivals need {' and '.join(missing)}: pip install 'midlie_jax[bench]'.")
