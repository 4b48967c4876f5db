"""The part of `make fuzz` for parameters of a torque that have one row for each body, or are the same for all.

A torque is drawn as a sum of terms, each with parameters of random shapes that are shared or not; the sizes often agree
by chance. `ensemble` must give each body the parameters that were meant, or refuse to choose.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

import midlie_jax as ml
from midlie_jax.drivers.ensemble import as_batch

SIZES = (1, 2, 3, 4, 5, 8)
# For each term: the shapes of its parameters, "m" being the length of a table, and the term itself.
TERMS = {
    "scaled": (((),), lambda p, t, state: p[0] * state.momentum),
    "drag": (((3,),), lambda p, t, state: -p[0] * state.momentum),
    "field": (((3,), (3,)), lambda p, t, state: jnp.cross(p[0], ml.so3.to_matrix(state.attitude).T @ p[1])),
    "spectrum": ((("m",), ("m",)), lambda p, t, state: jnp.sum(p[0] * jnp.cos(p[1] * t)) * state.attitude[1:]),
    "table": ((("m",), ()), lambda p, t, state: p[1] * p[0][-1] * state.momentum),
    "matrix": (((3, 3),), lambda p, t, state: p[0] @ state.momentum),
    "polynomial": ((("m",), (3,)), lambda p, t, state: jnp.polyval(p[0], t) * p[1]),
}


class Drawn(NamedTuple):
    """A torque as it is meant: for each term its name, the length of its table, and which parameters have rows."""

    count: int
    terms: list[tuple[str, int, tuple[bool, ...]]]
    numbers: int  # seed


class Term(eqx.Module):
    """A term of the torque, with parameters in a list."""

    name: str = eqx.field(static=True)
    parameters: list

    def __call__(self, t, state):
        return TERMS[self.name][1](self.parameters, t, state)


@st.composite
def drawn(draw):
    count = draw(st.sampled_from(SIZES))
    terms = [
        (name, draw(st.sampled_from([count, 3, 4])), tuple(draw(st.booleans()) for _ in TERMS[name][0]))
        for name in draw(st.lists(st.sampled_from(sorted(TERMS)), min_size=1, max_size=5))
    ]
    return Drawn(count, terms, draw(st.integers(0, 2**32 - 1)))


def check_rows(case: Drawn) -> str:
    """ "decided" or "refused"; an AssertionError where a body got other parameters than were meant."""
    rng = np.random.default_rng(case.numbers)
    terms, alone = [], [[] for _ in range(case.count)]
    for name, length, owned in case.terms:
        arrays = []
        for shape, own in zip(TERMS[name][0], owned, strict=True):
            shape = tuple(length if size == "m" else size for size in shape)
            arrays.append(jnp.asarray(rng.normal(size=(case.count, *shape) if own else shape)))
        terms.append(Term(name, arrays))
        for i, own_terms in enumerate(alone):
            own_terms.append(Term(name, [x[i] if own else x for x, own in zip(arrays, owned, strict=True)]))
    attitude = rng.normal(size=(case.count, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    start = ml.RigidState(rng.normal(size=(case.count, 3)), attitude)
    body = ml.RigidBody([1.0, 2.0, 2.5])
    try:
        batch = as_batch("RK4", body, ml.torques.Sum(*terms), start, 0.1, 0.0)
    except ValueError as error:
        if "torque_axes" not in str(error):
            raise AssertionError("refused for another reason") from error
        return "refused"
    for i, meant in enumerate(alone):
        _, torque, state, *_ = eqx.combine(jax.tree.map(lambda x, i=i: x[i], batch.mapped), batch.shared)
        t = jnp.asarray(0.7)
        given, wanted = torque(t, state), ml.torques.Sum(*meant)(t, state)
        assert given.shape == wanted.shape, (case, given.shape)
        assert np.allclose(given, wanted, rtol=1e-12, atol=1e-12), (case, i, given, wanted)
    return "decided"
