"""A body that also travels, with a state of 13 numbers and a flight, as a user of the package would write them."""

from typing import NamedTuple

from jax import Array

import midlie_jax as ml

cp = ml.flights.components
Turn = ml.RigidState  # whose arithmetic of attitudes serves here, too


class Momenta(NamedTuple):
    angular: cp.Vector
    linear: cp.Vector


class Place(NamedTuple):
    attitude: cp.Quaternion
    position: cp.Vector


class Constants(NamedTuple):
    rotation: ml.flights.Inertia
    mass: Array

    def velocity(self, momentum):
        return Momenta(self.rotation.velocity(momentum.angular), cp.scale(1 / self.mass, momentum.linear))

    def commutator(self, force):
        return Momenta(self.rotation.commutator(force.angular), cp.scale(0, force.linear))

    def square_of_turn(self, h, momentum):
        return self.rotation.square_of_turn(h, momentum.angular)

    def nutation(self, momentum):
        return self.rotation.nutation(momentum.angular)


class Traveller(ml.Body):
    moments: Array
    mass: Array

    def inertia(self):
        return Constants(ml.flights.Inertia.of(self), self.mass)


class Travel(ml.flights.Flight):
    name, order, symplectic, body, per_loop = "TRAVEL", None, True, Traveller, 2
    turning = ml.flights.Jacobi()

    def __call__(self, inertia, h, momentum):
        turn, change, ok = self.turning(inertia.rotation, h, momentum.angular)
        travel = cp.scale(h / inertia.mass, momentum.linear)
        return Place(turn, travel), Momenta(change, cp.scale(0, momentum.linear)), ok


class Travelling(ml.State):
    momentum: Array
    attitude: Array
    linear: Array
    position: Array
    body = Traveller

    def parts(self):
        momenta = Momenta(cp.vector(self.momentum), cp.vector(self.linear))
        return momenta, Place(cp.quaternion(self.attitude), cp.vector(self.position))

    @classmethod
    def join(cls, momentum, pose):
        return cls(*map(cp.pack, (momentum.angular, pose.attitude, momentum.linear, pose.position)))

    @staticmethod
    def rotate(pose, increment):
        return Place(Turn.rotate(pose.attitude, increment.attitude), cp.add(pose.position, increment.position))

    @staticmethod
    def turn(pose, increment, no_step):
        return Place(Turn.turn(pose.attitude, increment.attitude, no_step), cp.add(pose.position, increment.position))

    @staticmethod
    def rate(pose, velocity):
        return Place(Turn.rate(pose.attitude, velocity.angular), velocity.linear)

    @staticmethod
    def momentum_rate(momentum, velocity, force):
        return Momenta(cp.add(cp.cross(momentum.angular, velocity.angular), force.angular), force.linear)
