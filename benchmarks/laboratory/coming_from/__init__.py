"""The pages docs/coming-from/*.md: each shows the same run in another program and in this one, and this proves it.

Both programs are read from the page and run as they stand there, each in a process of its own. A page has a module of
its name here ("_" for "-"), with

- `TITLE`: the program, as the page and its tables call it;
- `HEADS`, optional: the programs at the head of the left columns, where a page has several; `(TITLE,)` unless given;
- `NEEDS`: the packages that the left column imports, beside this one; a name in capitals is that of an environment
  variable which says in which folder a program stands;
- `WITHIN`: the largest difference between the quantities of the two columns that the page allows, and `FURTHER`,
  optional, that of the last of several tables;
- `rows()`: yields the rows of the measured table, each four strings (`row` makes them): what is measured, the other
  program, midlie_jax, and the first over the second;
- `QUANTITIES`, optional: what both columns end with, `("times", "attitude")` unless given.
"""

import os
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[3] / "docs" / "coming-from"
PAGES = tuple(sorted(page.stem for page in FOLDER.glob("*.md")))
MARK = "measured"

_TABLE = re.compile(r"^<table>.*?^</table>$", re.MULTILINE | re.DOTALL)
_BLOCK = re.compile(r"^```(py|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def page_of(name: str) -> Path:
    return FOLDER / f"{name}.md"


def module_of(name: str) -> Any:
    """The module of a page."""
    if name not in PAGES:
        raise ValueError(f"unknown page {name!r}; choose from {', '.join(PAGES)}.")
    return import_module(f"{__name__}.{name.replace('-', '_')}")


def quantities(name: str) -> tuple[str, ...]:
    """The names of the quantities with which both columns of a page end."""
    return getattr(module_of(name), "QUANTITIES", ("times", "attitude"))


def missing(name: str) -> list[str]:
    """The packages and programs of the left column that are not installed."""
    return [need for need in module_of(name).NEEDS if not (os.environ.get(need) if need.isupper() else find_spec(need))]


def tables(name: str) -> list[tuple[str, str]]:
    """The two programs (left, right) of each table of a page whose columns are programs."""
    found: list[tuple[str, str]] = []
    for table in _TABLE.findall(page_of(name).read_text()):
        blocks = _BLOCK.findall(table)
        if [language for language, _ in blocks] != ["py", "python"]:
            raise ValueError(f"a table of {page_of(name).name} has not one py block and then one python block.")
        found.append((blocks[0][1], blocks[1][1]))
    return found


def columns(name: str) -> tuple[str, str]:
    """The two programs (left, right) of the first table of a page, "The same run in both"."""
    return tables(name)[0]
