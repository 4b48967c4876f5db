"""`PairForces`: forces between the sites of equal molecules in a periodic box.

The energy of two sites at distance r below the cut-off c, of different molecules and nearest images, is

    V = k q q' [erfc(a r)/r - erfc(a c)/c + (r - c) s] + 4 e [(d/r)^12 - (d/r)^6 - (d/c)^12 + (d/c)^6 + (r - c) g]

with s and g such that the force is zero at c, too: the damped, shifted Coulomb force of C. J. Fennell and J. D.
Gezelter, J. Chem. Phys. 124 (2006) 234104, and a shifted Lennard-Jones force (`coul/dsf` and `lj/smooth/linear` of
LAMMPS). A function for other energies is shifted in the same way.

One loop over all molecules for each slot of the list makes it fast on a CPU. The loop has no square root, division,
`erfc` or `exp`, only polynomials, unless the damping is strong. Each pair is computed twice, which avoids writes to
another molecule.
"""

from collections.abc import Callable
from math import erf, pi, sqrt
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from .._checks.arguments import as_floats
from .._math import components as cp
from .._xla.fusion import split
from ..model.free_body import Wrench
from ..model.state import Time
from ..model.torques.base import Torque
from .neighbours import Neighbours
from .points import sites, wrench_on_sites

_COULOMB = 138.935457644  # 1 / (4 pi epsilon_0), kJ/mol nm / e^2
# Beyond these products of damping and cut-off a polynomial for erf loses too many digits.
_SCREENED, _SCREENED_SINGLE = 4.5, 3.0
_filter_jit: Any = eqx.filter_jit  # its annotations lack the options of `jax.jit`
Term = Callable[[Array], tuple[Array, Array]]


