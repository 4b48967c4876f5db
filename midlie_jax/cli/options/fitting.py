"""The options of `midlie fit`."""

import argparse

from ..readers import file, number, positive, whole


def fit(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Fits the moments of inertia of a torque-free body, up to their sum, and its initial "
        "angular velocity to the angular velocities in a CSV file with a header: time, then the "
        "rates about the three principal axes. Empty cells are missing values. Prints the "
        "estimates with 95 % intervals. The exit code is 2 if the fit is not ok: if it did not "
        "converge, if its residuals are not noise of the size of sigma, or if the body rotates "
        "by more than half a revolution between rows. If the file holds more than a free flight, "
        "such as a phone in the hand before it and the catch after it, choose the flight by "
        "--from and --to."
    )
    parser.add_argument("data", metavar="DATA.csv", help="the measurements")
    parser.add_argument("--scene", choices=("free-body",), default="free-body", help="the model (default: free-body)")
    parser.add_argument(
        "--columns",
        nargs=4,
        metavar="NAME",
        help="the columns of time and of the three rates (default: the first four)",
    )
    parser.add_argument("--unit", choices=("deg/s", "rad/s"), required=True, help="the unit of the rates")
    parser.add_argument(
        "--sigma", type=positive, metavar="S", help="their standard deviation, in this unit (default: from the fit)"
    )
    parser.add_argument(
        "--bias",
        action="store_true",
        help="also find the bias of the gyroscope, the constant that it adds to the rates",
    )
    parser.add_argument("--time-unit", choices=("s", "ms", "us", "ns"), help="the unit of time (default: s)")
    parser.add_argument(
        "--from", dest="first", type=number, metavar="T", help="use the rows from this time on, in the file's unit"
    )
    parser.add_argument("--to", dest="last", type=number, metavar="T", help="use the rows up to this time")
    parser.add_argument(
        "--magnetometer",
        nargs=3,
        metavar="NAME",
        help="the columns of a magnetometer, along the same axes, in any unit; the field must be constant in space",
    )
    parser.add_argument(
        "--magnetometer-data",
        metavar="FILE.csv",
        help=("a separate file of the magnetometer with its own times; without it, its columns are in DATA.csv"),
    )
    parser.add_argument("--magnetometer-time", metavar="NAME", help="the column of time in that file")
    parser.add_argument(
        "--magnetometer-time-unit", choices=("s", "ms", "us", "ns"), help="the unit of that column (default: s)"
    )
    parser.add_argument(
        "--magnetometer-clock",
        choices=("same", "fitted"),
        help=("`same` if both files use one clock; `fitted` to also find the offset of the magnetometer clock"),
    )
    parser.add_argument(
        "--magnetometer-sigma", type=positive, metavar="DEG", help="the standard deviation of its direction, degrees"
    )
    parser.add_argument(
        "--hard-iron", action="store_true", help="also find the constant that the magnetometer adds to the field"
    )
    parser.add_argument(
        "--starts", type=whole(1), default=1, metavar="N", help="starts: the guess and N - 1 around it (default: 1)"
    )
    parser.add_argument(
        "--moments",
        nargs=3,
        type=positive,
        metavar="I",
        help="a guess; the fit keeps its sum (default: from the rates by Euler's equations, with the sum 5.5)",
    )
    parser.add_argument(
        "--out", type=file(".png"), metavar="FILE", help="draw the fitted curves and the residuals, as a PNG"
    )
