"""Which parameters the data determine: the singular values of the Jacobian with columns of length one.

A column is the derivative of all residuals with respect to one unconstrained number. A combination of numbers that
changes no residual is a null vector of the Jacobian, and its parameters cannot be told apart.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from .parameters import InertiaTensor, Moments, Parameter, UnitQuaternion

_SHARE = 0.1  # a number belongs to a null vector if its entry is at least this share of the largest


class Spectrum(NamedTuple):
    """The singular value decomposition of a scaled Jacobian.

    Attributes:
        lengths: (p,), the lengths of the columns; one where a column is zero.
        singular: (p,), the singular values of the scaled Jacobian, descending.
        directions: (p, p), the right singular vectors, one in each row.
        determined: (p,), whether each singular value is distinct from rounding.
    """

    lengths: Float[Array, " p"]
    singular: Float[Array, " p"]
    directions: Float[Array, "p p"]
    determined: Bool[Array, " p"]

    @classmethod
    def of(cls, jacobian: Float[Array, "r p"]) -> "Spectrum":
        lengths = lengths_of(jacobian)
        _, singular, directions = jnp.linalg.svd(jacobian / lengths[None], full_matrices=False)
        smallest = jnp.finfo(jacobian.dtype).eps ** (2 / 3) * jnp.maximum(singular[0], jnp.ones_like(singular[0]))
        return cls(lengths, singular, directions, singular > smallest)

    @property
    def rank(self) -> Int[Array, ""]:
        """The number of combinations of parameters that the data determine."""
        return jnp.sum(self.determined)

    @property
    def condition(self) -> Float[Array, ""]:
        """The largest singular value over the smallest; infinite where the rank is not full."""
        infinite = jnp.full_like(self.singular[0], jnp.inf)
        last = jnp.where(self.determined[-1], self.singular[-1], jnp.ones_like(self.singular[-1]))
        return jnp.where(self.determined[-1], self.singular[0] / last, infinite)

    def covariance(self) -> Float[Array, "p p"]:
        """(J^T J)^-1 of the unconstrained numbers on the combinations that are determined; zero on the others."""
        inverse = jnp.where(self.determined, 1 / jnp.where(self.determined, self.singular, 1.0), 0.0)
        half = inverse[:, None] * self.directions / self.lengths[None]
        return half.T @ half

    def undetermined(self, slopes: Float[Array, "k p"]) -> Bool[Array, " k"]:
        """Which quantities change along a null vector, from their derivatives by the unconstrained numbers."""
        scaled = slopes / self.lengths[None]
        along = jnp.sum(jnp.where(self.determined[None], 0.0, (scaled @ self.directions.T) ** 2), axis=-1)
        whole = jnp.sum(scaled**2, axis=-1)
        return along > jnp.finfo(slopes.dtype).eps ** (2 / 3) * whole


def lengths_of(jacobian: Float[Array, "r p"]) -> Float[Array, " p"]:
    """The lengths of the columns, one where a column is zero."""
    lengths = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    return jnp.where(lengths == 0, jnp.ones_like(lengths), lengths)


def confounded(spectrum: Spectrum, names: Sequence[str], typical: Any = None) -> list[list[str]]:
    """The groups of numbers that cannot be told apart; a group of one name is a number without any effect.

    The null vectors span a space, and the choice of a basis is arbitrary. So the groups are found from the matrix that
    projects on this space: two numbers belong together if their common entry is not small relative to their diagonal
    entries. Numbers are measured in two ways: by how much they change the residuals, and in units of `typical`. If
    moments can change by a common factor, one of them may count little in the first way, but all count the same in the
    second.

    Args:
        spectrum: that of the Jacobian.
        names: (p,), the names of the numbers.
        typical: (p,), the sizes of changes that matter, see `Parameter.typical`; one if None.
    """
    null = np.asarray(spectrum.directions)[~np.asarray(spectrum.determined)]
    changes = null / np.asarray(spectrum.lengths) / (np.ones(len(names)) if typical is None else np.asarray(typical))
    together = _linked(null) | _linked(changes)
    groups: list[list[str]] = []
    left = list(np.flatnonzero(np.diagonal(together)))
    while left:
        group, waiting = set[int](), {int(left[0])}
        while waiting:
            i = waiting.pop()
            group.add(i)
            waiting |= {int(k) for k in np.flatnonzero(together[i])} - group
        groups.append([names[i] for i in sorted(group)])
        left = [i for i in left if i not in group]
    return groups


def _linked(vectors: np.ndarray) -> np.ndarray:
    """(p, p), which pairs of numbers belong together in the span of vectors (m, p); diagonal: which are in it."""
    basis = np.linalg.qr(vectors.T)[0]
    projection = basis @ basis.T
    own = np.sqrt(np.diagonal(projection))
    inside = own > _SHARE * max(own.max(initial=0.0), 0.1)
    return (np.abs(projection) > _SHARE * np.outer(own, own)) & np.outer(inside, inside)


def complaint(groups: list[list[str]], named: Sequence[tuple[str, Parameter]]) -> str:
    """For a message: what cannot be determined, and the cure; "" if everything is determined.

    Args:
        groups: from `confounded`.
        named: the parameters with their names, from `Layout.named`.
    """
    if not groups:
        return ""
    told = "; ".join(
        f"{group[0]} has no effect on them" if len(group) == 1 else f"{', '.join(group)} cannot be told apart"
        for group in groups
    )
    cures = dict.fromkeys(_cure(group, named) for group in groups)
    return f"the measurements do not determine all parameters: {told}. {' '.join(cures)}"


def _cure(group: list[str], named: Sequence[tuple[str, Parameter]]) -> str:
    inside = [(name, p) for name, p in named if any(f"{name}{label}" in group for label in p.unconstrained_labels())]
    attitudes = [name for name, p in inside if isinstance(p, UnitQuaternion)]
    if attitudes:
        return (
            f"Angular velocities say nothing of where a body points, and one direction in space leaves a turn about it "
            f"open. Fix {attitudes[0]}: make it a known quaternion inside the model; or, with one direction, start the "
            "model from a DirectionState whose direction is a UnitVector; or add Attitudes, Positions, or Directions "
            "with another reference."
        )
    if any(isinstance(p, Moments | InertiaTensor) and p.scale == "free" for _, p in inside):
        return (
            "Without a known torque that does not grow with the moments, data give their ratios only: fix the scale, "
            'such as Moments(..., scale="fixed"), and make the initial angular velocity a parameter instead of the '
            "momentum."
        )
    return "Make one of them a known number inside the model, or add measurements that depend on them differently."
