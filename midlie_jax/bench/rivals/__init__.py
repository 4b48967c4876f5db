"""Other programs on the same problems, each through its public interface: one rival, one file.

They are measured, never used: nothing else in the package imports this, and each imports its own program when it is
run. `work_precision` puts them on one chart with the methods of this package. A new rival is a file here and a line in
`RIVALS`.
"""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import NamedTuple

from . import diffrax_ode, heyoka_taylor, lie_group, mujoco_steps, scipy_dop853
from .problem import Point, Problem


class Rival(NamedTuple):
    """A program, or a family of methods of one.

    Attributes:
        label: what the chart and the table call it.
        needs: the packages that it imports.
        measure: yields a point for each tolerance or step; a problem that it cannot pose gives none.
    """

    label: str
    needs: tuple[str, ...]
    measure: Callable[[Problem], Iterator[Point]]


RIVALS = (
    Rival("heyoka", ("heyoka",), heyoka_taylor.measure),
    Rival("diffrax Tsit5", (), diffrax_ode.tsit5),
    Rival("diffrax Dopri8", (), diffrax_ode.dopri8),
    Rival("SciPy DOP853", ("scipy",), scipy_dop853.measure),
    Rival("MuJoCo RK4", ("mujoco",), mujoco_steps.rk4),
    Rival("MuJoCo implicitfast", ("mujoco",), mujoco_steps.implicitfast),
    Rival("RKMK4", (), lie_group.rkmk4),
    Rival("CF4", (), lie_group.cf4),
)


def require(rivals: tuple[Rival, ...] = RIVALS) -> None:
    """Tells what is missing before, not after, minutes of measuring.

    Raises:
        ImportError: a package is not installed; the message names the extra that brings it.
    """
    missing = [name for name in dict.fromkeys(n for r in rivals for n in r.needs) if find_spec(name) is None]
    if missing:
        raise ImportError(f"the rivals need {' and '.join(missing)}: pip install 'midlie_jax[bench]'.")
