"""`Sublattices`: one sublattice after the other rotates in the field of the others, which are held fixed.

The field is then constant and each spin rotates about it by a known angle (Frank, Huang and Leimkuhler, J. Comput.
Phys. 133, 1997, 160; Krech, Bunker and Landau, Comput. Phys. Commun. 111, 1998, 1). The method conserves the energy of
fields that are linear in the spin and phase-space volume. It is not symplectic.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._math import components as cp
from .._xla.fusion import split
from .._xla.structure import once_for_numbers
from ..integrators.base import Method
from ..integrators.scheme import BATH as BATH
from ..integrators.scheme import KICK as KICK
from ..integrators.scheme import Scheme
from ..integrators.system import AnyMotion, Motion, System
from ..model.bodies import Body
from ..model.state import AnyState
from ..model.torques import kept_terms, on_body, terms_of
from ..model.torques.by_step import is_by_step
from ..model.torques.reads_body import without_bath
from .checkered import Checkered, CheckeredSpins, can_be_checkered
from .fields import Anisotropy, AppliedField, NeighbourField, OwnField, SpinField, in_dtype_of
from .state import Spins, SpinState, checkerboard
from .thermal_field import ThermalField
from .turns import damped, turned, turned_by_own, unit

CLOCK, OWN = "clock", "own"


class OnSublattices(eqx.Module):
    """The spins of a run."""

    spins: Spins
    labels: Any  # the sublattice of each spin, (*lattice), if spins are selected by it, or None
    count: int = eqx.field(static=True)
    own: tuple[OwnField, ...]  # fields of spins on themselves
    terms: tuple[Any, ...]  # other fields
    checkered: Checkered | None  # the neighbour tables, if the sublattices of a checkerboard are separate arrays


class Sublattices(Method):
    """SUBLATTICES[SCHEME]: rotations of sublattices in the order and with the coefficients of a scheme.

    Two sublattices replace the kicks and the flights of the scheme. More sublattices, and fields of spins on
    themselves, are nested: every table for two parts is a sequence of first-order steps and their adjoints, which
    extend to any number of parts (McLachlan, SIAM J. Sci. Comput. 16, 1995, 151).

    Attributes:
        scheme: a table without gradients. Composed tables (TJ4, S4, Y6, KL6, SU8, KL8) keep their order; others reach
            at most 4, because their higher orders require a property of kicks that sublattices lack.
    """

    scheme: Scheme = eqx.field(static=True)
    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    symmetric: bool = eqx.field(static=True)
    symplectic: bool = eqx.field(static=True)
    keeps_momentum: bool = eqx.field(static=True)
    bodies: type = eqx.field(static=True)
    evaluations: int = eqx.field(static=True)

    def __init__(self, scheme: Scheme):
        if scheme.gradients:
            raise ValueError(f"scheme {scheme.name!r} uses gradients of forces; choose another, as SRKN6b or KL6.")
        self.scheme = scheme.merged()
        self.name = f"SUBLATTICES[{scheme.name}]"
        self.order = order_of_parts(scheme)
        self.symmetric = scheme.symmetric
        self.symplectic = self.keeps_momentum = False
        self.bodies = Spins
        self.evaluations = sum(kind != BATH for kind, _ in self.scheme.stages) - self.scheme.reuses_force

    @property
    def random(self) -> bool:
        return self.scheme.random

    @property
    def is_divided(self) -> bool:
        return True

    def keeps_force(self, system: System) -> bool:
        """Whether the first sublattice's field at the end of a step is kept: it is constant during its rotation."""
        reused = self.scheme.reuses_force and not self.random
        return system.keeps_torque and reused and system.inertia.checkered is None

    def check(self, body: Any, torque: Any, start: Any, batch: int) -> None:
        """Raises unless the fields come from other sublattices, or have a known closed form."""
        lattice, dtype = start.spin.shape[batch:-1], start.spin.dtype
        rest, _ = without_bath(torque)
        terms = terms_of(rest)
        for term in terms if body.damping is not None else ():
            if isinstance(term, OwnField) and not isinstance(term, Anisotropy) and term.linear is None:
                raise ValueError(
                    f"a damped spin under {type(term).__name__} has no closed form; use the method 'spherical "
                    "midpoint', or leave out damping or this field."
                )
        count = _count(body, terms, lattice)
        for term in terms:
            if isinstance(term, NeighbourField):
                once_for_numbers(_check_neighbours, term, body, lattice)
            elif not isinstance(term, OwnField | AppliedField):
                once_for_numbers(_check_function, term, body, lattice, count, str(dtype), not batch)

    def system(self, body: Body, torque: Any, start: AnyState, t: Array, h: Array) -> System:
        assert isinstance(body, Spins)
        rest, bath = without_bath(torque)
        terms = terms_of(rest)
        own = tuple(term for term in terms if isinstance(term, OwnField))
        others = kept_terms(rest, lambda term: not isinstance(term, OwnField))
        system = System.of(body, others, start, t)
        # Library fields are sums over neighbours, which fuse with the rotation; any other function is evaluated
        # separately.
        costly = not all(isinstance(term, SpinField) for term in terms)
        lattice = start.momentum.shape[:-1]
        checkered = Checkered.of(lattice) if can_be_checkered(body, terms, lattice, t) else None
        count = _count(body, terms, lattice)
        labels = _labels(body, lattice) if count > 1 and checkered is None else None
        inertia = OnSublattices(body, labels, count, own, tuple(terms_of(others)), checkered)
        system = system._replace(inertia=inertia, placement=system.placement.if_costly(costly))
        if checkered is not None:
            system = system._replace(kind=CheckeredSpins(SpinState, SpinState.leaves, lattice))
        if self.random:
            assert isinstance(bath, ThermalField)
            bath.check_on(start, body)
            system = system._replace(bath=(bath.on_spins(body, system.kind, start),))
        return system._replace(by_step=is_by_step(rest))

    def loops_for(self, system: System) -> bool:
        """Whether the step is a loop over its stages, which holds two copies of the field instead of many."""
        return self.scheme.alternates and self.scheme.flights > 1 and system.torque is not None

    def step(
        self, system: System, t0: Array, t1: Array, h: Array, motion: AnyMotion, force: Any
    ) -> tuple[AnyMotion, Any, Array | bool]:
        parts = _Parts.of(system)
        take = self._step_in_loop if self.loops_for(system) else self._step_unrolled
        spin = motion.momentum
        if system.inertia.spins.damping is not None:
            # The closed forms of damping hold for unit vectors. Opposite to the field they amplify an error of length
            # faster than the spin leaves that direction, so rounding errors would grow without bound.
            spin = split(unit(spin) if system.inertia.checkered is None else tuple(map(unit, spin)))
        spin, known = take(parts, system, t0, t1, h, spin, force)
        if system.inertia.spins.damping is not None:  # a step of length zero changes no length
            spin = jax.tree.map(lambda old, new: jnp.where(h == 0, old, new), motion.momentum, split(spin))
        return Motion(spin, ()), known if self.keeps_force(system) else None, True

    def _step_unrolled(
        self, parts: "_Parts", system: System, t0: Array, t1: Array, h: Array, spin: Any, known: Any
    ) -> tuple[Any, Any]:
        """The spins after a step; `known` is the field on the first sublattice until another rotates."""
        elapsed, baths = 0.0, 0
        for number, coefficient in word(self.scheme, len(parts.names)):
            t = t0 if elapsed == 0 else t1 if abs(elapsed - 1) < 1e-12 else t0 + elapsed * h
            known = known if number == 0 else None
            if isinstance(number, str):
                bath: Any = system.bath
                spin = split(bath[0].turned(coefficient * h, t, baths, spin))
                baths += 1
            elif parts.names[number] == CLOCK:
                elapsed += coefficient
            else:
                spin, known = parts.turn(number, coefficient * h, t, spin, known)
        return spin, known

    def _step_in_loop(
        self, parts: "_Parts", system: System, t0: Array, t1: Array, h: Array, spin: Any, known: Any
    ) -> tuple[Any, Any]:
        """`_step_unrolled` as a loop of steps X and adjoint steps X* of `word`, without the last rotation of X*."""
        first, last = 0, len(parts.names) - 1
        middle = [*range(1, last)]
        if self.scheme.stages[0][0] != KICK:
            first, last, middle = last, first, middle[::-1]
        *rows, end = rows_of_loop(self.scheme)

        def through(order: list[int], a: Array, before: Array, after: Array, spin: Any) -> Any:
            t = before
            for number in order:
                if parts.names[number] == CLOCK:
                    t = after
                else:
                    spin, _ = parts.turn(number, a * h, t, spin, None)
            return spin

        def time(c: Array) -> Array:
            return jnp.where(c == 0, t0, jnp.where(c == 1, t1, t0 + c * h))

        def iteration(carry: Any, row: tuple[Array, ...]) -> tuple[Any, None]:
            spin, field = carry
            outer, forth, inner, back, *times = row
            begin, between, after = map(time, times)
            spin, _ = parts.turn(first, outer * h, begin, spin, field)
            spin = through(middle, forth, begin, between, spin)
            spin, _ = parts.turn(last, inner * h, between, spin, None)
            spin = through(middle[::-1], back, between, after, spin)
            return (spin, split(parts.field(first, after, spin))), None

        known = parts.field(first, t0, spin) if known is None else known
        columns = tuple(jnp.asarray(x, h.dtype) for x in zip(*rows, strict=True))
        (spin, known), _ = jax.lax.scan(iteration, (spin, known), columns)
        spin, _ = parts.turn(first, end[0] * h, t1, spin, known)
        return spin, known


