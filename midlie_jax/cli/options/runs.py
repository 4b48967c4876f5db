"""The options of the commands that make a run, and of the commands that read one."""

import argparse
from typing import Any

from ..readers import MOST_STEPS, OWN, axis, file, file_or_store, number, positive, sequence, whole


class _Given(argparse.Action):
    """Records that the option was given, because scenes with another default method define their own."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        setattr(namespace, self.dest, values)
        setattr(namespace, f"{self.dest}_given", True)


def run(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Integrates a scene and prints the errors of energy and momentum and the run time. --out saves the states in a "
        "file, --plot draws them."
    )
    parser.add_argument("scene", metavar="SCENE", help=f"see `midlie scenes`{OWN}")
    parser.add_argument(
        "--method",
        default="JACOBI[EA]",
        action=_Given,
        metavar="NAME",
        help=(f"see `midlie methods` (default: JACOBI[EA], or the scene's if that does not support its body){OWN}"),
    )
    parser.set_defaults(method_given=False)
    parser.add_argument("--dt", type=number, metavar="H", help="step (default: the scene's)")
    parser.add_argument(
        "--steps", type=whole(1, MOST_STEPS), metavar="N", help="number of steps (default: the scene's duration)"
    )
    parser.add_argument(
        "--bodies", type=whole(1), default=1, metavar="N", help="perturbed copies (default: 1, unperturbed)"
    )
    parser.add_argument("--size", type=number, default=1e-3, help="relative size of the perturbations (default: 1e-3)")
    parser.add_argument("--seed", type=whole(0), default=0, help="seed of the perturbations (default: 0)")
    parser.add_argument("--float32", action="store_true", help="integrate in single precision")
    parser.add_argument(
        "--out",
        type=file_or_store,
        metavar="FILE",
        help="save times and states: .npz or .csv; or .zarr, a store that is written during the run "
        "and from which it resumes (needs the extra io)",
    )
    parser.add_argument("--resume", action="store_true", help="resume the run in the .zarr of --out, if there is one")
    parser.add_argument("--save-every", type=whole(1), metavar="N", help="steps between two states saved in a .zarr")
    parser.add_argument("--devices", type=whole(1), metavar="K", help="spread the bodies of a .zarr over K devices")
    parser.add_argument(
        "--plot",
        type=file(".png"),
        metavar="FILE",
        help="draw energy, momentum, angular velocity and the path of an axis, as a PNG (needs the extra cli)",
    )


def inspect(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Reads a run written by `midlie run --out run.zarr` or midlie_jax.simulate, verifies its "
        "checksums, and prints its progress, the failed bodies, and its errors of energy and "
        "momentum."
    )
    parser.add_argument("store", metavar="RUN.zarr", help="the folder")
    parser.add_argument("--plot", type=file(".png"), metavar="FILE", help="draw the run, as a PNG")


def view(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Shows bodies of runs written by `midlie run --out` or midlie_jax.simulate, as an HTML "
        "file or as a GIF. The HTML file needs no network; the body can be rotated with the "
        "mouse, played and set to any time. Several bodies, or several runs, appear side by side "
        "at the same times."
    )
    parser.add_argument("runs", nargs="+", metavar="RUN", help="the .npz or .zarr; several of them side by side")
    parser.add_argument(
        "--body", nargs="+", type=whole(0), default=[0], metavar="K", help="which bodies, from 0 (default: 0)"
    )
    parser.add_argument(
        "--out",
        type=file(".html", ".gif"),
        default="view.html",
        metavar="FILE",
        help="the .html or .gif to write (default: view.html)",
    )
    parser.add_argument(
        "--axis",
        type=axis,
        default="e3",
        metavar="AXIS",
        help="the axis of the body that is traced: e1, e2 or e3, or a direction such as 1,0,1 (default: e3)",
    )
    parser.add_argument("--frames", type=whole(2), metavar="N", help="evenly spaced times (default: HTML 200, GIF 72)")
    parser.add_argument(
        "--title", metavar="TEXT", help="the line above (default: HTML the description of the run, GIF none)"
    )
    gif = parser.add_argument_group("only for a GIF")
    gif.add_argument("--rate", type=positive, metavar="F", help="frames per second, at most 50 (default: 20)")
    gif.add_argument("--size", type=whole(64, 2000), metavar="PIXELS", help="of the picture of a body (default: 320)")
    gif.add_argument("--elevation", type=number, metavar="DEG", help="of the viewer above the xy plane (default: 22)")
    gif.add_argument("--azimuth", type=number, metavar="DEG", help="of the viewer around z from x (default: -55)")
    gif.add_argument("--background", metavar="COLOUR", help="any colour of matplotlib (default: white)")
    parser.add_argument("--open", action="store_true", help="open it in the browser")


def export(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Writes the attitudes of one body of a run written by `midlie run --out` or "
        "midlie_jax.simulate, as CSV: time, then the unit quaternion from body to space, scalar "
        "first; or Euler angles. The header gives the unit. For a translating body the position "
        "follows; for a body without attitude, the axis is written."
    )
    parser.add_argument("run", metavar="RUN", help="the .npz or .zarr")
    parser.add_argument("--body", type=whole(0), default=0, metavar="K", help="which body, from 0 (default: 0)")
    parser.add_argument(
        "--euler",
        type=sequence,
        metavar="ABC",
        help="Euler angles instead: first about the body axis A, then about its axes B and C after "
        "the earlier rotations; ZYX is yaw, pitch and roll, ZXZ precession, nutation and spin",
    )
    parser.add_argument("--radians", action="store_true", help="angles in radians (default: degrees)")
    parser.add_argument("--csv", action="store_true", help="write CSV, as without this option")
    parser.add_argument(
        "--format",
        choices=("csv", "aem"),
        default="csv",
        help="csv (default), or aem: CCSDS Attitude Ephemeris Message",
    )
    parser.add_argument("--out", type=file(".csv", ".aem"), metavar="FILE", help="the file (default: the terminal)")
    message = parser.add_argument_group(
        "--format aem", "Required content of such a file that the run does not contain."
    )
    message.add_argument("--epoch", metavar="DATE", help="the epoch of t = 0, such as 2026-04-13T21:45:00")
    message.add_argument("--time-system", metavar="NAME", help="the time system of the epoch: UTC, TAI, GPS, TT, ...")
    message.add_argument("--time-unit", metavar="UNIT", help="the unit of time of the run: ns, us, ms, s, min, h or d")
    message.add_argument("--object-name", metavar="NAME", help="the name of the spacecraft")
    message.add_argument("--object-id", metavar="ID", help="its international designator, such as 2006-224A")
    message.add_argument("--originator", metavar="NAME", help="the originator of the file")
    message.add_argument("--frame-a", metavar="NAME", help="the space frame, such as EME2000")
    message.add_argument("--frame-b", metavar="NAME", help="the body frame, such as SC_BODY_1")
    message.add_argument("--center-name", metavar="NAME", help="the body at the origin of frame A; optional")
    message.add_argument("--spin", action="store_true", help="direction of the z axis, angle and rate about it instead")
    message.add_argument("--aem-version", choices=("1.0", "2.0"), help="of the standard (default: 2.0)")
