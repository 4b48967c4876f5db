"""The command line of `midlie`: its options, its help, and its error messages, without JAX.

It is a module outside the package, because any import from the package imports JAX, which takes a second. The commands
themselves are in `midlie_jax.bench.commands`.

Every mistake of the user gives one line on stderr and exit code 2; only bugs give a traceback.
"""
# PYTHON_ARGCOMPLETE_OK

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

_OWN = "; MODULE:NAME is one of your own, of a module in this folder"
COMMANDS = ("chart", "run", "inspect", "view", "export", "fit", "stability", "claims", "methods", "scenes")
_MOST_STEPS = 2**31 - 1  # steps are counted in 32 bits


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        arguments: as on the command line, without the program's name; by default those of the process.

    Returns:
        The exit code: 0; 2 after a mistake of the user, which is printed on stderr; 130 after ctrl-C.
    """
    try:
        options = _read(sys.argv[1:] if arguments is None else arguments)
    except ValueError as error:
        return _failed(str(error))
    if getattr(options, "devices", None):  # JAX reads this when it starts; it concerns the CPU alone
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count={options.devices}".strip()
    try:
        from midlie_jax.bench.commands import act

        act(options)
    except KeyboardInterrupt:
        print("midlie: stopped", file=sys.stderr)
        return 130
    except ValueError as error:
        return _failed(f"{error} (see midlie {options.command} --help)")
    except (ImportError, OSError) as error:
        return _failed(str(error))
    return 0


def _failed(message: str) -> int:
    print(f"midlie: {' '.join(message.split())}", file=sys.stderr)
    return 2


class _ShowVersion(argparse.Action):
    """`--version`, which looks the version up only when it is asked for."""

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, nargs=0, help="print the version and exit", **options)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"midlie_jax {version('midlie_jax')}")
        except PackageNotFoundError:
            parser.error("midlie_jax is not installed, so its version is not known; install it with pip")
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """Raises a ValueError for a wrong command line, so that it is printed like every other error."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message} (see {self.prog} --help)")


def _read(arguments: Sequence[str]) -> argparse.Namespace:
    parser, commands = _parsers()
    if arguments and not arguments[0].startswith("-") and arguments[0] not in commands:
        parser.error(f"unknown command {arguments[0]!r}; {_choice(arguments[0], COMMANDS)}")
    if "_ARGCOMPLETE" in os.environ:  # the shell asks what can stand next; see docs/start.md
        import argcomplete

        argcomplete.autocomplete(parser)
    options, rest = parser.parse_known_args(arguments)
    if rest:
        # argparse itself would report an unknown option of a subcommand as an error of `midlie`.
        command = commands[options.command]
        known = [option for action in command._actions for option in action.option_strings]
        hint = f"; {_choice(rest[0].split('=')[0], known)}" if rest[0].startswith("-") else ""
        command.error(f"unrecognized arguments: {' '.join(rest)}{hint}")
    if options.command == "run":
        store = bool(options.out) and Path(options.out).suffix.lower() == ".zarr"
        _only_with_store(commands["run"], options, store)
    return options


def _only_with_store(run: argparse.ArgumentParser, options: argparse.Namespace, store: bool) -> None:
    given = {"--resume": options.resume, "--save-every": options.save_every, "--devices": options.devices}
    wrong = [name for name, value in given.items() if value and not store]
    if wrong:
        run.error(f"{' and '.join(wrong)} must be given with --out and a name that ends in .zarr")


def _choice(name: str, known: Sequence[str]) -> str:
    """A hint after a wrong name: the most similar known name, or else all known names."""
    close = get_close_matches(name, known, n=1)
    return f"did you mean {close[0]}?" if close else f"choose from {', '.join(known)}"


def _parsers() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """The parser of `midlie`, and the parser of each command by its name."""
    parser = _Parser(prog="midlie", description="Rigid bodies in rotation by midpoint Lie integrators, on JAX.")
    parser.add_argument("--version", action=_ShowVersion)
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True)
    _add_chart(commands.add_parser("chart", help="errors of all methods against step, time and torque evaluations"))
    _add_run(commands.add_parser("run", help="integrate one scene, or many perturbed copies of it"))
    _add_inspect(commands.add_parser("inspect", help="check a run that was saved as .zarr, and draw it"))
    _add_view(commands.add_parser("view", help="turn a saved run into a moving picture: HTML or GIF"))
    _add_export(commands.add_parser("export", help="write the attitudes of one body of a saved run as CSV"))
    _add_fit(commands.add_parser("fit", help="moments and initial rates of a body from measured angular velocities"))
    _add_stability(commands.add_parser("stability", help="maps of where methods fail on a scene"))
    _add_claims(commands.add_parser("claims", help="measure what is claimed of the methods, and say what holds"))
    _add_names(commands.add_parser("methods", help="list the methods"), "any FLIGHT[SCHEME]; by default all methods")
    _add_names(commands.add_parser("scenes", help="list the scenes"), "by default a line on each scene")
    return parser, dict(commands.choices)


