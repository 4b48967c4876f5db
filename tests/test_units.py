"""The law of units: numbers in other units give the result in these units, or an error that says what to do.

Units are scaled by powers of two, which changes no digit of a product; SCENES are those of SI values."""

from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import CLASSES, DTYPES, ROTATION, epsilon, suited, torque_classes, whole
from unit_cases import CASES, INERTIA, MOMENTUM, NUMBER, TIME, TORQUE, TORQUES, Case, Units, dimensions, rigid, turning

import midlie_jax as ml
from midlie_jax._checks.arguments import same_dtype
from midlie_jax.drivers.arguments import check_clock
from midlie_jax.drivers.observe.observables import QUANTITIES
from midlie_jax.model import densities, orbits, torques

# Powers of two of the units of length, mass and time in which the numbers of this file, of about one, are SI values.
SCENES = {
    "nanoparticle": (-27, -66, -20),
    "bacterium": (-20, -50, -10),
    "satellite": (0, 5, 0),
    "asteroid": (9, 40, 13),
    "moonlet": (14, 55, 16),
    "planet": (23, 82, 16),
    "Sun": (29, 100, 21),
    "orbit of a planet about the Sun": (37, 12, 22),
    "outer comet": (47, 30, 38),
}
EXTREMES = {
    "float32": [(40, 0, 0), (-36, 0, 0), (0, 80, 0), (0, -80, 0), (0, 0, 50), (0, 0, -50), (30, -90, 40), (-30, 90, 9)],
    "float64": [(300, 0, 0), (-300, 0, 0), (0, 600, 0), (0, -600, 0), (0, 0, 400), (0, 0, -400), (200, -700, 300)],
}


# ---- the law ----


def results(case: Case, u: Units) -> list[np.ndarray] | str | None:
    """The results, compiled; the message if the arguments are refused; None if the dtype does not hold a number."""
    try:
        arguments = jax.tree.map(lambda x: jnp.asarray(x) if isinstance(x, np.ndarray) else x, case.build(u))
        if not u.held:
            return None
        eager = case.call in EAGER
        found = case.call(*arguments) if eager else _compiled(case.call)(*arguments)
    except ValueError as error:
        return str(error) if u.held else None
    return [np.asarray(x, np.float64) for x in jax.tree.leaves(found)]


EAGER = {
    CASES[name].call for name in ("TensorBody", "Surface", "from_points", "free_motion", "tumbling", "SymmetricRotor")
}
_compiled = cache(eqx.filter_jit)


def differs(case: Case, dtype: str, powers: tuple[int, int, int]) -> str:
    """What is wrong with a call in these units; nothing if it gives the result, or says that float64 is the cure."""
    reference, u = results(case, Units(dtype)), Units(dtype, powers)
    found = results(case, u)
    assert isinstance(reference, list), reference
    if found is None:
        return ""
    if isinstance(found, str):
        return "" if dtype == "float32" and "jax_enable_x64" in found else found
    for x, y, dimension in zip(found, reference, dimensions(case, len(reference)), strict=True):
        expected, held = u.scaled(y, dimension or NUMBER)
        if dimension is None or not held:
            continue
        slack = ROUNDED * epsilon(dtype) * np.max(np.abs(expected), initial=0.0)
        if not np.all(np.abs(x - expected) <= slack):
            return f"{x.ravel()[:3]} and not {expected.ravel()[:3]}"
    return ""


ROUNDED = 64  # units in the last place of the largest component
FIRST = ("EllipsoidBrightness", "tumble", "straight_rod")  # which once were wrong


@pytest.mark.sample(20)
@pytest.mark.parametrize(
    ("dtype", "name"),
    [*(("float32", name) for name in dict.fromkeys([*FIRST, *CASES])), *whole(*product(["float64"], CASES))],
)
def test_results_in_other_units_are_the_same(dtype, name):
    wrong = {powers: differs(CASES[name], dtype, powers) for powers in (*SCENES.values(), *EXTREMES[dtype])}
    assert not any(wrong.values()), {powers: text for powers, text in wrong.items() if text}


class Plain(Units):
    """Numbers of Python; vectors, which have no plain form, are float32."""

    def __call__(self, value: Any, dimension: tuple[int, int, int] = NUMBER) -> Any:
        return super().__call__(value, dimension) if np.ndim(value) else float(value)


