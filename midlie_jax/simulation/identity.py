"""The text that identifies a run: a run is resumed only if everything that determines its numbers is unchanged."""

import hashlib
import os
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .._xla.platform import on_cpu
from ..drivers.ensemble import Batch
from ..drivers.observe import Observe
from .names import named, numbers
from .plan import Plan
from .program import program, unseen
from .versions import versions

_NUMBERS_SHOWN = 4
# Flags of XLA that do not change a number: the number of devices, and the vector width.
_HARMLESS = ("--xla_force_host_platform_device_count", "--xla_cpu_prefer_vector_width", "--xla_dump")
UNSEEN = "code that is not in the program"


def identity(batch: Batch, observe: Observe | None, plan: Plan, given: Any = None) -> dict[str, str]:
    """Names and contents of everything that determines the numbers of the run; long contents are hashed.

    The entry `UNSEEN`, if present, names what cannot be compared. `given` is the progress from a `Carry`.
    """
    arguments = eqx.combine(batch.mapped, batch.shared)
    body, torque, start, dt, t0 = arguments
    lowered = program(batch, observe)
    hidden = unseen(lowered)
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
        **_contents("", {"dt": dt, "t0": t0}),
        **_contents("body.", body),
        **_contents("torque.", torque),
        **_contents("start.", start),
        **_contents("carry.", given),
        "observe": "the states" if observe is None else f"{type(observe).__name__} {_hash(*_arrays(observe))}",
        "program (the code of method, torque and observe, and the numbers in it)": _hash(text=lowered),
        **({UNSEEN: ", ".join(hidden)} if hidden else {}),
        **versions(),
        "platform": "cpu" if on_cpu() else f"{jax.default_backend()}, {jax.devices()[0].device_kind}",
        "XLA_FLAGS": " ".join(flag for flag in _flags() if not flag.startswith(_HARMLESS)),
    }


def _flags() -> list[str]:
    return sorted(os.environ.get("XLA_FLAGS", "").split())


def differences(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """The differences between two identities, in words."""
    return [
        f"{name} was {before.get(name, 'absent')} and is now {now.get(name, 'absent')}"
        for name in dict.fromkeys((*before, *now))
        if before.get(name) != now.get(name)
    ]


def _contents(prefix: str, tree: Any) -> dict[str, str]:
    arrays = eqx.filter(tree, eqx.is_array)
    return {f"{prefix}{name}": _shown(numbers(leaf)) for name, leaf in named(arrays, ".").items()}


def _shown(array: np.ndarray) -> str:
    if array.size <= _NUMBERS_SHOWN:
        return str(array.tolist())
    return f"{array.dtype}{list(array.shape)} {_hash(array)}"


def _hash(*arrays: Any, text: str = "") -> str:
    hashed = hashlib.sha256(text.encode())
    for array in map(numbers, arrays):
        hashed.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return hashed.hexdigest()[:16]


def _arrays(tree: Any) -> list[Any]:
    return jax.tree.leaves(eqx.filter(tree, eqx.is_array))
