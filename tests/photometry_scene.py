"""Magnitudes of a tumbling ellipsoid by NumPy and SciPy alone: facets, Euler's equations by DOP853, circular orbits."""

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

MOMENTS, SEMI_AXES = np.array([0.53, 0.9146, 1.0]), np.array([1.5, 1.0, 0.85])
MOMENTUM = np.array([0.20943951, 0.22340214, 0.64926248])  # body frame, at the time 0; hours
ATTITUDE = np.array([0.56443288, 0.13994471, 0.46500512, 0.6675337])
PERIODS = 7.15918897, 52.04676366  # precession of the short axis, rotation
NIGHTS = np.array([0.0, 24.0, 48.0, 120.0, 216.0, 336.0, 504.0, 720.0])
SIGMA, FACETS = 0.0217, 20000


def directions(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sun and observer, from the asteroid at 1.3 au; phase angle near 50 degrees."""
    asteroid = 0.6 + 2 * np.pi / (24 * 365.25) / 1.3**1.5 * t
    earth = -0.2 + 2 * np.pi / (24 * 365.25) * t
    place = 1.3 * np.stack([np.cos(asteroid), np.sin(asteroid), 0.1 * np.sin(asteroid)], axis=1)
    seen = np.stack([np.cos(earth), np.sin(earth), 0 * earth], axis=1) - place
    sun, observer = (-x / np.linalg.norm(x, axis=1, keepdims=True) for x in (place, -seen))
    return sun, observer


def magnitudes(t: np.ndarray, sun: np.ndarray, observer: np.ndarray) -> np.ndarray:
    """At times after 0, for the Lommel-Seeliger law."""

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        spin = y[:3] / MOMENTS
        w, v = y[3], y[4:]
        return np.concatenate([np.cross(y[:3], spin), [-v @ spin / 2], (w * spin + np.cross(v, spin)) / 2])

    start = np.concatenate([MOMENTUM, ATTITUDE])
    states = solve_ivp(rates, (0, t[-1]), start, "DOP853", t_eval=t, rtol=1e-11, atol=1e-12).y
    to_body = Rotation.from_quat(states[3:].T, scalar_first=True).inv()
    k = np.arange(FACETS) + 0.5
    polar, around = np.arccos(1 - 2 * k / FACETS), np.pi * (1 + 5**0.5) * k
    ball = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1)
    normals = ball / SEMI_AXES
    areas = np.linalg.norm(normals, axis=1)
    mu0, mu = (np.maximum(to_body.apply(x) @ (normals / areas[:, None]).T, 0) for x in (sun, observer))
    return -2.5 * np.log10((mu0 * mu / np.maximum(mu0 + mu, 1e-300)) @ areas)


def scene(seed: int) -> dict[str, Any]:
    """Eight nights of 45 values and 40 sparse ones, each group with its zero point; 2 % noise and 3 % outliers."""
    rng = np.random.default_rng(seed)
    nights = [start + np.sort(rng.uniform(0, 6.3, 45)) for start in NIGHTS]
    t = np.concatenate([*nights, rng.uniform(-220, 1060, 40)]) + 224.0
    index = np.repeat(np.arange(9), [45] * 8 + [40])
    order = np.argsort(t)
    t, index = t[order], index[order]
    sun, observer = directions(t)
    zeros = rng.uniform(17.0, 18.5, 9)
    noise = SIGMA * rng.standard_normal(400)
    outliers = np.sort(rng.choice(400, 11, replace=False))
    noise[outliers] += rng.uniform(0.2, 0.8, 11) * rng.choice([-1, 1], 11)
    light_time = 0.05 + 1e-5 * t
    seen = magnitudes(t, sun, observer) + zeros[index] + noise
    return {
        "times": t + light_time, "values": seen, "night": index, "sun": sun, "observer": observer,
        "light_time": light_time, "zeros": zeros, "outliers": outliers,
    }  # fmt: skip
