"""heyoka on the seven equations of a whole spinning top, where only its axis is asked for.

It shows what a program pays for the spin, which the axis does not need.
"""

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp

from midlie_jax.cli.scenes import Scene
from midlie_jax.model.bodies import RigidBody
from midlie_jax.model.rotor import SymmetricRotor

from ..kinds.axis import SPINNING
from . import heyoka_taylor
from .problem import Point, Problem

LABEL = "heyoka, with the spin"


def whole(problem: Problem) -> Problem:
    """The problem of the axis, to be solved with momentum and attitude in the body frame."""
    scene: Any = problem.scene
    starts: Any = problem.starts
    rotor = scene.body
    moments = jnp.stack([rotor.moment, rotor.moment, rotor.known_along])
    start = scene.start.with_attitude()
    as_body = Scene(
        *(scene.name, scene.title, RigidBody(moments), scene.torque, start),
        *(scene.dt, scene.duration, scene.source, scene.units),
    )
    return problem._replace(scene=as_body, kind=SPINNING, starts=starts.with_attitude())


def measure(problem: Problem) -> Iterator[Point]:
    """A point for each tolerance; none where the state is not an axis."""
    if isinstance(problem.scene.body, SymmetricRotor):
        yield from heyoka_taylor.measure(whole(problem), label=LABEL)
