"""The scenes, and every published case reproduced by a converged run.

All methods so far have order 2, so published digits are reached by extrapolation. LIEMID[EA] is symmetric: its
error after a fixed time is a series in even powers of the step. It runs with `base` times 1, 2, 3, 4, 6, 8 and 12
steps, and the momentum and the rotation matrix at the end (of the normalised quaternion) are extrapolated to step
zero, entry by entry, as polynomials in h^2 (Romberg's method with Bulirsch and Stoer's sequence).

One compiled batch holds all steps of all cases with one kind of torque: the number of steps is that of the finest
run, and coarser runs, whose steps are longer, pass the end on the way and are read there.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import midlie_jax as ml
from midlie_jax import oracles, scenes

REFINEMENTS = (1, 2, 3, 4, 6, 8, 12)


class Case(NamedTuple):
    """A motion whose end is known."""

    body: ml.RigidBody
    torque: Any
    start: ml.RigidState
    duration: float


class End(NamedTuple):
    """What a converged run arrives at."""

    momentum: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray  # body frame


def free(moments, momentum, duration) -> Case:
    # CALGO's ex3 has moments that no mass distribution has.
    body = ml.RigidBody(jnp.array(moments), physical=False)
    return Case(body, None, ml.RigidState(jnp.array(momentum), jnp.array([1.0, 0.0, 0.0, 0.0])), duration)


def of_scene(name: str, duration: float | None = None) -> Case:
    scene = scenes.scene(name)
    # A body built here and one built with physical=False are the same pytree.
    return Case(scene.body, scene.torque, scene.start, duration or scene.duration)


CALGO_0 = (
    (1.0, 1.648785782711929, 1.9720127096641928),
    (-0.709894965287627, -0.685144717153487, 0.163174308075589),
    0.1,
)
CALGO_3 = (
    (1.0, 1.012686988782515, 3.306237422473038),
    (-0.609860759302936, 0.761660947972381, 0.218957654801698),
    10.0,
)


def cases(group: str) -> dict[str, Case]:
    """The cases that share one compiled run."""
    match group:
        case "free":
            return {
                "CALGO ex0": free(*CALGO_0),
                "CALGO ex3": free(*CALGO_3),
                "free-asymmetric": of_scene("free-asymmetric"),
                "dzhanibekov": of_scene("dzhanibekov"),
            } | {f"tumbling-brick {t}": of_scene("tumbling-brick", float(t)) for t in (10, 20, 30)}
        case "top":
            return {
                "P1 1": of_scene("P1", 1.0),
                "P1 10": of_scene("P1", 10.0),
                "P1-tilted": of_scene("P1-tilted"),
                "P2": of_scene("P2"),
                "slow-top": of_scene("slow-top"),
            }
        case "bruls-cardona":
            return {f"{group} {t}": of_scene(group, float(t)) for t in (1, 2)}
        case _:
            return {group: of_scene(group)}


# Steps of the coarsest run. As coarse as the series converges: rounding grows with the number of steps. The pulsed
# body's steps of 200 s / k end at both switches.
BASES = {"free": 144, "top": 500, "bruls-cardona": 250, "gravity-gradient": 144, "pulsed-body": 144}
GROUP = {name: group for group in BASES for name in cases(group)}


def extrapolation_weights() -> np.ndarray:
    """Of the runs, so that their sum is the polynomial in h^2 through them at h = 0."""
    x = [k**-2.0 for k in REFINEMENTS]
    return np.array([np.prod([b / (b - a) for b in x if b != a]) for a in x])


@cache
def ends(group: str) -> dict[str, End]:
    """The ends of all cases of a group."""
    named, base = cases(group), BASES[group]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *named.values())
    dt = batch.duration[:, None] / (base * jnp.array(REFINEMENTS, float))[None]

    def run(case: Case, dt):
        return ml.integrate(
            "LIEMID[EA]", case.body, case.torque, case.start, dt=dt, steps=base * max(REFINEMENTS), save_every=base
        )

    path = jax.jit(jax.vmap(jax.vmap(run, (None, 0))))(batch, dt)
    assert path.ok.all()
    momenta, attitudes = (
        np.stack([np.asarray(values)[:, run, kept] for run, kept in enumerate(REFINEMENTS)], axis=1)
        for values in (path.states.momentum, path.states.attitude)
    )
    attitudes /= np.linalg.norm(attitudes, axis=-1, keepdims=True)
    weights = extrapolation_weights()
    momentum = np.einsum("k,nki->ni", weights, momenta)
    rotation = np.einsum("k,nkij->nij", weights, ml.so3.to_matrix(jnp.asarray(attitudes)))
    velocity = momentum / np.asarray(batch.body.moments)
    return {name: End(momentum[i], rotation[i], velocity[i]) for i, name in enumerate(named)}


def end(name: str) -> End:
    return ends(GROUP[name])[name]


def worst(found, expected) -> float:
    return float(np.max(np.abs(np.asarray(found) - np.asarray(expected))))


# (case, published momentum, tolerance)
MOMENTA = [
    ("CALGO ex0", (-0.7088447919224319, -0.6905148054187735, 0.1439734852739128), 1e-13),
    ("CALGO ex3", (-0.7243786338874610, -0.6515663606923394, 0.2252484681001733), 1e-13),
    ("free-asymmetric", (1.76596250851821, -0.695464197033089, 0.779554981481871), 1e-12),
    ("P1 1", (-0.113617175760399, 0.184034282516356, 50), 1e-11),
    ("P1 10", (-0.153091997209136, 0.143264870866601, 50), 1e-11),
    ("P1-tilted", (-0.825255618261498, 0.772281645922085, 50), 1e-11),
    ("P2", (0.001294760157796, 0.008576777914099, 1.376331238882863), 1e-12),
]


@pytest.mark.parametrize(("name", "momentum", "tolerance"), MOMENTA)
def test_published_momentum(name, momentum, tolerance):
    assert worst(end(name).momentum, momentum) < tolerance


# (case, published third column of R, tolerance)
COLUMNS = [
    ("CALGO ex3", (-0.6484702022780026, -0.0046633029105, -0.7612257551892809), 2e-13),
    ("P1 1", (0.021541104974264, -0.050010335483372, 0.998516372996121), 1e-13),
    ("P1-tilted", (-0.274864608390022, 0.154741521010720, 0.948949160245105), 2e-12),
    ("P2", (0.055504854936289, 0.004308103862570, 0.998449123050047), 2e-13),
]


@pytest.mark.parametrize(("name", "column", "tolerance"), COLUMNS)
def test_published_third_axis(name, column, tolerance):
    assert worst(end(name).rotation[:, 2], column) < tolerance


P1_MOMENTUM = (-0.153091997209136, 0.143264870866601, 50)
P1_ROTATION = (
    (-0.880353208246793, 0.471971165950715, -0.0471322314419819),
    (-0.473439184662768, -0.880420266806675, 0.0267486863587099),
    (-0.0288715630929733, 0.0458625370775063, 0.998530450480797),
)


def test_published_attitude_of_the_fast_top():
    assert worst(end("P1 10").rotation, P1_ROTATION) < 2e-11


def test_published_energy_of_the_tilted_top():
    case = of_scene("P1-tilted")
    energy = ml.energy(case.body, case.torque, case.start)
    np.testing.assert_allclose(energy, 1269.10672978251, rtol=0, atol=6e-12)
