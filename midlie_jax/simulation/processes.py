"""Waiting of the processes of one run for each other, by `jax.distributed`; a single process does not wait."""

from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np

R = TypeVar("R")


def wait(name: str) -> None:
    """Returns when all processes have called it with this name."""
    if jax.process_count() > 1:
        from jax.experimental.multihost_utils import sync_global_devices

        sync_global_devices(name)


def all_succeed(work: Callable[[], R]) -> R:
    """The result of `work`; raises in all processes if it raises in one, so that no process waits forever."""
    if jax.process_count() == 1:
        return work()
    from jax.experimental.multihost_utils import process_allgather

    result, error = None, None
    try:
        result = work()
    except Exception as caught:  # raised below, after the other processes are informed
        error = caught
    failed = np.flatnonzero(process_allgather(np.array(error is not None)))
    if error is not None:
        raise error
    if failed.size:
        raise RuntimeError(f"process {failed[0]} of this run failed; its own message says why.")
    return result  # pyright: ignore[reportReturnType]
