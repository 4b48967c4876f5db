"""Chooses how the outputs of a step leave it on a platform, to measure what another choice would cost."""

from collections.abc import Callable
from typing import Any

from jax.interpreters import mlir

from midlie_jax._kernel import fusion

OURS, REDUCTION = fusion._separate, fusion._reduce  # on accelerators and on CPUs


def lower_outputs(function: Callable[..., Any], platform: str) -> None:
    """From now on, outputs on this platform leave a step through this function of the leaves and their use."""
    mlir.register_lowering(fusion._fuse, mlir.lower_fun(function, multiple_results=True), platform=platform)
