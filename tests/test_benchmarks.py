"""The benchmarks: cheap parts run with tiny sizes and print their tables; claims, rivals and C do what they say."""

import itertools
import sys
from dataclasses import replace
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark
from laboratory import rivals

import midlie_jax as ml
from midlie_jax.cli import scenes
from midlie_jax.integrators.system import Motion, System
from midlie_jax.model.free_body import Momenta

claims, coming_from, limit, work_precision = map(benchmark, ("claims", "coming_from", "limit", "work_precision"))
# Module, table, and the sizes that make it small.
SMALL = {
    ("speed", "OBSERVED"): {"OBSERVED_BODIES": 4, "OBSERVED_STEPS": 2, "TURNS": 1},
    ("spins", "CONSERVATION"): {"CHAIN": 8, "CHAIN_TIME": 1.0, "CHAIN_METHODS": ("SUBLATTICES[EA]",)},
    ("solids", "BAR"): {"CASES": ((1.0, 10),)},
    ("work_precision", "FASTEST"): {},
    ("fits", "SEARCH"): {"SEEDS": ()},
}


@pytest.mark.parametrize(("name", "table"), SMALL)
def test_a_part_prints_its_table(name, table, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "one_core", ModuleType("one_core"))  # which would hold the tests to one core
    module = benchmark(name)
    for constant, value in SMALL[name, table].items():
        monkeypatch.setattr(module, constant, value)
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        lines = getattr(module, table).show(write=False)
    assert capsys.readouterr().out.splitlines() == lines
    assert len(lines) > 2 or table == "SEARCH"
    assert len({line.count("|") for line in lines}) == 1


# ---- claims ----

HAS, LACKS, STEPS = "JACOBI[EA]", "RK4", 2000


def test_claims_are_measured_where_they_hold_and_where_not(monkeypatch, tmp_path, capsys):
    """Also the accuracy on P1 of the published table, whose error of R is the root of two times the angle."""
    bench = claims.Bench(STEPS)
    measured = {name: bench.measure(ml.method(name)) for name in (HAS, LACKS)}
    for name, found in measured.items():
        tests = claims.keeps_momentum, claims.is_symplectic, claims.keeps_area, claims.comes_back
        assert {test(found) for test in (*tests, claims.has_no_drift)} == {name == HAS}
        assert found.ok
        assert abs(found.order - ml.method(name).order) < 0.1
    assert all(v.holds for v in claims.registry_verdicts(ml.method(HAS), measured[HAS]))
    assert measured[HAS].accuracy_p1 * 2**0.5 == pytest.approx(3.2e-6, rel=0.1)
    falls = {v.key for v in claims.registry_verdicts(ml.method(HAS), measured[LACKS]) if not v.holds}
    assert {"momentum", "symplectic", "area", "symmetric", "no drift", "evaluations"} <= falls
    monkeypatch.setattr(claims, "_PARTING", (1,))
    monkeypatch.setattr(claims, "Bench", lambda *steps: bench)
    monkeypatch.setattr(claims, "_measured", lambda bench, methods: [measured[m.name] for m in methods])
    files = ["--page", str(tmp_path / "page.md"), "--out", str(tmp_path / "energy.png")]
    claims.main(["--methods", HAS, LACKS, "--steps", str(STEPS), *files])
    assert f"| `{HAS}` |" in (tmp_path / "page.md").read_text()


# ---- rivals ----


def no_squish(moments, momentum, attitude, h, torque):
    """One step of NO_SQUISH as published (Miller et al., J. Chem. Phys. 116 (2002) 8649, eq. 2.16-2.21), on NumPy.

    The quaternion and its conjugate momentum p = 2 S(q) (0, L) turn by exp(dt L_k), k = 3, 2, 1, 2, 3, each a rotation
    of both by the angle zeta dt, zeta = p . P_k q / (4 I_k), in the plane of the vector and its permutation P_k.
    """
    permuted = (
        lambda v: np.array([-v[1], v[0], v[3], -v[2]]),
        lambda v: np.array([-v[2], -v[3], v[0], v[1]]),
        lambda v: np.array([-v[3], v[2], -v[1], v[0]]),
    )

    def conjugate(q, body):
        return 2 * sum(x * p(q) for x, p in zip(body, permuted, strict=True))

    q, p = attitude, conjugate(attitude, momentum)
    p = p + h / 2 * conjugate(q, torque(q))
    for k, part in ((2, 0.5), (1, 0.5), (0, 1.0), (1, 0.5), (2, 0.5)):
        angle = part * h * (p @ permuted[k](q)) / (4 * moments[k])
        q, p = (np.cos(angle) * v + np.sin(angle) * permuted[k](v) for v in (q, p))
    p = p + h / 2 * conjugate(q, torque(q))
    return np.array([p @ permuted[k](q) / 2 for k in range(3)]), q


