"""Single-line mutants of the package, each to be killed by a test of `make test`: `make mutants`.

    python tests/mutants.py [NAME ...] [--all] [--workers N]

With `--all` a mutant that survives its tests meets all of `make test`. The exit status is the number of survivors.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# The file below `midlie_jax`, a part of a line that occurs once in it, with «right→wrong», and the tests that kill it.
MUTANTS = {
    "dexp": ("model/so3.py", "cp.scale(«→-»_versine(x), first)", "so3"),
    "unequal moments": ("model/inertia.py", "cp.scale(per_unit, (b - c, c - a, «a - b→b - a»))", "flights"),
    "spread of a bath": ("model/exposure.py", "root_of(-jnp.expm1(-«2 * →»rate * time))", "heat"),
    "torque of J2": ("model/torques/travel.py", "cp.scale(«-→»6, cp.cross(n, of_n))", "paths -k slope"),
    "force of J2": ("model/torques/travel.py", "(15 «-→+» 105 * s2) * square, of_u", "paths -k slope"),
    "mutual potential": ("asteroids/mutual_gravity.py", "total + 0.«1→»25 * weight", "mutual_gravity paths -k slope"),
    "gravity gradient": (
        *("spacecraft/disturbances.py", "return «3→2» * self.mu * inverse * inverse"),
        "torques orbits api_examples",
    ),
    "rod": ("molecules/rods.py", "cp.scale(«0.5→1.0», cp.cross(lever, rodrigues))", "paths -k slope"),
    "Dzyaloshinskii-Moriya": (
        *("spins/fields.py", "cp.«subtract→add»(near(axis, 1), near(axis, -1))"),
        "paths -k slope",
    ),
    "eddy currents": (
        *("spacecraft/disturbances.py", "cp.cross(«self._times(induced), field→field, self._times(induced)»)"),
        "sunlight -k eddy",
    ),
    "sunlight": ("asteroids/brightness.py", "«2 * →»surface.areas * specular", "sunlight api_examples"),
    "thin gas": (*("spacecraft/disturbances.py", "(thermal * thermal) «/ 2 →»* z"), "surface sunlight api_examples"),
    "points": (
        *("molecules/points.py", "jnp.«sum(masses[:, None] * →mean(»places, axis=0, keepdims=True)"),
        "sites api_examples",
    ),
    "JACOBI": ("integrators/flights/jacobi.py", "1 - «2 * →»square * sine * sine", "flights"),
    "SYMMETRIC": ("integrators/flights/symmetric.py", "h / 2 * ((c «-→+» a) * momentum[2])", "flights"),
    "LIEMID": ("integrators/flights/lie_midpoint.py", "cp.scale(2«→.001» * factor, u)", "flights"),
    "DLM": (
        *("integrators/flights/rotations.py", "((2, 0.5), (1, 0.5), (0, 1.0), («1, 0.5), (2→2, 0.5), (1», 0.5))"),
        "flights",
    ),
    "CHIN4A": ("integrators/schemes.py", "(0.0, 1 / «48→24», 0.0)", "schemes order_conditions"),
    "bath in a step of no length": (
        *("integrators/splitting.py", "jnp.where(self.h «==→<» 0, old, new)"),
        "paths -k bath",
    ),
    "clock": ("drivers/clock.py", "_EXACT_BITS = «24→31»", "inputs -k exact_index"),
    "index of a step": (
        *("drivers/integrate.py", "interval_starts = «first + →»save_every * jnp.arange("),
        "laws paths -k continued or split",
    ),
    "last chunk": ("drivers/chunks.py", "jnp.minimum(jnp.arange(chunks * size), count - «1→2»)", "ensemble"),
    "adaptive clock": ("drivers/variable_step.py", "clock.half + dt «/ 2 →»* slope", "adaptive"),
    "merged covariance": (
        *("drivers/observe/statistics.py", "jnp.sum(part.scatter, axis=0)« + between→»"),
        "spread paths -k statistics",
    ),
    "interpolation": ("diffrax/dense.py", "return s * s * («3 - 2 *→2 -» s),", "dense_output"),
    "degrees of freedom": ("fitting/solve.py", "dof = count« - vector.size→»", "fit_calls"),
    "scattered rotations": (
        *("scattering/distributions.py", "return normal / «jnp.sqrt(square)→square».reshape(1)"),
        "scatter",
    ),
    "stability limit": ("integrators/limits.py", "(1 - «2 * →»next(weights, 0.0) * x * x)", "limits"),
    "periods of tumbling": (
        *("asteroids/tumbling_motion.py", "return shape.precession * shape.period / «(2 * pi)→pi»"),
        "tumbling",
    ),
    "noise": ("_math/normals.py", "_signed(cosine, drawn[i«→ + 1»])", "normals"),
}


# What is copied, without what git ignores but with compiled Python.
PARTS = ("midlie_jax", "tests", "benchmarks", "docs", "notebooks")


def fails(folder: Path, tests: str) -> bool:
    """Whether one of these tests of the sample fails in the copy."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "--sample", "-x"]
    names, _, keyword = tests.partition(" -k ")
    command += [f"tests/test_{name}.py" for name in names.split()] + (["-k", keyword] if keyword else [])
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode not in (0, 1):  # no tests, or pytest itself failed
        raise RuntimeError(f"pytest ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 1


def verdict(name: str, everything: bool) -> str:
    began, (file, line, killers) = time.monotonic(), MUTANTS[name]
    right, wrong = (re.sub("«(.*)→(.*)»", rf"\{n}", line) for n in (1, 2))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in PARTS:
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("build", ".hypothesis"))
        for one in filter(Path.is_file, ROOT.iterdir()):
            shutil.copy(one, copy / one.name)
        path = copy / "midlie_jax" / file
        text = path.read_text()
        if text.count(right) != 1:
            found = f"SURVIVED: the line occurs {text.count(right)} times in {file}"
        else:
            path.write_text(text.replace(right, wrong))
            found = "killed" if fails(copy, killers) else "SURVIVED"
            if everything and found == "SURVIVED" and fails(copy, ""):
                found = "killed by another test"
    print(f"{name:32} {found} ({time.monotonic() - began:.0f} s)", flush=True)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(MUTANTS)}; by default all")
    parser.add_argument("--all", action="store_true", help="try all of make test on a mutant that survives")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="mutants at a time")
    options = parser.parse_args()
    with ThreadPoolExecutor(options.workers) as pool:
        found = list(pool.map(partial(verdict, everything=options.all), options.names or MUTANTS))
    survivors = sum(one.startswith("SURVIVED") for one in found)
    print(f"{len(found) - survivors} killed, {survivors} survived")
    return survivors


if __name__ == "__main__":
    sys.exit(main())
