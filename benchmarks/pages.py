"""The tables of benchmarks: shown as measured, put into a page between the comments that mark the place, and read."""

import argparse
import re
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"


def put(name: str, begin: str, end: str, lines: Iterable[str]) -> None:
    """Replaces what stands between the comments `begin` and `end` of docs/`name` by these lines."""
    page = DOCS / name
    head, rest = page.read_text().split(begin)
    page.write_text("\n".join([head + begin, *lines, end]) + rest.split(end)[1])


def tables(name: str, first: str) -> dict[str, list[dict[str, str]]]:
    """The rows, by the head of the column, of the table in each section of docs/`name` whose first column is `first`.

    A section is named by what stands before the colon of its title.
    """
    _, *parts = re.split(r"^## ([\w-]+): ", (DOCS / name).read_text(), flags=re.MULTILINE)
    found: dict[str, list[dict[str, str]]] = {}
    for section, text in zip(parts[::2], parts[1::2], strict=True):
        (table,) = re.findall(rf"(?:^\| {first} \|.*\n)(?:^\|.*\n?)*", text, flags=re.MULTILINE)
        heads, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        found[section] = [dict(zip(heads, row, strict=True)) for row in rows]
    return found


def shown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown; each is printed as soon as its row is measured."""
    lines: list[str] = []
    for cells in chain((heads, ["---"] * len(heads)), rows):
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def command(
    description: str | None, name: str, begin: str, end: str, heads: Sequence[str], rows: Iterable[Sequence[str]]
) -> None:
    """A benchmark on the command line: shows its table, and with --write puts it into docs/`name`."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"put the table into docs/{name}")
    write = parser.parse_args().write
    lines = shown(heads, rows)
    if write:
        put(name, begin, end, lines)
