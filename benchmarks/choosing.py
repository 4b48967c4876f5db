"""The table of docs/choosing-a-method.md: the fastest methods at four errors, from the data of the reports.

    python benchmarks/choosing.py [--write]

Nothing is measured here: it reads docs/reports/tables/work-precision.csv. `make rivals`, which measures,
calls this at its end, so that the two pages agree.
"""

from collections.abc import Iterator

from pages import by_scene, command

BEGIN, END = "<!-- fastest -->", "<!-- /fastest -->"
ERRORS = ("1e-03", "1e-06", "1e-09", "1e-12")
FAMILIES = {"general": "any", "symplectic": "symplectic"}  # the family in the data file, and what readers are told
EQUAL = "any, symplectic"
HEADS = ["scene", "method", *(f"error {error}" for error in ERRORS)]


def _cell(row: dict[str, str], family: str) -> str:
    """Method and time of a family at one error; "same" stands for the column to its left."""
    order = ["general: µs per body", "conserving: µs per body", "symplectic: µs per body"]
    place = order.index(f"{family}: µs per body")
    while row[order[place]] == "same":
        place -= 1
    name, _, time = row[order[place]].partition(": ")
    return f"`{name}` {time.split()[0]}" if time else "-"


def rows() -> Iterator[list[str]]:
    """For each scene the fastest of all methods and of the symplectic ones, with µs per body; one row if equal."""
    for scene, table in by_scene("work-precision").items():
        at = {row["error"]: row for row in table}
        found = {told: [_cell(at[error], family) for error in ERRORS] for family, told in FAMILIES.items()}
        first, second = found.values()
        for told, cells in ({EQUAL: first} if first == second else found).items():
            yield [scene, told, *cells]


def main() -> None:
    command(__doc__, "choosing-a-method.md", BEGIN, END, HEADS, rows())


if __name__ == "__main__":
    main()
