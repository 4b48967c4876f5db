"""The table of docs/choosing-a-method.md: the fastest methods at four errors, read from docs/reports/work-precision.md.

    python benchmarks/choosing.py [--write]

Nothing is measured here. `make rivals`, which measures, calls this at its end, so that the two pages agree.
"""

from collections.abc import Iterator

from pages import command, tables

BEGIN, END = "<!-- fastest -->", "<!-- /fastest -->"
ERRORS = ("1e-03", "1e-06", "1e-09", "1e-12")
FAMILIES = {"general": "any", "symplectic": "symplectic"}  # the family in work-precision.md, and what readers are told
HEADS = ["scene", "method", *(f"error {error}" for error in ERRORS)]


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
    for scene, table in tables("reports/work-precision.md", "error").items():
        at = {row["error"]: row for row in table}
        for family, told in FAMILIES.items():
            yield [scene, told, *(_cell(at[error], family) for error in ERRORS)]


def main() -> None:
    command(__doc__, "choosing-a-method.md", BEGIN, END, HEADS, rows())


if __name__ == "__main__":
    main()
