"""Shared code of the commands: a progress bar, tables, and an early error about missing packages."""

from importlib.util import find_spec
from typing import Any


def require(*packages: str) -> None:
    """Checks that packages are installed, before minutes of measurements."""
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise ImportError(f"this command needs {' and '.join(missing)}: pip install 'midlie_jax[cli]'.")


def progress_bar(total: int, unit: str) -> Any:
    """A bar for `total` units of work, which is erased at the end; nothing is shown without a terminal."""
    from tqdm import tqdm

    return tqdm(total=total, unit=unit, mininterval=0.5, dynamic_ncols=True, leave=False, disable=None)


def show_table(heads: list[str], rows: list[list[str]]) -> None:
    """Prints rows in aligned columns, text to the left and numbers to the right.

    In a row with fewer cells than heads the cells after the second may be wider than their column. An empty row prints
    an empty line.
    """
    full_rows = [row for row in rows if len(row) == len(heads)]
    widths = [max([len(head), *(len(row[i]) for row in full_rows)]) for i, head in enumerate(heads)]
    numeric = [bool(full_rows) and all(_is_number(row[i]) for row in full_rows) for i in range(len(heads))]

    def show(cells: list[str]) -> None:
        padded = [
            cell if i >= 2 and len(cells) < len(heads) else cell.rjust(width) if right else cell.ljust(width)
            for i, (cell, width, right) in enumerate(zip(cells, widths, numeric, strict=False))
        ]
        print("  ".join(padded).rstrip())

    show(heads)
    print("  ".join("-" * width for width in widths))
    for row in rows:
        show(row)


def _is_number(text: str) -> bool:
    try:
        float(text or "0")
    except ValueError:
        return False
    return True
