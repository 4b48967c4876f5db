"""`Listing`: a list of names that prints as a table, with a sentence on when to use each."""

from collections.abc import Mapping


class Listing(list[str]):
    """A list of names, best first, that prints as a table of when to use each; the `note` is a line below the table."""

    def __init__(self, uses: Mapping[str, str], note: str = ""):
        super().__init__(uses)
        self.uses, self.note = dict(uses), note

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        lines = [f"{name:<{width}}  {use}" for name, use in self.uses.items()]
        return "\n".join([*lines, self.note] if self.note else lines)
