"""`midlie export RUN`: the attitudes of one body of a saved run as CSV, as quaternions or as Euler angles.

A body that travels has its position beside them, and a body that is only an axis has the axis instead.
"""

import argparse
import csv
import sys
from contextlib import nullcontext

import jax.numpy as jnp
import numpy as np

from ...model import so3
from ...model.states import TravellingState
from ...simulation.saved import saved_path
from .record import columns

_PLURAL = {"attitude": "attitudes", "axis": "axes"}
_LOCKED = 1e-7  # if the second angle has a smaller sine, or cosine, only one of the other angles is determined


def export(options: argparse.Namespace) -> None:
    """Writes a line for each time at which the body can be trusted; the header names each column and its unit."""
    saved = saved_path(options.run, options.body)
    path, states = saved.path, saved.path.states
    if states.several:
        raise ValueError(
            f"{options.run} holds {states.count} coupled bodies, and export writes one; write all of them by "
            "midlie run --out run.csv."
        )
    what = "attitude" if hasattr(states, "attitude") else "axis"
    poses = np.asarray(getattr(states, what))
    good = int(np.cumprod(np.isfinite(poses).all(axis=1)).sum())
    count = min(good, int(path.first_bad))
    if not count:
        raise ValueError(f"{options.run} holds no {what} of body {options.body} that can be trusted.")
    heads, values, remark = columns(states)[what], poses[:count], ""
    if options.euler:
        if what == "axis":
            raise ValueError(f"{options.run} holds the axis of a body, and no angle about it; leave --euler out.")
        angles, locked = euler_angles(np.asarray(so3.to_matrix(jnp.asarray(values))), options.euler)
        unit = "rad" if options.radians else "deg"
        heads = tuple(f"euler_{i + 1}_{axis} [{unit}]" for i, axis in enumerate(options.euler))
        values = angles if options.radians else np.degrees(angles)
        if locked.any():
            remark = f"; at {locked.sum()} times the first and third axis are parallel: the third angle is set to 0"
    if isinstance(states, TravellingState):
        heads = (*heads, *columns(states)["position"])
        values = np.concatenate([values, np.asarray(states.position)[:count]], axis=1)
    with open(options.out, "w", newline="") if options.out else nullcontext(sys.stdout) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("time", *heads))
        writer.writerows((t, *row) for t, row in zip(np.asarray(path.times[:count]), values, strict=True))
    if options.out:
        print(f"wrote {options.out}: {count} {_PLURAL[what]} of body {options.body}{remark}")
    elif remark:
        print(f"midlie: note{remark[1:]}", file=sys.stderr)


def euler_angles(matrices: np.ndarray, sequence: str) -> tuple[np.ndarray, np.ndarray]:
    """The angles a, b, c with R = R_i(a) R_j(b) R_k(c): rotations about body axes as they are after the earlier ones.

    Args:
        matrices: (n, 3, 3), each takes body components to space components.
        sequence: three letters X, Y, Z, of which no neighbours are the same: the axes i, j and k.

    Returns:
        The angles (n, 3) in radians, a and c from -pi to pi, b between -pi/2 and pi/2, or between 0 and pi if the first
        and third letter are equal. And (n,), whether the first and third axis are parallel, so that c is set to 0.
    """
    i, j, last = ("XYZ".index(letter) for letter in sequence)
    k = 3 - i - j
    r, sign = np.moveaxis(matrices, 0, -1), 1 if (j - i) % 3 == 1 else -1
    if last == i:
        cosine, sine = r[i, i], np.hypot(r[i, j], r[i, k])
        a, b, c = np.arctan2(r[j, i], -sign * r[k, i]), np.arctan2(sine, cosine), np.arctan2(r[i, j], sign * r[i, k])
        locked = sine < _LOCKED
    else:
        cosine, sine = np.hypot(r[i, i], r[i, j]), sign * r[i, k]
        a, b, c = np.arctan2(-sign * r[j, k], r[k, k]), np.arctan2(sine, cosine), np.arctan2(-sign * r[i, j], r[i, i])
        locked = cosine < _LOCKED
    a = np.where(locked, np.arctan2(sign * r[k, j], r[j, j]), a)
    return np.stack([a, b, np.where(locked, 0, c)], axis=-1), locked