def _add_chart(chart: argparse.ArgumentParser) -> None:
    chart.description = (
        "Runs every method over a ladder of steps and writes the errors and the times as a table and a picture. "
        "The command runs on one core, so times are those of one core."
    )
    chart.add_argument(
        "scene", nargs="?", default="P1", metavar="SCENE", help=f"see `midlie scenes` (default: P1){_OWN}"
    )
    chart.add_argument("--out", type=_file(".png"), metavar="FILE", help="the PNG to write (default: chart-SCENE.png)")
    chart.add_argument("--methods", nargs="+", metavar="NAME", help=f"methods (default: those of the paper){_OWN}")
    chart.add_argument(
        "--steps", type=_whole(1, _MOST_STEPS), metavar="N", help="steps on the coarsest rung of the ladder"
    )
    chart.add_argument("--levels", type=_whole(1), metavar="K", help="rungs; each halves the step (default: 5)")
    chart.add_argument(
        "--rivals",
        action="store_true",
        help="instead, draw error against cost, also of other programs (needs the extra bench)",
    )
    chart.add_argument("--quick", action="store_true", help="with --rivals: time fewer and shorter runs")


def _add_run(run: argparse.ArgumentParser) -> None:
    run.description = (
        "Integrates a scene and prints the errors of energy and momentum and the run time. --out saves the states in a "
        "file, --plot draws them."
    )
    run.add_argument("scene", metavar="SCENE", help=f"see `midlie scenes`{_OWN}")
    run.add_argument(
        "--method", default="JACOBI[EA]", metavar="NAME", help=f"see `midlie methods` (default: JACOBI[EA]){_OWN}"
    )
    run.add_argument("--dt", type=_number, metavar="H", help="step (default: the scene's)")
    run.add_argument(
        "--steps", type=_whole(1, _MOST_STEPS), metavar="N", help="number of steps (default: the scene's duration)"
    )
    run.add_argument(
        "--bodies", type=_whole(1), default=1, metavar="N", help="perturbed copies (default: 1, unperturbed)"
    )
    run.add_argument("--size", type=_number, default=1e-3, help="relative size of the perturbations (default: 1e-3)")
    run.add_argument("--seed", type=_whole(0), default=0, help="seed of the perturbations (default: 0)")
    run.add_argument("--float32", action="store_true", help="integrate in single precision")
    run.add_argument(
        "--out",
        type=_file_or_store,
        metavar="FILE",
        help="save times, momenta and attitudes: .npz or .csv; or .zarr, a store that is written as the run goes and "
        "from which it resumes (needs the extra io)",
    )
    run.add_argument("--resume", action="store_true", help="go on with the run in the .zarr of --out, if there is one")
    run.add_argument("--save-every", type=_whole(1), metavar="N", help="steps between two states saved in a .zarr")
    run.add_argument("--devices", type=_whole(1), metavar="K", help="spread the bodies of a .zarr over K devices")
    run.add_argument(
        "--plot",
        type=_file(".png"),
        metavar="FILE",
        help="draw energy, momentum, angular velocity and the path of an axis, as a PNG (needs the extra cli)",
    )


def _add_inspect(inspect: argparse.ArgumentParser) -> None:
    inspect.description = (
        "Reads a run that `midlie run --out run.zarr` or midlie_jax.simulate has written, compares all of it with the "
        "checksums written with it, and prints how far it came, which bodies failed, and its errors of energy and "
        "momentum."
    )
    inspect.add_argument("store", metavar="RUN.zarr", help="the folder")
    inspect.add_argument("--plot", type=_file(".png"), metavar="FILE", help="draw the run, as a PNG")