class _Parts(eqx.Module):
    """The parts of a step, which rotate in turn: a sublattice, CLOCK, or an axis of a field of spins on themselves."""

    names: tuple[Any, ...]
    own: list[tuple[OwnField, Any]]
    system: System

    @classmethod
    def of(cls, system: System) -> "_Parts":
        on: OnSublattices = system.inertia
        own = [(term, axis) for term in on.own for axis in term.axes()]
        sublattices = [*range(on.count)] if system.torque is not None else []
        names = *sublattices[:1], CLOCK, *((OWN, i) for i in range(len(own))), *sublattices[1:]
        return cls(names, own, system)

    def field(self, number: int, t: Array, spin: Any) -> Any:
        name, checkered = self.names[number], self.system.inertia.checkered
        if not isinstance(name, int):
            return None
        if checkered is not None:
            return checkered.field(self.system, name, t, spin)
        return self.system.force(t, Motion(spin, ()))

    def turn(self, number: int, time: Array, t: Array, spin: Any, field: Any) -> tuple[Any, Any]:
        name, on = self.names[number], self.system.inertia
        if isinstance(name, tuple):
            own = partial(_own_turn, on.spins, *self.own[name[1]], time)
            return own(spin) if on.checkered is None else tuple(map(own, spin)), None
        if name == CLOCK:
            return spin, None
        field = self.field(number, t, spin) if field is None else field
        if on.checkered is not None:
            moved = split(_turn(on.spins, field, time, spin[name], None))
            return (moved, spin[1]) if name == 0 else (spin[0], moved), field
        mask = None if on.labels is None else jnp.asarray(on.labels) == name
        return split(_turn(on.spins, field, time, spin, mask)), field


