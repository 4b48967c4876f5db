"""The table of docs/choosing-a-method.md: the fastest methods at four errors, read from docs/work-precision.md.

    python benchmarks/choosing.py [--write]

Nothing is measured here. `make rivals`, which measures, calls this at its end, so that the two pages agree.
"""

import re
from collections.abc import Iterator

from pages import DOCS, command

BEGIN, END = "<!-- fastest -->", "<!-- /fastest -->"
ERRORS = ("1e-03", "1e-06", "1e-09", "1e-12")
FAMILIES = {"general": "any", "symplectic": "symplectic"}  # the family in work-precision.md, and what readers are told
HEADS = ["scene", "method", *(f"error {error}" for error in ERRORS)]
SECTION = re.compile(r"^## ([\w-]+): ", re.MULTILINE)


def _table(section: str) -> list[dict[str, str]]:
    """The rows of the first table of a section, by the head of the column."""
    lines = [line for line in section.split("\n\n| error of R")[1].split("\n\n")[0].split("\n") if line]
    heads, _, *rows = [[cell.strip() for cell in f"| error of R{lines[0]}".strip("|").split("|")], *lines[1:]]
    return [dict(zip(heads, (cell.strip() for cell in row.strip("|").split("|")), strict=False)) for row in rows]


def _cell(row: dict[str, str], family: str) -> str:
    """Method and time of a family at one error; "same" stands for the column to its left."""
    order = ["general: us a body", "conserving: us a body", "symplectic: us a body"]
    place = order.index(f"{family}: us a body")
    while row[order[place]] == "same":
        place -= 1
    name, _, time = row[order[place]].partition(": ")
    return f"`{name}` {time.split()[0]}" if time else "-"


def rows() -> Iterator[list[str]]:
    """For each scene the fastest of all methods and of the symplectic ones, with microseconds a body."""
    _, *parts = SECTION.split((DOCS / "work-precision.md").read_text())
    for scene, section in zip(parts[::2], parts[1::2], strict=True):
        table = {row["error of R"]: row for row in _table(section)}
        for family, told in FAMILIES.items():
            yield [scene, told, *(_cell(table[error], family) for error in ERRORS)]


def main() -> None:
    command(__doc__, "choosing-a-method.md", BEGIN, END, HEADS, rows())


if __name__ == "__main__":
    main()
