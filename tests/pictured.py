"""Motions that the tests of pictures draw, and what they read from files."""

import json

import jax.numpy as jnp
import numpy as np
from PIL import Image, ImageSequence

import midlie_jax as ml
from midlie_jax.plot.model import Panel, turnings

HALF, MASS = np.array([0.3, 0.2, 0.5]), 4.0  # the half sides of a brick
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
GRAVITY = ml.torques.UniformGravity([0.0, 0.0, -9.81])
TIMES = np.linspace(0.0, 2.0, 21)


def brick(scale=1.0):
    """A body that travels, with the moments of a brick of known sides."""
    square = (HALF * scale) ** 2
    return ml.FreeBody(ml.RigidBody(MASS / 3 * (square.sum() - square)), MASS)


def thrown(scale=1.0, speed=8.0, steps=40):
    """A brick that is thrown and tumbles."""
    body = brick(scale)
    spin = body.momentum(jnp.array([0.1, 2.0, 0.3]))
    start = ml.FreeState(spin, UPRIGHT, MASS * scale * jnp.array([speed, speed / 8, speed]), [0.0, 0.0, scale])
    force = ml.torques.UniformGravity(scale * GRAVITY.acceleration)
    return ml.integrate("JACOBI[EA]", body, force, start, dt=0.05, steps=steps)


def flight(count, speeds):
    """Bodies that spin about e3, each at its rate, and fly on straight lines: the exact motion without forces."""
    rates, places = np.linspace(0.5, 1.0, count), np.stack(3 * [np.arange(count, dtype=float)], axis=1)
    angle = TIMES[:, None] * rates / 2
    shape = (len(TIMES), count, 3)
    return {
        "momentum": np.broadcast_to(np.outer(rates, [0.0, 0.0, 0.04]), shape),
        "attitude": np.stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)], axis=-1),
        "linear": np.broadcast_to(speeds, shape),
        "position": places + TIMES[:, None, None] * speeds,
    }


def apart(count, kind=ml.CoupledState):
    """Coupled bodies that fly apart, and their path."""
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


def spun(path, i, k):
    """The rotation of one of coupled bodies at a saved state."""
    return np.asarray(ml.so3.to_matrix(path.states.attitude[k, i]))


def turning(body, path, axis, frames, most):
    """One body at the times of the frames."""
    return turnings([Panel("", body, path)], axis, frames, most)[0]


def frames_of(file):
    with Image.open(file) as picture:
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(picture)]


def figure_of(page):
    """Data, layout and frames, as the page gives them to plotly."""
    decoder, call = json.JSONDecoder(), page.rindex("Plotly.newPlot(")
    data, end = decoder.raw_decode(page, page.index("[", call))
    layout, _ = decoder.raw_decode(page, page.index("{", end))
    frames, _ = decoder.raw_decode(page, page.index("[", page.index("Plotly.addFrames(", end)))
    return data, layout, frames
