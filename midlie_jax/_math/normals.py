"""Normal random numbers by counter: a function of a key and of the position at which the numbers are used.

A body draws the same numbers in any batch, and a resumed run those of an uninterrupted run. Two words make two numbers,
a radius and a point on the circle (G. Box and M. Muller, 1958), by bit operations and short polynomials: XLA would end
a loop at a true root or logarithm that is used twice. All is computed in float32, whose relative errors of 2e-7 shift
the variance by less than 1e-7. Compilers differ in the last places.

The words are mixed as in pcg4d (M. Jarzynski and M. Olano, Hash functions for GPU rendering, J. Comput. Graph. Tech.
9(3), 2020), and folded before and after; each input bit then changes each output bit with probability 1/2.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._xla.fusion import split

# Minimax polynomials, lowest power first. Near zero, to rounding: -log(1 + x)/x for sqrt(1/2) <= 1 + x <= sqrt(2), to
# 1.7e-7; 1/sqrt(1 - x) for |x| <= 0.07, to 2.3e-8.
LOGARITHM = (-0.99999994, 0.50000364, -0.3333506, 0.24969909, -0.19900166, 0.1725083, -0.16222578, 0.101068906)
ROOT = (1.0, 0.49999833, 0.37500072, 0.31393936, 0.27403697)
# cos a and sin(a)/a in powers of a^2, for |a| <= pi/4, to 2.8e-8; sqrt(2) sin(a)/a for |a| <= pi/2, to 6e-9.
COSINE = (1.0, -0.49999857, 0.041655026, -0.0013585909)
SINE = (1.0, -0.16666651, 0.008332036, -0.00019504022)
WIDE_SINE = (1.4142135, -0.23570214, 0.011784714, -0.00028014262, 3.6843444e-06)

_GUESS = 0x5F375A86  # as in `cp.inverse_root`
_SIGN, _MAGNITUDE, _FRACTION = 0x80000000, 0x7FFFFFFF, 0x007FFFFF
_ROOT_HALF = 0x3F3504F3  # the bits of sqrt(1/2)
_WHOLE = 31 << 23  # adds 31 to the exponent


def normals(
    key: Sequence[Array], counter: tuple[Array, Array | int, Array | int], count: int, dtype: Any
) -> tuple[Array, ...]:
    """`count` independent standard normal numbers; none exceeds 6.56, beyond which the normal distribution has 5e-11.

    The counter has the indices of the step, of the stage in the step, and of the member body, or an array of members.
    In float64 they are the same numbers, in a separate loop, because a float32 vector holds twice as many.
    """
    numbers = of_words(words(key, *counter, count + count % 2), count)
    if jnp.dtype(dtype) == jnp.float32:
        return numbers
    return tuple(jax.lax.convert_element_type(x, dtype) for x in split(numbers))


def of_words(drawn: Sequence[Array], count: int) -> tuple[Array, ...]:
    """`count` normal numbers, float32, from as many independent random words; one more if the count is odd."""
    numbers: list[Array] = []
    for i in range(0, count, 2):
        radius = _radius(drawn[i])
        if i + 1 < count:
            cosine, sine = _on_circle(drawn[i + 1])
            numbers += [radius * _signed(cosine, drawn[i]), radius * _signed(sine, drawn[i + 1] << np.uint32(31))]
        else:
            numbers.append(radius * _sine(drawn[i + 1]))
    return tuple(numbers)


def _float(word: Array) -> Array:
    return jax.lax.convert_element_type(jax.lax.bitcast_convert_type(word, jnp.int32), jnp.float32)


def _bits(x: Array) -> Array:
    return jax.lax.bitcast_convert_type(x, jnp.int32)


def _of_bits(x: Array) -> Array:
    return jax.lax.bitcast_convert_type(x, jnp.float32)


def _signed(x: Array, word: Array) -> Array:
    """x with its sign changed if the highest bit of the word is set."""
    return _of_bits(_bits(x) ^ jax.lax.bitcast_convert_type(word & np.uint32(_SIGN), jnp.int32))


def _radius(word: Array) -> Array:
    """sqrt(-log u), where u = 2^-31 |word| in (0, 1]; it does not depend on the sign of the word."""
    bits = (_bits(_float(word | np.uint32(1))) & np.int32(_MAGNITUDE)) - np.int32(_ROOT_HALF + _WHOLE)
    # u = 2^n (1 + x); n is exactly zero for u near 1, where the result depends on x alone.
    n = bits & ~np.int32(_FRACTION)
    x = _of_bits((bits & np.int32(_FRACTION)) + np.int32(_ROOT_HALF)) - np.float32(1)
    logarithm = _polynomial(LOGARITHM, x) * x
    return _root(logarithm - jax.lax.convert_element_type(n, jnp.float32) * np.float32(math.log(2) / 2**23))


def _root(x: Array) -> Array:
    """The root of x: zero, or far from underflow and overflow."""
    guess = _of_bits(np.int32(_GUESS) - (_bits(x) >> np.int32(1)))
    close = x * guess
    return close * _polynomial(ROOT, np.float32(1) - close * guess)


def _on_circle(word: Array) -> tuple[Array, Array]:
    """sqrt(2) (cos a, sin a) of an angle a = pi/4 + b in the first quarter, sums of cos b and sin b."""
    b = _float(word) * np.float32(math.pi / 2**33)
    square = b * b
    cosine, sine = _polynomial(COSINE, square), b * _polynomial(SINE, square)
    return cosine - sine, cosine + sine


def _sine(word: Array) -> Array:
    """sqrt(2) sin a of an angle a in the half of the circle where the sine takes each value once."""
    a = _float(word) * np.float32(math.pi / 2**32)
    return a * _polynomial(WIDE_SINE, a * a)


def _polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """Horner's scheme: in a loop with other independent work, fewer operations are faster."""
    *lower, highest = coefficients
    value: Any = np.float32(highest)
    for c in reversed(lower):
        value = value * x + np.float32(c)
    return value


# Words without a pattern: the fractional parts of the square roots of the first primes, as in SHA-2.
_ROOTS = (0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A, 0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19)


def words(key: Sequence[Array], step: Array, stage: Array | int, member: Array | int, count: int) -> tuple[Array, ...]:
    """`count` random words, uint32, for each member, from a key of two or four words."""
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
