"""The rows of docs/coming-from/diffrax.md."""

from collections.abc import Iterator

from . import columns, quantities, tables
from .alone import parts, run
from .compare import Row, agree, as_they_stand, both, changed, errors, row, times

NAME, TITLE, NEEDS = "diffrax", "diffrax", ("diffrax",)
WITHIN = 1e-6  # radians

_LEFT_SLOPE = """
def tip(weight):
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field), diffrax.Dopri8(), 0.0, 10.0, 0.02, start, weight, max_steps=501).ys[0, 4]
slope_of = jax.jit(jax.grad(tip), compiler_options={"xla_cpu_prefer_vector_width": 512})

slope = slope_of(20.0)
"""
_RIGHT_SLOPE = """
def tip(weight):
    torque = ml.torques.HeavyTop(weight)
    return ml.integrate("SYMMETRIC[SRKN6b]", body, torque, start, dt=0.1, steps=100, save_every=None).states.attitude[1]
slope_of = jax.jit(jax.grad(tip))

slope = slope_of(20.0)
"""


def rows() -> Iterator[Row]:
    left, right = columns(NAME)
    finer = (
        ("10.0, 101)", "10.0, 401)"),
        ("max_steps=100", "max_steps=400"),
        ("SRKN6b", "SRKN14a"),
        ("steps=1,", "steps=4,"),
    )
    fine = run(changed(right, *finer), quantities(NAME))
    agree(NAME, run(changed(left, ("1e-10", "1e-13")), quantities(NAME)), fine, within=1e-9)
    yield from as_they_stand(NAME, 20)
    ends = [run(code, quantities(NAME)) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, fine)
    yield from _a_thousand()
    theirs, ours = (
        run(parts(code)[0] + slope, ("slope",), 20) for code, slope in ((left, _LEFT_SLOPE), (right, _RIGHT_SLOPE))
    )
    agree(NAME, theirs, ours, within=1e-5)
    yield from times(theirs, ours, "the derivative of a run")


def _a_thousand() -> Iterator[Row]:
    one, many = tables(NAME)
    left, right = (f"{first}\n{second}" for first, second in zip(one, many, strict=True))
    theirs, ours = both(NAME, 5, (left, right))
    yield row("a thousand tops", theirs.later, ours.later)
    finer = ("dt=0.1, steps=100", "dt=0.025, steps=400"), ('SRKN6b]", body, torque', 'SRKN14a]", body, torque')
    fine = run(changed(right, *finer), quantities(NAME))
    yield errors("largest error of the thousand, rad", [theirs, ours], fine)
