"""A pair force to copy: rigid molecules of sites with charges and Lennard-Jones terms in a periodic box.

The energy of two sites at distance r < c, the cut-off, of different molecules and nearest images, is

    V = k q q' [erfc(a r)/r - erfc(a c)/c + (r - c) s] + 4 e [(d/r)^12 - (d/r)^6 - (d/c)^12 + (d/c)^6 + (r - c) g]

with s and g such that the force is zero at c, too: LAMMPS' `coul/dsf` and `lj/smooth/linear`. Units are nm, ps, amu and
kJ/mol. The list of neighbours is a leaf of the torque: a new list of the same size needs no new compilation.

What makes it fast on a CPU: one loop over all molecules for each slot of the list; no square root, division, `erfc` or
`exp` in it, but their polynomials; each pair computed twice, rather than a reaction written to another molecule.
"""

from math import erf, sqrt
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import midlie_jax as ml

from .neighbours import Neighbours

COULOMB = 138.935457644  # 1 / (4 pi epsilon_0), kJ/mol nm / e^2


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


class DampedPairs(ml.torques.Torque):
    """Torques and forces on equal molecules, (N, ...) in one state.

    Attributes:
        neighbours: their list.
        points: the sites of a molecule in its frame, (a, 3), in nm.
        charges, sigmas, epsilons: of the sites, in e, nm and kJ/mol, mixed by Lorentz' and Berthelot's rule.
        box: the edge of the cube, at least twice the cut-off.
        cutoff, damping: c in nm, a in 1/nm.
        single: whether the terms of pairs are computed in float32; the energy never is.
    """

    neighbours: Neighbours
    points: Array
    charges: tuple[float, ...] = eqx.field(static=True, converter=_floats)
    sigmas: tuple[float, ...] = eqx.field(static=True, converter=_floats)
    epsilons: tuple[float, ...] = eqx.field(static=True, converter=_floats)
    box: float = eqx.field(static=True)
    cutoff: float = eqx.field(static=True, default=0.9)
    damping: float = eqx.field(static=True, default=2.0)
    single: bool = eqx.field(static=True, default=False)

    def __call__(self, t: Any, state: Any) -> ml.torques.Wrench:
        sums = self._summed(state, self.single, with_energy=False)
        forces = jnp.stack([jnp.stack(site, axis=-1) for site in sums[:-1]], axis=1)
        return ml.molecules.wrench_on_sites(state, self.points, forces.astype(state.position.dtype))

    def potential(self, t: Any, state: Any) -> Array:
        return jnp.sum(self._summed(state, single=False, with_energy=True)[-1][0]) / 2  # a pair is in two lists

    def _summed(self, state: Any, single: bool, with_energy: bool) -> list[list[Array]]:
        """The components of the force on each site, and last the energy of each molecule; arrays of (N,)."""
        places = ml.molecules.sites(state, self.points)
        reach = self.neighbours.cutoff_now(places, self.cutoff)
        places = jnp.moveaxis(places / self.box, 0, -1)  # (a, 3, N) in units of the box
        if single:  # as whole numbers, whose differences wrap around as the box does
            places = jnp.floor(2.0**32 * (places % 1)).astype(jnp.int64).astype(jnp.int32)
        dtype = jnp.float32 if single else places.dtype
        sites, molecules = range(len(self.charges)), jnp.arange(places.shape[-1], dtype=jnp.int32)
        terms = {(p, q): self._pair(p, q, 8 if single else 14) for p in sites for q in sites}
        limit = (self.cutoff / self.box) ** 2

        @jax.checkpoint  # a reverse derivative computes a slot again, rather than keep its numbers
        def add(sums: Any, slot: Array) -> Any:
            sums, there, other = [list(site) for site in sums], places[:, :, slot], slot != molecules
            for (p, q), term in terms.items():
                d = [places[p, x] - there[q, x] for x in range(3)]
                d = [x.astype(dtype) * 2.0**-32 if single else x - jnp.round(x) for x in d]
                square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
                # At the cut-off force and energy are zero, and so they are for all that is set there.
                energy, factor = term(self.box**2 * jnp.where((square < limit) & other, square, limit))
                sums[p] = [total + factor * x for total, x in zip(sums[p], d, strict=True)]
                if with_energy:
                    sums[-1] = [sums[-1][0] + energy]
            return in_one_loop(sums)

        def add_two(sums: Any, slots: tuple[Array, Array]) -> tuple[Any, None]:
            two, nearest = slots
            return jax.lax.cond(nearest < reach, lambda s: add(add(s, two[0]), two[1]), lambda s: s, sums), None

        # A list that is too old has the reach NaN, and makes everything NaN.
        first = jnp.where(jnp.isnan(reach), reach, 0).astype(dtype) * jnp.ones(len(molecules), dtype)
        start = [[first] * 3 for _ in sites] + [[first] if with_energy else []]
        pairs = self.neighbours.slots.reshape(-1, 2, len(molecules)), self.neighbours.nearest[::2]
        *forces, energy = jax.lax.scan(add_two, start, pairs)[0]
        return [[self.box * x for x in site] for site in forces] + [energy]

    def _pair(self, p: int, q: int, degree: int) -> Any:
        """For a pair of sites, V and -V'(r)/r as a function of the square of r."""
        c, a = self.cutoff, self.damping
        charge = COULOMB * self.charges[p] * self.charges[q]
        sigma6, epsilon = ((self.sigmas[p] + self.sigmas[q]) / 2) ** 6, sqrt(self.epsilons[p] * self.epsilons[q])
        # erf(a r)/r is a polynomial in r^2, in whose powers V and -V'/r are sums over k of m_k r^(2k).
        erf_over_r = charge * fitted(lambda u: a * erf(a * sqrt(u)) / (a * sqrt(u)), c * c, degree)
        slope = 2 * np.arange(1, degree + 1) * erf_over_r[1:]
        twelve, six = 4 * epsilon * sigma6**2, 4 * epsilon * sigma6

        def at(square: Any, inverse: Any) -> tuple[Any, Any]:
            """Without the terms that are zero at the cut-off by subtraction."""
            per_square = inverse * inverse
            energy = charge * inverse - polynomial(erf_over_r, square)
            factor = charge * inverse * per_square + polynomial(slope, square)
            if epsilon > 0:
                sixth = per_square * per_square * per_square
                energy = energy + sixth * (twelve * sixth - six)
                factor = factor + sixth * per_square * (12 * twelve * sixth - 6 * six)
            return energy, factor

        at_cutoff = at(c * c, 1 / c)
        pull = c * at_cutoff[1]

        def shifted(square: Array) -> tuple[Array, Array]:
            inverse = inverse_root(square)
            energy, factor = at(square, inverse)
            return energy - at_cutoff[0] + (square * inverse - c) * pull, factor - pull * inverse

        return shifted