@pytest.mark.parametrize("name", TORQUES)
def test_python_numbers_keep_float32(name):
    torque, body, state, _ = TORQUES[name].build(Plain("float32"))
    same_dtype("the state", state.momentum, torque=torque)
    found = jax.eval_shape(lambda t, state: torque.on(body)(t, state), jnp.float32(0.0), state)
    assert {leaf.dtype.name for leaf in jax.tree.leaves(found)} == {"float32"}


def public(module: Any, kind: Any = object) -> set[str]:
    found = {name: getattr(module, name) for name in dir(module) if name[0] != "_"}  # which loads what is lazy
    classes = {name: value for name, value in found.items() if isinstance(value, type) and issubclass(value, kind)}
    return {name for name, value in classes.items() if value.__module__.startswith(module.__name__)}


ROOMS = (ml.asteroids, ml.molecules, ml.spacecraft, ml.spins)


def shown(*modules: Any) -> dict[str, Any]:
    found = {name: getattr(module, name) for module in modules for name in module.__all__}
    return {name: value for name, value in found.items() if callable(value)}


def test_every_public_name_is_under_the_law_or_has_no_units():
    """A new torque, orbit, density, observable or function is named here or above, or this fails."""
    tried = {name.split()[0].split(".")[0] for name in CASES}
    classes = {name: value for name, value in shown(*ROOMS).items() if isinstance(value, type)}
    fields = {*torque_classes()} | public(orbits) | public(densities)
    assert fields <= tried | WITHOUT_UNITS, fields - tried - WITHOUT_UNITS
    quantities = public(ml.observe, ml.observe.Observable)
    quantities |= {name for name, value in classes.items() if issubclass(value, ml.observe.Observable)}
    assert quantities <= tried | OBSERVED, quantities - tried - OBSERVED
    functions = {name for name, value in shown(ml, *ROOMS).items() if not isinstance(value, type)}
    functions |= {function.__name__ for function in QUANTITIES}
    assert functions <= tried | RUNS, functions - tried - RUNS


# Made of functions alone, whose numbers are the user's, and base classes.
WITHOUT_UNITS = {
    *("BodyTorque", "FromPotential", "Prescribed", "VelocityDependent", "Torque", "SpinField", "OwnField", "Orbit")
}
# Observables made of functions or of others, or without units.
OBSERVED = {"Axis", "Function", "Observable", "Together"}
# Functions that run others, or take numbers without units: names, keys, points of no dimension.
RUNS = {
    *("check", "ensemble", "fit", "integrate", "integrate_variable_step", "method", "methods", "recommend", "scatter"),
    *("simulate", "stepper", "tumblings", "checkerboard", "read", "write_xyz", "register_for_export", "gmst"),
}


# ---- runs ----

OTHERS = [name for name in ROTATION if name not in CLASSES]
RUN_UNITS = [(-20, -50, -10), (9, 40, 13), (14, 55, 16), (0, 90, 0), (30, -90, 40), (-30, 90, 9), (0, 0, -50)]


def steps_of(name: str, u: Units) -> Any:
    body = ml.RigidBody(suited(name, jnp.asarray(u([1.0, 2.0, 2.5], INERTIA))))
    torque = torques.HeavyTop(jnp.asarray(u(2.0, TORQUE)), (0.48, -0.6, 0.64))
    state = jax.tree.map(jnp.asarray, turning(u))
    return body, torque, state, u(0.02, TIME)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("dtype", "name"), [*product(["float32"], CLASSES), *whole(*product(DTYPES, OTHERS))])
def test_a_run_in_other_units_is_the_same_run(dtype, name):
    run = jax.jit(lambda body, torque, start, dt: ml.integrate(name, body, torque, start, dt=dt, steps=4))
    reference = run(*steps_of(name, Units(dtype)))
    assert reference.ok
    for powers in RUN_UNITS:
        u = Units(dtype, powers)
        path = run(*steps_of(name, u))
        assert u.held
        assert path.ok
        np.testing.assert_allclose(path.states.attitude, reference.states.attitude, atol=ROUNDED * epsilon(dtype))
        scaled, _ = u.scaled(reference.states.momentum, MOMENTUM)
        np.testing.assert_allclose(path.states.momentum, scaled, atol=ROUNDED * epsilon(dtype) * np.abs(scaled).max())


# ---- SI values, and what the dtype does not hold ----


