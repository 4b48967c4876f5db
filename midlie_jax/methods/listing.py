"""Lists of names that print with a sentence on when to take each."""

from collections.abc import Mapping


class Listing(list[str]):
    """Names, best first: a list like any other, that prints as a table.

    Attributes:
        uses: for each name, when to take it.
        note: a line below the table.
    """

    def __init__(self, uses: Mapping[str, str], note: str = ""):
        super().__init__(uses)
        self.uses, self.note = dict(uses), note

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        lines = [f"{name:<{width}}  {use}" for name, use in self.uses.items()]
        return "\n".join([*lines, self.note] if self.note else lines)