def fitted(function: Any, top: float, degree: int) -> np.ndarray:
    """The coefficients, lowest first, of a polynomial on [0, top]: exact at the zeros of a Chebyshev polynomial."""
    on_nodes = np.vectorize(function)
    fit = np.polynomial.Chebyshev.interpolate(on_nodes, degree, domain=[0, top])
    return fit.convert(kind=np.polynomial.Polynomial).coef


def polynomial(coefficients: np.ndarray, x: Any) -> Any:
    """Horner's scheme, written out."""
    value = float(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * x + float(coefficient)
    return value


@jax.custom_jvp
def inverse_root(x: Array) -> Array:
    """1/sqrt(x) from its bits: a guess to 3 %, and two Newton steps of higher order."""
    integer, magic = (jnp.int32, 0x5F375A86) if x.dtype == jnp.float32 else (jnp.int64, 0x5FE6EB50C7B537A9)
    bits = jnp.asarray(magic, integer) - (jax.lax.bitcast_convert_type(x, integer) >> 1)
    y = jax.lax.bitcast_convert_type(bits, x.dtype)
    e = 1 - x * (y * y)
    y = y * (1 + e * (0.5 + e * (0.375 + e * 0.3125)))
    e = 1 - x * (y * y)
    return y + y * (e * (0.5 + e * 0.375))


@inverse_root.defjvp
def _inverse_root_jvp(primals: Any, tangents: Any) -> Any:
    y = inverse_root(*primals)
    return y, -0.5 * y * y * y * tangents[0]


@jax.custom_jvp
def in_one_loop(arrays: Any) -> Any:
    """The arrays, unchanged. XLA's CPU compiler makes one loop of an operation only if it has many results.

    Such an operation is the reduction of many arrays at once, here of pairs of equal numbers to their second.
    """
    leaves, structure = jax.tree.flatten(arrays)
    twice = [jnp.broadcast_to(leaf, (2, *leaf.shape)) for leaf in leaves]
    zeros = [np.zeros((), leaf.dtype) for leaf in leaves]
    return structure.unflatten(jax.lax.reduce(twice, zeros, lambda first, second: second, (0,)))


@in_one_loop.defjvp
def _in_one_loop_jvp(primals: Any, tangents: Any) -> Any:
    """Forward derivatives are in one loop, too; for reverse ones, which JAX does not know, it is the identity."""
    same = jax.custom_derivatives.linear_call(lambda _, x: in_one_loop(x), lambda _, x: x, (), tangents[0])
    return in_one_loop(*primals), same
