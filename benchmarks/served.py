"""`Served`: a script in a process of its own, which keeps what it has compiled and answers how fast it runs."""

import statistics
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path


class Served:
    """The script, started with `--serve`. It reads requests (`requests`) and answers each by a line."""

    def __init__(self, script: str, environment: Mapping[str, str], folder: Path | None = None):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
        self.process = subprocess.Popen([sys.executable, script, "--serve"], env=environment, cwd=folder, **pipes)

    def line(self) -> str:
        return self.process.stdout.readline().strip()

    def ask(self, *words: str) -> float:
        self.process.stdin.write("\t".join(words) + "\n")
        self.process.stdin.flush()
        return float(self.line())


def requests() -> Iterator[tuple[str, ...]]:
    """The words of each request, in the process that serves."""
    return (tuple(line.rstrip("\n").split("\t")) for line in sys.stdin)


def asked_in_turn(processes: Sequence[Served], words: tuple[str, ...], repeats: int) -> tuple[float, ...]:
    """The medians of the answers, and of the ratio of the last to the first; after one answer each, which compiles.

    The processes take turns, so that a change of the speed of the machine affects all.
    """
    for process in processes:
        process.ask(*words)
    rounds = [[process.ask(*words) for process in processes] for _ in range(repeats)]
    medians = (statistics.median(column) for column in zip(*rounds, strict=True))
    return *medians, statistics.median(answers[-1] / answers[0] for answers in rounds)
