"""`midlie view RUN`: one body of a saved run as an HTML file or a GIF."""

import argparse
import webbrowser

from ...plot.animate import animate
from ...plot.view import view
from ...simulation.saved import saved_path
from .output import require


def view_run(options: argparse.Namespace) -> None:
    """Writes the picture, and opens it if requested."""
    gif = options.out.lower().endswith(".gif")
    reader = ["zarr"] if options.run.lower().endswith(".zarr") else []
    require("matplotlib" if gif else "plotly", *reader)
    saved = saved_path(options.run, options.body)
    title = saved.title if saved.bodies == 1 else f"{saved.title}; body {options.body} of {saved.bodies}"
    if gif:  # which has no room for the title of a run
        out = animate(saved.body, saved.path, options.out, axis=options.axis - 1)
    else:
        out = view(saved.body, saved.path, options.out, axis=options.axis - 1, title=title)
    print(f"{title}\nwrote {out} ({out.stat().st_size / 1e6:.2g} MB)")
    if options.open:
        webbrowser.open(out.absolute().as_uri())
