"""The `midlie` command: parses its line without JAX, which takes a second to import, and runs it.

Every user error gives one line on stderr and exit code 2; only bugs give a traceback.
"""
# PYTHON_ARGCOMPLETE_OK

import os
import platform
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from .parser import read

_CACHE_BYTES = 2**28


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
        options = read(sys.argv[1:] if arguments is None else arguments)
    except ValueError as error:
        return _failed(str(error))
    if getattr(options, "devices", None):  # JAX reads this variable when it starts; it affects only the CPU
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_force_host_platform_device_count={options.devices}".strip()
    try:
        from .commands import act

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
