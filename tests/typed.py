"""Uses of the package that type checkers must accept: `make lint` checks them, and `test_schemes.py` runs them."""

# pyright: strict, reportCallIssue=true, reportArgumentType=true, reportUnnecessaryTypeIgnoreComment=true

from pathlib import Path
from typing import Any, ClassVar, assert_type

from jax import Array

import midlie_jax as ml


class Slow(ml.flights.Jacobi):
    name: ClassVar[str] = "SLOW"


flights = ml.flights.names()
schemes = ml.schemes.names()
names: list[str] = [*flights, *schemes]
uses: dict[str, str] = flights.uses | schemes.uses
fastest: ml.flights.Flight = ml.flights.Jacobi()
assert_type(ml.schemes.EA, ml.schemes.Scheme)
assert_type(ml.schemes.measured_order(ml.schemes.EA), float)
methods = [ml.method(fastest, ml.schemes.SRKN6B), ml.method(ml.flights.FLIGHTS["DLM"], "EA")]


def states_of_runs(
    body: ml.RigidBody,
    momentum: ml.MomentumState,
    direction: ml.DirectionState,
    rigid: ml.RigidState,
    compensated: ml.CompensatedState,
) -> None:
    """Every driver returns states of the class of the start."""
    assert_type(ml.integrate("JACOBI[EA]", body, None, momentum, dt=0.1, steps=2).states, ml.MomentumState)
    assert_type(ml.integrate("JACOBI[EA]", body, None, direction, dt=0.1, steps=2).states, ml.DirectionState)
    assert_type(ml.integrate("JACOBI[EA]", body, None, rigid, dt=0.1, steps=2).states, ml.RigidState)
    assert_type(ml.integrate("JACOBI[EA]", body, None, compensated, dt=0.1, steps=2).states, ml.CompensatedState)
    path = ml.integrate("JACOBI[EA]", body, None, rigid, dt=0.1, steps=2)
    assert_type(path, ml.Path[ml.RigidState])
    assert_type(path._replace(ok=path.ok), ml.Path[ml.RigidState])
    assert_type(path[1], ml.RigidState)
    assert_type(ml.ensemble("JACOBI[EA]", body, None, direction, dt=0.1, steps=2), ml.Path[ml.DirectionState])
    assert_type(ml.free_motion(body, momentum, [0.0, 1.0]), ml.Path[ml.MomentumState])
    assert_type(ml.fitting.states_at("JACOBI[EA]", body, None, rigid, [0.0], dt=0.1).states, ml.RigidState)
    adaptive = ml.integrate_variable_step("JACOBI[EA]", body, None, rigid, density=_density, dt=0.1, steps=2)
    assert_type(adaptive, ml.Path[ml.RigidState])
    run = ml.simulate("JACOBI[EA]", body, None, compensated, out=Path("run.npz"), dt=0.1, steps=2)
    assert_type(run.states(), ml.CompensatedState)


def what_is_observed(body: ml.RigidBody, start: ml.RigidState) -> None:
    """It can be anything, and takes the place of the states."""
    path = ml.integrate("JACOBI[EA]", body, None, start, dt=0.1, steps=2, observe=ml.observe.angular_velocity)
    assert_type(path, ml.Path[Any])
    together = {"energy": ml.observe.energy, "spin": _spin}
    assert_type(ml.ensemble("JACOBI[EA]", body, None, start, dt=0.1, steps=2, observe=together), ml.Path[Any])


def what_takes_paths(axes: Any, body: ml.RigidBody, turning: ml.Path[ml.CompensatedState]) -> None:
    """A path of a subclass is a path of the class."""
    ml.plot.axis_path(axes, turning)
    ml.plot.view(body, {"one": turning})
    ml.observe.energy(body, None, turning)
    ml.observe.spatial_momentum(turning.states)
    crossings = ml.plot.poincare(axes, turning, lambda t, s: s.momentum[0], _spin, _spin)
    assert_type(crossings.states, ml.CompensatedState)


def _spin(t: Any, state: ml.RigidState) -> Array:
    return state.momentum[2]


def _density(t: Any, state: ml.RigidState) -> Array:
    return 1 + state.momentum[2] ** 2


def what_is_refused(axes: Any, body: ml.RigidBody, spinning: ml.Path[ml.MomentumState]) -> None:
    """Where a state has no attitude; strict pyright says so if one of these is not an error."""
    ml.plot.axis_path(axes, spinning)  # pyright: ignore[reportArgumentType]
    ml.plot.view(body, spinning)  # pyright: ignore[reportArgumentType]
    ml.plot.poincare(axes, spinning, _spin, _spin, _spin)  # pyright: ignore[reportArgumentType]
    ml.plot.polhode(axes, ml.Particles(1.0), spinning)  # pyright: ignore[reportArgumentType]
