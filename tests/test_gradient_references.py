"""Gradients against fifty digits: of ten thousand steps, and at points where formulas tend to fail.

    python tests/test_gradient_references.py [METHOD ...]

computes those of all symmetric methods, or of these, anew, in about two minutes each, and puts them into
`gradient_references.json`. The motion is regular: in a chaotic one rounding grows exponentially.
"""

# pyright: reportAttributeAccessIssue=false
# gmpy2 says nothing of its names to a type checker.
import json
import re
import sys
from functools import partial
from itertools import product
from pathlib import Path

import gmpy2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import METHODS, loop_bodies, quick, real, setup, suited, turn, whole
from fifty_digits import exact, in_fifty_digits

import midlie_jax as ml
from midlie_jax.drivers import derivatives
from midlie_jax.integrators import schemes
from midlie_jax.integrators.splitting import Splitting

FILE = Path(__file__).with_name("gradient_references.json")
STEPS = 10_000  # of methods with one or two flights a step; of others so many flights
NAMES = [method.name for method in METHODS if method.symmetric]
GROUPS = ("moments", "weight", "momentum", "attitude", "dt")
CASE = setup(moments=[2.0, 2.2, 2.5], weight=0.3)
WEIGHTS = np.array([0.3, -1.1, 0.7, 0.9, -0.4, 0.6, 1.3])
DIFFERENCE = gmpy2.mpfr("1e-25")


def run_of(name):
    method = ml.method(name)
    flights = sum(kind == schemes.FLIGHT for kind, _ in method.scheme.stages) if isinstance(method, Splitting) else 1
    # Divisible by the hundred steps between the states that an adjoint keeps.
    save_every = STEPS // 4 // (1 if flights <= 2 else flights) // 100 * 100
    return {"steps": 4 * save_every, "save_every": save_every}


def parameters(name):
    """The arguments of `loss`, in the order of `GROUPS`."""
    return np.asarray(suited(name, jnp.asarray(CASE.moments))), CASE.weight, CASE.momentum, CASE.attitude, CASE.dt


def directions():
    """For each group the direction in which it is moved, alone."""
    random = np.random.default_rng(7)
    return [random.uniform(0.5, 1.5, np.shape(getattr(CASE, group))) for group in GROUPS]


def values(name, moments, weight, momentum, attitude, dt, *, axis=(0.0, 0.0, 1.0), adjoint=None, **run):
    """Momentum and attitude of every saved state, (rows, 7)."""
    torque = ml.torques.HeavyTop(weight, axis)
    start = ml.RigidState(momentum, attitude)
    run = run or run_of(name)
    states = ml.integrate(name, ml.RigidBody(moments), torque, start, dt=dt, adjoint=adjoint, **run).states
    return jnp.concatenate([states.momentum, states.attitude], axis=-1)


def total(found):
    """One number that depends on every entry of every saved state, from `values` in any arithmetic."""
    return ((found + found * found) @ WEIGHTS.astype(found.dtype)).sum()


def loss(name, *given, **run):
    return total(values(name, *given, **run))


def reference(name, **run):
    """A function of `parameters` with the derivatives of the loss along `directions`, in fifty digits."""
    # SYMMETRIC moves bodies with two equal moments alone; its derivatives are those of the exact flight of any body.
    moves_any_body = name.replace("SYMMETRIC", "JACOBI")
    run = run or run_of(name)
    run_exactly = in_fifty_digits(partial(values, moves_any_body, **run), *parameters(name))

    def exact_loss(*given):
        return total(run_exactly(*given)[0])

    def slopes(given):
        given = [exact(x) for x in given]
        value = exact_loss(*given)
        for k, direction in enumerate(directions()):
            moved = [x + DIFFERENCE * exact(direction) if k == j else x for j, x in enumerate(given)]
            yield (exact_loss(*moved) - value) / DIFFERENCE

    return slopes


def stored():
    return json.loads(FILE.read_text()) if FILE.exists() else {}


