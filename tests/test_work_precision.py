"""Error against cost: the rivals written here, other programs, and the best of many methods at an error."""

import itertools
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import work_precision
from laboratory import rivals
from laboratory.rivals import CF4, RKMK4, Point
from work_precision import FAMILIES, family, work_precision_figure

import midlie_jax as ml
from midlie_jax.advice.program import Program
from midlie_jax.cli import scenes
from midlie_jax.integrators.registry import entries
from midlie_jax.integrators.runge_kutta import DOP853, RK4
from midlie_jax.integrators.system import Motion, System
from midlie_jax.model.free_body import Momenta

frontier = work_precision
kinds = all_scenes = heyoka_taylor = problem = runge_kutta = rivals


@pytest.mark.sample(0)
@pytest.mark.parametrize(("method", "count"), [(RKMK4(), 40), (CF4(), 40), (RK4, 40), (DOP853, 4)])
def test_order_on_the_asymmetric_top(method, count):
    """Of four bodies in the program of the ladder, judged by `ensemble` of DOP853 with steps of 1/400."""
    scene = replace(all_scenes.axis_third(scenes.scene("asymmetric-top", "float64")), duration=1.0)
    starts = scenes.perturbed(scene, 4, 1e-2)
    exact = ml.ensemble("DOP853", scene.body, scene.torque, starts, dt=1 / 400, steps=400)
    given = problem.Problem(scene, kinds.kind_of(scene), starts, kinds.numbers(exact.states), "", 0.0, 1)
    program = Program(method, scene.body, scene.torque, starts, chunk=2)
    ends = [program.run(1 / n, n) for n in (count, 2 * count)]
    assert all(np.all(ok) for _, ok in ends)
    coarse, fine = (given.error(kinds.numbers(states)) for states, _ in ends)
    assert abs(math.log2(coarse / fine) - method.order) < 0.35
    assert fine > 1e-12


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
        up = kinds.matrix(q)[2]
        return 3.0 * np.array([up[1], -up[0], 0.0])

    verlet = ml.schemes.Scheme("Verlet", 2, (("kick", 0.5), ("flight", 1.0), ("kick", 0.5)), "for NO_SQUISH")
    method = ml.method(ml.flights.ThreeAxis(), verlet)
    path = ml.integrate(method, scene.body, scene.torque, scene.start, dt=0.05, steps=40)
    momentum, attitude = np.asarray(scene.start.momentum), np.asarray(scene.start.attitude)
    for n in range(1, 41):
        momentum, attitude = no_squish(moments, momentum, attitude, 0.05, torque)
        np.testing.assert_allclose(path.states.momentum[n], momentum, rtol=0, atol=1e-12)
        np.testing.assert_allclose(path.states.attitude[n], attitude, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["bruls-cardona", "gravity-gradient"])
def test_axes_numbered_anew_are_the_same_motion(name):
    """The torque in space, and the spatial momentum, are what they were."""
    old = scenes.scene(name, "float64")
    old = replace(old, start=old.start.kind.normalised(old.start))
    new = all_scenes.axis_third(old)
    assert new.body.moments[0] == new.body.moments[1]
    for scene_of in (lambda s: s.start.momentum, lambda s: s.torque(jnp.float64(7.0), s.start)):
        its, mine = (ml.so3.rotate(s.start.attitude, scene_of(s)) for s in (old, new))
        np.testing.assert_allclose(mine, its, rtol=0, atol=1e-14 * float(jnp.max(jnp.abs(its))))


@pytest.mark.parametrize("name", work_precision.SCENES)
def test_the_rivals_are_given_the_equations_of_the_scene(name):
    """The rates of their numbers are those of a step of our own equations, of every kind of state."""
    scene = all_scenes.scene(name)
    start, orbit = scene.start.kind.normalised(scene.start), kinds.orbit_of(scene)
    motion = Motion(*start.parts())
    for t in (0.0, 1234.5):
        system = System.of(scene.body, scene.torque, scene.start, jnp.asarray(t))
        force = None if scene.torque is None else system.force(jnp.asarray(t), motion)
        momentum, pose = start.kind.rates(system.inertia, jnp.asarray(1.0), motion.momentum, motion.pose, force)
        parts = (momentum, pose)
        if isinstance(momentum, Momenta):
            parts = momentum.angular, pose.orientation, momentum.linear, pose.position
        exact = [float(x) for part in parts for x in part]
        place = None if orbit is None else kinds.kepler(orbit)(t)
        found = kinds.kind_of(scene).rates(scene)(kinds.numbers(start).tolist(), place)
        np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-13 * max(map(abs, exact)))


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


def given(name, bodies=2):
    return work_precision.problem(name, bodies=bodies, judged=2, quick=True)


def test_programs_reach_the_known_ends():
    """heyoka in 38 digits and at tolerances, SciPy, MuJoCo and the closed form; each has none of other problems."""
    (point,) = work_precision.measure(given("tumbling-brick"), ["free_motion"], (), said=lambda text: None)[0]
    assert point.error < 1e-13
    top = given("P1", 4)
    short = replace(top.scene, duration=0.5)
    top = top._replace(scene=short, ends=work_precision._ends(short, top.states[:2])[0])
    (point,) = runge_kutta.dop853(top, (1e-11,))
    assert point.error < 1e-8
    pytest.importorskip("mujoco")
    rk4 = next(rival for rival in rivals.RIVALS if rival.label == "MuJoCo RK4").measure
    assert min(p.error for p in itertools.islice(rk4(top._replace(longest=0.0)), 5)) < 1e-5
    assert not list(rk4(top._replace(scene=scenes.scene("gravity-gradient", "float64"))))
    pytest.importorskip("heyoka")
    assert top.error(heyoka_taylor.reference(short, top.kind, top.states[:2])) < 1e-14
    coarse, fine = heyoka_taylor.measure(top, (1e-4, 1e-8))
    assert fine.error < 1e-3 * coarse.error < 1e-3
    assert not list(heyoka_taylor.measure_spinning(top))
    axis = given("axis")
    whole = heyoka_taylor.whole(axis)
    assert whole.error(heyoka_taylor.reference(whole.scene, whole.kind, whole.states)) < 1e-14


