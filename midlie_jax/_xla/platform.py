"""Where programs run: on CPUs or on an accelerator, for which steps and batches are divided differently."""

import os
from typing import Any

import jax


def on_cpu() -> bool:
    """Whether programs run on the CPU, unless their arguments are placed elsewhere.

    `jax.default_device` decides if it is set, otherwise the platform that JAX prefers. The answer affects the speed of
    a program and nothing else.
    """
    config: Any = jax.config  # its annotations do not know the option
    device = config.jax_default_device
    return (device if isinstance(device, str) else getattr(device, "platform", jax.default_backend())) == "cpu"


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
