"""The options of every command, and the readers of their values. Nothing in this module imports JAX.

A wrong value raises an error with an example. The docstring of a function for a command is its description in the help.
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
        folder = path.absolute().parent
        for wrong, why in (
            (path.suffix.lower() not in endings, f"its name must end in {' or '.join(endings)}"),
            (not folder.is_dir(), "there is no such folder; create it first"),
            (path.is_dir() and path.suffix.lower() != ".zarr", "it is a folder; give the name of a file"),
            (not os.access(path if path.exists() else folder, os.W_OK), "permission denied; choose another folder"),
        ):
            if wrong:
                raise argparse.ArgumentTypeError(f"cannot write {text}: {why}")
        return text

    return read


def _adder(parser: Any) -> Callable[..., None]:
    def add(name: str, text: str, metavar: str = "", read: Any = None, **others: Any) -> None:
        """Adds an option with this help; `read` is the reader of its value, for an option with a `metavar`."""
        parser.add_argument(name, help=text, **({"metavar": metavar, "type": read} if metavar else {}), **others)

    return add


def chart(parser: argparse.ArgumentParser) -> None:
    """Runs every method over a ladder of steps and writes the errors and the times as a table and a picture. The
    command runs on one core, so times refer to one core.
    """
    add = _adder(parser)
    add("scene", f"see `midlie scenes` (default: P1){OWN}", "SCENE", nargs="?", default="P1")
    add("--out", "the PNG to write (default: chart-SCENE.png)", "FILE", file(".png"))
    add("--methods", f"methods (default: the paper's){OWN}", "NAME", nargs="+")
    add("--steps", "steps on the coarsest rung of the ladder", "N", whole(1, MOST_STEPS))
    add("--levels", "rungs; each halves the step (default: 5)", "K", whole(1))


def stability(parser: argparse.ArgumentParser) -> None:
    """Runs every method over a grid of steps and of spins, shapes of the body and strengths of the field, and draws
    the worst energy error, failed solves, blown-up runs, and the theoretical limits.
    """
    add = _adder(parser)
    add("scene", f"see `midlie scenes`; its energy must be constant{OWN}", "SCENE")
    add("--methods", f"methods (default: one of each kind){OWN}", "NAME", nargs="+")
    add("--steps", "steps of each run (default: 1e4)", "N", whole(1, MOST_STEPS), default=10_000)
    add("--grid", "points along each side of a map (default: 32)", "N", whole(2, 500), default=32)
    varied = "the varied properties, a row of maps each (default: all that the scene has)"
    add("--sweeps", varied, nargs="+", choices=("spin", "anisotropy", "stiffness"))
    add("--out", "the PNG to write (default: stability-SCENE.png)", "FILE", file(".png"))


def run(parser: argparse.ArgumentParser) -> None:
    """Integrates a scene and prints the errors of energy and momentum and the run time. --out saves the states in a
    file, --plot draws them.
    """
    add = _adder(parser)
    add("scene", f"see `midlie scenes`{OWN}", "SCENE")
    usual = "JACOBI[EA], or the scene's if that does not support its body"
    add("--method", f"see `midlie methods` (default: {usual}){OWN}", "NAME")
    add("--dt", "step (default: the scene's)", "H", number)
    add("--steps", "number of steps (default: the scene's duration)", "N", whole(1, MOST_STEPS))
    add("--bodies", "perturbed copies (default: 1, unperturbed)", "N", whole(1), default=1)
    add("--size", "relative size of the perturbations (default: 1e-3)", "SIZE", number, default=1e-3)
    add("--seed", "seed of the perturbations (default: 0)", "SEED", whole(0), default=0)
    add("--float32", "integrate in single precision", action="store_true")
    store = "a store that is written during the run and from which it resumes (needs the extra io)"
    add("--out", f"save times and states: .npz or .csv; or .zarr, {store}", "FILE", file(".npz", ".csv", ".zarr"))
    add("--resume", "resume the run in the .zarr of --out, if there is one", action="store_true")
    add("--save-every", "steps between two states saved in a .zarr", "N", whole(1))
    add("--devices", "spread the bodies of a .zarr over K devices", "K", whole(1))
    drawn = "energy, momentum, angular velocity and the path of an axis"
    add("--plot", f"draw {drawn}, as a PNG (needs the extra cli)", "FILE", file(".png"))


def inspect(parser: argparse.ArgumentParser) -> None:
    """Reads a run written by `midlie run --out run.zarr` or midlie_jax.simulate, verifies its checksums, and prints
    its progress, the failed bodies, and its errors of energy and momentum.
    """
    add = _adder(parser)
    add("store", "the folder", "RUN.zarr")
    add("--plot", "draw the run, as a PNG", "FILE", file(".png"))


def view(parser: argparse.ArgumentParser) -> None:
    """Shows bodies of runs written by `midlie run --out` or midlie_jax.simulate, as an HTML file or as a GIF. The
    HTML file needs no network; the body can be rotated with the mouse, played and set to any time. Several bodies, or
    several runs, appear side by side at the same times.
    """
    add = _adder(parser)
    add("runs", "the .npz or .zarr; several of them side by side", "RUN", nargs="+")
    add("--body", "which bodies, from 0 (default: 0)", "K", whole(0), nargs="+", default=[0])
    out = "the .html or .gif to write (default: view.html)"
    add("--out", out, "FILE", file(".html", ".gif"), default="view.html")
    traced = "the axis of the body that is traced: e1, e2 or e3, or a direction such as 1,0,1 (default: e3)"
    add("--axis", traced, "AXIS", axis, default="e3")
    add("--frames", "evenly spaced times (default: HTML 200, GIF 72)", "N", whole(2))
    add("--title", "the line above (default: HTML the description of the run, GIF none)", "TEXT")
    of_gif = _adder(parser.add_argument_group("only for a GIF"))
    of_gif("--rate", "frames per second, at most 50 (default: 20)", "F", positive)
    of_gif("--size", "of the picture of a body (default: 320)", "PIXELS", whole(64, 2000))
    of_gif("--elevation", "of the viewer above the xy plane (default: 22)", "DEG", number)
    of_gif("--azimuth", "of the viewer around z from x (default: -55)", "DEG", number)
    of_gif("--background", "any colour of matplotlib (default: white)", "COLOUR")
    add("--open", "open it in the browser", action="store_true")


def export(parser: argparse.ArgumentParser) -> None:
    """Writes the attitudes of one body of a run written by `midlie run --out` or midlie_jax.simulate, as CSV: time,
    then the unit quaternion from body to space, scalar first; or Euler angles. The header gives the unit. For a
    translating body the position follows; for a body without attitude, the axis is written.
    """
    add = _adder(parser)
    add("run", "the .npz or .zarr", "RUN")
    add("--body", "which body, from 0 (default: 0)", "K", whole(0), default=0)
    angles = "ZYX is yaw, pitch and roll, ZXZ precession, nutation and spin"
    order = "first about the body axis A, then about its axes B and C after the earlier rotations"
    add("--euler", f"Euler angles instead: {order}; {angles}", "ABC", sequence)
    add("--radians", "angles in radians (default: degrees)", action="store_true")
    add("--csv", "write CSV, as without this option", action="store_true")
    forms = "csv (default), or aem: CCSDS Attitude Ephemeris Message"
    add("--format", forms, choices=("csv", "aem"), default="csv")
    add("--out", "the file (default: the terminal)", "FILE", file(".csv", ".aem"))
    required = "Required content of such a file that the run does not contain."
    of_message = _adder(parser.add_argument_group("--format aem", required))
    of_message("--epoch", "the epoch of t = 0, such as 2026-04-13T21:45:00", "DATE")
    of_message("--time-system", "the time system of the epoch: UTC, TAI, GPS, TT, ...", "NAME")
    of_message("--time-unit", "the unit of time of the run: ns, us, ms, s, min, h or d", "UNIT")
    of_message("--object-name", "the name of the spacecraft", "NAME")
    of_message("--object-id", "its international designator, such as 2006-224A", "ID")
    of_message("--originator", "the originator of the file", "NAME")
    of_message("--frame-a", "the space frame, such as EME2000", "NAME")
    of_message("--frame-b", "the body frame, such as SC_BODY_1", "NAME")
    of_message("--center-name", "the body at the origin of frame A; optional", "NAME")
    of_message("--spin", "direction of the z axis, angle and rate about it instead", action="store_true")
    of_message("--aem-version", "of the standard (default: 2.0)", choices=("1.0", "2.0"))


def fit(parser: argparse.ArgumentParser) -> None:
    """Fits the moments of inertia of a torque-free body, up to their sum, and its initial angular velocity to the
    angular velocities in a CSV file with a header: time, then the rates about the three principal axes. Empty cells
    are missing values. Prints the estimates with 95 % intervals. The exit code is 2 if the fit is not ok: if it did
    not converge, if its residuals are not noise of the size of sigma, or if the body rotates by more than half a
    revolution between rows. If the file holds more than a free flight, such as a phone in the hand before it and the
    catch after it, the command takes the part with the largest rotation in which the rates satisfy Euler's equations
    of a free body; --from and --to choose another. Times are numbers or dates in ISO 8601.
    """
    add = _adder(parser)
    add("data", "the measurements", "DATA.csv")
    add("--scene", "the model (default: free-body)", choices=("free-body",), default="free-body")
    add("--columns", "the columns of time and of the three rates (default: the first four)", "NAME", nargs=4)
    add("--unit", "the unit of the rates", choices=("deg/s", "rad/s"), required=True)
    add("--sigma", "their standard deviation, in this unit (default: from the fit)", "S", positive)
    bias = "also find the bias of the gyroscope, the constant that it adds to the rates"
    add("--bias", bias, action="store_true")
    add("--time-unit", "the unit of time (default: s); not with dates", choices=("s", "ms", "us", "ns"))
    dates = "in the file's unit; with dates, a date or seconds after the first row"
    add("--from", f"use the rows from this time on, {dates}", "T", dest="first")
    add("--to", "use the rows up to this time", "T", dest="last")
    tracker = "the columns w x y z of a star tracker: quaternions of the same axes, from body to space"
    add("--tracker", tracker, "NAME", nargs=4)
    add("--tracker-sigma", "the standard deviation about each axis, degrees", "DEG", positive)
    add("--space-to-body", "the quaternions are from space to body", action="store_true")
    columns = "the columns of a magnetometer, along the same axes, in any unit; the field must be constant in space"
    add("--magnetometer", columns, "NAME", nargs=3)
    separate = "a separate file of the magnetometer with its own times; without it, its columns are in DATA.csv"
    add("--magnetometer-data", separate, "FILE.csv")
    add("--magnetometer-time", "the column of time in that file", "NAME")
    add("--magnetometer-time-unit", "the unit of that column (default: s)", choices=("s", "ms", "us", "ns"))
    clock = "`same` if both files use one clock; `fitted` to also find the offset of the magnetometer clock"
    add("--magnetometer-clock", clock, choices=("same", "fitted"))
    add("--magnetometer-sigma", "the standard deviation of its direction, degrees", "DEG", positive)
    add("--hard-iron", "also find the constant that the magnetometer adds to the field", action="store_true")
    add("--starts", "starts: the guess and N - 1 around it (default: 1)", "N", whole(1), default=1)
    guess = "a guess; the fit keeps its sum (default: from the rates by Euler's equations, with the sum 5.5)"
    add("--moments", guess, "I", positive, nargs=3)
    add("--out", "draw the fitted curves and the residuals, as a PNG", "FILE", file(".png"))


def methods(parser: argparse.ArgumentParser) -> None:
    _adder(parser)("names", f"only these, any FLIGHT[SCHEME]; by default all methods{OWN}", "NAME", nargs="*")


def scenes(parser: argparse.ArgumentParser) -> None:
    _adder(parser)("names", f"only these, by default a line on each scene{OWN}", "NAME", nargs="*")
