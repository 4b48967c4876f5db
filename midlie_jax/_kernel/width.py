"""Compiles programs for the widest vectors of the machine.

XLA's CPU compiler uses vectors of 256 bits even where the processor has AVX-512, unless it is told otherwise. With
vectors of 512 bits the results are the same, bit for bit, and the steps take less time on processors that compute 512
bits at once. Options of the compiler can be given to the outermost `jax.jit` alone: inside another `jax.jit` or a
derivative JAX refuses them. There the user's own program decides, with
`XLA_FLAGS=--xla_cpu_prefer_vector_width=512` before JAX starts. If XLA_FLAGS names this flag, the flag holds everywhere
and nothing is added to it; so `XLA_FLAGS=--xla_cpu_prefer_vector_width=256` turns the wide vectors off.
"""

import os
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import equinox as eqx

from .internals import runs_at_once
from .platform import on_cpu

P = ParamSpec("P")
R = TypeVar("R")

_FLAG = "xla_cpu_prefer_vector_width"
_PROCESSOR = Path("/proc/cpuinfo")  # on Linux; elsewhere no processor is known to have AVX-512


def vector_width_options() -> dict[str, Any]:
    """The compiler options that make XLA use 512-bit vectors; empty where that is not possible or not wanted.

    Empty if the programs run on another device than the CPU, if the processor has no AVX-512, and if XLA_FLAGS already
    sets the width.
    """
    if not on_cpu() or _FLAG in os.environ.get("XLA_FLAGS", "") or not _has_avx512():
        return {}
    return {_FLAG: 512}


@cache
def _has_avx512() -> bool:
    try:
        return "avx512f" in _PROCESSOR.read_text().split()
    except OSError:
        return False


def wide_jit(function: Callable[P, R]) -> Callable[P, R]:
    """`equinox.filter_jit`, with `vector_width_options` wherever the program runs at once, also under `jax.vmap`.

    Inside another `jax.jit`, a derivative or a `jax.shard_map` the options are left out.
    """
    jit: Any = eqx.filter_jit  # its annotations do not know the options of `jax.jit`
    plain = jit(function)
    wide = cache(lambda options: jit(function, compiler_options=dict(options)))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        options = vector_width_options()
        chosen = wide(tuple(options.items())) if options and runs_at_once() else plain
        return chosen(*args, **kwargs)

    return call
