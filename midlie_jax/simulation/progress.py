"""The progress bar of a run."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import jax

from .plan import Part, Plan


@contextmanager
def reported(
    progress: bool | Callable[[int], Any], plan: Plan, total: int, done: int
) -> Generator[Callable[[Part], Any]]:
    """A function that is to be called after each part; the first process shows a bar if the output is a terminal.

    Args:
        progress: see `simulate`.
        total, done: body-steps of this process in all, and those that need not be computed.
    """
    if callable(progress):
        yield lambda part: progress(plan.work([part]))
        return
    if not progress or jax.process_index() or find_spec("tqdm") is None:
        yield lambda part: None
        return
    from tqdm import tqdm

    shown: dict[str, Any] = {"unit": "body-steps", "unit_scale": True, "leave": False, "disable": None}
    with tqdm(total=total, initial=done, dynamic_ncols=True, **shown) as bar:
        yield lambda part: bar.update(plan.work([part]))
