"""The rows of docs/coming-from/scipy.md."""

from collections.abc import Iterator

import numpy as np

from . import columns, quantities, tables
from .alone import run
from .compare import Row, agree, as_they_stand, both, changed, errors, row

NAME, TITLE, NEEDS = "scipy", "SciPy", ("scipy",)
WITHIN = 1e-6  # radians

_FINE = 2  # steps of the reference for one of the page
# What the long run asks besides: the largest change of the energy, and of the length of the quaternion.
_LEFT = """
p, q, r, x, y, z, w = run.y
tip = w * w + z * z - x * x - y * y
energy = (A * p * p + B * q * q + C * r * r) / 2 + weight * tip / (run.y[3:] ** 2).sum(0)
"""
_RIGHT = """
energy = ml.observe.energy(body, torque, path)
"""


def rows() -> Iterator[Row]:
    left, right = columns(NAME)
    yield from as_they_stand(NAME)
    finer = f"dt={0.1 / _FINE}, steps={200 * _FINE}, save_every={_FINE}"
    fine = run(changed(right, ("dt=0.1, steps=200", finer)), quantities(NAME))
    finest = run(changed(left, ("1e-9", "3e-14")), quantities(NAME))
    agree(NAME, finest, fine, within=1e-10)
    ends = [run(code, quantities(NAME)) for code in (left, right)]
    yield errors("largest error of the attitude, rad", ends, fine)
    yield from _a_thousand()
    yield from _long()


def _a_thousand() -> Iterator[Row]:
    one, many = tables(NAME)
    left, right = (f"{first}\n{second}" for first, second in zip(one, many, strict=True))
    theirs, ours = both(NAME, 3, (left, right))
    yield row("a thousand bodies", theirs.later, ours.later)
    fine = run(changed(right, ("dt=0.4, steps=50", f"dt={0.4 / 8}, steps={50 * 8}")), quantities(NAME))
    yield errors("largest error of the thousand, rad", [theirs, ours], fine)


def _long() -> Iterator[Row]:
    left, right = columns(NAME)
    left = changed(left, ("20.0", "2000.0")) + _LEFT
    right = changed(right, ("steps=200", "steps=20000, save_every=100")) + _RIGHT
    theirs, ours = (run(code, ("attitude", "energy")).values for code in (left, right))
    changes = _change(theirs["energy"]), _change(ours["energy"])
    yield row("change of the energy in 2000 s, of m g l = 2", changes[0], changes[1], ".1e")
    lengths = _length(theirs["attitude"]), _length(ours["attitude"])
    yield row("change of the quaternion's length in 2000 s", lengths[0], lengths[1], ".1e")


def _change(energy: np.ndarray) -> float:
    return float(np.max(np.abs(energy - energy[0])))


def _length(attitude: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.norm(attitude, axis=-1) - 1)))