def _turn(spins: Spins, field: cp.Vector, time: Array, spin: cp.Vector, mask: Any) -> cp.Vector:
    moved = turned(spin, cp.scale(spins.rate * time, field))
    if spins.damping is not None:
        moved = damped(moved, field, spins.damping * spins.rate * time)
    return moved if mask is None else cp.where(mask, moved, spin)


def _own_turn(spins: Spins, term: OwnField, axis: Any, time: Array, spin: cp.Vector) -> cp.Vector:
    axis = in_dtype_of(spin, axis)
    if spins.damping is not None:
        assert term.linear is not None
        return turned_by_own(spin, axis, term.linear * spins.rate, time, spins.damping)
    angle = spins.rate * time * term.along(cp.dot(axis, spin))
    return turned(spin, cp.scale(angle, axis))


def _count(body: Any, terms: list[Any], lattice: tuple[int, ...]) -> int:
    if body.sublattices is not None:
        if body.sublattices.shape != lattice:
            raise ValueError(f"sublattices must have the shape {lattice} of the lattice, got {body.sublattices.shape}.")
        return body.count
    alone = all(isinstance(term, SpinField) and not isinstance(term, NeighbourField) for term in terms)
    return 1 if alone or not lattice else 2


def _labels(body: Any, lattice: tuple[int, ...]) -> Any:
    return checkerboard(lattice).astype(np.int8) if body.sublattices is None else body.sublattices


def _check_neighbours(term: NeighbourField, body: Spins, lattice: tuple[int, ...]) -> None:
    if cp.is_traced(body.sublattices):
        return
    for axis, size in enumerate(lattice):
        odd = term.closes(axis) and size % 2 == 1
        if odd if body.sublattices is None else _have_same(np.asarray(body.sublattices), axis, term.closes(axis)):
            where = f"axis {axis}, which is periodic with an odd number of {size} sites" if odd else f"axis {axis}"
            raise ValueError(
                f"{type(term).__name__} acts between spins of one sublattice along {where}; give "
                "Spins(sublattices=...) with different neighbours, or use the method 'spherical "
                "midpoint'."
            )


