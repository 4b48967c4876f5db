"""Compiles programs as many bodies need it on a CPU: with the widest vectors, and a step as one vectorised loop.

XLA's CPU compiler has two habits that cost time:

- It uses vectors of 256 bits even where the processor has AVX-512, unless it is told to use more. The width changes no
  bit of a result.
- It compiles a short loop of steps whole ("small while loop hoisting"), without vectors. One body gains by that,
  because no step has to be started from outside. For many bodies a step takes three to seven times as long. From jaxlib
  0.12 on it counts loops over thousands of bodies as short. Results can differ by rounding, because whole loops
  contract other products and sums (seen with GBS12 in float32).

Options of the compiler can be given to the outermost `jax.jit` alone: inside another `jax.jit` or a derivative JAX
refuses them. There the user's own program decides, with `XLA_FLAGS` before JAX starts:
`--xla_cpu_prefer_vector_width=512 --xla_disable_hlo_passes=small-while-loop-hoisting`. If XLA_FLAGS names one of these
flags, the flag holds everywhere and nothing is added to it.
"""

import os
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import equinox as eqx

from .internals import bodies_at_once
from .platform import on_cpu

P = ParamSpec("P")
R = TypeVar("R")

_WIDTH = "xla_cpu_prefer_vector_width"
_LEFT_OUT = "xla_disable_hlo_passes"
_PROCESSOR = Path("/proc/cpuinfo")  # on Linux; elsewhere no processor is known to have AVX-512
_MANY = 4  # bodies from which a vectorised step is faster, although each is started from outside


def compiler_options(bodies: int) -> dict[str, Any]:
    """The options with which XLA compiles a loop of steps of so many bodies; empty on another device than the CPU."""
    options = vector_width_options()
    if bodies >= _MANY and on_cpu() and _LEFT_OUT not in os.environ.get("XLA_FLAGS", ""):
        options[_LEFT_OUT] = "small-while-loop-hoisting"
    return options


def vector_width_options() -> dict[str, Any]:
    """The first of these options alone, as other programs gain by it, which may lose by the second.

    Empty also if the processor has no AVX-512, and if XLA_FLAGS already sets the width.
    """
    wide = on_cpu() and _WIDTH not in os.environ.get("XLA_FLAGS", "") and _has_avx512()
    return {_WIDTH: 512} if wide else {}


@cache
def _has_avx512() -> bool:
    try:
        return "avx512f" in _PROCESSOR.read_text().split()
    except OSError:
        return False


def _one(*args: Any, **kwargs: Any) -> int:
    del args, kwargs
    return 1


def tuned_jit(function: Callable[P, R], bodies: Callable[..., int] = _one) -> Callable[P, R]:
    """`equinox.filter_jit`, with `compiler_options` wherever the program runs at once, also under `jax.vmap`.

    Inside another `jax.jit`, a derivative or a `jax.shard_map` the options are left out.

    Args:
        function: what is compiled.
        bodies: the number of bodies, from the same arguments; the axes of `jax.vmap` are counted besides.
    """
    jit: Any = eqx.filter_jit  # its annotations do not know the options of `jax.jit`
    plain = jit(function)
    tuned = cache(lambda options: jit(function, compiler_options=dict(options)))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        mapped = bodies_at_once()
        options = compiler_options(mapped * bodies(*args, **kwargs)) if mapped else {}
        chosen = tuned(tuple(options.items())) if options else plain
        return chosen(*args, **kwargs)

    return call
