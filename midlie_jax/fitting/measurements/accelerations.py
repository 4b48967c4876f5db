"""`Accelerations`: what an accelerometer measures."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from ..._math import components as cp
from ...model import so3
from ...model.bodies import TensorBody
from ...model.states import TravellingState, attitude_of
from ...model.torques import GravityGradient, Torque, TorqueLike, kept_terms, on_body, terms_of, without_gravity
from ...model.wrench import Wrench
from .base import Expected
from .source import Part, Source, source

_GAUSS = 0.5 - math.sqrt(3) / 6  # of the two points of Gauss on (0, 1)


class Accelerations(Expected):
    """Specific forces in the body frame, as an accelerometer measures them: its acceleration without that of gravity.

    The model is R^T (a - g) + Omega' x r + Omega x (Omega x r), with the acceleration a of the centre of mass of a body
    that travels, zero for one that turns about a fixed point; r is the place of the instrument, and Omega' is from
    Euler's equations with the torque of the model. g is the gravity at the instrument: in orbit it differs from that at
    the centre of mass by the tidal term, (grad g) R r to first order. The fields of the torque give it, also their sum;
    a `GravityGradient` gives it to first order, if no other term of the torque is gravity.

    Args:
        times: (n,), ascending.
        values: (n, 3), length/time^2; NaN where missing.
        sigma: standard deviation in the same unit: one number, (3,), or (n, 3).
        lever: the place r of the instrument, from the centre of mass or the fixed point, body frame, (3,): a known
            array, the name of a parameter, or a function of the values of the parameters.
        gravity: the acceleration g of gravity at the centre of mass or the fixed point, space frame, (3,), in the same
            three forms; zeros in free fall. None if terms of the torque on a body that travels are gravity:
            `UniformGravity`, `PointMass` and `Oblateness`, and no others.
        bias: what the instrument adds, (3,), in the same three forms. None means no bias.
        clock: as for `Rates`.

    Raises:
        ValueError: as for `Rates`.

    Examples:
        >>> times, felt = np.arange(5.0), np.tile([0.0, 0.3, 9.8], (5, 1))  # m/s^2
        >>> instrument = ml.fitting.Accelerations(times, felt, sigma=0.05, lever="lever", gravity=[0.0, 0.0, -9.81])
        >>> guess = {"lever": ml.fitting.Free([0.1, 0.0, 0.0])}  # "lever" is a parameter of the fit
        >>> instrument.values.shape
        (5, 3)
    """

    lever: Source
    gravity: Source | None
    bias: Source | None
    run: tuple[TorqueLike | None] | None  # the torque of the model, when it is known

    def __init__(
        self,
        times: Any,
        values: Any,
        sigma: Any,
        *,
        lever: Part | Any,
        gravity: Part | Any = None,
        bias: Part | Any = None,
        clock: Part | float | None = None,
    ):
        self._record(times, values, sigma, (3,), clock)
        self.lever, self.gravity = Source.of("lever", lever, (3,)), source("gravity", gravity, (3,))
        self.bias, self.run = source("bias", bias, (3,)), None

    def of_run(self, torque: TorqueLike | None, times: Float[Array, " n"]) -> "Accelerations":
        del times
        return eqx.tree_at(lambda m: m.run, self, (torque,), is_leaf=lambda x: x is None)

    def expected(self, t: Array, state: Any, body: Any, parameters: Any) -> Array:
        assert self.run is not None
        (torque,) = self.run
        bound, pushing = on_body(torque, body), on_body(without_gravity(torque), body)
        zeros, rates, lever = jnp.zeros_like(state.momentum), body.velocity(state.momentum), self.lever(parameters)
        moment = zeros if bound is None else Wrench.of(bound(t, state)).torque
        change = body.velocity(jnp.cross(state.momentum, rates) + moment)
        felt = zeros if self.gravity is None else -self.gravity(parameters).reshape(3)
        if isinstance(state, TravellingState) and pushing is not None:
            felt = felt + Wrench.of(pushing(t, state)).force / body.mass
        fields = kept_terms(torque, _gravitational) if isinstance(state, TravellingState) else None
        if fields is not None:
            felt = felt + _fall(fields, t, state, body, lever)
        of_turning = jnp.cross(change, lever) + jnp.cross(rates, jnp.cross(rates, lever))
        measured = cp.pack(state.seen_from_body(cp.vector(felt))) + of_turning
        for term in terms_of(torque) if fields is None else []:
            if isinstance(term, GravityGradient):
                measured = measured - cp.pack(term.tide(t, state, cp.vector(lever)))
        return measured if self.bias is None else measured + self.bias(parameters)


def _gravitational(term: TorqueLike) -> bool:
    return isinstance(term, Torque) and term.gravitational


def _fall(fields: TorqueLike, t: Array, state: Any, body: Any, lever: Array) -> Array:
    """The acceleration of a body by gravity, minus the gravity at a place in the body, space frame.

    Both parts are derivatives, so that the difference of nearly equal accelerations is not taken: of the force by the
    moments, which it is linear in, and of the field along the lever, at two points of Gauss.
    """
    place, along = state.position, so3.rotate(attitude_of(state), lever)
    one = jnp.ones_like(body.mass)

    def field(position: Array, share: Array) -> Array:
        """The acceleration at a position of the body with this share of its moments."""
        moved = eqx.tree_at(lambda s: s.position, state, position)
        return Wrench.of(on_body(fields, _with_moments(body, share))(t, moved)).force / body.mass

    def slope(share: float) -> Array:
        return jax.jvp(lambda x: field(x, 0 * one), (place + share * along,), (along,))[1]

    of_shape = jax.jvp(lambda share: field(place, share), (0 * one,), (one,))[1]
    return of_shape - (slope(_GAUSS) + slope(1 - _GAUSS)) / 2


def _with_moments(body: Any, share: Array) -> Any:
    """A body that travels, with a share of its moments of inertia."""
    principal = isinstance(body.body, TensorBody)
    return eqx.tree_at(
        lambda b: b.body.principal if principal else b.body,
        body,
        replace_fn=lambda x: jax.tree.map(lambda m: share * m, x),
    )
