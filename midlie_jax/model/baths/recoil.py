"""`Recoil`: noise without friction, in the space frame."""

from collections.abc import Iterable
from typing import Any, ClassVar

import equinox as eqx
from jax import Array

from ..bodies import Body
from ..exposure import PreparedBath, kicks
from ..rotor import SymmetricRotor
from ..state import AnyState
from .base import BathOfBodies, as_key, words_of
from .coefficient import as_coefficient, at


class Recoil(BathOfBodies):
    """Noise without friction, such as the recoil of photons: dL = sqrt(2 D) dW in the space frame; likewise for p.

    The mean kinetic energy of a free body grows at a constant rate: tr(D)/m for the translation with the linear
    diffusion D, and tr(D)/I for the rotation of a sphere. Add friction and noise of a gas as
    `Langevin(...) + Recoil(...)`. The numbers do not depend on the orientation of the body.

    Attributes:
        diffusion: D, the diffusion of the angular momentum, `<dL_i dL_j> = 2 D_ij dt`: a number (), three numbers (3,)
            along the space axes, or a symmetric tensor (3, 3) in the space frame, which a state without an attitude or
            an axis does not support. For coupled bodies, numbers and tensors may have an axis for the bodies, (N, 3)
            and (N, 3, 3). Or a function of time t that returns one of these.
        key: a typed key, `jax.random.key(seed)`; (n,) for an ensemble.
        linear_diffusion: of the linear momentum, likewise; for a body that translates, 0 for none. None for a body that
            does not translate.

    Raises:
        ValueError: a diffusion that is negative, not symmetric or not positive semi-definite, or of another shape; a
            key that is not typed. When a run begins: as for `Langevin`.

    Examples:
        >>> sphere = ml.FreeBody(ml.RigidBody([0.4, 0.4, 0.4]), mass=1.0)
        >>> rest = ml.FreeState([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        >>> laser = ml.baths.Recoil(0.0, jax.random.key(0), linear_diffusion=[0.1, 0.1, 0.4])
        >>> path = ml.integrate("JACOBI[BAOAB]", sphere, None, rest, dt=0.1, steps=10, bath=laser)
        >>> path.states.linear.shape, bool(path.ok)
        ((11, 3), True)
    """

    numbers: ClassVar[tuple[str, ...]] = ("diffusion", "linear_diffusion")
    diffusion: Any
    key: Array
    linear_diffusion: Any

    def __init__(self, diffusion: Any, key: Any, linear_diffusion: Any = None):
        self.diffusion, self.key = as_coefficient("diffusion", diffusion), as_key(key)
        self.linear_diffusion = (
            None if linear_diffusion is None else as_coefficient("linear_diffusion", linear_diffusion)
        )

    @property
    def keys(self) -> tuple[Any, ...]:
        return (self.key,)

    def prepared(self, body: Body, coefficients: Iterable[float], t: Array, h: Array, start: AnyState) -> PreparedBath:
        effects = eqx.Partial(self.effects, body.in_principal_axes(), {b: b * h for b in sorted(coefficients)})
        varies = callable(self.diffusion) or callable(self.linear_diffusion)
        return PreparedBath.of(words_of(self.key), effects if varies else effects(t), None, start)

    def effects(self, body: Body, times: dict[float, Array], t: Array) -> Any:
        linear = None if self.linear_diffusion is None else at(self.linear_diffusion, t)
        return {b: kicks(body, at(self.diffusion, t), linear, time) for b, time in times.items()}

    def check_numbers(self, name: str, shape: tuple[int, ...], state: AnyState, body: Any) -> None:
        known = hasattr(state, "attitude") or isinstance(body.turning, SymmetricRotor)
        if name == "diffusion" and shape and not known:
            raise ValueError(
                f"diffusion must be a number for a {type(state).__name__}, which has no attitude, got shape {shape}; "
                "use a RigidState."
            )
