"""Compiles programs for many bodies on a CPU, with the widest vectors and each step as one vectorised loop.

Two defaults of XLA's CPU compiler increase the run time:

- It uses vectors of 256 bits even where the processor has AVX-512, unless an option allows more. The width changes no
  bit of a result.
- It compiles a short loop of steps as one function ("small while loop hoisting"), without vectors. A run of one body
  becomes faster; for many bodies a step takes several times longer. From jaxlib 0.12 on, loops over thousands of bodies
  count as short as well. Such a function contracts other products and sums, so results can differ by rounding.

Only the outermost `jax.jit` accepts compiler options. Inside another `jax.jit` or a derivative, `fusion.begin_step`
keeps loops in vectors, which is up to 20 % slower than the option (`benchmarks/compiler_options.py`), and the width
remains at 256 bits. If XLA_FLAGS names one of these flags, its value is used everywhere, and this module does not set
that option.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax

from . import budgets
from .fusion import vectors_by_option
from .internals import bodies_at_once
from .platform import on_cpu
from .structure import is_array, kind_of, remember

P = ParamSpec("P")
R = TypeVar("R")

_WIDTH = "xla_cpu_prefer_vector_width"
_LEFT_OUT = "xla_disable_hlo_passes"
_PROCESSOR = Path("/proc/cpuinfo")  # on Linux; on other systems AVX-512 is never assumed


def compiler_options(bodies: int) -> dict[str, Any]:
    """The options with which XLA compiles a loop of steps of this many bodies; empty if the device is no CPU."""
    options = vector_width_options()
    if bodies >= budgets.VECTOR_BODIES and on_cpu() and _LEFT_OUT not in os.environ.get("XLA_FLAGS", ""):
        options[_LEFT_OUT] = "small-while-loop-hoisting"
    return options


def vector_width_options() -> dict[str, Any]:
    """Only the option for wide vectors, which speeds up other programs as well; the other option may slow them down."""
    wide = on_cpu() and _WIDTH not in os.environ.get("XLA_FLAGS", "") and _has_avx512()
    return {_WIDTH: 512} if wide else {}


@cache
def _has_avx512() -> bool:
    try:
        return "avx512f" in _PROCESSOR.read_text().split()
    except OSError:
        return False


@dataclass(frozen=True)
class _Number:
    kind: Any
    value: Any = field(compare=False)


def exact_jit(function: Callable[P, R]) -> Callable[P, R]:
    """`equinox.filter_jit` that distinguishes equal Python numbers, such as 0.0 and -0.0, or 1 and True.

    They can be attributes of a user's torque; the second of two such torques would get the program of the first.
    """

    def marked(leaf: Any) -> Any:
        return _Number(kind_of(leaf), leaf) if isinstance(leaf, int | float | complex) else leaf

    def unmarked(leaf: Any) -> Any:
        return leaf.value if isinstance(leaf, _Number) else leaf

    @eqx.filter_jit
    @wraps(function)
    def of_marked(*args: Any, **kwargs: Any) -> R:
        args, kwargs = jax.tree.map(unmarked, (args, kwargs))
        return function(*args, **kwargs)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        args, kwargs = jax.tree.map(marked, (args, kwargs))
        return of_marked(*args, **kwargs)

    return call


def tuned_jit(function: Callable[P, R], bodies: Callable[..., int] = lambda *args, **kwargs: 1) -> Callable[P, R]:
    """`exact_jit`, with `compiler_options` if the program is outermost, also under `jax.vmap`.

    An outermost call finds its program by the structure of its arguments and passes only the arrays, in a fraction of
    the time of `exact_jit`. `bodies` returns the number of bodies from the arguments, without axes of `jax.vmap`.
    """
    plain = exact_jit(function)
    programs: dict[Any, _Program] = {}

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        mapped = bodies_at_once()
        if not mapped:
            return plain(*args, **kwargs)
        options = tuple(compiler_options(mapped * bodies(*args, **kwargs)).items())
        leaves, structure = jax.tree.flatten((args, kwargs))
        key = structure, tuple(map(kind_of, leaves)), options
        try:
            program = programs.get(key)
        except TypeError:  # a part without a hash, which JAX names in its error
            return plain(*args, **kwargs)
        if program is None:
            program = _Program(function, structure, leaves, dict(options))
            remember(programs, key, program)
        return program(list(filter(is_array, leaves)))

    return call


class _Program:
    """The compiled function for arguments of one structure, as a function of their arrays."""

    def __init__(self, function: Callable[..., Any], structure: Any, leaves: list[Any], options: dict[str, Any]):
        others = _without_arrays(leaves)
        self.structure: Any = None
        self.others: list[Any] = []

        @wraps(function)
        def run(arrays: list[Any]) -> list[Any]:
            args, kwargs = structure.unflatten(_filled(others, arrays))
            token = vectors_by_option.set(_LEFT_OUT in options)
            try:
                found, self.structure = jax.tree.flatten(function(*args, **kwargs))
            finally:
                vectors_by_option.reset(token)
            self.others = _without_arrays(found)
            return list(filter(is_array, found))

        self.compiled = jax.jit(run, compiler_options=options)

    def __call__(self, arrays: list[Any]) -> Any:
        found = self.compiled(arrays)  # its first call sets the structure and the others
        return self.structure.unflatten(_filled(self.others, found))


def _without_arrays(leaves: list[Any]) -> list[Any]:
    return [None if is_array(leaf) else leaf for leaf in leaves]


def _filled(others: list[Any], arrays: list[Any]) -> list[Any]:
    """The leaves, with an array in place of each None; a tree has no leaf None."""
    given = iter(arrays)
    return [next(given) if other is None else other for other in others]
