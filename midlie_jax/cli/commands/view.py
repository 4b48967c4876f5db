"""`midlie view RUN`: bodies of saved runs, one or several side by side, as an HTML file or a GIF."""

import argparse
import webbrowser
from itertools import product
from pathlib import Path
from typing import Any

from ...plot.animate import animate
from ...plot.view import view
from ...simulation.saved import Saved, saved_path
from .output import require

_OF_GIF = ("rate", "size", "elevation", "azimuth", "background")


def view_run(options: argparse.Namespace) -> None:
    """Writes the picture, and opens it if requested."""
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
        out = view(body, path, title=title if options.title is None else options.title, **shared).write(options.out)
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
