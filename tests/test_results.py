"""What drivers return: `path.result` says why a run failed; a path is a named tuple, a table and a dataset."""

import pickle
import typing
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from beartype import beartype
from beartype.roar import BeartypeCallHintParamViolation
from cases import CLASSES, DTYPES, each, equal_moments, quick
from jaxtyping import jaxtyped
from path_scenes import STATES
from scipy.io import netcdf_file
from scipy.spatial.transform import Rotation

import midlie_jax as ml
from midlie_jax import RESULTS

TOP = ml.torques.HeavyTop(20.0)
FAST = ml.RigidState([0.0, 0.0, 50.0], ml.so3.exp(jnp.array([0.05, 0.0, 0.0])))


def moments(name):
    return ml.RigidBody([5.0, 5.0, 1.0] if equal_moments(name) else [5.0, 4.0, 1.5])


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", each(few=CLASSES))
def test_a_step_that_is_too_long_and_a_number_that_is_not_finite_are_told_apart(name):
    """However many steps follow before a state is saved, by when all numbers may be anything."""
    too_far, solves = 1.5 * ml.method(name).reach / 30, ml.method(name).solves > 0
    cases = jnp.array([1e-3, too_far, 1e-3]), jnp.array([0.0, 0.0, jnp.nan])  # the step, and the torque from 0.025 on

    def run(dt, later, save_every):
        torque = TOP + jax.tree_util.Partial(lambda x, t, s: jnp.where(t > 0.025, x, 0.0) * jnp.ones(3), later)
        return ml.integrate(name, moments(name), torque, FAST, dt=dt, steps=40, save_every=save_every).result

    for every in (1, 40):
        found = quick(jax.vmap(partial(run, save_every=every)))(*cases)
        good, far, bad = (jax.tree.map(lambda x, i=i: x[i], found) for i in range(3))
        assert good == RESULTS.successful
        assert (far == RESULTS.beyond_reach) | (solves & (far == RESULTS.not_solved))
        assert (bad == RESULTS.not_finite) | (solves & (bad == RESULTS.not_solved))  # which a solve meets itself


@pytest.mark.sample(0)
def test_other_drivers_have_reasons_of_their_own():
    body = moments("SYMMETRIC[EA]")
    count = jax.jit(lambda first: ml.integrate("SYMMETRIC[EA]", body, None, FAST, dt=1e-3, steps=4, first_step=first))
    assert count(2**31 - 2).result == RESULTS.too_many_steps
    far = ml.free_motion(body, FAST, [0.0, 1e20])
    assert far.result == RESULTS.phase_lost
    assert "nearer to the start" in str(far.result)
    run = partial(ml.integrate_variable_step, "SYMMETRIC[EA]", body, None, FAST, dt=1e-3)
    assert run(density=lambda t, s: jnp.ones_like(t), steps=4, t1=1.0).result == RESULTS.end_not_reached
    jump = run(density=lambda t, s: jnp.where(t < 2.5e-3, 1.0, 9.0).astype(t.dtype), steps=8)
    assert jump.result == RESULTS.density_lost
    assert jump.first_bad < 9


