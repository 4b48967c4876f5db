"""The harness of all benchmarks: their command line, compiled calls, times in turn, other processes, and tables.

A script declares each table of docs/ as a `Table` and gives its parts to `main`. A long table has a data file,
docs/reports/tables/NAME.csv, and key rows on its page. A script that imports `one_core` runs on one core.
"""

import argparse
import csv
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import jax

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
REPORTS = DOCS / "reports"
DATA = REPORTS / "tables"
FRESH = 3  # processes, of which `first_call` takes the median

# ---- tables ----


class Table(NamedTuple):
    """A table of docs/.

    It stands between the comments <!-- mark --> and <!-- /mark --> of docs/page; "" is on no page. `rows` yields the
    cells of each row. Of a table with a data file `key` chooses rows, by their cells, and `columns` those on the page;
    `words` are on the page instead of rows, from the rows of the data file.
    """

    page: str
    mark: str
    heads: Sequence[str]
    rows: Callable[[], Iterable[Sequence[str]]] = tuple
    data: str = ""
    key: Callable[[list[str]], bool] = bool
    columns: Sequence[int] | None = None
    words: Callable[[list[dict[str, str]]], list[str]] | None = None

    def show(self, write: bool, rows: Iterable[Sequence[str]] | None = None) -> list[str]:
        """Prints the table while it is measured, and with `write` puts it into docs/; returns its lines."""
        lines = shown(self.heads, self.rows() if rows is None else rows)
        if write and self.page:
            self.write(lines)
        return lines

    def write(self, lines: Sequence[str]) -> None:
        if self.data:
            save(self.data, lines)
            text = [*part(lines, self.key, self.columns), ""] if self.words is None else self.words(saved(self.data))
            lines = [*text, link(self.data)]
        put(self.page, self.mark, lines)


def put(page: str, mark: str, lines: Iterable[str]) -> None:
    """Replaces what stands between the two comments of a mark in docs/`page` by these lines."""
    begin, end, file = f"<!-- {mark} -->", f"<!-- /{mark} -->", DOCS / page
    head, rest = file.read_text().split(begin)
    file.write_text("\n".join([head + begin, *map(compact, lines), end]) + rest.split(end)[1])


def compact(line: str) -> str:
    """The line below the heads of a table without spaces; other lines as they are."""
    return line.replace(" ", "") if set(line) <= set("|- ") else line


