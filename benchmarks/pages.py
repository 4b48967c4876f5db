"""Puts what a benchmark measured into a page of the documentation, between two comments that mark its place."""

from collections.abc import Iterable
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"


def put(name: str, begin: str, end: str, lines: Iterable[str]) -> None:
    """Replaces what stands between the comments `begin` and `end` of docs/`name` by these lines."""
    page = DOCS / name
    head, rest = page.read_text().split(begin)
    page.write_text("\n".join([head + begin, *lines, end]) + rest.split(end)[1])
