"""The tables of benchmarks: shown as measured, put between two comments of a page or into a data file, and read again.

The reports are in docs/reports/. A long table has a data file, docs/reports/tables/NAME.csv, and key rows on its page.
"""

import argparse
import csv
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"
DATA = DOCS / "reports" / "tables"


def put(name: str, begin: str, end: str, lines: Iterable[str]) -> None:
    """Replaces what stands between the comments `begin` and `end` of docs/`name` by these lines."""
    page = DOCS / name
    head, rest = page.read_text().split(begin)
    page.write_text("\n".join([head + begin, *map(compact, lines), end]) + rest.split(end)[1])


def compact(line: str) -> str:
    """The line below the heads of a table without spaces; other lines as they are."""
    return line.replace(" ", "") if set(line) <= set("|- ") else line


def cells(line: str) -> list[str]:
    """The cells of a line of a Markdown table."""
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]


def save(name: str, lines: Iterable[str], folder: Path = DATA) -> None:
    """Writes the lines of a Markdown table to docs/reports/tables/`name`.csv, without backticks."""
    heads, _, *rows = (cells(line.replace("`", "")) for line in lines)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f"{name}.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([heads, *rows])


def saved(name: str, folder: Path = DATA) -> list[dict[str, str]]:
    """The rows of a data file, by the heads of its columns."""
    with (folder / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def by_scene(name: str) -> dict[str, list[dict[str, str]]]:
    """The rows of a data file whose first column is the scene, for each scene."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in saved(name):
        found.setdefault(row["scene"], []).append(row)
    return found


def link(*names: str) -> str:
    """The line of a page that leads to whole tables."""
    return f"Data: {', '.join(f'[{name}.csv](tables/{name}.csv)' for name in names)}."


def part(
    lines: Sequence[str], rows: Callable[[list[str]], bool] = bool, columns: Sequence[int] | None = None
) -> list[str]:
    """The lines of a table with only some of its rows and columns.

    Args:
        lines: the whole table in Markdown.
        rows: whether the row with these cells is kept; by default all are.
        columns: the columns that are kept, counted from 0; by default all.
    """
    heads, rule, *rest = map(cells, lines)
    chosen = range(len(heads)) if columns is None else columns
    kept = [heads, rule, *(row for row in rest if rows(row))]
    return [f"| {' | '.join(row[column] for column in chosen)} |" for row in kept]


def publish(
    name: str,
    begin: str,
    end: str,
    lines: Sequence[str],
    data: str,
    rows: Callable[[list[str]], bool] = bool,
    columns: Sequence[int] | None = None,
) -> None:
    """Writes a whole table to a data file, and its key rows into docs/`name`, with a link: `save`, `part`, `put`."""
    save(data, lines)
    put(name, begin, end, [*part(lines, rows, columns), "", link(data)])


def shown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown; each is printed as soon as its row is measured."""
    lines: list[str] = []
    for cells in chain((heads, ["---"] * len(heads)), rows):
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def command(
    description: str | None,
    name: str,
    begin: str,
    end: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    write: Callable[[list[str]], None] | None = None,
) -> None:
    """A benchmark on the command line: shows its table, and with --write puts it into docs/`name`.

    Args:
        description: help of the command.
        name, begin, end: the page and the comments in it.
        heads, rows: the table.
        write: called with the lines of the table instead of `put`, for a table that has a data file, too.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"put the table into docs/{name}")
    wanted = parser.parse_args().write
    lines = shown(heads, rows)
    if not wanted:
        return
    if write is None:
        put(name, begin, end, lines)
    else:
        write(lines)
