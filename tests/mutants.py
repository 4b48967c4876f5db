"""Single-line mutants of the package, each to be killed by a test of `make test`: `make mutants`.

    python tests/mutants.py [NAME ...] [--all] [--workers N]

Each mutant is one line of the package made wrong, in a copy. First run the tests that should kill it, as `make test`
selects them. With `--all` a mutant that survives these meets the whole of `make test`. Prints a line for each; the exit
status is the number of survivors.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent


class Mutant(NamedTuple):
    """A wrong line.

    Attributes:
        file: below `midlie_jax`.
        right, wrong: a part of the line that occurs once in the file, and what takes its place.
        killers: arguments of pytest that select tests.
    """

    file: str
    right: str
    wrong: str
    killers: str


MUTANTS = {
    # model
    "dexp": Mutant("model/so3.py", "cp.scale(_versine(x), first)", "cp.scale(-_versine(x), first)", "test_so3.py"),
    "unequal moments": Mutant(
        "model/inertia.py",
        "cp.scale(per_unit, (b - c, c - a, a - b))",
        "cp.scale(per_unit, (b - c, c - a, b - a))",
        "test_flights.py",
    ),
    "spread of a bath": Mutant(
        "model/exposure.py",
        "root_of(-jnp.expm1(-2 * rate * time))",
        "root_of(-jnp.expm1(-rate * time))",
        "test_heat.py",
    ),
    "torque of J2": Mutant(
        "model/torques/travel.py",
        "cp.scale(-6, cp.cross(n, of_n))",
        "cp.scale(6, cp.cross(n, of_n))",
        "test_paths.py -k slope",
    ),
    "force of J2": Mutant(
        "model/torques/travel.py",
        "(15 - 105 * s2) * square, of_u",
        "(15 + 105 * s2) * square, of_u",
        "test_paths.py -k slope",
    ),
    "mutual potential": Mutant(
        "asteroids/mutual_gravity.py",
        "total + 0.125 * weight",
        "total + 0.25 * weight",
        "test_mutual_gravity.py test_paths.py -k slope",
    ),
    "gravity gradient": Mutant(
        "spacecraft/gravity_gradient.py",
        "return 3 * self.mu * inverse * inverse",
        "return 2 * self.mu * inverse * inverse",
        "test_torques.py test_orbits.py test_api_examples.py",
    ),
    "rod": Mutant(
        "molecules/rod_torque.py",
        "cp.scale(0.5, cp.cross(lever, rodrigues))",
        "cp.scale(1.0, cp.cross(lever, rodrigues))",
        "test_paths.py -k slope",
    ),
    "Dzyaloshinskii-Moriya": Mutant(
        "spins/neighbours.py",
        "cp.subtract(near(axis, 1), near(axis, -1))",
        "cp.add(near(axis, 1), near(axis, -1))",
        "test_paths.py -k slope",
    ),
    "eddy currents": Mutant(
        "spacecraft/eddy_currents.py",
        "cp.cross(self._times(induced), field)",
        "cp.cross(field, self._times(induced))",
        "test_sunlight.py -k eddy",
    ),
    "sunlight": Mutant(
        "asteroids/sunlight.py",
        "2 * surface.areas * specular",
        "surface.areas * specular",
        "test_sunlight.py test_api_examples.py",
    ),
    "thin gas": Mutant(
        "spacecraft/free_molecular_drag.py",
        "(thermal * thermal) / 2 * z",
        "(thermal * thermal) * z",
        "test_surface.py test_sunlight.py test_api_examples.py",
    ),
    "points": Mutant(
        "molecules/points.py",
        "jnp.sum(masses[:, None] * places, axis=0, keepdims=True)",
        "jnp.mean(places, axis=0, keepdims=True)",
        "test_sites.py test_api_examples.py",
    ),
    # methods
    "JACOBI": Mutant(
        "integrators/flights/jacobi.py", "1 - 2 * square * sine * sine", "1 - square * sine * sine", "test_flights.py"
    ),
    "SYMMETRIC": Mutant(
        "integrators/flights/symmetric.py",
        "h / 2 * ((c - a) * momentum[2])",
        "h / 2 * ((c + a) * momentum[2])",
        "test_flights.py",
    ),
    "LIEMID": Mutant(
        "integrators/flights/lie_midpoint.py",
        "cp.scale(2 * factor, u)",
        "cp.scale(2.001 * factor, u)",
        "test_flights.py",
    ),
    "DLM": Mutant(
        "integrators/flights/three_axis.py",
        "((2, 0.5), (1, 0.5), (0, 1.0), (1, 0.5), (2, 0.5))",
        "((2, 0.5), (1, 0.5), (0, 1.0), (2, 0.5), (1, 0.5))",
        "test_flights.py",
    ),
    "CHIN4A": Mutant(
        "integrators/schemes.py", "(0.0, 1 / 48, 0.0)", "(0.0, 1 / 24, 0.0)", "test_schemes.py test_order_conditions.py"
    ),
    "bath in a step of no length": Mutant(
        "integrators/splitting.py",
        "jnp.where(self.h == 0, old, new)",
        "jnp.where(self.h < 0, old, new)",
        "test_paths.py -k bath",
    ),
    # drivers
    "clock": Mutant("drivers/clock.py", "_EXACT_BITS = 24", "_EXACT_BITS = 31", "test_inputs.py -k exact_index"),
    "index of a step": Mutant(
        "drivers/integrate.py",
        "interval_starts = first + save_every * jnp.arange(",
        "interval_starts = save_every * jnp.arange(",
        "test_runs.py test_paths.py -k continued",
    ),
    "last chunk": Mutant(
        "drivers/chunks.py",
        "jnp.minimum(jnp.arange(chunks * size), count - 1)",
        "jnp.minimum(jnp.arange(chunks * size), count - 2)",
        "test_ensemble.py",
    ),
    "adaptive clock": Mutant(
        "drivers/variable_step.py", "clock.half + dt / 2 * slope", "clock.half + dt * slope", "test_adaptive.py"
    ),
    "merged covariance": Mutant(
        "drivers/observe/statistics.py",
        "jnp.sum(part.scatter, axis=0) + between",
        "jnp.sum(part.scatter, axis=0)",
        "test_spread.py test_paths.py -k statistics",
    ),
    # uses
    "interpolation": Mutant(
        "diffrax/interpolation.py",
        "return s * s * (3 - 2 * s),",
        "return s * s * (2 - s),",
        "test_dense_output.py test_dense_step.py",
    ),
    "degrees of freedom": Mutant(
        "fitting/estimate.py", "dof = count - vector.size", "dof = count", "test_fit_result.py"
    ),
    "scattered rotations": Mutant(
        "scattering/distributions.py",
        "return normal / jnp.sqrt(square).reshape(1)",
        "return normal / square.reshape(1)",
        "test_scatter.py",
    ),
    "stability limit": Mutant(
        "integrators/limits.py",
        "(1 - 2 * next(weights, 0.0) * x * x)",
        "(1 - next(weights, 0.0) * x * x)",
        "test_limits.py",
    ),
    "periods of tumbling": Mutant(
        "asteroids/tumbling_motion.py",
        "return shape.precession * shape.period / (2 * pi)",
        "return shape.precession * shape.period / pi",
        "test_tumbling.py",
    ),
    "noise": Mutant(
        "_math/normals.py", "_signed(cosine, drawn[i])", "_signed(cosine, drawn[i + 1])", "test_normals.py"
    ),
}


PARTS = ("midlie_jax", "tests", "benchmarks", "docs", "notebooks")


def copied(folder: Path) -> None:
    """A copy of the repository without what git ignores, but with compiled Python."""
    for part in PARTS:
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("build", ".hypothesis"))
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, folder / path.name)


def fails(folder: Path, tests: str) -> bool:
    """Whether one of these tests of the sample fails in the copy."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "--sample", "-x"]
    names, _, keyword = tests.partition(" -k ")
    command += [f"tests/{name}" for name in names.split()] + (["-k", keyword] if keyword else [])
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode not in (0, 1):  # no tests, or pytest itself failed
        raise RuntimeError(f"pytest ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 1


def verdict(name: str, everything: bool) -> str:
    began, mutant = time.monotonic(), MUTANTS[name]
    with tempfile.TemporaryDirectory() as folder:
        copied(Path(folder))
        path = Path(folder) / "midlie_jax" / mutant.file
        text = path.read_text()
        if text.count(mutant.right) != 1:
            found = f"SURVIVED: the line occurs {text.count(mutant.right)} times in {mutant.file}"
        else:
            path.write_text(text.replace(mutant.right, mutant.wrong))
            found = "killed" if fails(Path(folder), mutant.killers) else "SURVIVED"
            if everything and found == "SURVIVED" and fails(Path(folder), ""):
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