class PairForces(Torque):
    """Lennard-Jones, Coulomb and custom forces between the sites of equal molecules in a periodic box.

    Units are nm, ps, amu, kJ/mol and e, or any consistent units with another `coulomb`. Energy and force are shifted to
    zero at the cut-off. The state is a `CoupledState`, or a `CoupledFreeAxisState` for linear molecules.

    `midlie_jax.molecules.integrate` keeps the list of neighbours up to date. In other drivers, and for derivatives, use
    `forces.listed(start)`, whose list holds until a site has moved by half the skin; then the run is not `ok`.

    Attributes:
        points: the sites of a molecule in its principal frame, (a, 3).
        box: the edges of the box, three numbers, or one for a cube; each at least twice the cut-off.
        cutoff: the distance c at which forces end.
        charges: of the sites, a numbers; by default zero.
        sigmas, epsilons: Lennard-Jones diameter and depth of the sites, a numbers each, combined by the rule of Lorentz
            and Berthelot; by default zero.
        damping: a of the Coulomb force, 1/length. Zero leaves the Coulomb force shifted only. The force is slower if
            a c is above 4.5, or 3 if `single`.
        coulomb: 1/(4 pi epsilon_0).
        energy: None, or another energy of sites p and q, a function of (p, q, r) with arrays r of distances.
        single: whether the terms of pairs are computed in float32, in about two thirds of the time. The energy is not.
        neighbours: the list, or None.

    Raises:
        ValueError: a number of charges, sigmas or epsilons differs from the number of points, the box is
            shorter than twice the cut-off, or, when called, there is no list.

    Examples:
        >>> argon = ml.molecules.PairForces([[0.0, 0.0, 0.0]], box=3.0, cutoff=1.0, sigmas=[0.34], epsilons=[0.996])
        >>> still = jnp.zeros((2, 3))
        >>> pair = ml.CoupledState(still, jnp.tile(jnp.array([1.0, 0, 0, 0]), (2, 1)), still, still.at[1, 0].set(0.4))
        >>> argon.listed(pair)(0.0, pair).force[:, 0].round(3)  # 5.54 without the shift
        Array([ 5.501, -5.501], dtype=float64)
    """

    points: Float[Array, "points 3"]
    box: tuple[float, float, float] = eqx.field(static=True)
    cutoff: float = eqx.field(static=True)
    charges: tuple[float, ...] = eqx.field(static=True)
    sigmas: tuple[float, ...] = eqx.field(static=True)
    epsilons: tuple[float, ...] = eqx.field(static=True)
    damping: float = eqx.field(static=True)
    coulomb: float = eqx.field(static=True)
    energy: Callable[[int, int, Array], Array] | None = eqx.field(static=True)
    single: bool = eqx.field(static=True)
    neighbours: Neighbours | None

    def __init__(
        self,
        points: Any,
        *,
        box: Any,
        cutoff: float,
        charges: Any = None,
        sigmas: Any = None,
        epsilons: Any = None,
        damping: float = 2.0,
        coulomb: float = _COULOMB,
        energy: Callable[[int, int, Array], Array] | None = None,
        single: bool = False,
        neighbours: Neighbours | None = None,
    ):
        self.points = as_floats("points", points)
        self.charges, self.sigmas, self.epsilons = (
            _of_points(name, value, len(self.points))
            for name, value in (("charges", charges), ("sigmas", sigmas), ("epsilons", epsilons))
        )
        x, y, z = (float(edge) for edge in np.broadcast_to(np.asarray(box, float), (3,)))
        self.box, self.cutoff, self.damping, self.coulomb = (x, y, z), float(cutoff), float(damping), float(coulomb)
        self.energy, self.single, self.neighbours = energy, single, neighbours
        if not 0 < 2 * self.cutoff <= min(self.box):
            raise ValueError(f"box must be at least twice the cut-off {cutoff:g}, got {self.box}. Take more molecules.")

    def listed(self, state: Any, *, skin: float = 0.2, slots: int = 0) -> "PairForces":
        """The forces with the neighbours of this state.

        Args:
            state: N molecules.
            skin: the distance beyond the cut-off up to which neighbours are listed.
            slots: the least number of slots; lists of one shape need one compilation.
        """
        _check(state)
        near = Neighbours.of(sites(state, self.points), self.box, self.cutoff + skin, slots)
        return eqx.tree_at(lambda f: f.neighbours, self, near, is_leaf=lambda x: x is None)

    def __call__(self, t: Time, state: Any) -> Wrench:
        forces, _ = self._sums(state, self.single, with_energy=False)
        edge, dtype = self.box[0], state.position.dtype
        wrench = wrench_on_sites(state, self.points / edge, _on_sites(forces).astype(dtype))
        return Wrench(wrench.torque, wrench.force / edge)

    def potential(self, t: Time, state: Any) -> Array:
        _, (energy, _) = self._sums(state, single=False, with_energy=True)
        return jnp.sum(energy) / 2  # a pair is in two lists

    def virial(self, t: Time, state: Any) -> Array:
        """The sum over pairs of molecules of force times distance of the centres of mass, energy."""
        forces, (_, virial) = self._sums(state, single=False, with_energy=True)
        arms = sites(state, self.points) - state.position[:, None]
        return jnp.sum(virial) / 2 - jnp.sum(_on_sites(forces) * (arms / self.box[0]))

    def _sums(self, state: Any, single: bool, with_energy: bool) -> tuple[list[list[Array]], list[Array]]:
        """The force on each site times the first edge by component, and energy and virial of each molecule; (N,)."""
        _check(state)
        if self.neighbours is None:
            raise ValueError("PairForces need a list of neighbours; use molecules.integrate, or forces.listed(start).")
        return _sums(self, sites(state, self.points), single, with_energy)


