"""Error against cost as it is measured: the rivals written here, other programs, the ladder and the harness itself."""

import itertools
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import benchmark
from laboratory import kinds, rivals, work_precision
from laboratory import scenes as all_scenes
from laboratory.kinds import rigid
from laboratory.kinds.vectors import matrix
from laboratory.rivals import heyoka_taylor, mujoco_steps, problem, scipy_dop853, spinning_top
from laboratory.rivals.lie_group import CF4, RKMK4

import midlie_jax as ml
from midlie_jax.advice.program import Program
from midlie_jax.cli import convergence, scenes
from midlie_jax.integrators.runge_kutta import DOP853, RK4
from midlie_jax.integrators.system import Motion, System
from midlie_jax.model.free_body import Momenta


def moved(method, counts, name="asymmetric-top", duration=1.0, chunk=4) -> list[float]:
    """Errors of a method on four bodies over a short time, by steps, judged by DOP853 with steps of 1/400."""
    scene = replace(all_scenes.axis_third(scenes.scene(name, "float64")), duration=duration)
    starts = scenes.perturbed(scene, 4, 1e-2)
    exact = ml.ensemble("DOP853", scene.body, scene.torque, starts, dt=duration / 400, steps=400)
    given = problem.Problem(scene, kinds.kind_of(scene), starts, kinds.numbers(exact.states), "", 0.0, 1)
    program = Program(method, scene.body, scene.torque, starts, chunk=chunk)
    found = []
    for count in counts:
        states, ok = program.run(duration / count, count)
        assert np.all(ok)
        found.append(given.error(kinds.numbers(states)))
    return found


@pytest.mark.sample(0)
@pytest.mark.parametrize(("method", "count"), [(RKMK4(), 40), (CF4(), 40), (RK4, 40), (DOP853, 4)])
def test_order_on_the_asymmetric_top(method, count):
    coarse, fine = moved(method, (count, 2 * count))
    assert abs(math.log2(coarse / fine) - method.order) < 0.35
    assert fine > 1e-12


@pytest.mark.sample(1)
@pytest.mark.parametrize("method", [RKMK4(), CF4()])
def test_the_lie_group_rivals_keep_the_spatial_momentum_of_a_free_body(method):
    scene = scenes.scene("free-asymmetric", "float64")
    path = ml.integrate(method, scene.body, None, scene.start, dt=0.1, steps=100, save_every=50)
    momentum = np.asarray(ml.observe.spatial_momentum(path.states))
    assert np.all(path.ok)
    assert np.max(np.abs(momentum - momentum[0])) < 1e-14


@pytest.mark.sample(0)
def test_the_harness_moves_bodies_as_ensemble_does():
    """The loop of the ladder is that of `integrate`: same numbers, in chunks or not, steps two at a time or not."""
    scene = scenes.scene("P1", "float64")
    starts = scenes.perturbed(scene, 4, 1e-3)
    for name in ("SYMMETRIC[EA]", "RK4"):
        steps, dt = 50, 0.004
        path = ml.ensemble(name, scene.body, scene.torque, starts, dt=dt, steps=steps)
        method = ml.method(name)
        assert steps % method.unroll == 0
        ends, ok = Program(method, scene.body, scene.torque, starts, chunk=2).run(dt, steps)
        assert np.all(ok)
        np.testing.assert_allclose(ends.attitude, path.states.attitude, rtol=0, atol=1e-13)


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
    """NO_SQUISH is the three-axis splitting with kicks around it, written on the quaternion and its momentum: step by
    step the same numbers as a flight of DLM between half kicks, so that it needs no line of its own on a chart.
    `DLM[EA]` makes two such flights of half the length between its kicks.
    """
    scene = scenes.scene("asymmetric-top", "float64")
    moments = np.asarray(scene.body.moments)

    def torque(q):
        up = matrix(q)[2]
        return 3.0 * np.array([up[1], -up[0], 0.0])

    verlet = ml.schemes.Scheme(
        *("Verlet", 2, (("kick", 0.5), ("flight", 1.0), ("kick", 0.5)), "for NO_SQUISH"),
    )
    method = ml.method(ml.flights.ThreeAxis(), verlet)
    path = ml.integrate(method, scene.body, scene.torque, scene.start, dt=0.05, steps=40)
    momentum, attitude = np.asarray(scene.start.momentum), np.asarray(scene.start.attitude)
    for n in range(1, 41):
        momentum, attitude = no_squish(moments, momentum, attitude, 0.05, torque)
        np.testing.assert_allclose(path.states.momentum[n], momentum, rtol=0, atol=1e-12)
        np.testing.assert_allclose(path.states.attitude[n], attitude, rtol=0, atol=1e-13)


