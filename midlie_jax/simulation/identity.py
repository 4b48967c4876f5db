"""The text that identifies a run: a run is resumed only if everything that determines its numbers is unchanged.

The lowered program belongs to it. A traced function (a jaxpr) does not show the whole program, because constants of
inner loops, conditions and derivative rules are hidden. The lowered program contains them all, at any depth, and the
settings of JAX under which it was made.
"""

import hashlib
import os
import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._xla.platform import on_cpu
from ..drivers.derivatives import as_adjoint
from ..drivers.ensemble import Batch
from ..drivers.integrate import run_of_body
from ..drivers.observe import Observe, Statistic
from ..drivers.observe.series import Series
from .plan import Plan
from .variables import named, numbers, versions

UNSEEN = "code that is not in the program"
_NUMBERS_SHOWN = 4
# Flags of XLA that do not change a number: the number of devices, and the vector width.
_HARMLESS = ("--xla_force_host_platform_device_count", "--xla_cpu_prefer_vector_width", "--xla_dump")
# The names of calls whose code is outside the program, but part of JAX or of the GPU's libraries. Any other name
# belongs to code of the user, as with `jax.pure_callback` or `jax.ffi.ffi_call`, which is not visible here.
_KNOWN = re.compile(
    r"lapack_|cusolver|cublas|cudnn|cufft|cuda_|cu_|hip|roc|ducc_fft|Sharding$|SPMD|sdy|xla\.|mhlo\.|chlo\.|stablehlo\."
    r"|TopK$|ApproxTopK$|PartialReduce$|__gpu\$xla"
)
# A call without results, such as `jax.debug.print`, cannot determine a number.
_CALL = re.compile(r"custom_call @\"?(?P<name>[^\s\"(]+).*->\s*(?P<results>.+)$", re.MULTILINE)


def identity(batch: Batch, observe: Observe | None, plan: Plan, given: Any = None) -> dict[str, str]:
    """Names and contents of everything that determines the numbers of the run; long contents are hashed.

    The entry `UNSEEN`, if present, names what cannot be compared. `given` is the progress from a `Carry`.
    """
    body, torque, start, dt, t0 = eqx.combine(batch.mapped, batch.shared)
    program = _program(batch, observe)
    calls = [call["name"] for call in _CALL.finditer(program) if call["results"].strip() not in ("()", "tuple<>")]
    hidden = sorted({name for name in calls if not _KNOWN.match(name)} | set(re.findall("dense_resource", program)))
    flags = sorted(os.environ.get("XLA_FLAGS", "").split())
    observed = jax.tree.leaves(eqx.filter(observe, eqx.is_array))
    return {
        "method": batch.method.name,
        "dtype": str(start.momentum.dtype),
        "bodies": str(plan.bodies),
        "steps": str((plan.saves - 1) * plan.save_every),
        "first_step": str(plan.begin),
        "save_every": str(plan.save_every),
        "bodies of a group": str(plan.group),
        "saved states of a span": str(plan.span),
        "chunk": str(plan.chunk),
        **_contents({"dt": dt, "t0": t0, "body": body, "torque": torque, "start": start, "carry": given}),
        "observe": "the states" if observe is None else f"{type(observe).__name__} {_hash(*observed)}",
        "program (the code of method, torque and observe, and the numbers in it)": _hash(text=program),
        **({UNSEEN: ", ".join(hidden)} if hidden else {}),
        **versions(),
        "platform": "cpu" if on_cpu() else f"{jax.default_backend()}, {jax.devices()[0].device_kind}",
        "XLA_FLAGS": " ".join(flag for flag in flags if not flag.startswith(_HARMLESS)),
    }


def differences(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """The differences between two identities, in words."""
    return [
        f"{name} was {before.get(name, 'absent')} and is now {now.get(name, 'absent')}"
        for name in dict.fromkeys((*before, *now))
        if before.get(name) != now.get(name)
    ]


def _contents(tree: Any) -> dict[str, str]:
    arrays = {name: numbers(x) for name, x in named(eqx.filter(tree, eqx.is_array), ".").items()}
    return {
        name: str(x.tolist()) if x.size <= _NUMBERS_SHOWN else f"{x.dtype}{list(x.shape)} {_hash(x)}"
        for name, x in arrays.items()
    }


def _hash(*arrays: Any, text: str = "") -> str:
    hashed = hashlib.sha256(text.encode())
    for array in map(numbers, arrays):
        hashed.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return hashed.hexdigest()[:16]


def _program(batch: Batch, observe: Observe | None) -> str:
    """The program of one body over two steps, and of the statistic of its observed values, as text."""
    mapped, shared = jax.tree.map(lambda x: x[0], batch.mapped), batch.shared
    arrays, functions = eqx.partition(eqx.combine(mapped, shared), eqx.is_array)

    def run(arrays: Any) -> Any:
        of_body = eqx.combine(arrays, functions), jnp.int32(0), 2, 1, None, None, observe
        path: Any = run_of_body(batch.method, as_adjoint(None), *of_body)
        return path, _combined(observe, path.states) if isinstance(observe, Statistic) else None

    return jax.jit(run).lower(arrays).as_text()


def _combined(observe: Statistic, values: Any) -> Any:
    """The finished statistic of the values of some bodies, with one call of each of its functions."""
    if isinstance(observe, Series):
        values = jax.tree.map(lambda x: x[None], values)
        good = jnp.ones((1, jax.tree.leaves(values)[0].shape[1]), bool)
        return observe.finished(observe.of_bodies(values, good, jnp.ones(())))
    good = jnp.ones(len(jax.tree.leaves(values)[0]), bool)
    part = jax.tree.map(lambda x: x[None, None], observe.part(values, good))
    return observe.finished(observe.merged(part))