# ---- frontiers, on made-up points ----


def line(method: str, order: int, unit: float, counts=(1, 10, 100)) -> list[Point]:
    """error = (unit / seconds)^order"""
    return [Point(method, "", (unit / n) ** order, float(n), 2.0 * n, float(n)) for n in counts]


@pytest.mark.parametrize("order", [2, 8])
def test_cost_is_a_straight_line_in_logarithms(order):
    assert frontier.envelope([4.0, 1.0, 2.0, 3.0, 5.0], [1e-3, 1e-1, 1e-4, 1e-2, math.nan]) == [(1, 1e-1), (2, 1e-4)]
    reached = frontier.envelope(*zip(*[(p.seconds, p.error) for p in line("x", order, 0.5)], strict=True))
    for seconds in (1, 3, 10, 40, 100):
        assert frontier.cost_at(reached, (0.5 / seconds) ** order) == pytest.approx(seconds, rel=1e-12)
    assert frontier.cost_at(reached, 1.0) == 1  # a smaller error than asked for serves
    assert frontier.cost_at(reached, (0.5 / 101) ** order) == math.inf  # and nothing is claimed beyond the points
    assert frontier.cost_at([(1.0, 1e-2), (2.0, 0.0)], 1e-3) > 1  # an error of exactly zero has a logarithm, too


def test_the_frontier_is_the_lower_envelope_of_all_lines():
    """Order 2 with a small constant, and order 4: they cross where (1/n)^2 = (3/n)^4, n = 9."""
    both = line("low", 2, 1.0) + line("high", 4, 3.0)
    edge = frontier.frontier(both)
    for cost, error in edge[1:]:
        assert cost == pytest.approx(min(max(1.0, error**-0.5), max(1.0, 3 * error**-0.25)), rel=1e-9)
    assert frontier.best_at(both, 1 / 7.0**2).method == "low"
    assert frontier.best_at(both, (3 / 20.0) ** 4).method == "high"
    assert edge[0][0] < 1.2  # begins where the cheapest run is, not above it


def test_ratios_and_the_spread_of_the_runs_that_they_come_from():
    names = {"A": "symplectic", "B": "general", "C": "conserving"}
    ours = [p._replace(spread=0.3) for p in line("A", 4, 1.0)] + line("B", 4, 0.5) + line("C", 4, 2.0)
    others = line("heyoka", 4, 2.0) + line("diffrax Tsit5", 4, 50.0, (100, 1000)) + line("CF4", 4, 0.25)
    (row, beyond) = frontier.ratios(ours, others, names, [1e-4, 1e-12])
    assert (row.rival.method, row.over_rival, row.over_diffrax) == ("CF4", pytest.approx(2), pytest.approx(1 / 100))
    # The symplectic method is quicker than the one that only conserves, so it is the best of both families.
    bests = {name: (share.best.method, share.over_heyoka) for name, share in row.families.items()}
    assert bests["general"] == ("B", pytest.approx(1 / 4))
    assert bests["conserving"] == bests["symplectic"] == ("A", pytest.approx(1 / 2))
    assert all(math.isnan(x) for x in (beyond.over_rival, *(share.over_heyoka for share in beyond.families.values())))
    cells = frontier.cells(row)
    assert cells[3].startswith("A: ")
    assert cells[3].endswith(" ±30%")
    assert cells[5] == "same"
    assert frontier.span([0.5, 2.0, math.nan]) == "0.5 to 2 (1 of 3 not compared)"


@pytest.mark.parametrize("name", entries())
def test_the_family_of_a_method_is_told_by_its_attributes(name):
    method = ml.method(name)
    found = family(method)
    assert (found == "symplectic") == method.symplectic
    assert (found == "general") == (not method.symmetric and not method.symplectic and not method.keeps_energy)


@pytest.mark.parametrize("scene", ["asymmetric-top", "tumbling-brick"])
def test_a_chart_shows_rivals_by_time_and_leading_methods_by_evaluations(scene):
    """The closed form of a free body takes no steps: it is among the times alone, and in all three families."""
    free, nan = scene == "tumbling-brick", math.nan
    names = work_precision.methods_for(scenes.scene(scene))
    assert ("free_motion" in names) == free
    ours = [p for one in names if one != "free_motion" for p in line(one, 4, 1.0)]
    if free:
        ours = [p._replace(evaluations=nan) for p in ours] + [Point("free_motion", "", 1e-14, 1e-9, nan, nan, 0.1)]
    others = [p for rival in rivals.RIVALS for p in line(rival.label, 4, 1.0)]
    families = work_precision.families_of(ours)
    figure = work_precision_figure(ours, others, families, title="made up", note="of nothing")
    by_time, by_count = (set(axes.get_legend_handles_labels()[1]) for axes in figure.axes)
    assert by_time == {p.method for p in others} | set(FAMILIES) | ({"free_motion"} if free else set())
    assert set(FAMILIES) < by_count <= {*names, *FAMILIES} - {"free_motion"}
    (row,) = frontier.ratios(ours, others, families, [1e-6])
    assert not free or {share.best.method for share in row.families.values()} == {"free_motion"}