def test_no_squish_is_dlm():
    """Step by step the numbers of a flight of DLM between half kicks; so it needs no line of its own on a chart."""
    scene = scenes.scene("asymmetric-top", "float64")
    moments = np.asarray(scene.body.moments)

    def torque(q):
        up = rivals.matrix(q)[2]
        return 3.0 * np.array([up[1], -up[0], 0.0])

    verlet = ml.schemes.Scheme("Verlet", 2, (("kick", 0.5), ("flight", 1.0), ("kick", 0.5)), "for NO_SQUISH")
    method = ml.method(ml.flights.ThreeAxis(), verlet)
    path = ml.integrate(method, scene.body, scene.torque, scene.start, dt=0.05, steps=40)
    momentum, attitude = np.asarray(scene.start.momentum), np.asarray(scene.start.attitude)
    for n in range(1, 41):
        momentum, attitude = no_squish(moments, momentum, attitude, 0.05, torque)
        np.testing.assert_allclose(path.states.momentum[n], momentum, rtol=0, atol=1e-12)
        np.testing.assert_allclose(path.states.attitude[n], attitude, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", work_precision.SCENES)
def test_the_rivals_are_given_the_equations_of_the_scene(name):
    """The rates of their numbers are those of a step of our own equations, of every kind of state."""
    scene = rivals.scene(name)
    start, orbit = scene.start.kind.normalised(scene.start), rivals.orbit_of(scene)
    motion = Motion(*start.parts())
    for t in (0.0, 1234.5):
        system = System.of(scene.body, scene.torque, scene.start, jnp.asarray(t))
        force = None if scene.torque is None else system.force(jnp.asarray(t), motion)
        momentum, pose = start.kind.rates(system.inertia, jnp.asarray(1.0), motion.momentum, motion.pose, force)
        parts = (momentum, pose)
        if isinstance(momentum, Momenta):
            parts = momentum.angular, pose.orientation, momentum.linear, pose.position
        exact = [float(x) for part in parts for x in part]
        place = None if orbit is None else rivals.kepler(orbit)(t)
        found = rivals.kind_of(scene).rates(scene)(rivals.numbers(start).tolist(), place)
        np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-13 * max(map(abs, exact)))


def test_programs_reach_the_known_ends():
    """heyoka in 38 digits and at tolerances, SciPy, MuJoCo and the closed form."""
    free = work_precision.problem("tumbling-brick", bodies=2, judged=2, quick=True)
    (point,) = work_precision.measure(free, ["free_motion"], (), said=lambda text: None)[0]
    assert point.error < 1e-13
    top = work_precision.problem("P1", bodies=4, judged=2, quick=True)
    short = replace(top.scene, duration=0.5)
    top = top._replace(scene=short, ends=work_precision._ends(short, top.states[:2])[0])
    (point,) = rivals.dop853(top, (1e-11,))
    assert point.error < 1e-8
    pytest.importorskip("mujoco")
    rk4 = next(rival for rival in rivals.RIVALS if rival.label == "MuJoCo RK4").measure
    assert min(p.error for p in itertools.islice(rk4(top._replace(longest=0.0)), 5)) < 1e-5
    pytest.importorskip("heyoka")
    assert top.error(rivals.reference(short, top.kind, top.states[:2])) < 1e-14
    coarse, fine = rivals.measure(top, (1e-4, 1e-8))
    assert fine.error < 1e-3 * coarse.error < 1e-3


# ---- the pages docs/coming-from ----


@pytest.mark.sample(0)
@pytest.mark.parametrize("name", coming_from.PAGES)
def test_both_columns_of_a_page_on_coming_from_give_the_same_motion(name):
    """Within the error that the page states: of its first table, and of all together or of LAMMPS."""
    if absent := coming_from.missing(name):
        pytest.skip(f"{' and '.join(absent)} is not installed")
    page, pairs = coming_from.PAGES[name], [(coming_from.columns(name), None)]
    if name == "molecular-dynamics":
        pairs.append((coming_from.programs()[1], None))
    elif len(coming_from.tables(name)) > 1:
        pairs.append((coming_from.joined(name), page.further))
    for codes, within in pairs:
        coming_from.agree(name, *(coming_from.run(code, page.quantities) for code in codes), within)


# ---- the C of limit.c ----

# Each value of each choice occurs: numbers of vectors and groups, whose roots, which order of sums.
PAIRS = {
    ("LIEMID_EARLY", "float32"): limit.Form(2, 1, hardware_roots=False),
    ("JACOBI", "float64"): limit.Form(1, 8, hardware_roots=False),
    ("SYMMETRIC", "float64"): limit.Form(4, 1),
    ("DOP853", "float64"): limit.Form(1, 1, reorders_sums=False),
}


@pytest.mark.skipif(not limit.compilers(), reason="`make test` needs no C compiler, and this machine has none")
@pytest.mark.parametrize(("method", "dtype"), PAIRS)
def test_c_program_agrees_with_the_package(method, dtype):
    """To one rounding error a step. The moments differ from each other where the method allows that."""
    name, steps = {"LIEMID_EARLY": "LIEMID"}.get(method, method), 400
    moments = limit.MOMENTS if name == "SYMMETRIC" else (5.0, 4.5, 1.0)
    program = limit.built(method, dtype, PAIRS[method, dtype], limit.compilers()[0])
    _, momentum = limit.measured(program, bodies=1, steps=steps, moments=moments)
    body, torque = ml.RigidBody(jnp.array(moments, dtype)), ml.torques.HeavyTop(jnp.asarray(limit.WEIGHT, dtype))
    start, run = scenes.scene("P1", jnp.dtype(dtype)).start, {"dt": limit.DT, "steps": steps, "save_every": steps}
    path = ml.integrate(name if name == "DOP853" else f"{name}[EA]", body, torque, start, **run)
    ours = np.asarray(path.states.momentum[-1], np.float64)
    assert path.ok
    assert np.linalg.norm(momentum - ours) <= steps * jnp.finfo(dtype).eps * np.linalg.norm(ours)
