"""The description of a run in its file besides the motion: times, parameters, method, versions."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..drivers.clock import time_of
from ..drivers.ensemble import Batch
from .names import named, numbers, parameter
from .plan import Plan
from .variables import BODY, TIME, Variable, own_dims
from .versions import versions

_MOST_IN_ATTRIBUTES = 16  # a parameter with more numbers becomes a variable
Whole = dict[str, tuple[Variable, np.ndarray]]


def attributes_of(batch: Batch, plan: Plan) -> dict[str, Any]:
    """The attributes of the root: a description, and the parameters that are equal for all bodies."""
    _, torque, start, dt, t0 = eqx.combine(batch.mapped, batch.shared)
    parameters = {
        name: values.tolist()
        for name, values in _parameters(batch.shared).items()
        if values.size <= _MOST_IN_ATTRIBUTES
    }
    return {
        "title": f"{plan.bodies} bodies moved by {batch.method.name}",
        "method": batch.method.name,
        "order": batch.method.order,
        "torque": "none" if torque is None else getattr(torque, "__name__", type(torque).__name__),
        "state": type(start).__name__,
        "dtype": str(start.momentum.dtype),
        **({"dt": float(dt)} if not dt.ndim else {}),
        **({"t0": float(t0)} if not t0.ndim else {}),
        "steps": (plan.saves - 1) * plan.save_every,
        "first_step": plan.begin,
        "save_every": plan.save_every,
        "parameters": parameters,
        "source": "midlie_jax",
        "versions": versions(),
    }


def whole_variables(batch: Batch, plan: Plan) -> Whole:
    """The variables available before the run: the times, and parameters with many numbers."""
    *_, dt, t0 = eqx.combine(batch.mapped, batch.shared)
    indices = plan.begin + plan.save_every * jnp.arange(plan.saves, dtype=jnp.int32)
    if t0.ndim or dt.ndim:
        t0, dt, indices = t0.reshape(-1, 1), dt.reshape(-1, 1), indices[None]
    times = np.asarray(jax.jit(time_of)(t0, dt, indices))
    about = {"long_name": "time", "units": "time"}
    if times.ndim == 1:
        found: Whole = {"time": (Variable((TIME,), times.shape, times.dtype, about), times)}
    else:
        found = {"times": (Variable((BODY, TIME), times.shape, times.dtype, about), times)}
    own, shared = _parameters((*batch.mapped[:2], None, *batch.mapped[3:])), _parameters(batch.shared)
    shared = {name: values for name, values in shared.items() if values.size > _MOST_IN_ATTRIBUTES}
    for first, parameters in (((BODY,), own), ((), shared)):
        for name, values in parameters.items():
            name = parameter(name)
            dims = (*first, *own_dims(name, values.shape[len(first) :]))
            long_name = f"{name.removeprefix('parameter_')}, in the units of the run"
            found[name] = (Variable(dims, values.shape, values.dtype, {"long_name": long_name}), values)
    return found


def _parameters(arguments: Any) -> dict[str, np.ndarray]:
    body, torque, _, dt, t0 = arguments
    arrays = eqx.filter({"body": body, "torque": torque, "dt": dt, "t0": t0}, eqx.is_array)
    return {name: numbers(values) for name, values in named(arrays, ".").items()}
