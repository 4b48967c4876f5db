"""The options of the commands that measure methods."""

import argparse

from ..readers import MOST_STEPS, OWN, file, whole


def chart(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs every method over a ladder of steps and writes the errors and the times as a table "
        "and a picture. The command runs on one core, so times refer to one core."
    )
    parser.add_argument(
        "scene", nargs="?", default="P1", metavar="SCENE", help=f"see `midlie scenes` (default: P1){OWN}"
    )
    parser.add_argument("--out", type=file(".png"), metavar="FILE", help="the PNG to write (default: chart-SCENE.png)")
    parser.add_argument("--methods", nargs="+", metavar="NAME", help=f"methods (default: the paper's){OWN}")
    parser.add_argument(
        "--steps", type=whole(1, MOST_STEPS), metavar="N", help="steps on the coarsest rung of the ladder"
    )
    parser.add_argument("--levels", type=whole(1), metavar="K", help="rungs; each halves the step (default: 5)")


def stability(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Runs every method over a grid of steps and of spins, shapes of the body and strengths "
        "of the field, and draws the worst energy error, failed solves, blown-up runs, and the "
        "theoretical limits."
    )
    parser.add_argument("scene", metavar="SCENE", help=f"see `midlie scenes`; its energy must be constant{OWN}")
    parser.add_argument("--methods", nargs="+", metavar="NAME", help=f"methods (default: one of each kind){OWN}")
    parser.add_argument(
        "--steps", type=whole(1, MOST_STEPS), default=10_000, metavar="N", help="steps of each run (default: 1e4)"
    )
    parser.add_argument(
        "--grid", type=whole(2, 500), default=32, metavar="N", help="points along each side of a map (default: 32)"
    )
    parser.add_argument(
        "--sweeps",
        nargs="+",
        choices=("spin", "anisotropy", "stiffness"),
        help="the varied properties, a row of maps each (default: all that the scene has)",
    )
    parser.add_argument(
        "--out", type=file(".png"), metavar="FILE", help="the PNG to write (default: stability-SCENE.png)"
    )
