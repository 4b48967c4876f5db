"""Why a compensated P1 keeps a bias in float32, in two measurements, for docs/reports/rounding.md.

    python benchmarks/rounding_bias.py

SYMMETRIC turns attitude and momentum about the axis of the top by the same angle, with coefficients that are rounded
one by one. The spin is constant, so each of them is rounded alike in every step. First: by how much the two turns
differ in float32, for 16 tops like P1. Second: how far the vertical momentum drifts in float64 if the two turns are
made to differ by a given angle.
"""

from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np

import midlie_jax as ml
from midlie_jax.advice.timing import pin
from midlie_jax.cli import scenes
from midlie_jax.methods.flights import symmetric

jax.config.update("jax_enable_x64", True)
TOP, TOPS, DT = scenes.scene("P1"), 16, float(np.float32(0.005))
PHASES, TILT = 100_000, 0.1  # momenta across the axis, in all directions
IMPOSED, STEPS = (1e-8, 1e-6), 1_000_000


def differences():
    """For each top the mean angle by which the momentum turns further about the axis than the attitude."""
    body = ml.RigidBody(jnp.asarray(TOP.body.moments, jnp.float32))
    spins = np.asarray(scenes.perturbed(TOP, TOPS, 1e-3).momentum, np.float32)[:, 2]
    phase = 2 * np.pi * np.arange(PHASES) / PHASES
    across = TILT * np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    fly = jax.jit(jax.vmap(lambda p: symmetric.Symmetric()(body.inertia(), jnp.float32(DT), (p[0], p[1], p[2]))[:2]))
    for spin in spins:
        momenta = np.concatenate([across, np.full((PHASES, 1), spin)], axis=1).astype(np.float32)
        increments, changes = (np.stack([np.asarray(x, float) for x in parts], axis=-1) for parts in fly(momenta))
        increments /= np.linalg.norm(increments, axis=1, keepdims=True)
        ends = momenta + changes
        turned = np.asarray(ml.so3.rotate(ml.so3.conjugate(jnp.asarray(increments)), jnp.asarray(momenta, float)))
        sines = turned[:, 0] * ends[:, 1] - turned[:, 1] * ends[:, 0]
        yield float(np.mean(sines / np.sum(turned[:, :2] ** 2, axis=1)))


@contextmanager
def turning_further(angle):
    """While it is open, SYMMETRIC turns the momentum by so much more about the third axis than the attitude."""
    library = symmetric.Symmetric.formula

    def formula(self, inertia, h, momentum):
        flown = library(self, inertia, h, momentum)
        x, y = (p + c for p, c in zip(momentum[:2], flown.change[:2], strict=True))
        return flown._replace(change=(flown.change[0] - angle * y, flown.change[1] + angle * x, flown.change[2]))

    symmetric.Symmetric.formula = formula
    try:
        yield
    finally:
        symmetric.Symmetric.formula = library


def drift():
    """The change of the vertical momentum per step over the momentum: root mean square over the tops."""
    starts = scenes.perturbed(TOP, TOPS, 1e-3)
    path = ml.ensemble("SYMMETRIC[EA]", TOP.body, TOP.torque, starts, dt=DT, steps=STEPS, torque_axes=None)
    before, after = (np.asarray(ml.spatial_momentum(s))[:, 2] for s in (starts, path.states))
    return float(np.sqrt(np.mean(((after - before) / np.linalg.norm(starts.momentum, axis=1)) ** 2))) / STEPS


if __name__ == "__main__":
    pin()
    found = np.abs(list(differences()))
    print(f"float32: the turns of {TOPS} tops differ by {found.min():.1e} to {found.max():.1e} rad a step")
    for angle in IMPOSED:
        with turning_further(angle):
            jax.clear_caches()
            print(f"float64: a difference of {angle:g} rad drifts by {drift():.2e} of the momentum a step")