def unit(scene):
    """The scene from an attitude of unit length to rounding; published ones have it to their digits."""
    q = scene.start.attitude
    return replace(scene, start=ml.RigidState(scene.start.momentum, q / jnp.linalg.norm(q)))


@pytest.mark.parametrize("name", ["bruls-cardona", "gravity-gradient"])
def test_axes_numbered_anew_are_the_same_motion(name):
    """The torque in space, and the spatial momentum, are what they were."""
    old = unit(scenes.scene(name, "float64"))
    new = all_scenes.axis_third(old)
    assert new.body.moments[0] == new.body.moments[1]
    for scene_of in (lambda s: s.start.momentum, lambda s: s.torque(jnp.float64(7.0), s.start)):
        its, mine = (ml.so3.rotate(s.start.attitude, scene_of(s)) for s in (old, new))
        np.testing.assert_allclose(mine, its, rtol=0, atol=1e-14 * float(jnp.max(jnp.abs(its))))


def test_the_exact_end_does_not_depend_on_the_numbers_of_axes():
    """A top about its third, second, first and downward axis ends as one and the same."""
    scene = unit(scenes.scene("slow-top", "float64"))
    turn = np.asarray(ml.so3.to_matrix(jnp.full(4, 0.5)))
    ends = [convergence.find_reference(scene, 1)]
    for _ in range(2):
        scene = all_scenes.renumbered(scene, 0)
        ends.append(convergence.find_reference(scene, 1))
        np.testing.assert_allclose(ends[-1].momentum, ends[-2].momentum[[1, 2, 0]], rtol=0, atol=1e-13)
        np.testing.assert_allclose(ends[-1].attitude, ends[-2].attitude @ turn, rtol=0, atol=1e-13)
    flipped = ml.torques.HeavyTop(-scene.torque.mgl, tuple(-x for x in scene.torque.axis))
    again = convergence.find_reference(replace(scene, torque=flipped), 1)
    np.testing.assert_allclose(again.attitude, ends[-1].attitude, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", [name for name in work_precision.SCENES if name not in all_scenes.OWN])
def test_the_rivals_are_given_the_torque_of_the_scene(name):
    scene = all_scenes.axis_third(unit(scenes.scene(name, "float64")))
    q = scene.start.attitude
    orbit = rigid.orbit_of(scene)
    for t in (0.0, 1234.5):
        place = None if orbit is None else rigid.kepler(orbit)(t)
        found = rigid.torque(scene)([float(x) for x in q], place)
        exact = np.zeros(3) if scene.torque is None else np.asarray(scene.torque(jnp.float64(t), scene.start))
        np.testing.assert_allclose(
            [0.0 if x is None else x for x in found], exact, rtol=0, atol=1e-13 * max(1e-300, np.abs(exact).max())
        )


@pytest.mark.parametrize("name", work_precision.SCENES)
def test_the_rivals_are_given_the_equations_of_the_scene(name):
    """The rates of their numbers are those of a step of our own equations, of every kind of state."""
    scene = all_scenes.scene(name)
    start, system = scene.start.normalised(), System.of(scene.body, scene.torque, scene.start, jnp.asarray(0.0))
    motion = Motion(*start.parts())
    force = None if scene.torque is None else system.force(jnp.asarray(0.0), motion)
    exact = [float(x) for x in numbers_of(start, system.inertia, motion, force)]
    orbit = rigid.orbit_of(scene)
    place = None if orbit is None else rigid.kepler(orbit)(0.0)
    found = kinds.kind_of(scene).rates(scene)(kinds.numbers(start).tolist(), place)
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-13 * max(map(abs, exact)))


