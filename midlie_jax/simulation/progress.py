"""The progress bar of a run."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import jax


@contextmanager
def reported(progress: bool | Callable[[int], Any] | None, total: int, done: int) -> Generator[Callable[[int], Any]]:
    """A function to be called with the number of body-steps that were written; the first process shows a bar.

    Args:
        progress: see `simulate`.
        total, done: all body-steps of this process, and those of them that need not be computed.
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
