"""Random numbers: what normal numbers cost in a step, and the words for programs that test their quality.

    python benchmarks/random_numbers.py cost [--turns 15] [--rows NAME ...]
    python benchmarks/random_numbers.py words --order ORDER | RNG_test stdin32 -tlmax 32GB      (PractRand)
    python benchmarks/random_numbers.py words --order ORDER | dieharder -a -g 200

cost: nanoseconds of processor time for three numbers of one body, on one core: what a step of SYMMETRIC[EA] takes
longer if they are added to the momentum, and in brackets the share of the step without them. The bodies, 1024 heavy
tops, move in chunks of 256; the least time of runs that take turns. `fused` computes the numbers in the loop of the
step, `apart` in a loop of their own before it.

words: those of `midlie_jax/_math/normals.py` without end, in one of the orders in which they are used: `steps` is one
body step by step; `bodies` is 256 bodies side by side, whose keys JAX has split, step by step; `seeds` is the first
step of bodies whose keys are 0, 1, 2, ...; `high` is the same with the digits of the key reversed, so that the highest
change first; `members` is that of the members 0, 1, 2, ... of one body; `stages` is sixteen stages in each step.
"""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import Table, main
from jax import Array

import midlie_jax as ml
from midlie_jax._math import normals
from midlie_jax._math.normals import words
from midlie_jax._xla.compiler import tuned_jit
from midlie_jax._xla.fusion import split
from midlie_jax.advice.timing import Stopwatch
from midlie_jax.cli import scenes
from midlie_jax.drivers.clock import ends_of_step
from midlie_jax.integrators.system import Motion, System

CHUNKS, CHUNK, STEPS, DT = 4, 256, 2000, 0.005
Words = Sequence[Array]


def word(x: int) -> Array:
    return jnp.asarray(np.uint32(x))


def chosen(key: Words, n: Array, count: int) -> Words:
    return words(key, n, 0, 0, count)


ROTATIONS = (10, 11, 13, 23, 6, 17, 25, 18), (26, 21, 27, 5, 20, 11, 10, 20)


def threefry(start: Words, key: Words) -> Words:
    """One block of Threefry4x32-12, four words (Salmon et al. 2011)."""
    key, start = [*key], [*start]
    parity = word(0x1BD11BDA)
    for k in key:
        parity = parity ^ k
    key.append(parity)
    x = [a + k for a, k in zip(start, key, strict=False)]
    for r in range(12):
        for pair, rotations in enumerate(ROTATIONS):
            a, b, left = 2 * pair, (2 * pair + 1 + 2 * (r % 2)) % 4, rotations[r % 8]
            x[a] = x[a] + x[b]
            x[b] = ((x[b] << word(left)) | (x[b] >> word(32 - left))) ^ x[a]
        if r % 4 == 3:
            x = [a + key[(r // 4 + 1 + i) % 5] for i, a in enumerate(x)]
            x[-1] = x[-1] + word(r // 4 + 1)
    return x


def by_threefry(key: Words, n: Array, count: int) -> Words:
    zeros = [word(0), word(0)]
    starts = ([n.astype(jnp.uint32), word(block), *zeros] for block in range(-(-count // 4)))
    return [x for start in starts for x in threefry(start, [*key, *zeros])][:count]


GENERATORS: dict[str, Callable[[Words, Array, int], Words]] = {"chosen": chosen, "Threefry4x32-12": by_threefry}


def of_jax(key: Words, n: Array, dtype: Any) -> Sequence[Array]:
    folded = jax.random.fold_in(jax.random.wrap_key_data(jnp.stack(key), impl="threefry2x32"), n)
    return tuple(jax.random.normal(folded, (3,), dtype))


class Row(NamedTuple):
    """The words of the numbers, and whether these are computed in a loop of their own."""

    generator: str
    apart: bool = False

    def numbers(self, key: Words, n: Array, dtype: Any) -> Sequence[Array]:
        if self.generator not in GENERATORS:
            return of_jax(key, n, dtype)
        numbers = tuple(normals.of_words(GENERATORS[self.generator](key, n, 4), 3))
        return [x.astype(dtype) for x in (split(numbers) if self.apart else numbers)]


ROWS = [Row("chosen"), Row("chosen", apart=True), Row("Threefry4x32-12"), Row("jax.random")]


def compiled(row: Row | None, dtype: Any) -> Callable[[], Any]:
    """A run of all bodies."""
    scene = scenes.scene("P1", dtype)
    method = ml.method("SYMMETRIC[EA]").fitted(scene.body)
    keys = jax.random.key_data(jax.random.split(jax.random.key(1, impl="threefry2x32"), (CHUNKS, CHUNK)))
    t0, dt, size = (jnp.asarray(x, dtype) for x in (0, DT, 1e-4))

    def of_body(start: Any, key: Array, size: Array) -> Any:
        system = System.of(scene.body, scene.torque, start, t0)

        def iteration(n: Array, progress: Any) -> Any:
            def step(*arguments: Any) -> Any:
                motion, force, ok = method.step(*arguments)
                if row is not None:
                    numbers = row.numbers((key[0], key[1]), n, dtype)
                    kicked = tuple(x + size * z for x, z in zip(motion.momentum, numbers, strict=True))
                    motion = Motion(kicked, motion.pose)
                return motion, force, ok

            return method.advance(system, (t0, dt), partial(ends_of_step, n), dt, progress, step=step)[0]

        first, last = jnp.int32(0), jnp.int32(STEPS)
        return jax.lax.fori_loop(first, last, iteration, method.begin(system, start, t0))

    def run(start: Any, keys: Array, size: Array) -> Any:
        return jax.lax.map(lambda chunk: jax.vmap(of_body, (0, 0, None))(*chunk, size), (start, keys))

    starts = jax.tree.map(lambda x: jnp.broadcast_to(x, (CHUNKS, CHUNK, *x.shape)), scene.start)
    run = tuned_jit(run, lambda *_: CHUNK)
    return lambda: jax.block_until_ready(run(starts, keys, size))


def measured(rows: Sequence[Row], turns: int) -> Iterator[list[str]]:
    dtypes = ("float32", "float64")
    least: dict[Any, float] = {}
    for dtype in dtypes:
        runs = {row: compiled(row, dtype) for row in (None, *rows)}
        for run in runs.values():
            run()
        watches = {row: Stopwatch() for row in runs}
        for _ in range(turns):
            for row, run in runs.items():
                watches[row].time(run)
        least |= {(row, dtype): min(watch.laps) * 1e9 / (CHUNKS * CHUNK * STEPS) for row, watch in watches.items()}
    yield ["a step without numbers", "", *(f"{least[None, dtype]:.2f}" for dtype in dtypes)]
    for row in rows:
        more = [(least[row, dtype] - least[None, dtype], least[None, dtype]) for dtype in dtypes]
        place = "apart" if row.apart else "fused"
        yield [row.generator, place, *(f"{x:.2f} ({x / whole:.2f})" for x, whole in more)]


# ---- the words, for programs that test them ----

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


COST = Table("", "", ["words", "loop", "float32, ns", "float64, ns"])


def cost(options: Any) -> None:
    rows = [row for row in ROWS if not options.rows or row.generator in options.rows]
    COST.show(False, measured(rows, options.turns))


ARGUMENTS = {
    "--turns": {"type": int, "default": 15},
    "--rows": {"nargs": "*", "help": "only those with one of these generators"},
    "--order": {"choices": ORDERS, "default": "steps"},
}

if __name__ == "__main__":
    main(__doc__, {"cost": cost, "words": stream}, ARGUMENTS)