def _summed(
    forces: PairForces, places: Array, single: bool, with_energy: bool
) -> tuple[list[list[Array]], list[Array]]:
    neighbours: Any = forces.neighbours
    reach = neighbours.reach_now(places, forces.cutoff)
    edge, ratios = forces.box[0], tuple(length / forces.box[0] for length in forces.box)
    scaled = jnp.moveaxis(places / np.asarray(forces.box, places.dtype)[None, None, :], 0, -1)  # (a, 3, N)
    whole: Any = None
    if single:  # whole numbers, whose differences wrap around as the box does
        whole = scaled - jnp.round(scaled)
        whole = (2.0**32 * jnp.minimum(whole, 0.5 - 2.0**-24)).astype(jnp.int32)
    dtype, molecules = jnp.float32 if single else places.dtype, jnp.arange(places.shape[0], dtype=jnp.int32)
    terms = _terms(forces, single)

    @jax.checkpoint  # a reverse derivative computes a slot again instead of keeping its numbers
    def add(sums: Any, slot: Array) -> Any:
        (on_sites, totals), there, other = sums, scaled[:, :, slot], slot != molecules
        there_whole: Any = whole[:, :, slot] if single else None
        on_sites = [list(force) for force in on_sites]
        for (p, q), term in terms.items():
            if single:
                way = [_apart(whole[p, x], there_whole[q, x], scaled[p, x], there[q, x]) for x in range(3)]
            else:
                way = [scaled[p, x] - there[q, x] for x in range(3)]
                way = [x - jnp.round(x) for x in way]
            way = [x if ratio == 1 else ratio * x for x, ratio in zip(way, ratios, strict=True)]
            square = (edge / forces.cutoff) ** 2 * (way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
            # At the cut-off force and energy are zero, and so they are for all pairs that are set there.
            square = jnp.where((square < 1) & other, square, 1)
            energy, factor = term(square)
            on_sites[p] = [total + factor * x for total, x in zip(on_sites[p], way, strict=True)]
            if with_energy:
                totals = [totals[0] + energy, totals[1] + factor * square]
        return split((on_sites, totals))

    def add_two(sums: Any, slots: tuple[Array, Array]) -> tuple[Any, None]:
        two, nearest = slots
        return jax.lax.cond(nearest < reach, lambda s: add(add(s, two[0]), two[1]), lambda s: s, sums), None

    # A list that is too old has the reach NaN, and makes everything NaN.
    first = jnp.where(jnp.isnan(reach), reach, 0).astype(dtype) * jnp.ones(len(molecules), dtype)
    start = [[first] * 3 for _ in forces.charges], [first, first] if with_energy else []
    pairs = neighbours.slots.reshape(-1, 2, len(molecules)), neighbours.nearest[::2]
    on_sites, totals = jax.lax.scan(add_two, start, pairs)[0]
    return [[(edge / forces.cutoff) ** 2 * x for x in force] for force in on_sites], totals


def _terms(forces: PairForces, single: bool) -> dict[tuple[int, int], Term]:
    indices = range(len(forces.charges))
    terms = {(p, q): _term(forces, p, q, single) for p in indices for q in indices}
    return {pair: term for pair, term in terms.items() if term is not None}


def _term(forces: PairForces, p: int, q: int, single: bool) -> Term | None:
    """For a pair of sites, V and -V'(x)/x as a function of x^2, with x = r/c; None if both are zero."""
    own: Any = forces.energy
    c, a = forces.cutoff, forces.damping * forces.cutoff
    charge = forces.coulomb * forces.charges[p] * forces.charges[q] / c
    sixth = ((forces.sigmas[p] + forces.sigmas[q]) / 2 / c) ** 6
    epsilon = sqrt(forces.epsilons[p]) * sqrt(forces.epsilons[q])
    twelve, six = 4 * epsilon * sixth**2, 4 * epsilon * sixth
    if charge == 0 and six == 0 and own is None:
        return None
    # erf(a x)/x is a polynomial in x^2, in whose powers V and -V'/x are sums over k of m_k x^(2k).
    fitted = a <= (_SCREENED_SINGLE if single else _SCREENED)
    degree = round(8 + 4 * max(0, a - 1.8) if single else 14 + 7 * max(0, a - 2.4))
    erf_over_x = np.zeros(3)
    if a and fitted:
        erf_over_x = charge * _fitted(lambda u: a * erf(a * sqrt(u)) / (a * sqrt(u)), degree)
    energies = tuple(erf_over_x.tolist())
    slopes = tuple((2 * np.arange(1, len(erf_over_x)) * erf_over_x[1:]).tolist())

    def at(square: Any, inverse: Any) -> tuple[Any, Any]:
        """Without the terms that are zero at the cut-off by subtraction."""
        per_square = inverse * inverse
        energy = factor = 0 * square
        if charge and not fitted:
            screened = inverse * jax.lax.erfc(a * square * inverse)
            energy = charge * screened
            factor = charge * per_square * (screened + 2 * a / sqrt(pi) * jnp.exp(-a * a * square))
        elif charge:
            energy = charge * inverse - cp.polynomial(energies, square)
            factor = charge * inverse * per_square + cp.polynomial(slopes, square)
        if six:
            per_sixth = per_square * per_square * per_square
            energy = energy + per_sixth * (twelve * per_sixth - six)
            factor = factor + per_sixth * per_square * (12 * twelve * per_sixth - 6 * six)
        if own is not None:
            r = c * square * inverse
            value, slope = jax.jvp(lambda r: jnp.asarray(own(p, q, r)).astype(r.dtype), (r,), (jnp.full_like(r, c),))
            energy, factor = energy + value, factor - slope * inverse
        return energy, factor

    def shifted(square: Array) -> tuple[Array, Array]:
        inverse, one = _inverse_root(square), jnp.ones((), square.dtype)
        (energy, factor), (energy_at_c, pull) = at(square, inverse), at(one, one)
        return energy - energy_at_c + (square * inverse - 1) * pull, factor - pull * inverse

    return shifted


def _check(state: Any) -> None:
    if not state.several or state.momentum.ndim != 2:
        raise ValueError(
            f"state must be of the molecules of one box, with momenta (N, 3), got a {type(state).__name__} with "
            f"{state.momentum.shape}. Leave out OnEach; list each box alone."
        )


_sums = _filter_jit(_summed, inline=True)  # traced once for all forces of a step


def _of_points(name: str, values: Any, count: int) -> tuple[float, ...]:
    found = np.atleast_1d(np.zeros(count) if values is None else np.asarray(values, float))
    if found.shape != (count,):
        raise ValueError(f"{name} must be {count} numbers, one for each point, got {found.size}.")
    if not np.all(np.isfinite(found)) or (name != "charges" and np.any(found < 0)):
        raise ValueError(f"{name} must be finite and, unless charges, not negative, got {found}. Check the signs.")
    return tuple(found.tolist())


def _on_sites(forces: list[list[Array]]) -> Array:
    return jnp.stack([jnp.stack(force, axis=-1) for force in forces], axis=1)


def _fitted(function: Callable[[float], float], degree: int) -> np.ndarray:
    """The coefficients, lowest first, of a polynomial on [0, 1]: exact at the zeros of a Chebyshev polynomial."""
    fit = np.polynomial.Chebyshev.interpolate(np.vectorize(function), degree, domain=[0, 1])
    return fit.convert(kind=np.polynomial.Polynomial).coef


@jax.custom_jvp
def _apart(whole: Array, other_whole: Array, place: Array, other: Array) -> Array:
    """The difference of places from whole numbers, whose derivative would be zero; in float32."""
    return (whole - other_whole).astype(jnp.float32) * 2.0**-32


@_apart.defjvp
def _apart_jvp(primals: Any, tangents: Any) -> Any:
    return _apart(*primals), (tangents[2] - tangents[3]).astype(jnp.float32)


@jax.custom_jvp
def _inverse_root(x: Array) -> Array:
    """1/sqrt(x) from its bits: a guess to 3 %, and two Newton steps of higher order."""
    integer, magic = (jnp.int32, 0x5F375A86) if x.dtype == jnp.float32 else (jnp.int64, 0x5FE6EB50C7B537A9)
    bits = jnp.asarray(magic, integer) - (jax.lax.bitcast_convert_type(x, integer) >> 1)
    y = jax.lax.bitcast_convert_type(bits, x.dtype)
    e = 1 - x * (y * y)
    y = y * (1 + e * (0.5 + e * (0.375 + e * 0.3125)))
    e = 1 - x * (y * y)
    return y + y * (e * (0.5 + e * 0.375))


@_inverse_root.defjvp
def _inverse_root_jvp(primals: Any, tangents: Any) -> Any:
    y = _inverse_root(*primals)
    return y, -0.5 * y * y * y * tangents[0]
