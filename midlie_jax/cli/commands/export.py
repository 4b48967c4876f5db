"""`midlie export RUN`: the attitudes of one body of a saved run, as quaternions or as Euler angles, in CSV or AEM.

For a translating body the position follows; for a body without attitude, the axis is written instead.
"""

import argparse
import csv
import sys
from contextlib import nullcontext

import jax
import numpy as np

from ..._math.euler import euler_angles, matrices_of
from ...attitudes import write
from ...model.states import TravellingState
from ...simulation.saved import saved_path
from .record import columns

_PLURAL = {"attitude": "attitudes", "axis": "axes"}


_NEEDED = ("epoch", "time_system", "time_unit", "object_name", "object_id", "originator", "frame_a", "frame_b")
_OF_MESSAGE = (*_NEEDED, "center_name", "spin", "aem_version")


def export(options: argparse.Namespace) -> None:
    """Writes a line for each valid time of the body; the header names each column and its unit."""
    if options.format == "aem":
        _message(options)
        return
    for name in _OF_MESSAGE:
        if getattr(options, name):
            raise ValueError(f"{_option(name)} needs --format aem.")
    if options.out and not options.out.lower().endswith(".csv"):
        raise ValueError(f"--out {options.out} is not a .csv; for an Attitude Ephemeris Message give --format aem.")
    saved = saved_path(options.run, options.body)
    path, states = saved.path, saved.path.states
    if states.several:
        raise ValueError(
            f"{options.run} holds {states.count} coupled bodies, but export writes one; use midlie "
            "run --out run.csv for all."
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
            raise ValueError(
                f"{options.run} holds only the axis of a body, without an angle about it; leave out --euler."
            )
        angles, locked = euler_angles(matrices_of(values), options.euler)
        unit = "rad" if options.radians else "deg"
        heads = tuple(f"euler_{i + 1}_{axis} [{unit}]" for i, axis in enumerate(options.euler))
        values = (angles if options.radians else np.degrees(angles)).astype(values.dtype)
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


def _message(options: argparse.Namespace) -> None:
    """Writes an Attitude Ephemeris Message of the valid states."""
    lacking = [_option(name) for name in _NEEDED if not getattr(options, name)]
    if lacking:
        raise ValueError(f"--format aem needs {', '.join(lacking)}, which the run does not contain.")
    if options.csv or options.radians:
        raise ValueError(f"--format aem is not CSV, and in degrees; leave out --{'csv' if options.csv else 'radians'}.")
    if not options.out or not options.out.lower().endswith(".aem"):
        raise ValueError("--format aem needs --out with a name that ends in .aem, such as run.aem.")
    if options.spin and options.euler:
        raise ValueError("--spin and --euler are two forms of the same attitudes; leave out one of them.")
    saved = saved_path(options.run, options.body)
    path = saved.path
    count = int(path.first_bad)
    if not hasattr(path.states, "attitude") or path.states.several or not count:
        raise ValueError(f"{options.run} holds no attitudes of one body {options.body} that can be trusted.")
    written = write(
        jax.tree.map(lambda x: x[:count], path.states),
        options.out,
        times=path.times[:count],
        epoch=options.epoch,
        time_system=options.time_system,
        time_unit=options.time_unit,
        object_name=options.object_name,
        object_id=options.object_id,
        originator=options.originator,
        ref_frame_a=options.frame_a,
        ref_frame_b=options.frame_b,
        center_name=options.center_name,
        form="spin" if options.spin else "euler" if options.euler else "quaternion",
        sequence=options.euler,
        body=saved.body,
        version=options.aem_version or "2.0",
    )
    print(f"wrote {options.out}: {written} attitudes of body {options.body}")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
