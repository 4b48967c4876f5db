"""The progress bar of a run."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import jax


@contextmanager
def reported(progress: bool | Callable[[int], Any] | None, total: int, done: int) -> Generator[Callable[[int], Any]]:
    """A function that accepts the number of written body-steps; the first process shows a bar.

    Args:
        progress: see `simulate`.
        total, done: number of body-steps of this process, and how many of them need not be computed.
    """
    if callable(progress):
        yield progress
        return
    if progress is False or jax.process_index() or find_spec("tqdm") is None:
        yield lambda work: None
        return
    from tqdm import tqdm

    shown: dict[str, Any] = {"unit": "body-steps", "unit_scale": True, "leave": False}
    shown["disable"] = None if progress is None else False  # None: unless stderr is a terminal
    with tqdm(total=total, initial=done, dynamic_ncols=True, **shown) as bar:
        yield bar.update
