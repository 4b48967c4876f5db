"""Motions that the tests of pictures draw."""

import jax.numpy as jnp
import numpy as np

import midlie_jax as ml

MASS, UPRIGHT = 4.0, [1.0, 0.0, 0.0, 0.0]
GRAVITY = ml.torques.UniformGravity([0.0, 0.0, -9.81])
TIMES = np.linspace(0.0, 2.0, 21)


def brick():
    """A body that travels, with the moments of a brick of half sides 0.3, 0.2 and 0.5."""
    return ml.FreeBody(ml.RigidBody(MASS / 3 * np.array([0.29, 0.34, 0.13])), MASS)


def thrown():
    spin = brick().momentum(jnp.array([0.1, 2.0, 0.3]))
    start = ml.FreeState(spin, UPRIGHT, MASS * jnp.array([8.0, 1.0, 8.0]), [0.0, 0.0, 1.0])
    return ml.integrate("JACOBI[EA]", brick(), GRAVITY, start, dt=0.05, steps=40)


def flight(count, speeds):
    """Bodies that spin about e3, each at its rate, and fly on straight lines: the exact motion without forces."""
    rates, places = np.linspace(0.5, 1.0, count), np.stack(3 * [np.arange(count, dtype=float)], axis=1)
    angle, shape = TIMES[:, None] * rates / 2, (len(TIMES), count, 3)
    return {
        "momentum": np.broadcast_to(np.outer(rates, [0.0, 0.0, 0.04]), shape),
        "attitude": np.stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)], axis=-1),
        "linear": np.broadcast_to(speeds, shape),
        "position": places + TIMES[:, None, None] * speeds,
    }


def apart(count, kind=ml.CoupledState):
    body = ml.FreeBody(ml.RigidBody(np.tile([0.02, 0.03, 0.04], (count, 1))), np.ones(count))
    places = np.stack(3 * [np.arange(count, dtype=float)], axis=1)
    arrays = flight(count, places - places.mean(axis=0) + 0.1)
    states = kind(*(arrays[name] for name in kind.described()))
    path = ml.Path(jnp.asarray(TIMES), states, jnp.asarray(True), jnp.asarray(len(TIMES)), jnp.asarray(0))
    return body if kind is ml.CoupledState else body.body, path


def fleet(count, speed=1.0):
    """The path of bodies without interaction, as `ensemble` returns it."""
    arrays = flight(count, np.tile([speed, -0.5 * speed, 0.0], (count, 1)))
    states = ml.FreeState(*(jnp.asarray(arrays[name]).swapaxes(0, 1) for name in ml.FreeState.described()))
    return ml.Path(jnp.asarray(TIMES), states, jnp.ones(count, bool), jnp.full(count, 21), jnp.zeros(count, int))
