"""A body that also travels, with a state of 13 numbers and a flight, as a user of the package would write them."""

from jax import Array

import midlie_jax as ml


class Traveller(ml.base.Body):
    moments: Array
    mass: Array

    def inertia(self):
        return ml.FreeBody(ml.RigidBody(self.moments), self.mass).inertia()


class Travelling(ml.base.State):
    momentum: Array
    attitude: Array
    linear: Array
    position: Array
    body = Traveller
    leaves = ml.FreeState.leaves


class Travel(ml.flights.Jacobi):
    name, body = "TRAVEL", Traveller
