"""stub"""

import jax.numpy as jnp

_ROT = ((10, 26), (11, 21), (13, 27), (23, 5), (6, 20), (17, 11), (25, 10), (18, 20))


def _rotl(x, r):
    return (x << jnp.uint32(r)) | (x >> jnp.uint32(32 - r))


def bits(key, ctr, rounds=12):
    k = [jnp.asarray(w, jnp.uint32) for w in key]
    while len(k) < 4:
        k.append(jnp.uint32(0))
    ks = [*k, jnp.uint32(0x1BD11BDA) ^ k[0] ^ k[1] ^ k[2] ^ k[3]]
    x = [jnp.asarray(c).astype(jnp.uint32) for c in ctr]
    x = [a + b for a, b in zip(x, ks)]
    for r in range(rounds):
        a, b = _ROT[r % 8]
        if r % 2 == 0:
            x[0] = x[0] + x[1]
            x[1] = _rotl(x[1], a) ^ x[0]
            x[2] = x[2] + x[3]
            x[3] = _rotl(x[3], b) ^ x[2]
        else:
            x[0] = x[0] + x[3]
            x[3] = _rotl(x[3], a) ^ x[0]
            x[2] = x[2] + x[1]
            x[1] = _rotl(x[1], b) ^ x[2]
        if r % 4 == 3:
            j = r // 4 + 1
            x = [x[i] + ks[(j + i) % 5] for i in range(4)]
            x[3] = x[3] + jnp.uint32(j)
    return x


def normals(key, counter, count, dtype):
    step, stage, member = counter
    out = []
    for block in range(-(-count // 4)):
        w = bits(
            key,
            (
                jnp.asarray(step).astype(jnp.uint32),
                jnp.uint32(stage),
                jnp.asarray(member).astype(jnp.uint32),
                jnp.uint32(block),
            ),
        )
        w = jnp.broadcast_arrays(*w)
        u = [
            ((x >> jnp.uint32(8)).astype(jnp.int32).astype(jnp.float32) + jnp.float32(0.5)) * jnp.float32(2**-24)
            for x in w
        ]
        for i in (0, 2):
            r = jnp.sqrt(-2 * jnp.log(u[i]))
            a = jnp.float32(6.2831855) * u[i + 1]
            out += [r * jnp.cos(a), r * jnp.sin(a)]
    return tuple(x.astype(dtype) for x in out[:count])
