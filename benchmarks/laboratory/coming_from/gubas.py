"""The rows of docs/coming-from/gubas.md.

The environment variable GUBAS names a folder with GUBAS's scripts, the files of its example, and the program, made by

    g++ -std=c++11 -O3 -march=native -DARMA_NO_DEBUG hou_cpp.cpp -o hou_cpp_final -larmadillo

and, for NumPy 2, with its scripts changed as the page says. Its times are those of one binary; its errors are measured
against a far finer run of this library, with which its own errors fall to 4e-10.
"""

from collections.abc import Iterator
from typing import NamedTuple

from . import columns
from .alone import Outcome, parts, run
from .compare import Row, both, changed, error, errors, row, times

TITLE, NEEDS = "GUBAS", ("GUBAS", "scipy")
WITHIN = 1e-2  # radians: what LGVI with steps of 30 s is off after a day
QUANTITIES = ("times", "position", "attitude")

_STEPS = "dt=600.0, steps=144, save_every=6"
_FINE = "dt=200.0, steps=432, save_every=18"
# RK 7(8) has its own times, so that only the end is read; then the program alone, without the scripts.
_END = """
subprocess.run([sys.executable, "hou_shell_cfg.py"], check=True)
end = np.fromfile("output_x/x_out.bin").reshape(-1, 30)[-1]
A = end[12:21].reshape(3, 3)
turned = Rotation.from_matrix(np.stack([A, A @ end[21:30].reshape(3, 3)]))
attitude = turned.as_quat(scalar_first=True)

subprocess.run(["./hou_cpp_final"], check=True)
"""
# A thousand binaries that spin a little faster, one after the other.
_MANY = """
faster = jnp.linspace(1.0, 1.1, 1000)[:, None, None]
starts = ml.CoupledState(
    faster * start.momentum, *(jnp.stack([x] * 1000) for x in (start.attitude, start.linear, start.position))
)

path = ml.ensemble("JACOBI[SRKN14a]", pair, gravity, starts, dt=86400.0 / STEPS, steps=STEPS)
attitude = path.states.attitude[0]
"""
COUNT = 1000


class _Case(NamedTuple):
    """A degree of the gravity, a tolerance of RK 7(8), and steps a day with which our error is not larger."""

    degree: int
    tolerance: float
    steps: int


_CASES = _Case(2, 1e-10, 54), _Case(4, 1e-10, 54)


def rows() -> Iterator[Row]:
    left, right = columns("gubas")
    theirs, ours = both("gubas", later=3)
    yield from times(theirs, ours)
    fine = run(changed(right, (_STEPS, _FINE)), QUANTITIES)
    yield errors("largest error of the attitudes, rad", (theirs, ours), fine, form=".0e")
    for case in _CASES:
        yield from _at_equal_error(left, right, case)


def _at_equal_error(left: str, right: str, case: _Case) -> Iterator[Row]:
    right = changed(right, ("degree=2", f"degree={case.degree}"))
    fine = _end(run(changed(right, (_STEPS, _FINE)), QUANTITIES))
    theirs = run(_runge_kutta(left, case), ("attitude",), later=3)
    steps = f"dt={86400.0 / case.steps}, steps={case.steps}, save_every={case.steps}"
    ours = run(changed(right, (_STEPS, steps)), QUANTITIES, later=20)
    many = run(parts(right)[0] + changed(_MANY, ("STEPS", str(case.steps))), ("attitude",), later=3)
    theirs_off, *ours_off = (error(found, fine) for found in (theirs, _end(ours), many))
    if max(ours_off) > theirs_off:
        raise RuntimeError(f"With {case.steps} steps a day the error is {ours_off}, that of GUBAS {theirs_off:.1e}.")
    named = f"degree {case.degree}, RK 7(8) at {case.tolerance:g}"
    yield row(f"{named}: one binary", theirs.later, ours.later)
    yield row(f"{named}: each of {COUNT}", theirs.later, many.later / COUNT)
    yield row(f"{named}: largest error after the day, rad", theirs_off, ours_off[0], ".0e")


def _runge_kutta(left: str, case: _Case) -> str:
    """The left column with RK 7(8) and another degree, without the tables that GUBAS's scripts write."""
    settings = left.partition("\nsubprocess.run")[0]
    changes = (
        ('Truncation Order": 2', f'Truncation Order": {case.degree}'),
        ('"Integrator Flag": 2', f'"Integrator Flag": 3, "Absolute Tolerance": {case.tolerance}'),
        ('"Output Settings": {', '"Output Settings": {"Post Processing": 0,'),
    )
    return changed(settings, *changes) + _END


def _end(found: Outcome) -> Outcome:
    return found._replace(values={"attitude": found.values["attitude"][-1]})
