"""`scatter`: random inputs of an ensemble; the draw of a body does not depend on the other bodies or the order.

Random bits are integers, the same in every program, but XLA rounds the numbers made of them differently in programs for
other numbers of rows. All bodies therefore go through one compiled program, in blocks of one size.
"""

from functools import partial
from hashlib import blake2b
from operator import index
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._checks.arguments import FLOATS, described, is_key, require_finite
from .._math.components import is_traced
from .distributions import Distribution

_BLOCK = 1024  # bodies per call of the compiled program; a power of two, so vector instructions leave no remainder
_MOST = 2**32  # the most bodies: indices have 32 bits


def scatter(key: Any, bodies: Any, *, dtype: Any = None, **quantities: Any) -> dict[str, Any]:
    """Draws random inputs for the bodies of an ensemble: for each name an array with a leading axis of bodies.

    The draw of body k depends only on the key, the name of the quantity, k, the distribution and the dtype, and not on
    other bodies and quantities. A process that holds the bodies i to j - 1 draws only these: `scatter(key, range(i, j),
    ...)` equals these rows of `scatter(key, n, ...)`, bit for bit, for one kind of processor and one version of JAX.
    For independent Monte Carlo runs, give each run its own key (`jax.random.split`).

    Args:
        key: a typed key, `jax.random.key(seed)`, of JAX's default generator threefry.
        bodies: number of bodies, for the bodies 0 to n - 1; or the indices of the bodies, a range or integers (n,).
        dtype: float32 or float64, of all arrays; by default float64 if JAX's x64 is on, else float32.
        **quantities: a distribution of `midlie_jax.distributions` for each name; for `Joint` a dictionary is returned.

    Raises:
        ValueError: an argument is not of the kind above; a body has no row in an `Each`; or the function is called
            inside jit, vmap or grad, where the draws would become part of another program.

    Examples:
        >>> normal, rotation = ml.distributions.Normal([0.0, 0.0, 50.0], 1.0), ml.distributions.Rotation()
        >>> drawn = ml.scatter(jax.random.key(0), 1000, momentum=normal, attitude=rotation)
        >>> ml.RigidState(**drawn).attitude.shape  # the start of an ensemble
        (1000, 4)
    """
    for name, value in (("key", key), ("bodies", bodies)):
        if is_traced(value):
            raise ValueError(f"{name} is traced; call scatter outside jit, vmap and grad, and pass its result.")
    if not is_key(key) or key.shape != ():
        raise ValueError(f"key must be one typed key, got {described(key)}; make it with jax.random.key(0).")
    if "threefry" not in str(jax.random.key_impl(key)):
        raise ValueError("key must be of the generator threefry2x32: jax.random.key(0, impl='threefry2x32').")
    indices, name_of_dtype = _indices(bodies), _dtype_name(dtype)
    if not quantities:
        raise ValueError("scatter needs a quantity; pass one by name, such as weight=Normal(20.0, 0.5).")
    drawn: dict[str, Any] = {}
    for name, distribution in quantities.items():
        if not isinstance(distribution, Distribution):
            raise ValueError(
                f"{name} must be a distribution of midlie_jax.distributions, got "
                f"{described(distribution)}; use Each for one given value per body, and leave out values "
                "shared by all bodies."
            )
        distribution.check_bodies(name, indices)
        drawn[name] = _drawn(name, distribution, key, indices, name_of_dtype)
    return drawn


def _drawn(name: str, distribution: Distribution, key: Array, indices: np.ndarray, dtype: str) -> Any:
    with np.errstate(over="ignore"):  # reported below
        cast = jax.tree.map(lambda x: np.asarray(x, dtype), distribution)
    for leaf in jax.tree.leaves(cast):
        require_finite(f"a parameter of {name} in {dtype}", leaf)
    cast = jax.tree.map(jnp.asarray, cast)  # once for all blocks
    # Two words of a hash of the name, the same in every process.
    for word in np.frombuffer(blake2b(name.encode(), digest_size=8).digest(), "<u4"):
        key = jax.random.fold_in(key, int(word))
    padded = np.zeros((max(-(-indices.size // _BLOCK), 1), _BLOCK), np.uint32)
    padded.flat[: indices.size] = indices
    blocks = [_block(cast, key, block, dtype) for block in padded]
    return jax.tree.map(lambda *parts: _joined(parts, indices.size), *blocks)


@partial(jax.jit, static_argnames="dtype")
def _block(distribution: Distribution, key: Array, indices: Array, dtype: str) -> Any:
    return jax.vmap(lambda body: distribution.draw(jax.random.fold_in(key, body), body, dtype))(indices)


def _joined(parts: tuple[Array, ...], count: int) -> Array:
    """The first rows of the parts, joined by NumPy, because XLA would compile a program for each number of parts."""
    if is_key(parts[0]):
        return jax.random.wrap_key_data(_joined(tuple(map(jax.random.key_data, parts)), count))
    return jnp.asarray(np.concatenate([np.asarray(part) for part in parts])[:count])


def _indices(bodies: Any) -> np.ndarray:
    wanted = "bodies must be a positive number of bodies, or their indices as a range or integers (n,)"
    try:
        count = None if isinstance(bodies, (bool, np.bool_, Array)) else index(bodies)
    except TypeError:
        count = None
    if count is not None:
        if not 1 <= count <= _MOST:
            raise ValueError(f"{wanted}, got {count}; give 1 to 2^32 bodies.")
        return np.arange(count)
    indices = np.asarray(bodies)
    if isinstance(bodies, bool) or indices.ndim != 1 or (indices.size and indices.dtype.kind not in "iu"):
        raise ValueError(f"{wanted}, got {described(bodies)}.")
    if indices.size and not 0 <= indices.min() <= indices.max() < _MOST:
        raise ValueError(f"{wanted}, got indices from {indices.min()} to {indices.max()}; they count from 0.")
    return indices.astype(np.int64)


def _dtype_name(dtype: Any) -> str:
    default = jnp.result_type(float).name
    name = default if dtype is None else np.dtype(dtype).name
    if name not in FLOATS:
        raise ValueError(f"dtype must be float32 or float64, got {dtype}; leave it out for {default}.")
    if name == "float64" and default == "float32":
        raise ValueError('dtype float64 needs jax.config.update("jax_enable_x64", True) first; or leave it out.')
    return name