AXIS = ml.AxisState([0.1, 0.2, 0.3], [0.0, 0.0, 1.0])
FREE = ml.FreeState([0.1, 0.2, 0.3], [1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
PAIR = jax.tree.map(lambda x: jnp.stack([x, x]), FREE)
MASS = ml.ParticleState([0.1, 0.2], [0.0, 0.0])
# How a body is made of traced numbers, a start, numbers of possible bodies, and of impossible ones.
MADE = {
    "rigid": (ml.RigidBody, FAST, [[1, 1, 2.0], [1, 2.0000001, 1], [2.5, 2, 3]], [[1, 1, 5], [-1, 1, 1], [1, 1, 0]]),
    "tensor": (lambda m: ml.TensorBody(jnp.diag(m)), FAST, [[1, 2.0, 3]], [[1, 1.0, 5], [1, -1, 1]]),
    "rotor": (ml.SymmetricRotor, AXIS, [1.0], [-1.0, 0.0, jnp.inf]),
    "free": (lambda m: ml.FreeBody(ml.RigidBody([1.0, 2, 2.5]), m), FREE, [1.0], [-1.0, 0.0]),
    "coupled": (
        lambda m: ml.FreeBody(ml.RigidBody(jnp.array([[1, 1, 1], [1, 2, 2]], m.dtype) * m[:, None]), m),
        ml.CoupledState.of_bodies(PAIR),
        [[1.0, 2]],
        [[1.0, -2], [0, 1]],
    ),
    "particles": (ml.Particles, MASS, [[1.0, 2]], [[1.0, -2]]),
    "mass matrix": (ml.Particles, MASS, [[[1, 0.5], [0.5, 1.0]]], [[[1, 2], [2, 1.0]]]),
}
MOVER = {"rotor": "SYMMETRIC[EA]", "particles": "Verlet", "mass matrix": "Verlet"}


@pytest.mark.sample(1)
@pytest.mark.parametrize(("kind", "dtype"), [(kind, DTYPES[i % 2]) for i, kind in enumerate(MADE)])
def test_a_body_that_cannot_be_is_found_under_a_trace(kind, dtype):
    make, start, good, bad = MADE[kind]
    start = jax.tree.map(lambda x: x.astype(dtype), start)
    numbers = jnp.asarray([*good, *bad], dtype)
    dt = jnp.asarray(1e-3, dtype)

    def run(numbers):
        body = jax.tree.map(lambda x: x.astype(dtype), make(numbers))
        return ml.integrate(MOVER.get(kind, "JACOBI[EA]"), body, None, start, dt=dt, steps=2)._replace(states=None)

    path = quick(jax.vmap(run))(numbers)
    wanted = [True] * len(good) + [False] * len(bad)
    assert path.ok.tolist() == (path.result == RESULTS.successful).tolist() == wanted
    assert (path.result != RESULTS.impossible_body).tolist() == wanted


DRIVERS = {
    "ensemble": lambda body, start: ml.ensemble(
        "JACOBI[EA]", body, None, jax.tree.map(lambda x: x[None], start), dt=1e-3, steps=2
    ),
    "adaptive": lambda body, start: ml.integrate_variable_step(
        "JACOBI[EA]", body, None, start, dt=1e-3, steps=2, density=lambda t, s: jnp.ones_like(t)
    ),
    "free motion": lambda body, start: ml.free_motion(body, start, [0.0, 1.0]),
}


@pytest.mark.sample(1)
@pytest.mark.parametrize("driver", DRIVERS)
def test_every_driver_finds_a_body_that_cannot_be(driver):
    def run(numbers):
        path = DRIVERS[driver](ml.RigidBody(numbers), FAST)
        return jax.tree.map(jnp.ravel, (path.ok, path.result == RESULTS.impossible_body))

    run = quick(run)
    assert run(jnp.array([5.0, 4.0, 1.5])) == (True, False)
    assert run(jnp.array([5.0, 1.0, 1.5])) == (False, True)


@pytest.mark.sample(0)
def test_diffrax_ends_at_a_body_that_cannot_be():
    @quick
    @jax.vmap
    def run(numbers):
        term, controller = ml.diffrax.RigidBodyTerm(ml.RigidBody(numbers)), diffrax.PIDController(1e-3, 1e-3)
        options = {"stepsize_controller": controller, "throw": False, "max_steps": 64}
        return diffrax.diffeqsolve(term, ml.diffrax.LieSolver(), 0.0, 0.1, 0.01, FAST, **options).result

    found = run(jnp.array([[5.0, 4.0, 1.5], [5.0, 1.0, 1.5]]))
    assert (found == diffrax.RESULTS.successful).tolist() == [True, False]
    assert (found == diffrax.RESULTS.nonlinear_divergence).tolist() == [False, True]


BODY, RUN = moments("JACOBI[EA]"), {"dt": 1e-3, "steps": 4, "save_every": 2}
DRIVEN = {
    "ensemble": lambda torque, many, weight, **how: ml.ensemble("JACOBI[EA]", BODY, torque, many, **RUN, **how),
    "integrate": lambda torque, many, weight, **how: jax.vmap(
        lambda s: ml.integrate("JACOBI[EA]", BODY, torque, s, **RUN, **how)
    )(many),
    "free motion": lambda torque, many, weight, **how: jax.vmap(
        lambda s: ml.free_motion(ml.RigidBody(weight * jnp.array([0.25, 0.2, 0.08])), s, jnp.array([0.0, 1e-3, 2e-3]))
    )(many),
}


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("way", "adjoint"),
    [("ensemble", ml.adjoints.Reversible()), ("integrate", ml.adjoints.Checkpointed(every=2)), ("free motion", None)],
)
def test_a_body_that_starts_with_nan_does_not_spoil_the_gradient_of_the_others(way, adjoint):
    """Of a weight that all share; the body itself is not ok, and holds NaN."""
    factors = jnp.array([[1.0], [1.1], [0.9]])
    many = ml.RigidState(FAST.momentum[None] * factors, jnp.tile(FAST.attitude, (3, 1)))

    @quick
    @partial(jax.value_and_grad, has_aux=True)
    def run(weight, spoilt):
        momentum = many.momentum.at[1, 0].set(jnp.where(spoilt, jnp.nan, many.momentum[1, 0]))
        start = ml.RigidState.unchecked(momentum=momentum, attitude=many.attitude)
        path = DRIVEN[way](ml.torques.HeavyTop(weight), start, weight, adjoint=adjoint)
        counted = path.ok & (jnp.arange(3) != 1)
        seen = [jnp.sin(x).reshape(3, -1) for x in jax.tree.leaves(path.states)]
        return sum(jnp.sum(jnp.where(counted[:, None], x, 0)) for x in seen), path._replace(times=None)

    (whole, _), slope = run(20.0, False)
    (spoilt, path), found = run(20.0, True)
    assert path.ok.tolist() == [True, False, True]
    assert path.first_bad.tolist() == [3, 0, 3]
    assert (path.result == RESULTS.not_finite).tolist() == [False, True, False]
    assert all(bool(jnp.isnan(x[1, 1:]).all()) for x in jax.tree.leaves(path.states))
    np.testing.assert_allclose([spoilt, found], [whole, slope], rtol=1e-12)
    assert found != 0


def bonds(t, state):
    """Twelve bodies in a row, held by bonds that break: the stiffness is 100 at rest, and h has the limit 0.1."""
    away = state.position[1:] - state.position[:-1]
    return 100 * jnp.sum(1 - jnp.exp(-0.5 * (jnp.sqrt(jnp.sum(away * away, -1)) - 0.8) ** 2))


def chain(speed=0.3, count=12):
    numbers = np.random.default_rng(0).normal(size=(2, count, 3))
    place = 0.8 * np.arange(count)[:, None] * np.array([1.0, 0, 0]) + 0.02 * numbers[0]
    level = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return ml.CoupledState(np.zeros((count, 3)), level, speed * numbers[1], place)


HEAVY = ml.FreeBody(ml.RigidBody([1.0, 2.0, 2.5]), 1.0)
AWAY = ml.FreeState(FREE.momentum, FREE.attitude, FREE.linear, [1.0, 0.0, 0.0])
DOTS = ml.ParticleState(jnp.array([[0.1, 0.0], [0.0, 0.2]]), jnp.array([[1.0, 0.0], [0.0, 1.0]]))
BONDED = (ml.torques.FromPotential(bonds), 20.0)
SPRUNG = (ml.torques.FromPotential(lambda t, state: 50 * jnp.sum(state.position**2)), 10.0)
# Method, body, torque, the highest frequency, and starts.
STIFF = {
    "chain": ("JACOBI[EA]", HEAVY, *BONDED, [chain(), chain(1e-7)]),
    "body": ("JACOBI[EA]", HEAVY, *SPRUNG, [AWAY, FREE]),
    "particles": ("Verlet", ml.Particles(1.0), *SPRUNG, [DOTS]),
}


def limit_of(kind):
    name, _, _, frequency, _ = STIFF[kind]
    return ml.method(name).stability_limit(1j) / frequency


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", STIFF)
def test_a_step_beyond_the_limit_of_a_force_is_found(kind):
    """Up to 10 times the limit, also where the bodies then fly apart; and no step is found that keeps the energy."""
    name, body, torque, _, starts = STIFF[kind]
    limit = limit_of(kind)
    factors = jnp.array([0.01, 0.3, 0.6, 0.9, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0])
    one = partial(ml.integrate, name, body, torque, steps=200, save_every=100)
    run = quick(jax.vmap(lambda start, dt: one(start, dt=dt), (None, 0)))
    for start in starts:
        path = run(start, limit * factors)
        ok, unstable = (np.asarray(x) for x in (path.ok, path.result == RESULTS.unstable))
        energy = np.asarray(jax.vmap(lambda path: ml.observe.energy(body, torque, path))(path))
        np.testing.assert_array_equal(ok, energy[:, -1] < 20 * energy[:, 0])
        np.testing.assert_array_equal(ok[:4], True)
        assert not ok[6:].any()
        assert unstable.any()
        np.testing.assert_array_equal(np.asarray(path.first_bad)[unstable], 1)


@pytest.mark.sample(1)
@pytest.mark.parametrize("driver", ["ensemble", "adaptive", "simulate"])
def test_every_driver_finds_a_step_beyond_the_limit(driver, tmp_path):
    (name, body, torque, *_), limit = STIFF["body"], limit_of("body")
    many = jax.tree.map(lambda *x: jnp.stack(x), AWAY, AWAY)
    if driver == "adaptive":
        run = partial(
            ml.integrate_variable_step, name, body, torque, AWAY, steps=200, density=lambda t, s: jnp.ones_like(t)
        )
        paths = run(dt=0.9 * limit), run(dt=1.5 * limit)
        assert [bool(path.ok) for path in paths] == [True, False]
        assert paths[1].result == RESULTS.unstable
    elif driver == "ensemble":
        path = ml.ensemble(name, body, torque, many, dt=limit * jnp.array([0.9, 1.5]), steps=200)
        assert path.ok.tolist() == [True, False]
        assert (path.result == RESULTS.unstable).tolist() == [False, True]
    else:
        run = ml.simulate(name, body, torque, many, out=tmp_path / "run.npz", dt=1.2 * limit, steps=200, save_every=20)
        assert run.first_bad.tolist() == [1, 1]


@pytest.mark.sample(0)
def test_a_path_prints_in_two_lines():
    """Its times, whether it is ok, why not, and the shapes; inside a program its parts."""
    run = partial(ml.integrate, "JACOBI[EA]", BODY, TOP, steps=40)
    path, failed = run(FAST, dt=1e-3), run(FAST, dt=1.0)
    shapes = "RigidState(momentum=f64[41,3], attitude=f64[41,4])"
    assert repr(path) == f"Path: 41 saved states at times 0 to 0.04; ok\n{shapes}"
    assert "times 0 to 40; states[:1] ok. A step turned the body further" in repr(failed)
    many = jax.tree.map(lambda x: jnp.stack([x, 100 * x if len(x) == 3 else x]), FAST)
    assert "1 of 2 ok. A step turned" in repr(ml.ensemble("JACOBI[EA]", BODY, TOP, many, **RUN))
    texts = []
    jax.make_jaxpr(lambda s: texts.append(repr(run(s, dt=1e-3))) or s.momentum)(FAST)
    assert "times=f64[41]" in texts[0]


START = ml.RigidState([0.3, 1.0, -0.2], [1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module", params=["constant steps", "variable steps"])
def path(request):
    run = {"dt": 0.1, "steps": 4}
    if request.param == "constant steps":
        return ml.integrate("JACOBI[EA]", BODY, None, START, **run)
    density = {"density": lambda t, state: 1 + state.momentum[2] ** 2}
    return ml.integrate_variable_step("JACOBI[EA]", BODY, None, START, **density, **run)


@pytest.mark.parametrize("kind", [ml.Path, ml.simulation.Simulation, ml.plot.Crossings])
def test_annotations_with_the_class_of_the_states_are_accepted_at_run_time(kind):
    """By Python, and by beartype, which refuses all annotations with a NamedTuple that is a `typing.Generic`."""
    of_states = kind[ml.RigidState]
    assert (typing.get_origin(of_states), typing.get_args(of_states)) == (kind, (ml.RigidState,))
    made = of_states(*range(len(kind._fields)))
    assert type(made) is kind

    def first(value):
        return value[0]

    first.__annotations__ |= {"value": of_states | None}
    assert beartype(first)(made) == 0
    with pytest.raises(BeartypeCallHintParamViolation):
        beartype(first)(tuple(made))


def test_a_path_is_a_tuple(path):
    times, states, ok, bad, _, *rest = path
    assert (times is path.times, states is path.states, ok is path.ok, bad is path.first_bad) == (True,) * 4
    assert len(rest) == len(path._fields) - 5
    changed = path._replace(states=path.states.momentum)
    assert type(changed) is type(path)
    assert changed.states is path.states.momentum
    back = pickle.loads(pickle.dumps(path._replace(result=None)))
    np.testing.assert_array_equal(back.states.attitude, path.states.attitude)


def test_a_path_goes_through_transformations(path):
    """As a pytree of its kind, whose states keep their class."""
    pair = jax.tree.map(lambda x: jnp.stack([x, x]), path)
    sums = jax.vmap(jaxtyped(typechecker=beartype)(_total))(pair)
    np.testing.assert_array_equal(sums, [jnp.sum(path.states.momentum)] * 2)
    slope = jax.grad(lambda states: _total(path._replace(states=states)))(path.states)
    np.testing.assert_array_equal(slope.momentum, jnp.ones_like(path.states.momentum))


def _total(path: ml.Path[ml.RigidState]) -> jax.Array:
    return jnp.sum(path.states.momentum)


def test_a_path_is_written_as_csv_and_read_again(path, tmp_path):
    path.to_csv(tmp_path / "run.csv", euler="ZYX")
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["time"], path.times)
    for i, letter in enumerate("wxyz"):
        np.testing.assert_array_equal(table[f"attitude_{letter}"], path.states.attitude[:, i])
    angles = np.stack([table[name] for name in table.dtype.names or () if name.startswith("euler")], axis=1)
    expected = Rotation.from_quat(np.asarray(path.states.attitude)[:, [1, 2, 3, 0]]).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(angles, expected, atol=1e-12)
    assert table["ok"].all()


def test_an_ensemble_has_a_line_per_body_and_time(tmp_path):
    starts = jax.tree.map(lambda x: jnp.stack([x, 2 * x if x.shape[-1] == 3 else x]), START)
    path = ml.ensemble("JACOBI[EA]", BODY, None, starts, dt=0.1, steps=4, save_every=2)
    path.to_csv(tmp_path / "run.csv")
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["body"], [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(table["momentum_3"], np.asarray(path.states.momentum)[..., 2].ravel())
    data = path.to_xarray()
    assert data.momentum.dims == ("body", "time", "axis")
    assert data.ok.dims == ("body",)
    with pytest.raises(ValueError, match="to_csv needs saved times"):
        ml.ensemble("JACOBI[EA]", BODY, None, starts, dt=0.1, steps=4).to_csv(tmp_path / "end.csv")


def test_a_path_of_every_kind_of_state_is_a_dataset(tmp_path):
    path = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2)
    for _, start in STATES.values():
        states = jax.tree.map(lambda x: np.stack([x, x, x]), start)
        data = path._replace(states=states).to_xarray()
        for name, (dims, about) in start.described().items():
            assert data[name].dims[-len(dims) :] == dims or not dims
            assert data[name].attrs == about
            np.testing.assert_array_equal(data[name], getattr(states, name))
        data.to_netcdf(tmp_path / "run.nc", engine="scipy")


def test_observed_values_are_tables_too(tmp_path):
    observe = {"energy": ml.observe.energy, "axis": ml.observe.Axis()}
    path = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2, observe=observe)
    path.to_csv(tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().split("\n")[0] == "time,axis_0,axis_1,axis_2,energy,ok"
    with pytest.raises(ValueError, match="euler needs attitudes"):
        path.to_csv(tmp_path / "run.csv", euler="ZYX")


def test_netcdf_holds_flags_whole_numbers_names_and_attributes(tmp_path):
    """As xarray reads them, and SciPy alone."""
    observe = {"a b/c": lambda t, s: s.momentum[0] > 0, "n_µ": lambda t, s: jnp.int32(3), "L": lambda t, s: s.momentum}
    path = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2, observe=observe)
    rigid = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2)
    for data in (path.to_xarray(), rigid.to_xarray()):
        data.to_netcdf(tmp_path / "run.nc")
        with xarray.open_dataset(tmp_path / "run.nc") as read:
            for name in data:
                xarray.testing.assert_identical(read[name], data[name])
                assert read[name].dtype.kind == data[name].dtype.kind
    with netcdf_file(tmp_path / "run.nc", mmap=False) as plain:
        assert plain.variables["attitude"].frame == b"body to space"
        np.testing.assert_array_equal(plain.variables["momentum"][:], rigid.states.momentum)
