"""`ThermalField`: the random field of a heat bath on damped spins."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from .._math.normals import normals
from ..model.baths.base import Warm, words_of
from ..model.exposure import root_of
from ..model.state import AnyState
from .state import Spins
from .turns import turned


class ThermalField(Warm):
    """The heat bath of damped spins: a random field whose strength follows from temperature and damping.

    The argument `bath` of a run, for methods whose scheme has a bath stage, such as "SUBLATTICES[BAOAB]". The damping
    acts in the flights. The stage rotates each spin about a random axis, as Brownian motion on the sphere with the
    diffusion constant D = kT g alpha: `<S(t) . S(0)> = exp(-2 D t)` without a field. Averages have weak order 2. D h of
    a stage, for its part of the step, must be at most 1; above, the spins are NaN and `ok` is False. The random numbers
    depend only on the key, on the index of step and stage, and on the site of the spin.

    Attributes:
        kT: the temperature in units of energy, (), or a function of time t -> (). Not negative.
        key: a typed key, `jax.random.key(seed)`; (n,) for an ensemble.

    Raises:
        ValueError: a negative temperature, or a key that is not typed. When a run begins: spins without damping,
            several keys for one run, or a method without the stage.

    Examples:
        >>> up = ml.spins.SpinState(jnp.tile(jnp.array([0.0, 0.0, 1.0]), (100, 1)))
        >>> bath, damped = ml.spins.ThermalField(0.7, jax.random.key(0)), ml.spins.Spins(damping=0.5)
        >>> bool(ml.integrate("SUBLATTICES[BAOAB]", damped, None, up, dt=0.1, steps=20, bath=bath).ok)
        True
    """

    methods: ClassVar[str] = "SUBLATTICES[BAOAB]"

    def check_kind(self, state: AnyState, body: Any) -> None:
        if not isinstance(body, Spins):
            raise ValueError(f"ThermalField acts on spins, not on a {type(body).__name__}; use Langevin for bodies.")
        if body.damping is None:
            raise ValueError("ThermalField needs a damping, which sets its strength; use Spins(damping=...).")

    def on_spins(self, body: Spins, kind: Any, start: Any) -> "BathOfSpins":
        assert body.damping is not None
        shape = start.spin.shape[:-1]
        places = jnp.arange(int(np.prod(shape)), dtype=jnp.int32).reshape(*shape, 1)
        numbered, _ = kind.parts(start.unchecked(spin=jnp.broadcast_to(places, start.spin.shape)))
        member = cp.wrapped(numbered, lambda vector: vector[0])
        return BathOfSpins(self.root, words_of(self.key), (body.damping * body.rate).astype(start.spin.dtype), member)


class BathOfSpins(NamedTuple):
    """A `ThermalField`, prepared for the steps of a run."""

    root: Callable[[Any], Array]  # sqrt(kT) as a function of time
    key: tuple[Array, ...]  # in words
    mobility: Array  # g alpha
    member: Any  # the site of each spin, in the form of the components of the spins
    step: Array | None = None

    def turned(self, h: Array, t: Array, stage: int, spin: Any) -> Any:
        """The spins after the time h, rotated by three normal numbers of variance 2 D h (1 - D h / 6).

        The mean of every spherical harmonic of the spin then agrees with Brownian motion up to h^3, unless D h > 1.
        """
        spread = self.mobility * h * self.root(t) ** 2
        size = root_of(2 * spread * jnp.where(spread <= 1, 1 - spread / 6, jnp.nan))

        def one(member: Array, spin: cp.Vector) -> cp.Vector:
            assert self.step is not None
            x, y, z = normals(self.key, (self.step, stage, member), 3, self.mobility.dtype)
            return turned(spin, cp.scale(size, (x, y, z)))

        return jax.tree.map(one, self.member, spin)
