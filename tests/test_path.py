"""What drivers return is a named tuple, whose type has a parameter: the class of its states."""

import pickle
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beartype import beartype
from beartype.roar import BeartypeCallHintParamViolation
from jaxtyping import jaxtyped
from path_scenes import STATES
from scipy.io import netcdf_file
from scipy.spatial.transform import Rotation

import midlie_jax as ml

BODY = ml.RigidBody([1.0, 2.0, 2.5])
START = ml.RigidState([0.3, 1.0, -0.2], [1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module", params=["constant steps", "variable steps"])
def path(request):
    run = {"dt": 0.1, "steps": 4}
    if request.param == "constant steps":
        return ml.integrate("JACOBI[EA]", BODY, None, START, **run)
    return ml.integrate_variable_step("JACOBI[EA]", BODY, None, START, density=_density, **run)


def _density(t, state):
    return 1 + state.momentum[2] ** 2


GENERIC = [ml.Path, ml.simulation.Simulation, ml.plot.Crossings]


@pytest.mark.parametrize("kind", GENERIC)
def test_annotations_with_the_class_of_the_states_are_accepted_at_run_time(kind):
    """By Python, and by beartype, which refuses all annotations with a NamedTuple that is a `typing.Generic`."""
    of_states = kind[ml.RigidState]
    assert (typing.get_origin(of_states), typing.get_args(of_states)) == (kind, (ml.RigidState,))
    made = of_states(*range(len(kind._fields)))
    assert type(made) is kind
    assert issubclass(kind, tuple)

    def first(value, other):
        return value[0]

    first.__annotations__ |= {"value": of_states, "other": of_states | None}
    checked = beartype(first)
    assert checked(made, None) == checked(made, made) == 0
    for wrong in ((tuple(made), None), (made, tuple(made))):
        with pytest.raises(BeartypeCallHintParamViolation):
            checked(*wrong)


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
    twice = jax.jit(lambda p: p._replace(times=2 * p.times))(path)
    assert type(twice) is type(path)
    assert type(twice.states) is ml.RigidState
    np.testing.assert_array_equal(twice.times, 2 * path.times)
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


@pytest.mark.parametrize("state", STATES)
def test_a_path_of_every_kind_of_state_is_a_dataset(state, tmp_path):
    _, start = STATES[state]
    states = jax.tree.map(lambda x: jnp.stack([x, x, x]), start)
    path = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2)._replace(states=states)
    data = path.to_xarray()
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
    assert path.to_xarray().energy.dims == ("time",)
    with pytest.raises(ValueError, match="euler needs attitudes"):
        path.to_csv(tmp_path / "run.csv", euler="ZYX")


def test_netcdf_holds_flags_whole_numbers_names_and_attributes(tmp_path):
    """As xarray reads them, and SciPy alone."""
    xarray = pytest.importorskip("xarray")
    observe = {"a b/c": lambda t, s: s.momentum[0] > 0, "n_µ": lambda t, s: jnp.int32(3), "L": lambda t, s: s.momentum}
    path = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2, observe=observe)
    rigid = ml.integrate("JACOBI[EA]", BODY, None, START, dt=0.1, steps=2)
    for data in (path.to_xarray(), rigid.to_xarray()):
        data.to_netcdf(tmp_path / "run.nc")
        with xarray.open_dataset(tmp_path / "run.nc") as read:
            for name in data:
                np.testing.assert_array_equal(read[name], data[name])
                assert (read[name].dtype.kind, read[name].dims) == (data[name].dtype.kind, data[name].dims)
                assert read[name].attrs == data[name].attrs
    with netcdf_file(tmp_path / "run.nc", mmap=False) as plain:
        assert plain.variables["attitude"].frame == b"body to space"
        np.testing.assert_array_equal(plain.variables["momentum"][:], rigid.states.momentum)