ADJOINTS = {
    "Checkpointed": ml.adjoints.Checkpointed(),
    "Reversible": ml.adjoints.Reversible(),
    "Forward": ml.adjoints.Forward(),
}
TAKEN = [("SYMMETRIC[EA]", "Checkpointed"), ("JACOBI[EA]", "Reversible"), ("LIEMID[I]", "Forward")]
LEFT = [(name, adjoint) for name in NAMES for adjoint in ADJOINTS if (name, adjoint) not in TAKEN]


def slopes(name, adjoint, given, **run):
    own = partial(loss, name, adjoint=adjoint, **run)
    moves = [jnp.asarray(m, x.dtype) for m, x in zip(directions(), given, strict=True)]
    if isinstance(adjoint, ml.adjoints.Forward):
        seeds = [tuple(m if i == k else jnp.zeros_like(m) for i, m in enumerate(moves)) for k in range(len(moves))]
        seeds = jax.tree.map(lambda *x: jnp.stack(x), *seeds)
        return jax.vmap(lambda seed: jax.jvp(own, given, seed)[1])(seeds)
    gradient = jax.grad(own, argnums=tuple(range(len(moves))))(*given)
    return jnp.stack([jnp.sum(g * m) for g, m in zip(gradient, moves, strict=True)])


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "adjoint"), [*TAKEN, *whole(*LEFT)])
def test_gradients_of_ten_thousand_steps_equal_fifty_digits(name, adjoint):
    expected = stored()[name]
    given = arrays(name)
    found = quick(partial(slopes, name, ADJOINTS[adjoint]))(given)
    for group, slope in zip(GROUPS, found, strict=True):
        assert abs(slope - float(expected[group])) <= 1e-9 * abs(float(expected[group])), group


SHORT = {"steps": 32, "save_every": 16}
AT_REST = [0.0, 0.0, 0.0]
POINTS = {
    "a generic point": {},
    "no momentum": {"momentum": AT_REST},
    "no torque": {"weight": 0.0},
    "nothing moves": {"momentum": AT_REST, "weight": 0.0},
    "a sphere": {"moments": [2.0, 2.0, 2.0]},
    "two equal moments": {"moments": [2.0, 2.0, 3.5]},
    "attitude of no turn": {"attitude": turn(0.0, 0.0, 0.0)},
    "spin about an axis of symmetry": {"moments": [2.0, 2.0, 3.5], "momentum": [0.0, 0.0, 1.5]},
}
FEW = [("SYMMETRIC[EA]", "Reversible"), ("JACOBI[EA]", "Checkpointed")]
REST = [(name, adjoint) for name in NAMES for adjoint in ADJOINTS if (name, adjoint) not in FEW]


def point(name, changes):
    given = dict(zip(GROUPS, parameters(name), strict=True)) | changes
    given["moments"] = suited(name, np.asarray(given["moments"]))
    return tuple(np.asarray(given[group], np.float64) for group in GROUPS)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "adjoint"), [*FEW, *whole(*REST)])
def test_gradients_equal_fifty_digits_where_formulas_tend_to_fail(name, adjoint):
    points = [point(name, changes) for changes in POINTS.values()]
    batch = tuple(jnp.asarray(np.stack(column)) for column in zip(*points, strict=True))
    found = quick(jax.vmap(partial(slopes, name, ADJOINTS[adjoint], **SHORT)))(batch)
    exact_slopes = reference(name, **SHORT)
    for label, given, row in zip(POINTS, points, found, strict=True):
        expected = np.array([float(x) for x in exact_slopes(given)])
        assert np.all(abs(row - expected) <= 1e-12 * (1 + abs(expected))), label


def test_every_symmetric_method_has_stored_references():
    assert sorted(stored()) == sorted(NAMES)