def _add_view(view: argparse.ArgumentParser) -> None:
    view.description = (
        "Shows bodies of runs that `midlie run --out` or midlie_jax.simulate has written: as an HTML file, in which a "
        "body can be turned with the mouse, played and set to any time, and which needs no network; or as a GIF. "
        "Several bodies, or several runs, stand side by side at the same times."
    )
    view.add_argument("runs", nargs="+", metavar="RUN", help="the .npz or .zarr; several of them side by side")
    view.add_argument(
        "--body", nargs="+", type=_whole(0), default=[0], metavar="K", help="which bodies, from 0 (default: 0)"
    )
    view.add_argument(
        "--out",
        type=_file(".html", ".gif"),
        default="view.html",
        metavar="FILE",
        help="the .html or .gif to write (default: view.html)",
    )
    view.add_argument(
        "--axis",
        type=_axis,
        default="e3",
        metavar="AXIS",
        help="the axis of the body that is traced: e1, e2 or e3, or a direction such as 1,0,1 (default: e3)",
    )
    view.add_argument("--frames", type=_whole(2), metavar="N", help="evenly spaced times (default: HTML 200, GIF 72)")
    view.add_argument("--title", metavar="TEXT", help="the line above (default: HTML what the run says, GIF none)")
    gif = view.add_argument_group("of a GIF alone")
    gif.add_argument("--rate", type=_positive, metavar="F", help="frames a second, at most 50 (default: 20)")
    gif.add_argument("--size", type=_whole(64, 2000), metavar="PIXELS", help="of the picture of a body (default: 320)")
    gif.add_argument("--elevation", type=_number, metavar="DEG", help="of the viewer above the xy plane (default: 22)")
    gif.add_argument("--azimuth", type=_number, metavar="DEG", help="of the viewer around z from x (default: -55)")
    gif.add_argument("--background", metavar="COLOUR", help="any colour of matplotlib (default: white)")
    view.add_argument("--open", action="store_true", help="open it in the browser")


def _add_export(export: argparse.ArgumentParser) -> None:
    export.description = (
        "Writes the attitudes of one body of a run that `midlie run --out` or midlie_jax.simulate has written, as CSV: "
        "time, then the unit quaternion from body to space, scalar first; or Euler angles. The header says the unit."
    )
    export.add_argument("run", metavar="RUN", help="the .npz or .zarr")
    export.add_argument("--body", type=_whole(0), default=0, metavar="K", help="which body, from 0 (default: 0)")
    export.add_argument(
        "--euler",
        type=_sequence,
        metavar="ABC",
        help="Euler angles instead: first about the body's axis A, then about its axes B and C where they are by then; "
        "ZYX is yaw, pitch and roll, ZXZ precession, nutation and spin",
    )
    export.add_argument("--radians", action="store_true", help="angles in radians (default: degrees)")
    export.add_argument("--csv", action="store_true", help="write CSV; there is no other format yet")
    export.add_argument("--out", type=_file(".csv"), metavar="FILE", help="the .csv to write (default: the terminal)")


def _add_fit(fit: argparse.ArgumentParser) -> None:
    fit.description = (
        "Fits the moments of inertia of a body under no torque, up to their sum, and its initial angular velocity to "
        "the angular velocities in a CSV file with a header: time, then the rates about the three principal axes. "
        "Empty cells are missing values. Prints the estimates with 95 % intervals. The exit code is 2 if the fit is "
        "not ok: if it did not converge, or if its residuals are not noise of the size of sigma."
    )
    fit.add_argument("data", metavar="DATA.csv", help="the measurements")
    fit.add_argument("--scene", choices=("free-body",), default="free-body", help="the model (default: free-body)")
    fit.add_argument(
        "--columns",
        nargs=4,
        metavar="NAME",
        help="the columns of time and of the three rates (default: the first four)",
    )
    fit.add_argument("--unit", choices=("deg/s", "rad/s"), required=True, help="the unit of the rates")
    fit.add_argument(
        "--sigma", type=_positive, metavar="S", help="their standard deviation, in this unit (default: from the fit)"
    )
    fit.add_argument(
        "--bias", action="store_true", help="also find the bias of the gyroscope, what it adds to the rates"
    )
    fit.add_argument("--time-unit", choices=("s", "ms", "us", "ns"), help="the unit of time (default: s)")
    fit.add_argument(
        "--magnetometer",
        nargs=3,
        metavar="NAME",
        help="the columns of a magnetometer, along the same axes, in any unit; the field must be constant in space",
    )
    fit.add_argument(
        "--magnetometer-sigma", type=_positive, metavar="DEG", help="the standard deviation of its direction, degrees"
    )
    fit.add_argument("--hard-iron", action="store_true", help="also find what the magnetometer adds to the field")
    fit.add_argument(
        "--starts", type=_whole(1), default=1, metavar="N", help="starts: the guess and N - 1 around it (default: 1)"
    )
    fit.add_argument(
        "--moments",
        nargs=3,
        type=_positive,
        metavar="I",
        help="a guess; the fit keeps its sum (default: from the rates by Euler's equations, with the sum 5.5)",
    )
    fit.add_argument(
        "--out", type=_file(".png"), metavar="FILE", help="draw the fitted curves and the residuals, as a PNG"
    )