def numbers_of(start, inertia, motion, force):
    """d/dt of the numbers of a state, in their order, by its own `rates`."""
    momentum, pose = start.kind.rates(inertia, jnp.asarray(1.0), motion.momentum, motion.pose, force)
    if isinstance(momentum, Momenta):
        return *momentum.angular, *pose.orientation, *momentum.linear, *pose.position
    return *momentum, *pose


def test_perturbed_copies_are_those_of_the_package():
    scene = scenes.scene("asymmetric-top", "float64")
    found, known = all_scenes.perturbed(scene.start, 4, 1e-3), scenes.perturbed(scene, 4, 1e-3)
    np.testing.assert_allclose(kinds.numbers(found), kinds.numbers(known), rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", all_scenes.OWN)
def test_errors_of_other_kinds_of_state(name):
    """Zero of the exact end; of the attitude in radian, of the position relative to r, of the axis in radian."""
    scene = all_scenes.scene(name)
    exact = kinds.numbers(all_scenes.perturbed(scene.start, 1, 0.0))
    for size in (0.0, 1e-5):
        turned = jnp.zeros(scene.start.minus(scene.start).shape).at[4].set(size)
        moved = kinds.numbers(jax.tree.map(lambda x: x[None], scene.start.plus(turned)))
        assert kinds.kind_of(scene).errors(moved, exact)[0] == pytest.approx(size, rel=1e-4, abs=1e-15)
    if name == "orbit":
        assert kinds.kind_of(scene).errors(exact + 1e-3 * np.eye(13)[[12]], exact)[0] == pytest.approx(1e-3)


@pytest.mark.sample(0)
def test_a_whole_top_ends_with_the_axis_of_the_axis():
    pytest.importorskip("heyoka")
    given = work_precision.problem("axis", bodies=2, judged=2, quick=True)
    whole = spinning_top.whole(given)
    ends = heyoka_taylor.reference(whole.scene, whole.kind, whole.states)
    assert whole.error(ends) < 1e-14
    assert whole.states.shape == (2, 7)
    assert not list(spinning_top.measure(work_precision.problem("P1", bodies=2, judged=2, quick=True)))


def test_the_closed_form_is_one_point_at_rounding():
    given = work_precision.problem("tumbling-brick", bodies=4, judged=2, quick=True)
    said = []
    ours, _ = work_precision.measure(given, ["free_motion"], (), said=said.append)
    assert said == ["free_motion"]
    (point,) = ours
    assert point.error < 1e-13
    assert point.seconds > 0
    assert work_precision.families_of(ours) == {"free_motion": "symplectic"}


def test_scipy_reaches_the_end_of_a_scene():
    given = work_precision.problem("P1", bodies=2, judged=2, quick=True)
    scene = replace(given.scene, duration=0.5)
    given = given._replace(scene=scene, ends=work_precision._ends(scene, given.states)[0])
    (point,) = scipy_dop853.measure(given, (1e-11,))
    assert point.error < 1e-8


def test_heyoka_and_the_reference_agree_with_the_closed_form():
    pytest.importorskip("heyoka")
    given = work_precision.problem("bruls-cardona", bodies=4, judged=2, quick=True)
    assert "Taylor series in 30 digits" in given.source
    found = heyoka_taylor.reference(given.scene, given.kind, given.states[:2])
    assert given.error(found) < 1e-14
    coarse, fine = heyoka_taylor.measure(given, (1e-4, 1e-8))
    assert fine.error < 1e-4 * coarse.error < 1e-2


def test_mujoco_turns_the_same_top():
    pytest.importorskip("mujoco")
    given = work_precision.problem("P1", bodies=4, judged=4, quick=True)
    given = given._replace(longest=0.0)
    errors = [p.error for p in itertools.islice(mujoco_steps.rk4(given), 5)]
    assert min(errors) < 1e-5
    assert not list(mujoco_steps.rk4(given._replace(scene=scenes.scene("gravity-gradient", "float64"))))


def test_a_missing_rival_is_named_with_the_extra(monkeypatch, capsys):
    monkeypatch.setattr(rivals, "find_spec", lambda name: None if name in ("heyoka", "mujoco") else name)
    with pytest.raises(SystemExit, match="2"):
        benchmark("rivals").main(["P1"])
    said = capsys.readouterr()
    assert "heyoka and mujoco" in said.err
    assert "pip install 'midlie_jax[bench]'" in said.err
    assert said.out == ""
