"""`WithBath`: the torque and the heat bath of a run as one tree, from the arguments of a driver to its step."""

from typing import Any

import jax.numpy as jnp
from jax import Array

from ..._checks.arguments import described
from ..state import Time
from ..torques.base import Torque, TorqueLike, on_body, potential_of, velocity_dependent
from ..torques.reads_body import ReadsBody
from .base import HeatBath


class WithBath(ReadsBody):
    torque: TorqueLike | None
    bath: HeatBath

    def at(self, t: Time, state: Any, body: Any) -> Any:
        self.bath.check_on(state, body)
        return jnp.zeros_like(state.momentum) if self.torque is None else on_body(self.torque, body)(t, state)

    def potential_at(self, t: Time, state: Any, body: Any) -> Array:
        if self.torque is None:
            return jnp.zeros((), state.momentum.dtype)
        return potential_of(on_body(self.torque, body))(t, state)

    def check(self, state: Any) -> None:
        self.bath.check(state)
        if isinstance(self.torque, Torque):
            self.torque.check(state)

    @property
    def velocity_dependent(self) -> bool:
        return velocity_dependent(self.torque)


def with_bath(torque: Any, bath: Any) -> Any:
    if bath is None:
        return torque
    if not isinstance(bath, HeatBath):
        cure = "; add baths with a + b" if isinstance(bath, list | tuple) else ""
        raise ValueError(f"bath must be a midlie_jax.baths.Langevin or None, got {described(bath)}{cure}.")
    return WithBath(torque, bath)


def without_bath(torque: Any) -> tuple[Any, HeatBath | None]:
    return (torque.torque, torque.bath) if isinstance(torque, WithBath) else (torque, None)
