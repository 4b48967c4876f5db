"""The rows of docs/coming-from/diffrax.md, heyoka.md and scipy.md."""

import re
from collections.abc import Iterator

import numpy as np

from .alone import Outcome, parts, run
from .compare import PAGES, Page, Row, agree, as_they_stand, both, changed, columns, errors, joined, row, times

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


def _diffrax() -> Iterator[Row]:
    left, right = columns("diffrax")
    finer = (
        ("10.0, 101)", "10.0, 401)"),
        ("max_steps=100", "max_steps=400"),
        ("SRKN6b", "SRKN14a"),
        ("steps=1,", "steps=4,"),
    )
    fine = run(changed(right, *finer))
    agree("diffrax", run(changed(left, ("1e-10", "1e-13"))), fine, within=1e-9)
    yield from as_they_stand("diffrax", 20)
    ends = [run(code) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, fine)
    yield from _thousand_tops()
    theirs, ours = (
        run(parts(code)[0] + slope, ("slope",), 20) for code, slope in ((left, _LEFT_SLOPE), (right, _RIGHT_SLOPE))
    )
    agree("diffrax", theirs, ours, within=1e-5)
    yield from times(theirs, ours, "the derivative of a run")


def _thousand_tops() -> Iterator[Row]:
    left, right = joined("diffrax")
    theirs, ours = both("diffrax", 5, (left, right))
    yield row("a thousand tops", theirs.later, ours.later)
    finer = ("dt=0.1, steps=100", "dt=0.025, steps=400"), ('SRKN6b]", body, torque', 'SRKN14a]", body, torque')
    fine = run(changed(right, *finer))
    yield errors("largest error of the thousand, rad", [theirs, ours], fine)


_WIDTHS = (1, 2, 4)
# From the asymmetric body to the fast top, and to the methods that fit it.
_TOP_LEFT = (("1.0, 2.0, 3.0, 3.0", "5.0, 5.0, 1.0, 20.0"), ("[1.1, -0.35, 4.0 / 3", "[0.0, 0.0, 50.0"))
_TOP_RIGHT = (
    ("[1.0, 2.0, 3.0]", "[5.0, 5.0, 1.0]"),
    ("HeavyTop(3.0)", "HeavyTop(20.0)"),
    ("[1.1, -0.35, 4.0 / 3]", "[0.0, 0.0, 50.0]"),
    ("PGBS12", "SYMMETRIC[SRKN14a]"),
    ("dt=0.2, steps=50", "dt=0.1, steps=100"),
)


def _heyoka() -> Iterator[Row]:
    left, right = columns("heyoka")
    yield from as_they_stand("heyoka")
    ends = [run(code) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, _finest(left))
    left, right = joined("heyoka")
    yield from _many("1024 bodies", left, right)
    yield from _many("1024 fast tops", changed(left, *_TOP_LEFT), changed(right, *_TOP_RIGHT))


def _many(label: str, left: str, right: str) -> Iterator[Row]:
    built = [run(changed(left, ("width = 1 *", f"width = {n} *")), later=20) for n in _WIDTHS]
    theirs, ours = min(built, key=lambda found: found.later), run(right, later=20)
    agree("heyoka", theirs, ours)
    yield row(label, theirs.later, ours.later)
    yield errors(f"largest error of the {label}, rad", [theirs, ours], _finest(left))


def _finest(code: str) -> Outcome:
    return run(re.sub(r"tol=1e-\d+", "tol=1e-16", code))


_FINER = 2  # steps of the reference for one of the page
# What the long run asks besides: the largest change of the energy, and of the length of the quaternion.
_ENERGY_LEFT = """
p, q, r, x, y, z, w = run.y
tip = w * w + z * z - x * x - y * y
energy = (A * p * p + B * q * q + C * r * r) / 2 + weight * tip / (run.y[3:] ** 2).sum(0)
"""
_ENERGY_RIGHT = """
energy = ml.observe.energy(body, torque, path)
"""


def _scipy() -> Iterator[Row]:
    left, right = columns("scipy")
    yield from as_they_stand("scipy")
    finer = f"dt={0.1 / _FINER}, steps={200 * _FINER}, save_every={_FINER}"
    fine = run(changed(right, ("dt=0.1, steps=200", finer)))
    finest = run(changed(left, ("1e-9", "3e-14")))
    agree("scipy", finest, fine, within=1e-10)
    ends = [run(code) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, fine)
    yield from _thousand_bodies()
    yield from _long()


def _thousand_bodies() -> Iterator[Row]:
    left, right = joined("scipy")
    theirs, ours = both("scipy", 3, (left, right))
    yield row("a thousand bodies", theirs.later, ours.later)
    fine = run(changed(right, ("dt=0.4, steps=50", f"dt={0.4 / 8}, steps={50 * 8}")))
    yield errors("largest error of the thousand, rad", [theirs, ours], fine)


def _long() -> Iterator[Row]:
    left, right = columns("scipy")
    left = changed(left, ("20.0", "2000.0")) + _ENERGY_LEFT
    right = changed(right, ("steps=200", "steps=20000, save_every=100")) + _ENERGY_RIGHT
    theirs, ours = (run(code, ("attitude", "energy")).values for code in (left, right))
    changes = _change(theirs["energy"]), _change(ours["energy"])
    yield row("change of the energy in 2000 s, of m g l = 2", changes[0], changes[1], ".1e")
    lengths = _length(theirs["attitude"]), _length(ours["attitude"])
    yield row("change of the quaternion's length in 2000 s", lengths[0], lengths[1], ".1e")


def _change(energy: np.ndarray) -> float:
    return float(np.max(np.abs(energy - energy[0])))


def _length(attitude: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.norm(attitude, axis=-1) - 1)))


PAGES["diffrax"] = Page("diffrax", ("diffrax",), 1e-6, _diffrax)  # radians
PAGES["heyoka"] = Page("heyoka", ("heyoka",), 1e-8, _heyoka)
PAGES["scipy"] = Page("SciPy", ("scipy",), 1e-6, _scipy)
