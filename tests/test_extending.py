"""What is written outside the package works as its own parts do, with no registration."""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from cases import quick

import midlie_jax as ml
from midlie_jax.cli import convergence, scenes

cp, half_turn = ml.flights.components, ml.flights.short_series.half_turn


class Explicit(ml.flights.Flight):
    """Turns by h times the angular velocity that one step of Euler's equations gives half way: order 2."""

    name: ClassVar[str] = "EXPLICIT"
    order: ClassVar[int | None] = 2
    symplectic: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False
    body: ClassVar[type] = ml.RigidBody
    per_loop: ClassVar[int] = 2

    def __call__(self, inertia, h, momentum):
        change = cp.cross(momentum, inertia.velocity(momentum))
        half_way = inertia.velocity(cp.add(momentum, cp.scale(h / 2, change)))
        w = cp.scale(h / 2, half_way)
        increment = cp.square(half_turn(w))
        return increment, cp.rotation_change(cp.conjugate(increment), momentum), cp.dot(w, w) <= 1


def test_a_flight_from_outside_keeps_the_laws_that_it_claims():
    scene, method = scenes.scene("free-asymmetric"), ml.method(Explicit(), "E1")
    assert (method.name, method.order, method.symmetric, method.symplectic) == ("EXPLICIT[E1]", 1, False, False)
    path = ml.integrate(method, scene.body, None, scene.start, dt=0.05, steps=200, save_every=20)
    assert path.ok
    momenta = np.asarray(ml.observe.spatial_momentum(path.states))
    np.testing.assert_allclose(momenta, np.tile(momenta[0], (len(momenta), 1)), atol=1e-13)
    many = ml.ensemble(method, scene.body, None, scenes.perturbed(scene, 3, 1e-3), dt=0.05, steps=200, save_every=20)
    np.testing.assert_allclose(many.states.attitude[0], path.states.attitude, atol=1e-13)
    rungs = [128, 256, 512]
    reference = convergence.find_reference(scene, 512)
    rows, _ = convergence.survey(scene, [ml.method(Explicit(), "EA")], rungs, reference)
    assert all(row.ok and not row.failure for row in rows)
    assert rows[-1].attitude_slope == pytest.approx(2, abs=0.1)

    class Other(Explicit):
        name: ClassVar[str] = "JACOBI"

    with pytest.raises(ValueError, match="flight 'JACOBI': midlie_jax has a flight of this name; choose another name"):
        ml.method(Other(), "EA")


@pytest.mark.sample(0)
def test_a_scheme_from_outside():
    """Verlet's method with the kick in two parts is the paper's."""
    kick, flight = ml.schemes.KICK, ml.schemes.FLIGHT
    stages = ((kick, 0.25), (kick, 0.25), (flight, 0.5), (flight, 0.5), (kick, 0.25), (kick, 0.25))
    scheme = ml.schemes.Scheme("parts", 2, stages, "this test")
    assert ml.schemes.measured_order(scheme) == pytest.approx(2, abs=0.05)
    scene = scenes.scene("P1")

    def end(method):
        path = ml.integrate(method, scene.body, scene.torque, scene.start, dt=0.005, steps=40, save_every=40)
        assert path.ok
        return path.states.attitude[-1]

    np.testing.assert_allclose(end(ml.method("JACOBI", scheme)), end(ml.method("JACOBI[EA]")), atol=1e-13)


def test_a_torque_from_outside():
    """A subclass of `Torque` with a potential: a spring that pulls the body's axis e3 towards space's."""

    class Spring(ml.torques.Torque):
        strength: float

        def __call__(self, t, state):
            up = ml.so3.to_matrix(state.attitude)[2]
            return 2 * self.strength * (1 - up[2]) * jnp.cross(jnp.array([0.0, 0.0, 1.0]), up)

        def potential(self, t, state):
            return self.strength * (1 - ml.so3.to_matrix(state.attitude)[..., 2, 2]) ** 2

    scene, torque = scenes.scene("asymmetric-top"), Spring(2.0)
    path = quick(
        lambda: ml.integrate("JACOBI[SRKN6b]", scene.body, torque, scene.start, dt=0.01, steps=200, save_every=20)
    )()
    energies = np.asarray(ml.observe.energy(scene.body, torque, path))
    assert path.ok
    assert np.ptp(energies) < 1e-6 * abs(energies[0])
    assert math.isfinite(energies[0])
