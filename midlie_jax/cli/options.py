"""The options of every command, and the readers of their values. Nothing in this module imports JAX.

A wrong value raises an error with an example.
"""

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

OWN = "; MODULE:NAME is a custom one, from a module in this folder"  # ends the help of an option that takes a name
MOST_STEPS = 2**31 - 1  # steps are counted in 32 bits


def whole(least: int, most: int | float = math.inf) -> Callable[[str], int]:
    span = f"at least {least}" + (f" and at most {most}" if math.isfinite(most) else "")

    def read(text: str) -> int:
        try:
            value = int(text) if text.isdigit() else float(text)
        except ValueError:
            value = math.nan
        if value != value // 1 or not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f"must be a whole number, {span}, got {text!r}; write for example 1000 or 1e3"
            )
        return int(value)

    return read


def number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}; write for example 0.005 or 5e-3") from None


def axis(text: str) -> Any:
    """An axis of the body: its name, or a direction as a unit vector.

    A single number is rejected as ambiguous: 1 could mean e1 or, with Python's counting, e2.
    """
    if text in ("e1", "e2", "e3"):
        return text
    parts = [number(part) for part in text.split(",")] if "," in text else []
    length = math.hypot(*parts)
    if len(parts) != 3 or not 0 < length < math.inf:
        hint = "; Python's axis=0, 1, 2 are e1, e2, e3" if text.isdigit() else ""
        raise argparse.ArgumentTypeError(f"must be e1, e2 or e3, or a direction such as 1,0,1, got {text!r}{hint}")
    return [part / length for part in parts]


