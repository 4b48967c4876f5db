"""Runs spread over devices by `jax.shard_map`, which checks what varies from one device to the next, and by a mesh."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

# One program for each way in which a step is built.
RUNS = ["rows", "damping", "closure", "adaptive", "ensemble", "typed"]
RUNS += ["LIEMID[I]", "JACOBI[SRKN6b]", "RK4", "SLIEMID[EA]", "JACOBI[EA]"]


@pytest.mark.sample(0)
def test_runs_are_those_of_one_device_without_a_message_and_a_gradient_is_summed_once():
    """After the loop over steps; `on_devices.py` needs more devices than this process has."""
    script = Path(__file__).with_name("on_devices.py")
    done = subprocess.run([sys.executable, script, *RUNS, "slope"], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    assert list(found) == [*RUNS, "slope"]
    for name, one in found.items():
        assert "error" not in one, (name, one["error"])
        bound = 1e-12 if name == "slope" else 1e-13
        assert (name, one["gap"] < bound, one["messages"] > 0, one["in loops"]) == (name, True, name == "slope", 0)
