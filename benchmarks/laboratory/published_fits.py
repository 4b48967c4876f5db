"""Fits to published rates, each estimate beside the published number.

The tumbling brick of NASA's NESC (check case 2, simulation 1) is a free body: thirteen rows of its rates. The satellite
of NASA's JEOD (verification case RUN_10A) turns in the gravity gradient of the Earth on a known orbit, from a known
attitude: only its rates at the start and after 28,800 s are published. All rates are in the body frame.
"""

import math
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
from harness import Table

import midlie_jax as ml
from midlie_jax import fitting
from midlie_jax.cli import scenes

BRICK = np.array([0.00189422, 0.006211019, 0.007194665])  # slug ft^2
BRICK_TIMES = np.arange(0.0, 30.1, 2.5)  # seconds
BRICK_RATES = np.deg2rad(
    [
        (9.99999999996, 20, 29.9999999999),
        (-4.74028105465, 22.9654461294, 28.4678763351),
        (-16.9394851494, 9.63193937744, 33.4066280794),
        (-15.6333789317, -12.7550023251, 32.6626195391),
        (-2.41890222178, -23.5525695195, 28.12859263),
        (12.0432574252, -18.0549594639, 30.8551539978),
        (18.4372543136, 2.38688029891, 34.3107056116),
        (9.36648383982, 20.4978715829, 29.7627968788),
        (-5.42273467989, 22.7159305765, 28.6082817472),
        (-17.2600824195, 8.64613424581, 33.595702754),
        (-15.1840887012, -13.6177995003, 32.4167961984),
        (-1.72453974837, -23.652730324, 28.0694406586),
        (12.6183907757, -17.3974747618, 31.1195888868),
    ]
)
NOISE = 1e-3 * np.linalg.norm(BRICK_RATES[0])

SATELLITE = np.array([500.0, 12250.0, 12250.0])  # kg m^2
SATELLITE_TIMES = np.array([0.0, 28800.0])  # seconds
SATELLITE_RATES = np.array(  # rad/s
    [
        (-1.97989570839746e-5, -0.001134281491669957, 0.0),
        (-1.97989570839746e-5, -0.001080027400090759, -0.0007098670173048437),
    ]
)
KNOWN_TO = 2.3e-13  # rad/s, to which an independent computation agrees with the published rates at the end
METHOD = "RK4"
BRICK_STEP = 2.5 / 100


def free(values: Any) -> Any:
    body = ml.RigidBody(values["moments"])
    return body, None, ml.MomentumState(body.momentum(values["rate"]))


def brick_guess() -> dict[str, Any]:
    """Moments in other ratios by 3 to 8 %, with the published sum; rates off by 2 %."""
    moments = BRICK * [1.05, 0.97, 1.0]
    moments = moments * (BRICK.sum() / moments.sum())
    return {
        "moments": fitting.Moments(moments, scale="fixed"),
        "rate": fitting.Free(BRICK_RATES[0] * [1.02, 0.98, 1.01]),
    }


def brick_data(rates: Any = BRICK_RATES) -> fitting.Rates:
    return fitting.Rates(BRICK_TIMES, rates, NOISE)


def fitted_brick() -> Any:
    return ml.fit(free, brick_guess(), brick_data(), method=METHOD, dt=BRICK_STEP)


def satellite(values: Any) -> Any:
    """On the published orbit from the published attitude; the rates at the start are a parameter or the published."""
    scene: Any = scenes.scene("gravity-gradient")
    body = ml.RigidBody(values["moments"])
    torque = ml.spacecraft.GravityGradient(None, scene.torque.orbit, scene.torque.mu)
    rate = values.get("rate", jnp.asarray(SATELLITE_RATES[0]))
    return body, torque, ml.RigidState(body.momentum(rate), scene.start.attitude)


def satellite_data() -> fitting.Rates:
    return fitting.Rates(SATELLITE_TIMES, SATELLITE_RATES, KNOWN_TO)


def fitted_satellite() -> Any:
    """The first moment of the guess is a fifth too large, and the published sum of the moments is kept."""
    guess = {
        "moments": fitting.Moments([600.0, 12200.0, 12200.0], scale="fixed"),
        "rate": fitting.Free(SATELLITE_RATES[0]),
    }
    return ml.fit(satellite, guess, satellite_data(), method=METHOD, dt=5.0, absolute_sigma=True)


def satellite_without_scale() -> Any:
    """The same with all three moments free, which the data do not determine; the rates at the start are known."""
    guess = {"moments": fitting.Moments([600.0, 12200.0, 12200.0])}
    options: Any = {"method": METHOD, "dt": 5.0, "absolute_sigma": True, "require_rank": False}
    return ml.fit(satellite, guess, satellite_data(), **options)


def ratios(values: Any) -> Any:
    return values["moments"][:2] / values["moments"][2]


def quantities(label: str, result: Any, published: Any, unit: str) -> Iterator[tuple[str, str, Any, Any, Any]]:
    """Ratios of the moments and the rates at the start: published, fitted, half the 95 % interval."""
    moments, rate = published
    values, intervals = result.derived(ratios)
    for i, name in enumerate(("I1/I3", "I2/I3")):
        yield label, name, moments[i] / moments[2], values[i], np.ptp(intervals[i]) / 2
    values, intervals = result.derived(lambda v: v["rate"])
    for i in range(3):
        yield label, f"Ω{i + 1} at the start, {unit}", rate[i], values[i], np.ptp(intervals[i]) / 2


def rows() -> Iterator[list[str]]:
    brick, other = fitted_brick(), fitted_satellite()
    assert brick.ok
    assert other.ok
    for label, name, published, found, half in [
        *quantities("brick", brick, (BRICK, np.deg2rad([10.0, 20.0, 30.0])), "rad/s"),
        *quantities("satellite", other, (SATELLITE, SATELLITE_RATES[0]), "rad/s"),
    ]:
        digits = 1 - math.floor(math.log10(half))
        shown = f"{round(float(found), digits) + 0.0:.{digits}f}"  # no zero with a sign
        yield [label, name, f"{published:.12g}", shown, f"{half:.1e}"]


TABLE = Table(
    *("reports/applications.md", "published fits"),
    ("body", "quantity", "published", "fitted", "half of the 95 % interval"),
    *(rows, "published-fits", lambda row: row[1] in ("I1/I3", "I2/I3")),
)


def measure(options: Any) -> None:
    TABLE.show(options.write)
    print(satellite_without_scale())
