"""Checks that a body, a state and a torque are valid and compatible, made before tracing."""

from dataclasses import fields
from typing import Any

import equinox as eqx
import jax

from .._checks.arguments import described, other_arguments
from .baths.base import HeatBath
from .bodies import principal_of
from .free_body import FreeBody
from .state import AnyState, State
from .torques import Torque, terms_of


def check_state(name: str, state: Any) -> None:
    if not isinstance(state, State):
        raise ValueError(f"{name} must be a state such as midlie_jax.RigidState, got {described(state)}.")
    for field in fields(state):
        value = getattr(state, field.name)
        if isinstance(value, list | tuple | float | int):
            raise ValueError(f"{name}.{field.name} must be an array, got {described(value)}; use jnp.array(...).")
    state.__check_init__()


def check_body(body: Any, state: AnyState) -> None:
    if not state.belongs_to(principal_of(body)):
        kind, rotation = state.body.__name__, getattr(state, "rotation", None)
        of = f" of a {rotation.body.__name__}" if rotation is not None and isinstance(body, FreeBody) else ""
        own = isinstance(body, eqx.Module) or not state.body.__module__.startswith("midlie_jax.")
        cure = order_cure(body) or ("" if own else f"; make one with {state.body.namespace}.{kind}")
        raise ValueError(f"a {type(state).__name__} belongs to a {kind}{of}, but body is {body_named(body)}{cure}.")


def check_custom(name: str, body: Any, state: AnyState) -> None:
    package = __name__.split(".")[0]
    own = all(type(x).__module__.split(".")[0] == package for x in (body, state))
    if own or state.own_axes != 1 or state.several:
        return
    translation = fields(state)[state.leaves[0].arrays :] if len(state.leaves) > 1 else ()
    for field in translation:
        size = getattr(state, field.name).shape[-1:]
        if size != (3,):
            raise ValueError(
                f"{name}.{field.name} must have shape (3,), got {size}. Put variables other than a translation in "
                "space into the first leaf."
            )
    arrays, rest = eqx.partition(body, eqx.is_array)

    def found(arrays: Any, state: AnyState) -> Any:
        momentum, pose = state.parts()
        velocity = eqx.combine(arrays, rest).in_principal_axes().inertia().velocity(momentum)
        return (velocity, momentum), (state.kind.rate(pose, velocity), pose)

    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[-1:], x.dtype), state)
    arrays = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[len(body.batch) :], x.dtype), arrays)
    velocities, rates = jax.eval_shape(found, arrays, one)
    kind = type(body).__name__
    for what, like, (value, wanted), cure in (
        ("velocity", "momentum", velocities, f"If each body has its own row, define the property {kind}.batch."),
        ("rate", "pose", rates, "Define `rate` of the leaf, or correct the shapes of the state."),
    ):
        got, must = ([leaf.shape for leaf in jax.tree.leaves(tree)] for tree in (value, wanted))
        if got != must:
            shape = "" if set(got) == {()} else f" of shape {max(got)}"
            raise ValueError(
                f"the {what} of {kind} must be {len(must)} scalars like the {like} of the state, got {len(got)} "
                f"numbers{shape}. {cure}"
            )


def order_cure(body: Any) -> str:
    return "; the body comes before the torque" if isinstance(body, Torque) else ""


def body_named(body: Any) -> str:
    return f"FreeBody of a {type(body.body).__name__}" if isinstance(body, FreeBody) else described(body)


def check_torque(torque: Any) -> None:
    if torque is not None and not callable(torque):
        cure = " Pass a heat bath as bath=." if isinstance(torque, HeatBath) else ""
        raise ValueError(f"torque must be None or a callable of (t, state), got {described(torque)}.{cure}")
    for term in terms_of(torque):
        arguments = other_arguments(term, 2)
        if arguments is None:
            continue
        cure = {
            1: "for a torque of time alone use midlie_jax.torques.Prescribed(function).",
            3: "for a function of (t, state, body) use midlie_jax.torques.BodyTorque(function).",
        }
        raise ValueError(
            f"torque must be a callable of (t, state), got one of ({', '.join(arguments)}); "
            f"{cure.get(len(arguments), 'bind the other arguments with functools.partial.')}"
        )


def check_batch(name: str, body: Any, state: AnyState, batch: int = 0) -> None:
    """Raises unless the state has `batch` leading axes, and the body at most as many."""
    if not state.own_axes:
        body.check_shape(name, state.momentum.shape, batch)
        return
    if state.several:
        _check_several(name, body, state, batch)
        return
    momentum, axes_of_momentum = state.momentum.shape, len(state.batch)
    moments = "body.moments" if body.in_principal_axes() is body else "body.principal.moments"
    shapes = ((moments, (*body.batch, 3), len(body.batch), 0), (f"{name}.momentum", momentum, axes_of_momentum, batch))
    for argument, shape, axes, least in shapes:
        if not least <= axes <= batch:
            wanted, cure = (
                "(3,)",
                "use midlie_jax.ensemble or jax.vmap for many bodies, a CoupledState for coupled bodies",
            )
            if batch:
                wanted, cure = "(n, 3)", "stack the states of the bodies, or use midlie_jax.integrate for one"
            raise ValueError(f"{argument} must be {wanted}, got {shape}; {cure}.")


def _check_several(name: str, body: Any, state: Any, batch: int) -> None:
    axes, count = len(state.batch), state.count
    if axes != batch:
        wanted, cure = "(N, 3)", "map over replicas with jax.vmap, or use midlie_jax.ensemble"
        if batch:
            wanted, cure = "(n, N, 3)", "stack the states of the replicas, or use midlie_jax.integrate for one"
        raise ValueError(f"{name}.momentum must be {wanted}, got {state.momentum.shape}; {cure}.")
    shape = body.batch
    if shape and (shape[-1] != count or len(shape) > 1 + batch):
        wanted = f"() or ({count},)" + (f" or (n, {count})" if batch else "")
        raise ValueError(f"body holds {shape} bodies, but {name} holds N = {count}; give leading axes {wanted}.")
