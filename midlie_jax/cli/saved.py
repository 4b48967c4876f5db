"""`midlie inspect`, `view` and `export`: a saved run checked, shown as a moving picture, written as attitudes."""

import argparse
import csv
import sys
import webbrowser
from contextlib import nullcontext
from itertools import product
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._math.euler import euler_angles, matrices_of
from ..model.states import TravellingState
from ..plot.animate import animate
from ..plot.view import view as view_of
from ..simulation.saved import Saved, saved_path
from ..simulation.summary import Inspection
from ..simulation.summary import inspect as inspected
from ..spacecraft.attitudes.writer import write as write_message
from . import scenes
from .figures import write
from .record import SCENE, Record, columns
from .run_chart import run_figure, store_figure
from .tables import require

_SHOWN = 1000  # the largest number of bodies of a store whose errors are computed and drawn: evenly spaced ones
_OF_GIF = ("rate", "size", "elevation", "azimuth", "background")
_PLURAL = {"attitude": "attitudes", "axis": "axes"}
_SAME = ("epoch", "time_system", "time_unit", "object_name", "object_id", "originator")  # as for `write_message`
_NEEDED = (*_SAME, "frame_a", "frame_b")
_OF_MESSAGE = (*_NEEDED, "center_name", "spin", "aem_version")


def inspect(options: argparse.Namespace) -> None:
    require("zarr")
    if options.plot:
        require("matplotlib")
    found = inspected(options.store)
    print(found)
    record = _record(found)
    if record is not None:
        shown = "all bodies" if found.bodies <= _SHOWN else f"{len(record.ok)} of {found.bodies} bodies"
        print(*(f"{name}, of {shown}: {value}" for name, value in record.errors), sep="\n")
    if options.plot:
        draw(found, options.plot)


def draw(found: Inspection, path: str) -> None:
    record = _record(found)
    write(store_figure(found) if record is None else run_figure(record), path)
    print(f"wrote {path}")


def _record(found: Inspection) -> Record | None:
    """The run as far as it is computed, for evenly spaced bodies; None unless the store holds the states of a scene."""
    said = found.attributes
    if said.get("scene") not in scenes.scenes() or found.done == 0:
        return None
    scene = scenes.scene(said["scene"], jnp.dtype(said["dtype"]))
    import zarr

    root: Any = zarr.open_group(str(found.path), mode="r")
    names = list(scene.start.described())
    if said.get("state") != type(scene.start).__name__ or any(name not in root for name in names):
        return None
    bodies = slice(None, None, -(-found.bodies // _SHOWN))
    values = [root[name][bodies] for name in names]
    computed = int(np.sum(~np.all(np.isnan(values[0]), axis=(0, 2))))
    momenta, attitudes, *travel = (array[:, :computed] for array in values)
    run = said["method"], said["dt"], said["steps"], said[SCENE[1]], said[SCENE[2]], root["time"][:computed]
    return Record(scene, *run, momenta, attitudes, found.first_bad[bodies] == found.saves, travel=tuple(travel))


def view(options: argparse.Namespace) -> None:
    gif = options.out.lower().endswith(".gif")
    of_gif = {name: getattr(options, name) for name in _OF_GIF if getattr(options, name) is not None}
    if of_gif and not gif:
        raise ValueError(f"{' and '.join(f'--{name}' for name in of_gif)} must be given with --out and a .gif.")
    zarr = any(run.lower().endswith(".zarr") for run in options.runs)
    require("matplotlib" if gif else "plotly", *(["zarr"] if zarr else []))
    found = {(run, body): saved_path(run, body) for run, body in product(options.runs, options.body)}
    names, title = _names(found)
    body: Any = [one.body for one in found.values()]
    path: Any = dict(zip(names, [one.path for one in found.values()], strict=True))
    if len(found) == 1:
        (body,), (path,) = body, path.values()
    shared = {"axis": options.axis} | ({"frames": options.frames} if options.frames else {})
    if gif:  # a GIF has no room for the title of a run
        out = animate(body, path, options.out, title=options.title or "", **shared, **of_gif)
    else:
        out = view_of(body, path, title=title if options.title is None else options.title, **shared).write(options.out)
    print(f"{title}\nwrote {out} ({out.stat().st_size / 1e6:.2g} MB)")
    if options.open:
        webbrowser.open(out.absolute().as_uri())


def _names(found: dict[tuple[str, int], Saved]) -> tuple[list[str], str]:
    runs, several = list(dict.fromkeys(run for run, _ in found)), len({body for _, body in found}) > 1
    files = [Path(run).name if len({Path(one).name for one in runs}) == len(runs) else run for run in runs]
    short = dict(zip(runs, files, strict=True))
    first = next(iter(found.values()))
    if len(found) == 1:
        ((_, body),) = found
        return [""], first.title if first.bodies == 1 else f"{first.title}; body {body} of {first.bodies}"
    if len(runs) == 1:
        return [f"body {body}" for _, body in found], f"{first.title}; {len(found)} of {first.bodies} bodies"
    return [short[run] + (f", body {body}" if several else "") for run, body in found], " and ".join(files)


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
    written = write_message(
        jax.tree.map(lambda x: x[:count], path.states),
        options.out,
        times=path.times[:count],
        **{name: getattr(options, name) for name in _SAME},
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