def _have_same(labels: np.ndarray, axis: int, closes: bool) -> bool:
    same = labels == np.roll(labels, -1, axis)
    return bool(np.any(same if closes else np.delete(same, -1, axis)))


def _check_function(term: Any, body: Spins, lattice: tuple[int, ...], count: int, dtype: str, one: bool) -> None:
    """Raises if, at random spins, a custom field depends on spins of the sublattice on which it acts.

    `one` is whether the function belongs to one lattice; otherwise its parameters may have a row for each.
    """
    field = on_body(term, body)
    if cp.is_traced(*jax.tree.leaves(field), body.sublattices):
        return
    drawn = np.random.default_rng(0).normal(size=(2, *lattice, 3)).astype(dtype)
    spin = drawn[0] / np.linalg.norm(drawn[0], axis=-1, keepdims=True)
    numbers = np.zeros(lattice, np.int8) if count == 1 else np.asarray(_labels(body, lattice))
    eps, time = np.finfo(dtype).eps, jnp.zeros((), dtype)
    for number in range(count):
        here = numbers == number
        tangent = jnp.asarray(np.where(here[..., None], drawn[1], 0))
        try:
            value, change = jax.jvp(
                lambda x: field(time, SpinState.unchecked(spin=x)), (jnp.asarray(spin),), (tangent,)
            )
        except (TypeError, ValueError):
            if one:
                raise
            return  # its parameters have a row for each lattice
        if value.shape != spin.shape or cp.is_traced(value, change):
            return  # the run raises; or the function holds unknown numbers
        if np.any(np.abs(np.asarray(change)[here]) > 64 * eps * (1 + np.abs(np.asarray(value)).max())):
            raise ValueError(
                f"the field depends on spins of sublattice {number}, on which it acts; give "
                "Spins(sublattices=...) without such interactions, or use the method 'spherical "
                "midpoint'."
            )


_LARGEST_GENERAL_ORDER = 4
_ROUNDING = 1e-14


def order_of_parts(scheme: Scheme) -> int:
    """The order of a table for parts that are not kicks, whose commutator [K, [K, [K, F]]] is not zero.

    It is of fourth order, and its terms cancel in a symmetric table.
    """
    if scheme.composed:
        return scheme.order
    return min(scheme.order, _LARGEST_GENERAL_ORDER if scheme.symmetric or scheme.random else 3)


def word(scheme: Scheme, count: int) -> list[tuple[int | str, float]]:
    """The rotations of a step: pairs of the number of a part, counted from 0, or of BATH, and its coefficient.

    The kicks of the scheme are the first part and its flights the last; with one part, flights are skipped.
    """
    if count == 1:
        return [(kind if kind == BATH else 0, c) for kind, c in scheme.stages if kind in (KICK, BATH)]
    turns: list[tuple[int | str, float]] = []
    begun = 0.0  # the coefficient of the step X or X* whose first end part has acted

    def between(coefficient: float, backwards: bool) -> None:
        if abs(coefficient) > _ROUNDING:
            middle = range(1, count - 1)
            turns.extend((part, coefficient) for part in (reversed(middle) if backwards else middle))

    for kind, coefficient in scheme.stages:
        if kind == BATH:
            turns.append((BATH, coefficient))
            continue
        first = kind == KICK
        turns.append((0 if first else count - 1, coefficient))
        begun = coefficient - begun
        between(begun, backwards=not first)
    return turns


def rows_of_loop(scheme: Scheme) -> list[tuple[float, ...]]:
    """An alternating scheme as a loop: rows of the coefficients of the outer part, X, the inner part and X*, and times.

    The times, in steps, are before X, between X and X*, and after X*. The last row has only the coefficient of the
    outer part that ends the step.
    """
    coefficients = [c for _, c in scheme.stages]
    rows: list[tuple[float, ...]] = []
    begun, elapsed = 0.0, 0.0
    for outer, inner in zip(coefficients[0:-1:2], coefficients[1::2], strict=True):
        forth = outer - begun
        begun = inner - forth
        between, after = elapsed + forth, elapsed + forth + begun
        rows.append((outer, forth, inner, begun, elapsed, between, after))
        elapsed = after
    last = (*rows[-1][:-1], 1.0)  # rounded coefficients do not sum exactly to 1
    return [*rows[:-1], last, (coefficients[-1],)]
