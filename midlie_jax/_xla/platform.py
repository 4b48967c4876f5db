"""The platform of programs, CPU or accelerator, which decides how steps and batches are divided."""

import os
from typing import Any

import jax


def on_cpu() -> bool:
    """Whether programs run on the CPU, unless their arguments are placed elsewhere; affects only speed."""
    config: Any = jax.config  # its annotations lack the option
    device = config.jax_default_device
    return (device if isinstance(device, str) else getattr(device, "platform", jax.default_backend())) == "cpu"


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
