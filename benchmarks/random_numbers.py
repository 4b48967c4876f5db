"""Random words of `midlie_jax/_math/counter.py` without end, for programs that test their quality.

    python benchmarks/random_numbers.py --order ORDER | RNG_test stdin32 -tlmax 32GB      (PractRand)
    python benchmarks/random_numbers.py --order ORDER | dieharder -a -g 200

The orders are those in which they are used: `steps` is one body step by step; `bodies` is 256 bodies side by side,
whose keys JAX has split, step by step; `seeds` is the first step of bodies whose keys are 0, 1, 2, ...; `high` is the
same with the digits of the key reversed, so that the highest change first; `members` is that of the members 0, 1, 2,
... of one body; `stages` is sixteen stages in each step.
"""

import os
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import main
from jax import Array

from midlie_jax._math.counter import words

AT_ONCE, BODIES, STAGES = 2**18, 256, 16
ORDERS = ("steps", "bodies", "seeds", "high", "members", "stages")


def reversed_bits(n: np.ndarray) -> np.ndarray:
    digits = np.unpackbits(n.astype(">u4").view(np.uint8).reshape(-1, 4), axis=1)[:, ::-1]
    return np.packbits(digits, axis=1).view(">u4").ravel().astype(np.uint32)


def arguments(order: str, block: int) -> tuple[Any, Any, Any, Any]:
    """Key, step, stage and member of the words of a block, and the same for `jax.vmap`."""
    n = np.arange(block * AT_ONCE, (block + 1) * AT_ONCE, dtype=np.uint32)
    zero = np.zeros_like(n)
    key = jax.random.key_data(jax.random.key(1, impl="threefry2x32"))
    ours = [np.broadcast_to(np.asarray(k), n.shape) for k in key]
    if order == "bodies":
        keys = np.asarray(jax.random.key_data(jax.random.split(jax.random.wrap_key_data(key), BODIES)))
        return (*keys[n % BODIES].T,), n // BODIES, zero, zero
    if order in ("seeds", "high"):
        return (zero, n if order == "seeds" else reversed_bits(n)), zero, zero, zero
    if order == "members":
        return tuple(ours), zero, zero, n
    return tuple(ours), n // STAGES if order == "stages" else n, n % STAGES if order == "stages" else zero, zero


@jax.jit
def drawn(key: tuple[Array, Array], step: Array, stage: Array, member: Array) -> Array:
    return jnp.stack(words(key, step, stage, member, 4), axis=-1)


def stream(options: Any) -> None:
    block = 0
    try:
        while True:
            sys.stdout.buffer.write(np.asarray(drawn(*arguments(options.order, block))).tobytes())
            block += 1
    except BrokenPipeError:  # the test has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main(__doc__, stream, {"--order": {"choices": ORDERS, "default": "steps"}})
