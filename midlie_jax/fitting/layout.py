"""`Layout`: the parameters of a guess as one vector of unconstrained numbers, and the names of its entries."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from .._checks.arguments import described
from .parameters import Parameter


class Layout(eqx.Module):
    """The parameters of a guess, in the order of the leaves of its pytree.

    Attributes:
        guess: a pytree whose leaves are `Parameter`s.
    """

    guess: Any

    @property
    def parameters(self) -> list[Parameter]:
        return jax.tree.leaves(self.guess, is_leaf=_is_parameter)

    @property
    def size(self) -> int:
        """The number of unconstrained numbers."""
        return sum(parameter.vector().size for parameter in self.parameters)

    def start(self) -> Float[Array, " p"]:
        """The unconstrained numbers of the guess."""
        return jnp.concatenate([parameter.vector() for parameter in self.parameters])

    def typical(self) -> Float[Array, " p"]:
        """The sizes of changes that matter, see `Parameter.typical`."""
        return jnp.concatenate([parameter.typical() for parameter in self.parameters])

    def values(self, vector: Float[Array, " p"]) -> Any:
        """The physical values, a pytree of arrays of the structure of the guess."""
        leaves: list[Array] = []
        begin = 0
        for parameter in self.parameters:
            end = begin + parameter.vector().size
            leaves.append(parameter.value(vector[begin:end]))
            begin = end
        return jax.tree.unflatten(jax.tree.structure(self.guess, is_leaf=_is_parameter), leaves)

    def coordinates(self, vector: Float[Array, " p"]) -> Float[Array, " k"]:
        """The physical numbers, see `Parameter.coordinates`."""
        values = jax.tree.leaves(self.values(vector))
        return jnp.concatenate([p.coordinates(value) for p, value in zip(self.parameters, values, strict=True)])

    def names(self) -> list[str]:
        """The name of each coordinate, such as "moments[0]"."""
        return [f"{name}{label}" for name, p in self.named() for label in p.labels()]

    def unconstrained_names(self) -> list[str]:
        """The name of each unconstrained number: that of the coordinate that the number mainly changes."""
        return [f"{name}{label}" for name, p in self.named() for label in p.unconstrained_labels()]

    def named(self) -> Sequence[tuple[str, Parameter]]:
        """Each parameter with its name, such as "moments"."""
        found = jax.tree_util.tree_flatten_with_path(self.guess, is_leaf=_is_parameter)[0]
        return [(_name(path), parameter) for path, parameter in found]

    @classmethod
    def checked(cls, guess: Any) -> "Layout":
        """The layout of a guess; a ValueError if a leaf is no `Parameter`, or if there is none."""
        leaves = jax.tree_util.tree_flatten_with_path(guess, is_leaf=_is_parameter)[0]
        if not leaves:
            raise ValueError("guess holds no parameter; give for example {'moments': Moments([1.0, 2.0, 2.5])}.")
        for path, leaf in leaves:
            if not _is_parameter(leaf):
                raise ValueError(
                    f"guess: {_name(path)} is {described(leaf)}, not a parameter; wrap it, for example in "
                    "midlie_jax.fitting.Free, or use it inside the model if it is known."
                )
        layout = cls(guess)
        dtypes = {parameter.vector().dtype.name for parameter in layout.parameters}
        if len(dtypes) > 1:
            raise ValueError(f"all parameters of the guess must have one dtype, got {' and '.join(sorted(dtypes))}.")
        return layout


def _is_parameter(x: Any) -> bool:
    return isinstance(x, Parameter)


def _name(path: Any) -> str:
    """The name of a leaf of the guess, such as "moments" or "gyro.bias"."""
    return jax.tree_util.keystr(path, simple=True, separator=".") or "value"
