"""`kept_by`: what of the angular momentum in space the exact motion under a torque conserves.

For a body that travels, it is the total momentum x cross p + R Pi about the origin: a torque without a force leaves
x cross p alone, a uniform force changes the total momentum across itself, and a force of the field of a point mass at
the origin, with its torque, does not change it. Of coupled bodies it is the sum over all.
"""

from typing import Any, Literal, NamedTuple

import numpy as np

from ..model import torques


class Kept(NamedTuple):
    """One component.

    Attributes:
        direction: a vector along it, in space, (3,).
        letter: its index in formulas.
        which: its name.
    """

    direction: np.ndarray
    letter: str
    which: str


ALL: Literal["all"] = "all"


def kept_by(torque: Any) -> Kept | Literal["all"] | None:
    """The component that is conserved, `ALL`, or None if nothing is known to be."""
    if torque is None or isinstance(torque, torques.PointMass | torques.MutualGravity):
        return ALL
    if isinstance(torque, torques.HeavyTop):
        return Kept(np.array([0.0, 0.0, 1.0]), "z", "vertical component")
    if isinstance(torque, torques.DipoleInField) and not callable(torque.field):
        return Kept(np.asarray(torque.field), "f", "component along the field")
    if isinstance(torque, torques.UniformGravity):
        return Kept(np.asarray(torque.acceleration), "g", "component along gravity")
    if isinstance(torque, torques.Oblateness):
        return Kept(np.asarray(torque.pole), "n", "component along the pole")
    if isinstance(torque, torques.OnEach):
        return kept_by(torque.torque)
    return _by_all_of(torque.terms) if isinstance(torque, torques.Sum) else None


def _by_all_of(terms: Any) -> Kept | Literal["all"] | None:
    """What each term of a sum conserves."""
    found: Kept | Literal["all"] = ALL
    for term in terms:
        own = kept_by(term)
        if own is None:
            return None
        if isinstance(found, Kept) and isinstance(own, Kept) and not _parallel(found.direction, own.direction):
            return None
        found = own if isinstance(own, Kept) and not isinstance(found, Kept) else found
    return found


def _parallel(a: np.ndarray, b: np.ndarray) -> bool:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.linalg.norm(np.cross(a, b))) <= 4 * float(np.finfo(np.float32).eps) * size
