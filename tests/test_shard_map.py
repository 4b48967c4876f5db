"""Runs spread over devices by `jax.shard_map`, which checks what varies from one device to the next, and by a mesh."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from cases import RIGID_FLIGHTS, whole

# One program for each way in which a step is built; those of the other flights are of the whole matrix.
RUNS = ["rows", "damping", "closure", "adaptive", "ensemble", "typed"]
RUNS += ["LIEMID[I]", "JACOBI[SRKN6b]", "RK4", "SLIEMID[EA]", "JACOBI[EA]"]
OTHERS = [name for name in (f"{flight.name}[EA]" for flight in RIGID_FLIGHTS) if name not in RUNS]
SLOPES = ["slope LIEMID[EA]"]
OTHER_SLOPES = ["slope LIEMID[I]", "slope SYMMETRIC[EA]"]


def results(names):
    """Of `on_devices.py`, which needs more devices than this process has."""
    script = Path(__file__).parent / "on_devices.py"
    done = subprocess.run([sys.executable, script, *names], capture_output=True, text=True, timeout=600, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert list(found) == names
    return found


@pytest.mark.sample(0)
@pytest.mark.parametrize("names", [RUNS, *whole(OTHERS)], ids=["each way", "other flights"])
def test_runs_are_those_of_one_device_without_a_message(names):
    for name, found in results(names).items():
        assert "error" not in found, (name, found["error"])
        assert (name, found["gap"] < 1e-13, found["messages"]) == (name, True, 0)


@pytest.mark.sample(0)
@pytest.mark.parametrize("names", [SLOPES, *whole(OTHER_SLOPES)], ids=["one", "others"])
def test_a_gradient_is_summed_over_the_devices_once(names):
    """By what all devices share, after the loop over steps and not within it."""
    for name, found in results(names).items():
        assert "error" not in found, (name, found["error"])
        assert (name, found["gap"] < 1e-12, found["messages"] > 0, found["in loops"]) == (name, True, True, 0)