def _add_stability(stability: argparse.ArgumentParser) -> None:
    stability.description = (
        "Runs every method over a grid of steps and of spins, shapes of the body and strengths of the field, and draws "
        "the worst energy error, where solves fail, where runs blow up, and the limits that theory gives."
    )
    stability.add_argument("scene", metavar="SCENE", help=f"see `midlie scenes`; its energy must be constant{_OWN}")
    stability.add_argument("--methods", nargs="+", metavar="NAME", help=f"methods (default: one of each kind){_OWN}")
    stability.add_argument(
        "--steps", type=_whole(1, _MOST_STEPS), default=10_000, metavar="N", help="steps of each run (default: 1e4)"
    )
    stability.add_argument(
        "--grid", type=_whole(2, 500), default=32, metavar="N", help="points along each side of a map (default: 32)"
    )
    stability.add_argument(
        "--sweeps",
        nargs="+",
        choices=("spin", "anisotropy", "stiffness"),
        help="what is varied, a row of maps each (default: all that the scene has)",
    )
    stability.add_argument(
        "--out", type=_file(".png"), metavar="FILE", help="the PNG to write (default: stability-SCENE.png)"
    )


def _add_claims(claims: argparse.ArgumentParser) -> None:
    claims.description = (
        "Measures order, symplectic defect, spatial momentum, reversal, energy over long runs, a published drift test "
        "and the work of a step, and holds the claims of the paper and of the package against the figures. By default "
        "the methods of the paper and one with each flight and each scheme of `midlie methods`, in under five minutes "
        "on two cores."
    )
    which = claims.add_mutually_exclusive_group()
    which.add_argument("--methods", nargs="+", metavar="NAME", help=f"only these methods{_OWN}")
    which.add_argument("--all", action="store_true", help="every method, and every flight with every scheme: hours")
    claims.add_argument(
        "--steps", type=_whole(8, _MOST_STEPS), metavar="N", help="steps of the long run (default: 1e6)"
    )
    claims.add_argument("--page", type=_file(".md"), metavar="FILE", help="write figures and verdicts as Markdown")
    claims.add_argument(
        "--out", type=_file(".png"), metavar="FILE", help="draw the energy over the long runs, as a PNG"
    )


def _add_names(command: argparse.ArgumentParser, what: str) -> None:
    command.add_argument("names", nargs="*", metavar="NAME", help=f"only these, {what}{_OWN}")


def _whole(least: int, most: float = math.inf) -> Callable[[str], int]:
    """A reader of whole numbers, which may also be written as 1e3."""
    span = f"at least {least}" + (f" and at most {most}" if math.isfinite(most) else "")

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = _integer(text)
        if value is None or not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f"must be a whole number, {span}, got {text!r}; write for example 1000 or 1e3"
            )
        return value

    return read


def _integer(text: str) -> int | None:
    """The whole number that a text such as 1e3 stands for, or None."""
    try:
        number = float(text)
    except ValueError:
        return None
    return int(number) if number.is_integer() else None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}; write for example 0.005 or 5e-3") from None


def _axis(text: str) -> Any:
    """An axis of the body: its name, or a direction as a unit vector.

    A single number is refused: 1 meant e1 here once, where Python's axis=1 is e2.
    """
    if text in ("e1", "e2", "e3"):
        return text
    parts = [_number(part) for part in text.split(",")] if "," in text else []
    length = math.hypot(*parts)
    if len(parts) != 3 or not 0 < length < math.inf:
        hint = "; Python's axis=0, 1, 2 are e1, e2, e3" if text.isdigit() else ""
        raise argparse.ArgumentTypeError(f"must be e1, e2 or e3, or a direction such as 1,0,1, got {text!r}{hint}")
    return [part / length for part in parts]


def _positive(text: str) -> float:
    number = _number(text)
    if not (math.isfinite(number) and number > 0):
        raise argparse.ArgumentTypeError(f"must be positive, got {text!r}")
    return number


def _sequence(text: str) -> str:
    """The axes of Euler angles."""
    if len(text) != 3 or set(text) - set("XYZ") or text[1] in (text[0], text[2]):
        raise argparse.ArgumentTypeError(
            f"must be three of the letters X, Y, Z, no neighbours the same, got {text!r}; write for example ZYX or ZXZ"
        )
    return text


def _file_or_store(text: str) -> str:
    """The name of a file, checked at once; or of a store, which may exist already."""
    if Path(text).suffix.lower() == ".zarr":
        return text
    return _file(".npz", ".csv", ".zarr")(text)


def _file(*endings: str) -> Callable[[str], str]:
    """A reader of names of output files, which raises an error at once if the file cannot be written."""

    def read(text: str) -> str:
        path = Path(text)
        if path.suffix.lower() not in endings:
            raise argparse.ArgumentTypeError(f"cannot write {text}: its name must end in {' or '.join(endings)}")
        if not path.absolute().parent.is_dir():
            raise argparse.ArgumentTypeError(f"cannot write {text}: there is no such folder; create it first")
        if path.is_dir():
            raise argparse.ArgumentTypeError(f"cannot write {text}: it is a folder; give the name of a file")
        if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
            raise argparse.ArgumentTypeError(f"cannot write {text}: permission denied; choose another folder")
        return text

    return read
