"""Runs spread over devices by `jax.shard_map`, which checks what varies from one device to the next, and by a mesh."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path


@cache
def results():
    """Of `on_devices.py`, which needs more devices than this process has."""
    script = Path(__file__).parent / "on_devices.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=600, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_runs_are_those_of_one_device_without_a_message():
    runs = {name: found for name, found in results().items() if not name.startswith("slope")}
    assert len(runs) > 15
    for name, found in runs.items():
        assert "error" not in found, (name, found["error"])
        assert (name, found["gap"] < 1e-13, found["messages"]) == (name, True, 0)


def test_a_gradient_is_summed_over_the_devices_once():
    """By what all devices share, after the loop over steps and not within it."""
    slopes = {name: found for name, found in results().items() if name.startswith("slope")}
    assert len(slopes) > 2
    for name, found in slopes.items():
        assert "error" not in found, (name, found["error"])
        assert (name, found["gap"] < 1e-12, found["messages"] > 0, found["in loops"]) == (name, True, True, 0)
