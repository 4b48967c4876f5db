"""The `midlie` command: parses its line without JAX, which takes a second to import, and runs it.

Every user error gives one line on stderr and exit code 2; only bugs give a traceback.
"""
# PYTHON_ARGCOMPLETE_OK

import argparse
import os
import platform
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from . import options

_CACHE_BYTES = 2**28
_COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None], str]] = {
    # The module of its function, imported only when it runs; what adds its options; its help.
    "chart": ("charts", options.chart, "errors of all methods against step, time and torque evaluations"),
    "run": ("run", options.run, "integrate one scene, or many perturbed copies of it"),
    "inspect": ("saved", options.inspect, "check a run that was saved as .zarr, and draw it"),
    "view": ("saved", options.view, "turn a saved run into a moving picture: HTML or GIF"),
    "export": ("saved", options.export, "write the attitudes of one body of a saved run as CSV"),
    "fit": ("fit", options.fit, "moments and initial rates of a body from measured angular velocities"),
    "stability": ("stability", options.stability, "maps of where methods fail on a scene"),
    "methods": ("tables", options.methods, "list the methods"),
    "scenes": ("tables", options.scenes, "list the scenes"),
}


def command(arguments: Sequence[str] | None = None) -> int:
    """Runs the command in a process of its own, and keeps the compiled programs for the next one.

    They are in the user's cache folder, for each machine apart, in at most 256 MB. The environment variables of JAX
    change this: JAX_COMPILATION_CACHE_DIR names another folder, JAX_ENABLE_COMPILATION_CACHE=0 keeps nothing.
    """
    if find_spec("platformdirs") and find_spec("filelock"):
        from platformdirs import user_cache_dir

        folder = Path(user_cache_dir("midlie_jax", appauthor=False), platform.node() or "here")
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
        os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(_CACHE_BYTES))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    return main(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        arguments: as on the command line, without the name of the program; by default the arguments of the process.

    Returns:
        The exit code: 0; 2 after a user error, which is printed on stderr; 130 after ctrl-C.
    """
    try:
        found = read(sys.argv[1:] if arguments is None else arguments)
    except ValueError as error:
        return _failed(str(error))
    if getattr(found, "devices", None):  # JAX reads this variable when it starts; it affects only the CPU
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count={found.devices}".strip()
    try:
        import jax

        jax.config.update("jax_enable_x64", True)  # before any array is created, including the arrays of scenes
        getattr(import_module(f".{_COMMANDS[found.command][0]}", __package__), found.command)(found)
    except KeyboardInterrupt:
        print("midlie: stopped", file=sys.stderr)
        return 130
    except ValueError as error:
        return _failed(f"{error} (see midlie {found.command} --help)")
    except (ImportError, OSError) as error:
        return _failed(str(error))
    return 0


def _failed(message: str) -> int:
    print(f"midlie: {' '.join(message.split())}", file=sys.stderr)
    return 2


class _ShowVersion(argparse.Action):
    """Prints the version, which it looks up only when the option is used."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"midlie_jax {version('midlie_jax')}")
        except PackageNotFoundError:
            parser.error("midlie_jax is not installed, so its version is unknown; install it with pip")
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """Raises a ValueError for a wrong command line, so that it is printed like every other error."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message} (see {self.prog} --help)")


def read(arguments: Sequence[str]) -> argparse.Namespace:
    parser = _Parser(prog="midlie", description="Rigid bodies in rotation by midpoint Lie integrators, on JAX.")
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="print the version and exit")
    parsers = parser.add_subparsers(metavar="COMMAND", dest="command", required=True)
    commands: dict[str, argparse.ArgumentParser] = {}
    for name, (_, add_options, text) in _COMMANDS.items():
        commands[name] = parsers.add_parser(name, help=text, description=add_options.__doc__)
        add_options(commands[name])
    if arguments and not arguments[0].startswith("-") and arguments[0] not in commands:
        parser.error(f"unknown command {arguments[0]!r}; {_choice(arguments[0], list(commands))}")
    if "_ARGCOMPLETE" in os.environ:  # the shell asks for completions; see docs/start.md
        import argcomplete

        argcomplete.autocomplete(parser)
    found, rest = parser.parse_known_args(arguments)
    if rest:
        # argparse itself would report an unknown option of a subcommand as an error of `midlie`.
        command = commands[found.command]
        known = [option for action in command._actions for option in action.option_strings]
        hint = f"; {_choice(rest[0].split('=')[0], known)}" if rest[0].startswith("-") else ""
        command.error(f"unrecognized arguments: {' '.join(rest)}{hint}")
    if found.command == "run":
        given = {"--resume": found.resume, "--save-every": found.save_every, "--devices": found.devices}
        wrong = [name for name, value in given.items() if value]
        if wrong and Path(found.out or "").suffix.lower() != ".zarr":
            commands["run"].error(f"{' and '.join(wrong)} must be given with --out and a name that ends in .zarr")
    return found


def _choice(name: str, known: Sequence[str]) -> str:
    close = get_close_matches(name, known, n=1)
    return f"did you mean {close[0]}?" if close else f"choose from {', '.join(known)}"
