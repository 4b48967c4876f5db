"""Readers of option values: numbers, axes, names of files. A wrong value raises an error with an example."""

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

OWN = "; MODULE:NAME is a custom one, from a module in this folder"  # ends the help of an option that takes a name
MOST_STEPS = 2**31 - 1  # steps are counted in 32 bits


def whole(least: int, most: int | float = math.inf) -> Callable[[str], int]:
    span = f"at least {least}" + (f" and at most {most}" if math.isfinite(most) else "")

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = _integer(text)
        if value is None or not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f"must be a whole number, {span}, got {text!r}; write for example 1000 or 1e3"
            )
        return value

    return read


def _integer(text: str) -> int | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return int(number) if number.is_integer() else None


def number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}; write for example 0.005 or 5e-3") from None


def axis(text: str) -> Any:
    """An axis of the body: its name, or a direction as a unit vector.

    A single number is rejected as ambiguous: 1 could mean e1 or, with Python's counting, e2.
    """
    if text in ("e1", "e2", "e3"):
        return text
    parts = [number(part) for part in text.split(",")] if "," in text else []
    length = math.hypot(*parts)
    if len(parts) != 3 or not 0 < length < math.inf:
        hint = "; Python's axis=0, 1, 2 are e1, e2, e3" if text.isdigit() else ""
        raise argparse.ArgumentTypeError(f"must be e1, e2 or e3, or a direction such as 1,0,1, got {text!r}{hint}")
    return [part / length for part in parts]


def positive(text: str) -> float:
    value = number(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be positive, got {text!r}")
    return value


def sequence(text: str) -> str:
    """The axes of Euler angles."""
    if len(text) != 3 or set(text) - set("XYZ") or text[1] in (text[0], text[2]):
        raise argparse.ArgumentTypeError(
            f"must be three of the letters X, Y, Z without equal neighbours, got {text!r}; write for example ZYX or ZXZ"
        )
    return text


def file_or_store(text: str) -> str:
    if Path(text).suffix.lower() == ".zarr":
        return text
    return file(".npz", ".csv", ".zarr")(text)


def file(*endings: str) -> Callable[[str], str]:
    """A reader of names of output files with these endings, which raises immediately if a file cannot be written."""

    def read(text: str) -> str:
        path = Path(text)
        if path.suffix.lower() not in endings:
            raise argparse.ArgumentTypeError(f"cannot write {text}: its name must end in {' or '.join(endings)}")
        if not path.absolute().parent.is_dir():
            raise argparse.ArgumentTypeError(f"cannot write {text}: there is no such folder; create it first")
        if path.is_dir():
            raise argparse.ArgumentTypeError(f"cannot write {text}: it is a folder; give the name of a file")
        if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
            raise argparse.ArgumentTypeError(f"cannot write {text}: permission denied; choose another folder")
        return text

    return read
