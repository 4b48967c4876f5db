"""Names of version 0.1 work once more, and say what to write instead."""

import inspect

import numpy as np
import pytest

import midlie_jax as ml
from midlie_jax._checks.renamed import renamed

TOP = ml.RigidBody([5.0, 5.0, 1.0])


def started(count=None):
    shape = (3,) if count is None else (count, 3)
    attitude = np.zeros((*shape[:-1], 4))
    attitude[..., 0] = 1.0
    return ml.RigidState(np.ones(shape), attitude)


@pytest.mark.sample(0)
def test_attributes():
    craft = ml.TensorBody([[120.0, 4.0, -3.0], [4.0, 100.0, 2.0], [-3.0, 2.0, 80.0]])
    with pytest.warns(DeprecationWarning, match=r"TensorBody\.axes is the name of version 0\.1; write \.frame"):
        np.testing.assert_array_equal(craft.axes, craft.frame)
    judged = ml.check("JACOBI[EA]", TOP, ml.torques.HeavyTop(20.0), started(), dt=0.01, steps=10)
    with pytest.warns(DeprecationWarning, match=r"Check\.order .* write \.harmonic"):
        assert judged.order == judged.harmonic


def test_an_argument(tmp_path):
    run = {"dt": 0.01, "steps": 4}
    with pytest.warns(DeprecationWarning, match=r"simulate\(segment=\) .* write span="):
        ml.simulate("JACOBI[EA]", TOP, None, started(2), out=tmp_path / "a.zarr", segment=2, **run)
    with pytest.raises(TypeError, match="got span and its old name segment; leave segment out"):
        ml.simulate("JACOBI[EA]", TOP, None, started(2), out=tmp_path / "b.zarr", segment=2, span=2, **run)
    assert "segment" not in inspect.signature(ml.simulate).parameters


def test_the_function_stays_what_it_is():
    @renamed(old="new")
    def doubled(x, *, new=1):
        """Twice."""
        return 2 * x + new

    assert doubled(1) == 3
    assert doubled(1, new=0) == 2
    assert (doubled.__name__, doubled.__doc__) == ("doubled", "Twice.")
    with pytest.raises(TypeError, match="other"):
        doubled(1, other=2)