# A million steps; and a gradient in float32. Regular motions, Lagrange's top.
@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "steps", "bound"), [("float64", 1_000_000, 1e-6), ("float32", 10_000, 1e-3)])
def test_the_gradient_of_a_long_way_back(dtype, steps, bound):
    name = "SYMMETRIC[EA]"
    run = {"steps": steps, "save_every": steps}
    given = arrays(name)
    expected = real(partial(slopes, name, ml.adjoints.Checkpointed(every=1000), **run))(given)
    back = real(partial(slopes, name, ml.adjoints.Reversible(), **run))
    found = back(tuple(x.astype(dtype) for x in given)).astype(float)
    assert np.all(abs(found - expected) <= bound * abs(expected))


# ---- what a choice of `adjoint=` costs in memory, and its limits; test_paths.py has the derivatives ----


def arrays(name):
    return tuple(map(jnp.asarray, parameters(name)))


def lost(name, adjoint, given, steps=48, save_every=16):
    return loss(name, *given, adjoint=adjoint, axis=(0.48, 0.6, 0.64), steps=steps, save_every=save_every)


@pytest.mark.sample(0)
@pytest.mark.parametrize(("dtype", "bound"), [("float64", 4e-9), ("float32", 1.4e-3)])
def test_the_way_back_between_two_kept_states_is_right_to_the_stated_bound(dtype, bound):
    """Of tops that turn by up to a radian a step, over the longest distance that `Reversible` takes by itself."""
    steps = derivatives._FARTHEST[dtype]
    spins = jnp.linspace(0.2, 1.0, 64).astype(dtype)

    def there_and_back(spin):
        body, torque = ml.RigidBody(jnp.array([2.0, 2.0, 1.2], dtype)), ml.torques.HeavyTop(jnp.asarray(0.01, dtype))
        start = ml.RigidState(jnp.array([0.3, 0.2, 1.2], dtype) * spin, ml.so3.exp(jnp.array([0.5, 0.2, 0.0], dtype)))
        run = {"steps": steps, "save_every": steps}
        there = ml.integrate("SYMMETRIC[EA]", body, torque, start, dt=jnp.asarray(0.95, dtype), **run)
        end = jax.tree.map(lambda x: x[-1], there.states)
        back = ml.integrate("SYMMETRIC[EA]", body, torque, end, dt=jnp.asarray(-0.95, dtype), **run)
        pair = (back.states.attitude[-1].astype(float), start.attitude.astype(float))
        return ml.so3.log(ml.so3.multiply(ml.so3.conjugate(pair[1]), pair[0])), there.ok & back.ok

    turns, ok = real(jax.vmap(there_and_back))(spins)
    assert jnp.all(ok)
    assert jnp.linalg.norm(turns, axis=1).max() <= bound


@pytest.mark.sample(0)
def test_memory_of_the_way_back_does_not_grow_with_the_steps():
    def memory(adjoint, steps):
        gradient = jax.grad(partial(lost, "SYMMETRIC[EA]", adjoint, steps=steps, save_every=steps))
        return quick(gradient).lower(arrays("SYMMETRIC[EA]")).compile().memory_analysis().temp_size_in_bytes

    least = memory(ml.adjoints.Reversible(), 1600)
    assert memory(ml.adjoints.Reversible(), 160_000) <= 1.1 * least
    every_step = memory(ml.adjoints.Checkpointed(every=1), 160_000)
    assert every_step >= 50 * least
    assert memory(ml.adjoints.Checkpointed(every=400), 160_000) <= every_step / 50
    # By default a state of ten numbers every 100 steps, and the seven that each step between two of them needs.
    assert memory(ml.adjoints.Checkpointed(), 160_000) <= every_step / 30
    assert memory(ml.adjoints.Checkpointed(), 1024) == memory(ml.adjoints.Checkpointed(every=1), 1024)
    assert memory(ml.adjoints.Checkpointed(), 1600) < memory(ml.adjoints.Checkpointed(every=1), 1600)


