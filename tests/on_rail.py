"""A rigid body that slides along a rail, SO(3) x R: a custom body, leaf, state and flight, as a user writes them."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

import midlie_jax as ml

(Rotation,), jacobi = ml.RigidState.leaves, ml.flights.Jacobi()


class Constants(NamedTuple):
    rotation: ml.flights.Inertia
    per_mass: Array

    def velocity(self, momentum):
        return *self.rotation.velocity(momentum[:3]), self.per_mass * momentum[3]

    def commutator(self, force):
        return *self.rotation.commutator(force[:3]), jnp.zeros_like(force[3])

    def square_of_turn(self, h, momentum):
        return self.rotation.square_of_turn(h, momentum[:3])

    def nutation(self, momentum):
        return self.rotation.nutation(momentum[:3])


class OnRail(ml.base.Body):
    moments: Array
    mass: Array

    @property
    def batch(self):
        return self.mass.shape

    def inertia(self):
        return Constants(ml.RigidBody(self.moments).inertia(), 1 / self.mass)


class Sliding(ml.base.Leaf):
    """The momentum (Pi, p), (4,), and the pose (quaternion, x), (5,)."""

    @staticmethod
    def act(pose, increment, no_step=None):
        return *Rotation.act(pose[:4], increment[:4], no_step), pose[4] + increment[4]

    @staticmethod
    def rate(pose, velocity):
        return *Rotation.rate(pose[:4], velocity[:3]), velocity[3]

    @staticmethod
    def momentum_rate(momentum, velocity, force):
        return *Rotation.momentum_rate(momentum[:3], velocity[:3], force[:3]), force[3]


class OnRailState(ml.base.State):
    momentum: Array
    pose: Array
    body = OnRail
    leaves = (Sliding,)


class Slide(ml.flights.Flight):
    name, order, symplectic, body, per_loop = "SLIDE", None, True, OnRail, 1

    def __call__(self, inertia, h, momentum):
        rotation, change, ok = jacobi(inertia.rotation, h, momentum[:3])
        return (*rotation, h * inertia.per_mass * momentum[3]), (*change, jnp.zeros_like(h)), ok