def row_of(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def table(heads: Sequence[str], rows: Iterable[Iterable[str]]) -> list[str]:
    return [compact(row_of(row)) for row in (heads, ["---"] * len(heads), *rows)]


def shown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown; each is printed as soon as its row is measured."""
    lines: list[str] = []
    for row in chain((heads, ["---"] * len(heads)), rows):
        lines.append(row_of(row))
        print(lines[-1], flush=True)
    return lines


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]


def part(
    lines: Sequence[str], rows: Callable[[list[str]], bool] = bool, columns: Sequence[int] | None = None
) -> list[str]:
    """The lines of a table with only those rows whose cells pass, and only these columns."""
    heads, rule, *rest = map(cells, lines)
    chosen = range(len(heads)) if columns is None else columns
    return [row_of(row[column] for column in chosen) for row in (heads, rule, *filter(rows, rest))]


def save(name: str, lines: Iterable[str], folder: Path = DATA) -> None:
    """Writes the lines of a table to docs/reports/tables/`name`.csv, without backticks."""
    heads, _, *rows = (cells(line.replace("`", "")) for line in lines)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f"{name}.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([heads, *rows])


def saved(name: str, folder: Path = DATA) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def by_scene(name: str) -> dict[str, list[dict[str, str]]]:
    """The rows of a data file whose first column is the scene, for each scene."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in saved(name):
        found.setdefault(row["scene"], []).append(row)
    return found


def link(*names: str) -> str:
    return f"Data: {', '.join(f'[{name}.csv](tables/{name}.csv)' for name in names)}."


# ---- the command line ----

Part = Table | Callable[[argparse.Namespace], Any]


def main(
    description: str | None,
    parts: Part | Mapping[str, Part],
    arguments: Mapping[str, Mapping[str, Any]] = {},
    *,
    first: Callable[..., Callable[[], Any]] | None = None,
    serve: Callable[[], None] | None = None,
) -> None:
    """A benchmark on the command line, with `--write` and options as for `ArgumentParser.add_argument`.

    `parts` are what it measures, by name; all unless some are named. What is no table is called with the options.
    `first` makes the run of a process that `first_call` starts, from its words; `serve` is what `Served` starts.
    """
    if first is not None and "--first" in sys.argv:
        run = first(*sys.argv[sys.argv.index("--first") + 1 :])
        began = time.process_time()
        jax.block_until_ready(run())
        print(time.process_time() - began)
        return
    if serve is not None and "--serve" in sys.argv:
        serve()
        return
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    named: Mapping[str, Part] = parts if isinstance(parts, Mapping) else {"": parts}
    if isinstance(parts, Mapping):
        parser.add_argument("names", nargs="*", metavar="PART", help=f"{', '.join(named)}; by default all")
    parser.add_argument("--write", action="store_true", help="put tables and pictures into docs/")
    for name, given in arguments.items():
        parser.add_argument(name, **given)
    options = parser.parse_args()
    wanted = getattr(options, "names", None) or list(named)
    if unknown := set(wanted) - set(named):
        parser.error(f"no part {', '.join(sorted(unknown))}; there are {', '.join(named)}.")
    for name in wanted:
        chosen = named[name]
        chosen.show(options.write) if isinstance(chosen, Table) else chosen(options)


# ---- times ----


class Compiled(NamedTuple):
    """A compiled program, which waits for its result, and the seconds of processor time of tracing and compiling."""

    program: Any
    arguments: tuple[Any, ...]
    seconds: float

    def __call__(self) -> Any:
        return jax.block_until_ready(self.program(*self.arguments))

    @property
    def memory(self) -> int:
        return self.program.memory_analysis().temp_size_in_bytes


def compiled(run: Callable[..., Any], *arguments: Any, bodies: int = 1, options: Any = None) -> Compiled:
    """The function of these arguments, compiled as the package compiles its own for so many bodies, or with options."""
    if options is None:
        from midlie_jax._xla.compiler import compiler_options

        options = compiler_options(bodies)
    began = time.process_time()
    program = jax.jit(run).lower(*arguments).compile(compiler_options=options)
    return Compiled(program, arguments, time.process_time() - began)


def in_turn(calls: Iterable[Callable[[], Any]], rounds: int, most: int | None = None, **options: Any) -> list[float]:
    """Median seconds of calls that take turns, so that what slows the machine for a while slows them all."""
    from midlie_jax.advice.timing import timed_in_turn

    waiting = [lambda call=call: jax.block_until_ready(call()) for call in calls]
    return [timing.seconds for _, timing in timed_in_turn(waiting, least=rounds, most=most or rounds, **options)]


# ---- charts ----


class Line(NamedTuple):
    """A line of a chart, or marks. Names are in the legend. `options` are for `axes.plot`."""

    name: str
    x: Any
    y: Any
    colour: str
    style: str = "-"
    bold: bool = False
    options: Mapping[str, Any] = {}


class Panel(NamedTuple):
    """A panel of a chart. `options` are for `axes.set`; `more` draws further marks."""

    title: str
    across: str
    up: str
    lines: Sequence[Line]
    options: Mapping[str, Any] = {}
    more: Callable[[Any], Any] = lambda axes: None


def chart(
    path: Path, rows: Sequence[Sequence[Panel]], size: tuple[float, float], title: str = "", note: str = "", **room: Any
) -> None:
    """Writes a PNG of panels in rows; size in inches, `room` as for `subplots_adjust`."""
    from midlie_jax.cli.figures import heading, new_figure, panel, write

    figure = new_figure(*size)
    if title:
        heading(figure, title, note)
    figure.subplots_adjust(**room)
    every = figure.subplots(len(rows), len(rows[0]), squeeze=False)
    for axes, one in zip(every.flat, chain(*rows), strict=True):
        panel(axes, one.title, one.across, one.up)
        axes.set(**one.options)
        for line in one.lines:
            style = [line.style] if line.style else []
            axes.plot(line.x, line.y, *style, **{"color": line.colour, "label": line.name or None, **line.options})
        one.more(axes)
        named = [line for line in one.lines if line.name]
        legend = axes.legend(fontsize=9, frameon=False) if named else None
        for text, line in zip(legend.get_texts() if legend else [], named, strict=False):
            text.set(color=line.colour, weight="bold" if line.bold else "normal")
    write(figure, str(path))


# ---- separate processes ----


def first_call(script: str, *words: str) -> float:
    """Median processor time of a first call with tracing and compiling, in separate processes (`main`'s `first`)."""
    command = [sys.executable, script, "--first", *words]
    found = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(FRESH)]
    return statistics.median(float(text.split()[-1]) for text in found)


class Served:
    """A script, started with `--serve`, which keeps what it has compiled, and answers each request by a line."""

    def __init__(self, script: str, environment: Mapping[str, str], folder: Path | None = None):
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
        self.process = subprocess.Popen([sys.executable, script, "--serve"], env=environment, cwd=folder, **pipes)

    def line(self) -> str:
        return self.process.stdout.readline().strip()

    def ask(self, *words: str) -> float:
        self.process.stdin.write("\t".join(words) + "\n")
        self.process.stdin.flush()
        return float(self.line())


def requests() -> Iterator[tuple[str, ...]]:
    return (tuple(line.rstrip("\n").split("\t")) for line in sys.stdin)


def asked_in_turn(processes: Sequence[Served], words: tuple[str, ...], repeats: int) -> tuple[float, ...]:
    """Medians of the answers, and of the ratio of the last to the first, of processes that take turns.

    The first answer of each, which compiles, does not count.
    """
    for process in processes:
        process.ask(*words)
    rounds = [[process.ask(*words) for process in processes] for _ in range(repeats)]
    medians = (statistics.median(column) for column in zip(*rounds, strict=True))
    return *medians, statistics.median(answers[-1] / answers[0] for answers in rounds)
