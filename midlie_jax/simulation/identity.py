"""What determines the numbers of a run, as text: a run is resumed only if nothing of it has changed."""

import hashlib
import re
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .._kernel.platform import on_cpu
from ..drivers.adjoints import as_adjoint
from ..drivers.ensemble import Batch
from ..drivers.integrate import run_of_body
from ..drivers.observe import Observe
from .names import named
from .plan import Plan
from .versions import versions

_NUMBERS_SHOWN = 4


def identity(batch: Batch, observe: Observe | None, plan: Plan) -> dict[str, str]:
    """Names and contents of all that determines the numbers of the run: what is long is represented by a hash."""
    arguments = eqx.combine(batch.mapped, batch.shared)
    body, torque, start, dt, t0 = arguments
    return {
        "method": batch.method.name,
        "dtype": str(start.momentum.dtype),
        "bodies": str(plan.bodies),
        "steps": str((plan.saves - 1) * plan.save_every),
        "save_every": str(plan.save_every),
        "bodies of a group": str(plan.group),
        "saved states of a segment": str(plan.segment),
        "chunk": str(plan.chunk),
        **_contents("", {"dt": dt, "t0": t0}),
        **_contents("body.", body),
        **_contents("torque.", torque),
        **_contents("start.", start),
        "observe": "the states" if observe is None else f"{type(observe).__name__} {_hash(*_arrays(observe))}",
        "program (the code of method, torque and observe)": _program(batch, observe),
        **versions(),
        "platform": "cpu" if on_cpu() else jax.default_backend(),
    }


def differences(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """In words, what is not the same in two identities."""
    return [
        f"{name} was {before.get(name, 'absent')} and is now {now.get(name, 'absent')}"
        for name in dict.fromkeys((*before, *now))
        if before.get(name) != now.get(name)
    ]


def _contents(prefix: str, tree: Any) -> dict[str, str]:
    arrays = eqx.filter(tree, eqx.is_array)
    return {f"{prefix}{name}": _shown(np.asarray(leaf)) for name, leaf in named(arrays, ".").items()}


def _shown(array: np.ndarray) -> str:
    if array.size <= _NUMBERS_SHOWN:
        return str(array.tolist())
    return f"{array.dtype}{list(array.shape)} {_hash(array)}"


def _hash(*arrays: Any, text: str = "") -> str:
    hashed = hashlib.sha256(text.encode())
    for array in arrays:
        hashed.update(np.asarray(array).tobytes())
    return hashed.hexdigest()[:16]


def _program(batch: Batch, observe: Observe | None) -> str:
    """A hash of the traced computation of one body, with the constants that its functions close over."""
    mapped, shared = jax.tree.map(lambda x: x[0], batch.mapped), batch.shared
    arrays, functions = eqx.partition(eqx.combine(mapped, shared), eqx.is_array)

    def run(arrays: Any) -> Any:
        body, torque, start, dt, t0 = eqx.combine(arrays, functions)
        first = jax.numpy.int32(0)
        run_one: Callable[..., Any] = run_of_body
        return run_one(batch.method, as_adjoint(None), body, torque, start, dt, t0, first, 2, 1, None, None, observe)

    traced = jax.make_jaxpr(run)(arrays)
    text = re.sub(r"0x[0-9a-f]+", "", str(traced))  # the addresses of functions differ from process to process
    return _hash(*traced.consts, text=text)


def _arrays(tree: Any) -> list[Any]:
    return jax.tree.leaves(eqx.filter(tree, eqx.is_array))
