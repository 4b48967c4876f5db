"""The force of the boomerang scene: its blades in air."""

from typing import Any

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..model import so3
from ..model.torques.reads_body import ReadsBody
from ..model.wrench import Wrench


class Blades(ReadsBody):
    """Lift and drag of thin blades that rotate about the third body axis, in air at rest, averaged over a rotation.

    A piece of a blade moves at U along the plane and at W along the third axis n. Per unit of length, its lift along n
    is strength/radius * U (lift U - slope W), and its drag is strength/radius * drag U^2. U = spin r + v . (n x r^),
    where v is the velocity of the body and r^ points along the blade. The advancing blade therefore has more lift: the
    axis precesses and the path bends. Stall and wake are neglected.

    Attributes:
        strength: half the density of air times the chord, the number and the length of the blades, (), mass/length.
        radius: length of a blade, ().
        lift: coefficient of lift of a blade that moves in its plane, ().
        slope: decrease of this coefficient with W/U, (), 1/radian.
        drag: coefficient of drag, ().
    """

    strength: Float[Array, ""]
    radius: Float[Array, ""]
    lift: Float[Array, ""]
    slope: Float[Array, ""]
    drag: Float[Array, ""]

    @property
    def velocity_dependent(self) -> bool:
        return True

    def at(self, t: Any, state: Any, body: Any) -> Wrench:
        del t
        a, turn = self.radius, body.velocity(state.momentum)
        v = so3.rotate(so3.conjugate(state.attitude), state.linear / body.mass)  # all vectors are along the body axes
        n = jnp.zeros_like(v).at[2].set(1)
        spin, along = turn[2], v[2]
        across, tilt = v - along * n, turn - spin * n  # the parts in the plane of the blades
        square = jnp.sum(across**2)
        lift = self.lift * ((spin * a) ** 2 / 3 + square / 2) + self.slope * a * (
            jnp.sum(across * tilt) / 4 - spin * along / 2
        )
        bend = (self.slope * a * along / 4 - self.lift * a**2 * spin / 3) * across
        steady = -self.slope * a**3 * spin / 8 * tilt
        slow = -self.drag * a * ((spin * a) ** 2 + square) / 4 * n
        force = lift * n - self.drag * a * spin / 2 * across
        return Wrench(self.strength * (bend + steady + slow), self.strength * so3.rotate(state.attitude, force))