def test_numbers_beyond_float32_name_the_cure():
    """Moments of a nanoparticle and of the Earth, in kg m^2, and Python numbers."""
    for moment in (np.float32(5e-32), np.float32(8e37)):
        tensor = moment * np.eye(3, dtype=np.float32)
        for make, given in ((ml.RigidBody, np.full(3, moment)), (ml.TensorBody, tensor), (ml.SymmetricRotor, moment)):
            with pytest.raises(ValueError, match=r"must be between 5e-31 and 2e\+30 in float32.*jax_enable_x64"):
                make(given)
        assert ml.RigidBody(float(moment) * np.ones(3))
    top, gravity = torques.HeavyTop, torques.UniformGravity
    with jax.enable_x64(False):
        for make, value in ((top, 1e40), (top, 1e-50), (gravity, [1e39, 0.0, 1.0])):
            with pytest.raises(ValueError, match=r"in float32, got 1e.*jax_enable_x64"):
                make(value)
        assert gravity([1e-60, 0.0, 9.81]).acceleration.dtype == np.float32


# ---- times that do not move ----

LATE = 1.77e9  # seconds since 1970
SINGLE = Units("float32")
TWO = jax.tree.map(lambda x: jnp.stack([x, x]), turning(SINGLE))


def late(driver: Callable[..., Any], start: Any = None, **options: Any) -> Any:
    start = turning(SINGLE) if start is None else start
    return driver("JACOBI[EA]", rigid(SINGLE), None, start, **{"dt": 0.1, "steps": 10, "t0": LATE, **options})


MINUTES = 8e8 + 10 * np.arange(721.0)
LATE_TIMES, ROWS = np.float32(LATE) + 128 * np.arange(9, dtype=np.float32), np.zeros((9, 3), np.float32)
FEW = {"tolerance": 1e-2, "duration": 10.0, "t0": LATE}
GUESS = {"x": ml.fitting.Free(jnp.float32(1.0))}
RATES = ml.fitting.Rates(np.float32(LATE) + 1e4 * np.arange(9, dtype=np.float32), ROWS, 1.0)
FROZEN = {
    "integrate": lambda path: late(ml.integrate),
    "ensemble": lambda path: late(ml.ensemble, TWO, t0=jnp.array([0.0, LATE], jnp.float32)),
    "simulate": lambda path: late(ml.simulate, TWO, out=path / "run.npz"),
    "integrate_variable_step": lambda path: late(ml.integrate_variable_step, density=lambda t, state: 1 + 0 * t),
    "check": lambda path: late(ml.check),
    "recommend": lambda path: ml.recommend(rigid(SINGLE), None, turning(SINGLE), **FEW),
    "free_motion": lambda path: ml.free_motion(rigid(SINGLE), turning(SINGLE), MINUTES),
    "Rates": lambda path: ml.fitting.Rates(MINUTES, np.zeros((721, 3), np.float32), 1.0),
    "Observed": lambda path: ml.fitting.Observed(MINUTES, np.zeros(721, np.float32), 1.0, lambda t, s, b, v: t),
    "fit": lambda path: ml.fit(lambda v: (rigid(SINGLE), None, turning(SINGLE)), GUESS, RATES, dt=0.5, t0=LATE),
    "states_at": lambda path: ml.fitting.states_at("RK4", rigid(SINGLE), None, turning(SINGLE), MINUTES, dt=1.0),
    "TableOrbit": lambda path: orbits.TableOrbit(LATE_TIMES, np.ones((9, 3), np.float32)),
}


def test_times_that_do_not_move_are_refused(tmp_path):
    for call in FROZEN.values():
        with pytest.raises(ValueError, match=r"4 units in the last place.*jax_enable_x64"):
            call(tmp_path)


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_step_of_four_last_places_is_taken_and_a_long_run_from_zero_too(dtype):
    t0 = np.asarray(LATE, dtype)
    four = 4 * np.spacing(t0)
    check_clock(t0, four, 0, 10**6)
    check_clock(-t0, -four)
    check_clock(np.stack([t0, 0 * t0]), np.stack([four, four / 100]))
    check_clock(np.zeros((), dtype), np.asarray(0.1, dtype), 2**31 - 10, 9)
    for late_step in (four / 2, -four / 2):
        with pytest.raises(ValueError, match="4 units in the last place of t0"):
            check_clock(t0, late_step)
    with pytest.raises(ValueError, match="4 units in the last place of t0"):
        check_clock(np.stack([t0, 0 * t0]), four / 2)
