"""Runs spread over devices by `jax.shard_map`, which checks what varies from one device to the next, and by a mesh."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest


@cache
def results():
    """Of `on_devices.py`, which needs more devices than this process has."""
    script = Path(__file__).parent / "on_devices.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=600, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def fails(name, why):
    return pytest.param(name, marks=pytest.mark.xfail(reason=why, strict=True))


STAGES = fails(
    "JACOBI[SRKN6b]", "the loop over stages begins with a constant, which does not vary, and ends with what does"
)
TANGENT = fails(
    "LIEMID[EA]", "the derivative of a flight that says whether it settled has a constant, which does not vary"
)


@pytest.mark.parametrize(
    "name", ["LIEMID[EA]", "LIEMID[I]", STAGES, "rows", "closure", "adaptive", "ensemble", "typed"]
)
def test_runs_are_those_of_one_device_without_a_message(name):
    found = results()[name]
    assert "error" not in found, found["error"]
    assert found["gap"] < 1e-13
    assert found["messages"] == 0


@pytest.mark.parametrize("name", [TANGENT, "LIEMID[I]"])
def test_a_gradient_is_summed_over_the_devices_once(name):
    """By what all devices share, after the loop over steps and not within it."""
    found = results()[f"slope {name}"]
    assert "error" not in found, found["error"]
    assert found["gap"] < 1e-12
    assert found["messages"] > 0
    assert found["in loops"] == 0
