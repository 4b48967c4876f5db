"""The seconds of a first call, in a process of its own: tracing and compiling, without imports."""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import jax

_FRESH = 3  # processes


def seconds(script: str, *parts: str) -> float:
    """The median over processes of `python script --first PART ...`, which calls `report`."""
    command = [sys.executable, script, "--first", *parts]
    found = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(_FRESH)]
    return statistics.median(float(text.split()[-1]) for text in found)


def report(run: Callable[[], Any]) -> None:
    """Prints the processor time of a call."""
    began = time.process_time()
    jax.block_until_ready(run())
    print(time.process_time() - began)