def positive(text: str) -> float:
    value = number(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive, got {text!r}")
    return value


def sequence(text: str) -> str:
    """The axes of Euler angles."""
    if len(text) != 3 or set(text) - set("XYZ") or text[1] in (text[0], text[2]):
        raise argparse.ArgumentTypeError(
            f"must be three of the letters X, Y, Z without equal neighbours, got {text!r}; write for example ZYX or ZXZ"
        )
    return text


def file(*endings: str) -> Callable[[str], str]:
    """A reader of names of output files with these endings, which raises immediately if a file cannot be written."""

    def read(text: str) -> str:
        path = Path(text)
        if path.suffix.lower() not in endings:
            raise argparse.ArgumentTypeError(f"cannot write {text}: its name must end in {' or '.join(endings)}")
        if not path.absolute().parent.is_dir():
            raise argparse.ArgumentTypeError(f"cannot write {text}: there is no such folder; create it first")
        if path.is_dir() and path.suffix.lower() != ".zarr":
            raise argparse.ArgumentTypeError(f"cannot write {text}: it is a folder; give the name of a file")
        if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
            raise argparse.ArgumentTypeError(f"cannot write {text}: permission denied; choose another folder")
        return text

    return read


def chart(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Runs every method over a ladder of steps and writes the errors and the times as a table and a picture. The "
        "command runs on one core, so times refer to one core."
    )
    add("scene", nargs="?", default="P1", metavar="SCENE", help=f"see `midlie scenes` (default: P1){OWN}")
    add("--out", type=file(".png"), metavar="FILE", help="the PNG to write (default: chart-SCENE.png)")
    add("--methods", nargs="+", metavar="NAME", help=f"methods (default: the paper's){OWN}")
    add("--steps", type=whole(1, MOST_STEPS), metavar="N", help="steps on the coarsest rung of the ladder")
    add("--levels", type=whole(1), metavar="K", help="rungs; each halves the step (default: 5)")


def stability(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Runs every method over a grid of steps and of spins, shapes of the body and strengths of the field, and draws "
        "the worst energy error, failed solves, blown-up runs, and the theoretical limits."
    )
    add("scene", metavar="SCENE", help=f"see `midlie scenes`; its energy must be constant{OWN}")
    add("--methods", nargs="+", metavar="NAME", help=f"methods (default: one of each kind){OWN}")
    add("--steps", type=whole(1, MOST_STEPS), default=10_000, metavar="N", help="steps of each run (default: 1e4)")
    add("--grid", type=whole(2, 500), default=32, metavar="N", help="points along each side of a map (default: 32)")
    add(
        "--sweeps",
        nargs="+",
        choices=("spin", "anisotropy", "stiffness"),
        help="the varied properties, a row of maps each (default: all that the scene has)",
    )
    add("--out", type=file(".png"), metavar="FILE", help="the PNG to write (default: stability-SCENE.png)")


def run(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Integrates a scene and prints the errors of energy and momentum and the run time. --out saves the states in a "
        "file, --plot draws them."
    )
    add("scene", metavar="SCENE", help=f"see `midlie scenes`{OWN}")
    add(
        "--method",
        metavar="NAME",
        help=f"see `midlie methods` (default: JACOBI[EA], or the scene's if that does not support its body){OWN}",
    )
    add("--dt", type=number, metavar="H", help="step (default: the scene's)")
    add("--steps", type=whole(1, MOST_STEPS), metavar="N", help="number of steps (default: the scene's duration)")
    add("--bodies", type=whole(1), default=1, metavar="N", help="perturbed copies (default: 1, unperturbed)")
    add("--size", type=number, default=1e-3, help="relative size of the perturbations (default: 1e-3)")
    add("--seed", type=whole(0), default=0, help="seed of the perturbations (default: 0)")
    add("--float32", action="store_true", help="integrate in single precision")
    add(
        "--out",
        type=file(".npz", ".csv", ".zarr"),
        metavar="FILE",
        help="save times and states: .npz or .csv; or .zarr, a store that is written during the run "
        "and from which it resumes (needs the extra io)",
    )
    add("--resume", action="store_true", help="resume the run in the .zarr of --out, if there is one")
    add("--save-every", type=whole(1), metavar="N", help="steps between two states saved in a .zarr")
    add("--devices", type=whole(1), metavar="K", help="spread the bodies of a .zarr over K devices")
    add(
        "--plot",
        type=file(".png"),
        metavar="FILE",
        help="draw energy, momentum, angular velocity and the path of an axis, as a PNG (needs the extra cli)",
    )


def inspect(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Reads a run written by `midlie run --out run.zarr` or midlie_jax.simulate, verifies its checksums, and prints "
        "its progress, the failed bodies, and its errors of energy and momentum."
    )
    add("store", metavar="RUN.zarr", help="the folder")
    add("--plot", type=file(".png"), metavar="FILE", help="draw the run, as a PNG")


def view(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Shows bodies of runs written by `midlie run --out` or midlie_jax.simulate, as an HTML file or as a GIF. The "
        "HTML file needs no network; the body can be rotated with the mouse, played and set to any time. Several "
        "bodies, or several runs, appear side by side at the same times."
    )
    add("runs", nargs="+", metavar="RUN", help="the .npz or .zarr; several of them side by side")
    add("--body", nargs="+", type=whole(0), default=[0], metavar="K", help="which bodies, from 0 (default: 0)")
    add(
        "--out",
        type=file(".html", ".gif"),
        default="view.html",
        metavar="FILE",
        help="the .html or .gif to write (default: view.html)",
    )
    add(
        "--axis",
        type=axis,
        default="e3",
        metavar="AXIS",
        help="the axis of the body that is traced: e1, e2 or e3, or a direction such as 1,0,1 (default: e3)",
    )
    add("--frames", type=whole(2), metavar="N", help="evenly spaced times (default: HTML 200, GIF 72)")
    add("--title", metavar="TEXT", help="the line above (default: HTML the description of the run, GIF none)")
    gif = parser.add_argument_group("only for a GIF")
    gif.add_argument("--rate", type=positive, metavar="F", help="frames per second, at most 50 (default: 20)")
    gif.add_argument("--size", type=whole(64, 2000), metavar="PIXELS", help="of the picture of a body (default: 320)")
    gif.add_argument("--elevation", type=number, metavar="DEG", help="of the viewer above the xy plane (default: 22)")
    gif.add_argument("--azimuth", type=number, metavar="DEG", help="of the viewer around z from x (default: -55)")
    gif.add_argument("--background", metavar="COLOUR", help="any colour of matplotlib (default: white)")
    add("--open", action="store_true", help="open it in the browser")


def export(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Writes the attitudes of one body of a run written by `midlie run --out` or midlie_jax.simulate, as CSV: time, "
        "then the unit quaternion from body to space, scalar first; or Euler angles. The header gives the unit. For a "
        "translating body the position follows; for a body without attitude, the axis is written."
    )
    add("run", metavar="RUN", help="the .npz or .zarr")
    add("--body", type=whole(0), default=0, metavar="K", help="which body, from 0 (default: 0)")
    add(
        "--euler",
        type=sequence,
        metavar="ABC",
        help="Euler angles instead: first about the body axis A, then about its axes B and C after "
        "the earlier rotations; ZYX is yaw, pitch and roll, ZXZ precession, nutation and spin",
    )
    add("--radians", action="store_true", help="angles in radians (default: degrees)")
    add("--csv", action="store_true", help="write CSV, as without this option")
    add(
        "--format",
        choices=("csv", "aem"),
        default="csv",
        help="csv (default), or aem: CCSDS Attitude Ephemeris Message",
    )
    add("--out", type=file(".csv", ".aem"), metavar="FILE", help="the file (default: the terminal)")
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


def fit(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Fits the moments of inertia of a torque-free body, up to their sum, and its initial angular velocity to the "
        "angular velocities in a CSV file with a header: time, then the rates about the three principal axes. Empty "
        "cells are missing values. Prints the estimates with 95 % intervals. The exit code is 2 if the fit is not ok: "
        "if it did not converge, if its residuals are not noise of the size of sigma, or if the body rotates by more "
        "than half a revolution between rows. If the file holds more than a free flight, such as a phone in the hand "
        "before it and the catch after it, the command takes the part with the largest rotation in which the rates "
        "satisfy Euler's equations of a free body; --from and --to choose another. Times are numbers or dates in ISO "
        "8601."
    )
    add("data", metavar="DATA.csv", help="the measurements")
    add("--scene", choices=("free-body",), default="free-body", help="the model (default: free-body)")
    add(
        "--columns",
        nargs=4,
        metavar="NAME",
        help="the columns of time and of the three rates (default: the first four)",
    )
    add("--unit", choices=("deg/s", "rad/s"), required=True, help="the unit of the rates")
    add("--sigma", type=positive, metavar="S", help="their standard deviation, in this unit (default: from the fit)")
    add(
        "--bias",
        action="store_true",
        help="also find the bias of the gyroscope, the constant that it adds to the rates",
    )
    add("--time-unit", choices=("s", "ms", "us", "ns"), help="the unit of time (default: s); not with dates")
    add(
        "--from",
        dest="first",
        metavar="T",
        help="use the rows from this time on, in the file's unit; with dates, a date or seconds after the first row",
    )
    add("--to", dest="last", metavar="T", help="use the rows up to this time")
    add(
        "--tracker",
        nargs=4,
        metavar="NAME",
        help="the columns w x y z of a star tracker: quaternions of the same axes, from body to space",
    )
    add("--tracker-sigma", type=positive, metavar="DEG", help="the standard deviation about each axis, degrees")
    add("--space-to-body", action="store_true", help="the quaternions are from space to body")
    add(
        "--magnetometer",
        nargs=3,
        metavar="NAME",
        help="the columns of a magnetometer, along the same axes, in any unit; the field must be constant in space",
    )
    add(
        "--magnetometer-data",
        metavar="FILE.csv",
        help="a separate file of the magnetometer with its own times; without it, its columns are in DATA.csv",
    )
    add("--magnetometer-time", metavar="NAME", help="the column of time in that file")
    add("--magnetometer-time-unit", choices=("s", "ms", "us", "ns"), help="the unit of that column (default: s)")
    add(
        "--magnetometer-clock",
        choices=("same", "fitted"),
        help="`same` if both files use one clock; `fitted` to also find the offset of the magnetometer clock",
    )
    add("--magnetometer-sigma", type=positive, metavar="DEG", help="the standard deviation of its direction, degrees")
    add("--hard-iron", action="store_true", help="also find the constant that the magnetometer adds to the field")
    add("--starts", type=whole(1), default=1, metavar="N", help="starts: the guess and N - 1 around it (default: 1)")
    add(
        "--moments",
        nargs=3,
        type=positive,
        metavar="I",
        help="a guess; the fit keeps its sum (default: from the rates by Euler's equations, with the sum 5.5)",
    )
    add("--out", type=file(".png"), metavar="FILE", help="draw the fitted curves and the residuals, as a PNG")


def methods(parser: argparse.ArgumentParser) -> None:
    what = f"only these, any FLIGHT[SCHEME]; by default all methods{OWN}"
    parser.add_argument("names", nargs="*", metavar="NAME", help=what)


def scenes(parser: argparse.ArgumentParser) -> None:
    what = f"only these, by default a line on each scene{OWN}"
    parser.add_argument("names", nargs="*", metavar="NAME", help=what)
