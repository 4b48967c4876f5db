"""What the commands share: tables on the terminal, and a word about a missing package in time."""

from importlib.util import find_spec


def require(*packages: str) -> None:
    """Tells what is missing before, not after, a minute of measuring.

    Raises:
        ImportError: a package is not installed; the message names the extra that brings it.
    """
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise ImportError(f"this command needs {' and '.join(missing)}: pip install 'midlie_jax[cli]'.")


def show_table(heads: list[str], rows: list[list[str]]) -> None:
    """Aligned columns: text to the left, numbers to the right; a row cut short may run over, an empty one is a gap."""
    whole = [row for row in rows if len(row) == len(heads)]
    widths = [max([len(head), *(len(row[i]) for row in whole)]) for i, head in enumerate(heads)]
    numeric = [bool(whole) and all(_is_number(row[i]) for row in whole) for i in range(len(heads))]

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
