"""The program of a run for the compiler, with every constant; with the arguments it determines the numbers.

A traced function (a jaxpr) does not show the whole program, because constants of inner loops, conditions and derivative
rules are hidden. The lowered program contains them all, at any depth, and the settings of JAX under which it was made.
"""

import re
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from ..drivers.adjoints import as_adjoint
from ..drivers.ensemble import Batch
from ..drivers.integrate import run_of_body
from ..drivers.observe import Observe, Statistic
from ..drivers.observe.series import Series

# The names of calls whose code is outside the program, but part of JAX or of the GPU's libraries. Any other name
# belongs to code of the user, as with `jax.pure_callback` or `jax.ffi.ffi_call`, which is not visible here.
_KNOWN = re.compile(
    r"lapack_|cusolver|cublas|cudnn|cufft|cuda_|cu_|hip|roc|ducc_fft|Sharding$|SPMD|sdy|xla\.|mhlo\.|chlo\.|stablehlo\."
    r"|TopK$|ApproxTopK$|PartialReduce$|__gpu\$xla"
)
# A call without results, such as `jax.debug.print`, cannot determine a number.
_CALL = re.compile(r"custom_call @\"?(?P<name>[^\s\"(]+).*->\s*(?P<results>.+)$", re.MULTILINE)


def program(batch: Batch, observe: Observe | None) -> str:
    """The program of one body over two steps, and of the statistic of its observed values, as text."""
    mapped, shared = jax.tree.map(lambda x: x[0], batch.mapped), batch.shared
    arrays, functions = eqx.partition(eqx.combine(mapped, shared), eqx.is_array)

    def run(arrays: Any) -> Any:
        body, torque, start, dt, t0 = eqx.combine(arrays, functions)
        first = jax.numpy.int32(0)
        run_one: Callable[..., Any] = run_of_body
        path = run_one(batch.method, as_adjoint(None), body, torque, start, dt, t0, first, 2, 1, None, None, observe)
        return path, _combined(observe, path.states) if isinstance(observe, Statistic) else None

    return jax.jit(run).lower(arrays).as_text()


def unseen(program: str) -> list[str]:
    """The names of the calls in a program whose code is outside it, so that changes cannot be detected."""
    found = [call["name"] for call in _CALL.finditer(program) if call["results"].strip() not in ("()", "tuple<>")]
    return sorted({name for name in found if not _KNOWN.match(name)} | set(re.findall("dense_resource", program)))


def _combined(observe: Statistic, values: Any) -> Any:
    """The finished statistic of the values of some bodies, with one call of each of its functions."""
    if isinstance(observe, Series):
        values = jax.tree.map(lambda x: x[None], values)
        good = jax.numpy.ones((1, jax.tree.leaves(values)[0].shape[1]), bool)
        return observe.finished(observe.of_bodies(values, good, jax.numpy.ones(())))
    good = jax.numpy.ones(len(jax.tree.leaves(values)[0]), bool)
    part = jax.tree.map(lambda x: x[None, None], observe.part(values, good))
    return observe.finished(observe.merged(part))
