"""`Checkpointed`, `Reversible` and `Forward`: how a run is differentiated (`adjoint=`).

The values of a run do not depend on the adjoint. Adjoints differ in how reverse mode gets the states it needs, from the
last to the first. Some states are kept and the others recomputed, or every step is taken backwards.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from .._checks.arguments import as_count, described
from .._xla import budgets
from .._xla.internals import Tracer, is_zero_tangent, make_primitive, with_zeros
from .._xla.keep import recomputed
from .._xla.per_row import in_rows, with_tangents_of
from .._xla.rules import fits
from ..integrators.base import Method, Progress
from ..integrators.system import System
from .steps import OneStep

# The most backward steps from a kept state. Rounding changes the momentum by about eps per step, and therefore the
# attitude. After n steps of one radian in a regular motion, the attitude error is about n^1.5 eps, here 4e-9 and 1.4e-3
# radians.
_FARTHEST = {"float64": 2**16, "float32": 2**9}
_Functions = tuple[Callable[..., Any], ...]


class Adjoint(eqx.Module):
    """How a run is differentiated."""

    @abstractmethod
    def run(self, steps: OneStep, inputs: Any, total: int, progress: Progress) -> Progress:
        """The progress after consecutive steps of a run of `total`, with their indices and prepared inputs."""

    def check(self, method: Method, system: System, save_every: int) -> None:
        """Raises a ValueError if the derivative does not exist for this method and torque."""


class _Keeping(Adjoint):
    """An adjoint that keeps a state every `every` steps."""

    every: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.every is not None:
            as_count("every", self.every)

    def check(self, method: Method, system: System, save_every: int) -> None:
        if self.every is not None and save_every % self.every:
            raise ValueError(
                f"save_every ({save_every}) must be divisible by every ({self.every}) of the adjoint; "
                "change one of them."
            )


class Checkpointed(_Keeping):
    """Reverse mode keeps some states and recomputes the others; forward mode and higher derivatives work as well.

    Attributes:
        every: a state is kept every `every` steps; it must divide `save_every`. With 1, each step is recomputed once.
            With more, each step is recomputed twice, and n steps need memory for n / every + every states. The default
            is 1 for a run of at most 10240 numbers. For a longer run it is the largest divisor of `save_every` from 8
            to 1024 over the numbers of a state, else the next larger one up to 8 times as many, else 1.

    Examples:
        >>> start, body = ml.AxisState([0.0, 0.0, 10.0], [0.0, np.sin(0.3), np.cos(0.3)]), ml.SymmetricRotor(5.0)
        >>> def height(weight):  # of the tip after 100 steps
        ...     run = {"dt": 0.01, "steps": 100, "save_every": 100, "adjoint": ml.adjoints.Checkpointed(every=10)}
        ...     return ml.integrate("SYMMETRIC[EA]", body, ml.torques.HeavyTop(weight), start, **run).states.axis[-1, 2]
        >>> round(float(jax.grad(height)(20.0)), 6)
        -0.035224
    """

    def run(self, steps: OneStep, inputs: Any, total: int, progress: Progress) -> Progress:
        size = sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(progress, eqx.is_inexact_array)))
        every = self.every or _every(len(inputs[0]), total, size)
        one = _summing_once(steps, inputs, progress)
        take = recomputed(lambda progress, step: (one(progress, step), None), middle=True)
        if every == 1:
            return jax.lax.scan(take, progress, inputs, unroll=steps.unroll)[0]

        def advance(progress: Progress, inputs: Any) -> tuple[Progress, None]:
            return jax.lax.scan(take, progress, inputs, unroll=steps.unroll)

        block = recomputed(advance, middle=False)
        return jax.lax.scan(block, progress, _in_blocks(inputs, every))[0]


class Reversible(_Keeping):
    """Reverse mode takes the steps of a symmetric method backwards; memory does not grow with the number of steps.

    The rounding errors of backward steps accumulate. A few states are therefore kept, and the backward steps restart
    from each of them. Forward mode is not supported; a gradient can be differentiated again.

    In a regular motion of at most one radian per step, the recovered states are by default accurate to 4e-9 radians in
    float64 and to 1.4e-3 radians in float32. In a chaotic motion their error grows at the same rate as the derivative.

    Attributes:
        every: a state is kept every `every` steps; it must divide `save_every`. By default 16 to 32 states are kept
            between two saved states. More are kept if they would be over 65536 steps apart in float64 or 512 in
            float32, and fewer if `save_every` has no suitable divisor.

    Examples:
        >>> start, body = ml.AxisState([0.0, 0.0, 10.0], [0.0, np.sin(0.3), np.cos(0.3)]), ml.SymmetricRotor(5.0)
        >>> def height(weight):  # of the tip after 100 steps
        ...     run = {"dt": 0.01, "steps": 100, "save_every": 100, "adjoint": ml.adjoints.Reversible()}
        ...     return ml.integrate("SYMMETRIC[EA]", body, ml.torques.HeavyTop(weight), start, **run).states.axis[-1, 2]
        >>> round(float(jax.grad(height)(20.0)), 6)
        -0.035224
    """

    def check(self, method: Method, system: System, save_every: int) -> None:
        if not method.symmetric:
            raise ValueError(
                f"adjoint=Reversible() needs a symmetric method, and {method.name} is not one; "
                "use Checkpointed(), or a method whose `symmetric` is True."
            )
        if system.reads_momentum:
            raise ValueError(
                "adjoint=Reversible() needs a torque that does not read the momentum, because a step with another "
                "torque cannot be undone; use Checkpointed()."
            )
        super().check(method, system, save_every)

    def run(self, steps: OneStep, inputs: Any, total: int, progress: Progress) -> Progress:
        block = self.every or _block(len(inputs[0]), progress)
        index = jax.tree.map(lambda x: x[0], inputs)
        # Arrays that the steps close over become arguments, so that derivatives with respect to them exist.
        known = jax.tree.map(jnp.zeros_like, jax.eval_shape(steps.take_back, progress, index)[1])
        functions, arrays = zip(
            _with_arguments(steps.take, progress, index),
            _with_arguments(steps.take_back, progress, index),
            _with_arguments(steps.take_again, progress, index, known),
            strict=True,
        )

        def run(progress: Progress, inputs: Any) -> tuple[Progress, None]:
            return _run_reversibly(functions, steps.unroll, progress, inputs, arrays), None

        return jax.lax.scan(run, progress, _in_blocks(inputs, block))[0]


class Forward(Adjoint):
    """Supports forward mode only; a reverse derivative of the run raises a ValueError.

    Examples:
        >>> start, body = ml.AxisState([0.0, 0.0, 10.0], [0.0, np.sin(0.3), np.cos(0.3)]), ml.SymmetricRotor(5.0)
        >>> def height(weight):  # of the tip after 100 steps
        ...     run = {"dt": 0.01, "steps": 100, "save_every": 100, "adjoint": ml.adjoints.Forward()}
        ...     return ml.integrate("SYMMETRIC[EA]", body, ml.torques.HeavyTop(weight), start, **run).states.axis[-1, 2]
        >>> height_there, slope = jax.jvp(height, (20.0,), (1.0,))
        >>> round(float(slope), 6)
        -0.035224
    """

    def run(self, steps: OneStep, inputs: Any, total: int, progress: Progress) -> Progress:
        def take(progress: Progress, step: Any) -> tuple[Progress, None]:
            return steps.take(progress, step), None

        taken, _ = jax.lax.scan(take, progress, inputs, unroll=steps.unroll)
        leaves, structure = jax.tree.flatten(taken)
        return structure.unflatten(_forward_only.bind(*leaves))


_DEFAULT = Checkpointed()


def as_adjoint(adjoint: Any) -> Adjoint:
    """The adjoint itself, or `Checkpointed()` for None; otherwise raises a ValueError."""
    if adjoint is None:
        return _DEFAULT
    if not isinstance(adjoint, Adjoint):
        raise ValueError(
            f"adjoint must be midlie_jax.adjoints.Checkpointed(), Reversible() or Forward(), got {described(adjoint)}."
        )
    return adjoint


def _every(number: int, total: int, size: int) -> int:
    """The default steps between two kept states, a divisor of `number`; a state has `size` numbers."""
    if total * size <= budgets.KEPT_ALL:
        return 1
    longest = max(budgets.SHORTEST_BETWEEN, budgets.KEPT_BETWEEN // size)
    candidates = [*range(longest, budgets.SHORTEST_BETWEEN - 1, -1), *range(longest + 1, 8 * longest + 1)]
    return next((every for every in candidates if number % every == 0), 1)


def _summing_once(steps: OneStep, inputs: Any, progress: Progress) -> Callable[[Progress, Any], Progress]:
    """`steps.take`, with a reverse derivative that sums over the bodies after the loop for shared parameters.

    This is used for small parameters, which a step reads as scalars, and only if a step is a single loop over the
    bodies. Otherwise the run would read the copies as arrays with one row per body, even without derivatives. On a mesh
    whose axes are part of the array types, the rows of a copy would lack these axes.
    """
    if not steps.method.is_one_loop(steps.system) or jax.sharding.get_abstract_mesh().explicit_axes:
        return steps.take
    index = jax.tree.map(lambda x: x[0], inputs)
    take, arrays = jax.closure_convert(steps.take, progress, index)
    small = [fits(jax.typeof(x)) for x in arrays]
    few, others = eqx.partition(arrays, small)
    values = [x for x in few if x is not None]
    copies = in_rows(values, jax.tree.leaves(eqx.filter(progress, eqx.is_inexact_array)))
    values = jax.lax.stop_gradient(values)

    def one(progress: Progress, step: Any) -> Progress:
        own = iter(with_tangents_of(copies, values))
        given = [next(own) if is_small else x for is_small, x in zip(small, others, strict=True)]
        return take(progress, step, *given)

    return one


def _with_arguments(function: Callable[..., Any], *examples: Any) -> tuple[Callable[..., Any], list[Any]]:
    """The function with the traced arrays it reads as extra arguments, and these arrays, also those of integers."""
    traced, rest = eqx.partition(eqx.filter_closure_convert(function, *examples), lambda x: isinstance(x, Tracer))
    arrays, structure = jax.tree.flatten(traced)

    def with_arguments(*given: Any) -> Any:
        own = len(given) - len(arrays)
        return eqx.combine(structure.unflatten(given[own:]), rest)(*given[:own])

    return with_arguments, arrays


def _block(count: int, progress: Progress) -> int:
    """A divisor of `count`: the steps between two states that a reversible run keeps; see `Reversible`."""
    dtypes = {str(leaf.dtype) for leaf in jax.tree.leaves(progress)}
    longest = min(-(-count // budgets.REVERSED_INTERVALS), *(_FARTHEST[dtype] for dtype in dtypes & _FARTHEST.keys()))
    candidates = [*range(longest, longest // 2, -1), *range(longest + 1, count + 1)]
    return next(block for block in candidates if count % block == 0)


def _in_blocks(tree: Any, block: int) -> Any:
    return jax.tree.map(lambda x: x.reshape(-1, block, *x.shape[1:]), tree)


class _Perturbed(eqx.Module):
    """For each array that `take_again` reads, whether a derivative with respect to it is needed."""

    flags: tuple[bool, ...] = eqx.field(static=True)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _run_reversibly(functions: _Functions, unroll: int, progress: Progress, inputs: Any, arrays: Any) -> Progress:
    """The progress after the steps with these inputs, from `take`, `take_back` and `take_again`, each with its arrays.

    The derivative differentiates `take_again` instead of `take`, so the tangents belong to the arrays of `take_again`.
    """

    def take(progress: Progress, step: Any) -> tuple[Progress, None]:
        return functions[0](progress, step, *arrays[0]), None

    end = jax.lax.scan(take, progress, inputs, unroll=unroll)[0]
    # Under `jax.vmap` JAX raises an error for a derivative if bodies share an output. An example is the third component
    # of the torque on a top whose centre of mass lies on the axis e3, which is always zero.
    leaves, structure = jax.tree.flatten(end)
    return structure.unflatten(in_rows(leaves, []))


def _forward_pass(functions: _Functions, unroll: int, *arguments: Any) -> tuple[Progress, Any]:
    progress, inputs, arrays = jax.tree.map(lambda x: x.value, arguments)
    end: Any = _run_reversibly(functions, unroll, progress, inputs, arrays)
    return end, (end, inputs, arrays, _Perturbed(tuple(x.perturbed for x in arguments[2][2])))


def _backward_pass(functions: _Functions, unroll: int, kept: Any, cotangent: Any) -> tuple[Any, ...]:
    _, take_back, take_again = functions
    end, inputs, (_, arrays_back, arrays), perturbed = kept
    numbers, rest = eqx.partition(end, eqx.is_inexact_array)
    # Differentiate only with respect to the needed arrays, so that the derivative of the step has fewer operations.
    wanted, given = eqx.partition(arrays, list(perturbed.flags))

    def step_back(carry: Any, step: Any) -> tuple[Any, None]:
        after, cotangent, total = carry
        before, known = take_back(eqx.combine(after, rest), step, *arrays_back)
        before = eqx.filter(before, eqx.is_inexact_array)

        def taken(before: Any, wanted: Any) -> Any:
            after = take_again(eqx.combine(before, rest), step, known, *eqx.combine(wanted, given))
            return eqx.filter(after, eqx.is_inexact_array)

        _, pullback = jax.vjp(taken, before, wanted)
        cotangent, change = pullback(cotangent)
        return (before, cotangent, jax.tree.map(jnp.add, total, change)), None

    begin = numbers, eqx.filter(with_zeros(cotangent, end), eqx.is_inexact_array), jax.tree.map(jnp.zeros_like, wanted)
    (_, before, total), _ = jax.lax.scan(step_back, begin, inputs, reverse=True, unroll=unroll)
    return before, None, (None, None, total)  # None means zero, also where `before` and `total` have None


_run_reversibly.defvjp(_forward_pass, _backward_pass, symbolic_zeros=True)


def _identity(*leaves: Array) -> list[Array]:
    return list(leaves)


def _mark_tangents(primals: Any, tangents: Any) -> tuple[list[Any], list[Any]]:
    """Applies the primitive only to tangents that a reverse derivative will transpose."""
    moving = [tangent for tangent in tangents if not is_zero_tangent(tangent)]
    marked = iter(_forward_only.bind(*moving) if moving else [])
    return list(primals), [tangent if is_zero_tangent(tangent) else next(marked) for tangent in tangents]


def _no_transpose(cotangents: Any, *primals: Any) -> list[Any]:
    raise ValueError("adjoint=Forward() has no reverse derivative; use Checkpointed() or Reversible(), or jax.jacfwd.")


_forward_only = make_primitive(
    "forward_only",
    default=_identity,
    on_cpu=_identity,
    jvp=_mark_tangents,
    transpose=_no_transpose,
    batch=lambda values, axes: (_forward_only.bind(*values), axes),
)
