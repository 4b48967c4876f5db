"""Random words by counter: a function of a key and of the position at which the words are used, without state.

A body therefore draws the same numbers in any batch, and a resumed run draws the numbers of an uninterrupted run. The
words are mixed as in pcg4d (M. Jarzynski and M. Olano, Hash functions for GPU rendering, Journal of Computer Graphics
Techniques 9(3), 2020): the four words of a block are multiplied with each other, and the high half of each is folded
into the low half. pcg4d itself is too weak for keys, because its low output bits do not depend on the highest input
bits. Here words that may follow a pattern are folded first, and the result is folded last; each input bit then changes
each output bit with probability 1/2.

With Threefry (J. Salmon, M. Moraes, R. Dror and D. Shaw, Parallel random numbers: as easy as 1, 2, 3, 2011) of twelve
rounds, normal numbers took 1.4 times the time, and from `jax.random` 20 times. Philox needs products of 64 bits, which
JAX lacks unless float64 is on.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# Words without a pattern: the fractional parts of the square roots of the first primes, as in SHA-2.
_ROOTS = (0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A, 0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19)


def words(key: Sequence[Array], step: Array, stage: Array | int, member: Array | int, count: int) -> tuple[Array, ...]:
    """`count` random words, uint32, in the shape of the member, if that is an array.

    Args:
        key: two or four words, uint32.
        step, stage: of the run and in the step; scalars shared by all bodies.
        member: the owner of the words, one number or an array of them. Calls with the same count give each member its
            own numbers.
    """
    blocks = -(-count // 4)
    # Each of the two is mixed separately, then both together. XLA computes the part that depends only on the key before
    # the loop over steps; the part that does not depend on the body costs nothing in a loop over bodies. The constants
    # come first, because `_mix` does not change two leading words of zero, and key 0 has no others.
    a, b, c, d = (*map(_word, _ROOTS[len(key) : 4]), *key)
    own = _mix(_fold(a), _fold(b), _fold(c), _fold(d))
    place = _mix(*_mix(*map(_fold, (_word(_ROOTS[6]), _word(_ROOTS[7]), _word(step), _word(stage)))))
    result: list[Array] = []
    for block in range(blocks):
        row = _word(member) * _word(blocks) + _word(block)
        # Odd multiples, so that the words differ from row to row, and not only in their highest bits.
        rows = (_fold(row * _word(root | 1)) for root in _ROOTS[:4])
        x, y, z, w = (k ^ (p + r) for k, p, r in zip(own, place, rows, strict=True))
        result += _mix(x, y, z, w)
    return tuple(result[:count])


def _word(x: Array | int) -> Array:
    return jax.lax.convert_element_type(x, jnp.uint32) if isinstance(x, Array) else jnp.asarray(np.uint32(x))


def _fold(x: Array) -> Array:
    return x ^ (x >> _word(16))


def _mix(x: Array, y: Array, z: Array, w: Array) -> tuple[Array, Array, Array, Array]:
    """A permutation of all blocks of four words."""
    for _ in range(2):
        x = x + y * w
        y = y + z * x
        z = z + x * y
        w = w + y * z
        x, y, z, w = _fold(x), _fold(y), _fold(z), _fold(w)
    return x, y, z, w