def test_the_steps_between_two_kept_states_divide_those_between_two_saved_ones():
    """Of a state of ten numbers, in a long run; a run of 1024 steps keeps all states."""
    for save_every, every in ((1024, 64), (2000, 100), (103, 103), (7, 1), (10_007, 1), (8, 8)):
        assert derivatives._every(save_every, 20_000, 10) == every
        assert derivatives._every(save_every, 1024, 10) == 1


@pytest.mark.parametrize(
    ("method", "torque", "adjoint", "message"),
    [
        ("RK4", None, ml.adjoints.Reversible(), "RK4 is not one"),
        ("JACOBI[EA]", lambda t, state: -state.momentum, ml.adjoints.Reversible(), "does not read the momentum"),
        ("JACOBI[EA]", None, ml.adjoints.Reversible(every=5), r"save_every \(16\) must be divisible by every \(5\)"),
        ("JACOBI[EA]", None, ml.adjoints.Checkpointed(every=3), r"save_every \(16\) must be divisible by every \(3\)"),
    ],
)
def test_what_has_no_derivative_is_refused(method, torque, adjoint, message):
    start = ml.RigidState(jnp.array([1.0, 0.8, -1.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    run = {"dt": 0.01, "steps": 32, "save_every": 16, "adjoint": adjoint}
    with pytest.raises(ValueError, match=message):
        ml.integrate(method, ml.RigidBody([1.0, 2.0, 2.5]), torque, start, **run)


@pytest.mark.sample(0)
def test_every_is_a_positive_integer():
    for adjoint, every in product((ml.adjoints.Checkpointed, ml.adjoints.Reversible), (0, -1, True)):
        with pytest.raises(ValueError, match="every must be a positive"):
            adjoint(every=every)
    with pytest.raises(ValueError, match="has no reverse derivative"):
        jax.grad(partial(lost, "SYMMETRIC[EA]", ml.adjoints.Forward()))(arrays("SYMMETRIC[EA]"))


BATCH = 1003  # a number that nothing else in the program has


@pytest.mark.sample(0)
@pytest.mark.parametrize(("name", "loops", "shared"), [("SYMMETRIC[EA]", 1, True), ("JACOBI[EA]", 2, False)])
def test_the_reverse_derivative_of_a_step_is_few_loops(name, loops, shared):
    """Without those that only add up what a step contributes to the derivatives of parameters."""
    moments, weight, _, *rest = arrays(name)

    def end(parts, momentum):
        return lost(name, ml.adjoints.Checkpointed(), (*parts, momentum, *rest), steps=8, save_every=8)

    def of_each(momenta):
        return jax.vmap(jax.grad(end), (None, 0))((moments, weight), momenta)

    def of_all(momenta):
        return jax.grad(lambda parts: jnp.sum(jax.vmap(end, (None, 0))(parts, momenta)))((moments, weight))

    momenta = jnp.asarray(CASE.momentum * np.linspace(0.9, 1.1, BATCH)[:, None])
    text = real(of_all if shared else of_each).lower(momenta).compile().as_text()
    assert not any(re.search(rf" = f64\[\]\S* .*(fusion|reduce)\(.*{BATCH}", body) for body in loop_bodies(text))
    fused = [re.findall(rf"%([a-z_]+)_fusion\S* = .*\[{BATCH}\].* fusion\(", body) for body in loop_bodies(text)]
    assert max(fusions.count("broadcast_reduce") for fusions in fused) <= 2 * loops
    # What is not: sums, and copies of kept states.
    others = {"broadcast_reduce", "add_add", "bitcast_dynamic-update-slice"}
    assert max(len([name for name in fusions if name not in others]) for fusions in fused) <= 6


def main(names):
    for name in names or NAMES:
        slopes = list(reference(name)(parameters(name)))
        known = stored() | {name: {group: f"{x:.25g}" for group, x in zip(GROUPS, slopes, strict=True)}}
        FILE.write_text(json.dumps(known, indent=2, sort_keys=True) + "\n")
        print(name, *(f"{x:.6g}" for x in slopes), flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(sys.argv[1:])
