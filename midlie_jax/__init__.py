"""Fast, structure-preserving simulation of rotating rigid bodies, in JAX.

`__init__.pyi` lists the public names with their modules; everything else is internal. A name is imported at its first
use, so `midlie --help` does not wait for JAX, nor a run for diffrax.

The examples of all docstrings assume a heavy top, tilted by 0.3 rad, in float64, and for flights a free body:

    >>> import jax, jax.numpy as jnp, numpy as np, midlie_jax as ml
    >>> body, torque = ml.RigidBody([5.0, 5.0, 1.0]), ml.torques.HeavyTop(20.0)
    >>> start = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.3, 0.0, 0.0])))
    >>> inertia = ml.RigidBody([1.0, 2.0, 2.5]).inertia()
    >>> momentum = ml.flights.components.vector(jnp.array([1.0, 0.8, -1.3]))  # a tuple of scalars
"""

from typing import Any

from ._lazy import names_of

_found, _, __all__ = names_of(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A public name; or the version of the installed package, which is defined in pyproject.toml."""
    if name != "__version__":
        return _found(name)
    from importlib.metadata import version

    return version(__name__)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
