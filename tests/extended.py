"""Every method in extended precision: its published equations on NumPy's longdouble, many bodies at a time.

An oracle for single steps that shares no code with the package but the tables of coefficients. Implicit equations are
solved by Newton's method along a path from a step of no length, which leads to the root that a small step has. Vectors
are (n, 3), quaternions (n, 4), scalars (n, 1), so that everything broadcasts.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from midlie_jax.integrators import schemes, tableau

LONG = np.longdouble
_PARTS, _ITERATIONS = 12, 12


class Motion(NamedTuple):
    """Momentum (n, 3) and attitude (n, 4)."""

    momentum: np.ndarray
    attitude: np.ndarray


Torque = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of time (n, 1) and attitude (n, 4)


def dot(a, b):
    return np.sum(a * b, axis=-1, keepdims=True)


def multiply(p, q):
    w, u, s, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.concatenate([w * s - dot(u, v), w * v + s * u + np.cross(u, v)], axis=1)


def conjugate(q):
    return q * np.array([1, -1, -1, -1])


def rotate(q, v):
    """By the rotation that q stands for, whatever its length."""
    w, u = q[:, :1], q[:, 1:]
    return v + 2 * np.cross(u, w * v + np.cross(u, v)) / dot(q, q)


def back(q, v):
    return rotate(conjugate(q), v)


def exp(v):
    half = np.sqrt(dot(v, v)) / 2
    sinc = np.where(half > 0, np.sin(half) / np.where(half > 0, half, 1), 1)
    return np.concatenate([np.cos(half), sinc * v / 2], axis=1)


def about(axis, angle):
    vector = np.zeros((len(angle), 3), LONG)
    vector[:, axis : axis + 1] = angle
    return exp(vector)


def _inverse(columns):
    a, b, c = columns
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return rows / dot(a, np.cross(b, c))[..., None]


def solve(residual, h, scale):
    """The root x (n, 3) of residual(x, h) that grows from zero with h, and whether it was found.

    Args:
        residual: of x and h.
        scale: the size of x that matters, (n, 1), for differences.
    """
    x = np.zeros((len(h), 3), LONG)
    step = 1e-9 * scale
    for part in range(1, _PARTS + 1):
        for _ in range(_ITERATIONS if part == _PARTS else 4):
            here = h * part / LONG(_PARTS)
            value = residual(x, here)
            columns = [(residual(x + step * e, here) - residual(x - step * e, here)) / (2 * step) for e in np.eye(3)]
            change = np.einsum("nij,nj->ni", _inverse(columns), value)
            x = x - np.where(np.isfinite(change), change, 0)
    found = np.abs(change).max(axis=1) <= 1e-15 * np.maximum(np.abs(x).max(axis=1), 1e-30 * scale[:, 0])
    return x, found


# ---- flights: (moments, h, momentum) -> increment, momentum, found ----


def _exact(moments, h, momentum, degree=30):
    """Taylor series of Euler's equations and the attitude, in parts of at most .2 radians."""
    turn = np.max(np.linalg.norm((h * momentum / moments).astype(float), axis=1), initial=0.0)
    parts = int(min(200, max(1, np.ceil(turn / 0.2))))
    unit, q = h / parts, np.tile(np.array([1, 0, 0, 0], LONG), (len(h), 1))
    for _ in range(parts):
        p, a = [momentum], [q]
        for n in range(degree):
            p.append(sum(np.cross(p[k], unit * p[n - k] / moments) for k in range(n + 1)) / (n + 1))
            omega = [np.concatenate([0 * h, unit * p[n - k] / moments], axis=1) for k in range(n + 1)]
            a.append(sum(multiply(a[k], omega[k]) for k in range(n + 1)) / (2 * (n + 1)))
        momentum, q = sum(reversed(p)), sum(reversed(a))
    return q, momentum, np.full(len(h), True)


def _turned(moments, h, momentum, residual):
    """A flight from an equation for its rotation vector."""
    turn, found = solve(residual, h, np.maximum(np.abs(h * momentum / moments).max(axis=1, keepdims=True), 1e-300))
    increment = exp(turn)
    return increment, back(increment, momentum), found


def _liemid(moments, h, momentum):
    return _turned(moments, h, momentum, lambda x, h: x - h / moments * back(exp(x / 2), momentum))


def _dexp(x, v):
    """dexp(-x) v."""
    size = np.sqrt(dot(x, x))
    safe = np.where(size > 1e-3, size, 1)
    two = np.where(size > 1e-3, 2 * (np.sin(safe / 2) / safe) ** 2, 0.5 - size**2 / 24 + size**4 / 720)
    three = np.where(size > 1e-3, (safe - np.sin(safe)) / safe**3, LONG(1) / 6 - size**2 / 120 + size**4 / 5040)
    once = np.cross(x, v)
    return v - two * once + three * np.cross(x, once)


def _sliemid(order):
    def flight(moments, h, momentum):
        def residual(x, h):
            gradient = moments * x
            if order == 4:
                d = np.cross(x, moments * x) / moments
                gradient = gradient - (np.cross(moments * x, d) + moments * np.cross(d, x)) / 12
            return (gradient - h * _dexp(x, momentum)) / moments

        return _turned(moments, h, momentum, residual)

    return flight


def _moser_veselov(order):
    def flight(moments, h, momentum):
        def speeds(h):
            """1/I -> s/I + d."""
            i, n, energy = moments, dot(momentum, momentum) / 2, dot(momentum, momentum / moments) / 2
            product, s1, x1 = np.prod(i, axis=1, keepdims=True), i.sum(1, keepdims=True), (1 / i).sum(1, keepdims=True)
            s, d = 1 + 0 * h, 0 * h
            if order >= 4:
                s = s + h**2 * (s1 * n / (6 * product) - x1 * energy / 3)
                d = d + h**2 * (-n / (3 * product) + s1 * energy / (6 * product))
            if order == 6:
                s2, x2, sg = (i**2).sum(1, keepdims=True), (1 / i**2).sum(1, keepdims=True), s1 * x1 - 3
                s = s + h**4 * (
                    (s2 / product - x1) * n**2 / (30 * product)
                    + (1 - sg) * n * energy / (30 * product)
                    + (3 * s1 / product + 2 * x2) * energy**2 / 60
                )
                d = d + h**4 * (
                    -s1 * n**2 / (60 * product**2)
                    + (x1 / (10 * product) - s2 / (60 * product**2)) * n * energy
                    - (9 + sg) * energy**2 / (60 * product)
                )
            return s / moments + d

        def residual(c, h):
            i = 1 / speeds(h)
            a = 1 + dot(c, c)
            gaps = np.roll(i, -1, axis=1) - np.roll(i, -2, axis=1)
            products = np.roll(c, -1, axis=1) * np.roll(c, -2, axis=1)
            return (i * c - a * h / 2 * momentum - gaps * products) / i

        scale = np.maximum(np.abs(h * momentum / moments).max(axis=1, keepdims=True), 1e-300)
        c, found = solve(residual, h, scale)
        increment = np.concatenate([1 + 0 * h, c], axis=1) / np.sqrt(1 + dot(c, c))
        return increment, back(increment, momentum), found

    return flight


def _chain(parts):
    """A flight made of rotations about body axes, or of exact symmetric flights, one after the other."""

    def flight(moments, h, momentum):
        q = np.tile(np.array([1, 0, 0, 0], LONG), (len(h), 1))
        for part in parts:
            turn = part(moments, h, momentum)
            q, momentum = multiply(q, turn), back(turn, momentum)
        return q, momentum, np.full(len(h), True)

    return flight


def _axis_turn(axis, share):
    return lambda i, h, p: about(axis, share * h * p[:, axis : axis + 1] / i[:, axis : axis + 1])


def _gap_turn(share):
    return lambda i, h, p: about(0, share * h * (1 / i[:, :1] - 1 / i[:, 1:2]) * p[:, :1])


def _symmetric_turn(i, h, p):
    spin = about(2, h * (1 / i[:, 2:] - 1 / i[:, 1:2]) * p[:, 2:])
    return multiply(exp(h * p / i[:, 1:2]), spin)


FLIGHTS = {
    "LIEMID": _liemid,
    "SLIEMID": _sliemid(2),
    "SLIEMID4": _sliemid(4),
    "JACOBI": _exact,
    "SYMMETRIC": _exact,
    "NEARSYM": _chain([_gap_turn(0.5), _symmetric_turn, _gap_turn(0.5)]),
    "DLM": _chain([_axis_turn(k, share) for k, share in ((2, 0.5), (1, 0.5), (0, 1), (1, 0.5), (2, 0.5))]),
    "DMV": _moser_veselov(2),
    "DMV4": _moser_veselov(4),
    "DMV6": _moser_veselov(6),
}


# ---- steps: (moments, torque, t, h, motion) -> motion, found ----


def splitting(flight: str, scheme: schemes.Scheme):
    """Kicks and flights in turn; no force gradients."""

    def step(moments, torque, t, h, motion):
        good = np.full(len(h), True)

        def fly(a, motion):
            nonlocal good
            increment, momentum, found = FLIGHTS[flight](moments, a * h, motion.momentum)
            good = good & found
            return Motion(momentum, multiply(motion.attitude, increment))

        def kick(b, c, motion, force):
            return motion._replace(momentum=motion.momentum + b * h * force)

        motion, _ = schemes.run(scheme, fly, kick, lambda c, g, m: torque(t + c * h, m.attitude), motion)
        return motion, good

    return step


def _lie_midpoint_implicit(moments, torque, t, h, motion):
    p, q = motion

    def force(x, h):
        return torque(t + h / 2, multiply(q, exp(x / 2)))

    def residual(x, h):
        return x - h / moments * (back(exp(x / 2), p) + h / 2 * force(x, h))

    x, found = solve(residual, h, np.abs(h * p / moments).max(axis=1, keepdims=True) + 1e-300)
    momentum = back(exp(x), p) + h * back(exp(x / 2), force(x, h))
    return Motion(momentum, multiply(q, exp(x))), found


def _simo_wong(moments, torque, t, h, motion):
    p, q = motion

    def end(x, h):
        return back(exp(x), p) + h * back(exp(x / 2), torque(t + h / 2, multiply(q, exp(x / 2))))

    def residual(x, h):
        return x - h / (2 * moments) * (p + end(x, h))

    x, found = solve(residual, h, np.abs(h * p / moments).max(axis=1, keepdims=True) + 1e-300)
    return Motion(end(x, h), multiply(q, exp(x))), found


def _cayley(v):
    return np.concatenate([1 + 0 * v[:, :1], v / 2], axis=1) / np.sqrt(1 + dot(v, v) / 4)


def _akw(moments, torque, t, h, motion):
    p, q = motion

    def end(change, h):
        mean = p + change / 2
        return mean, multiply(q, _cayley(h * mean / moments))

    def residual(change, h):
        mean, there = end(change, h)
        return change - h * (np.cross(mean, mean / moments) + (torque(t, q) + torque(t + h, there)) / 2)

    change, found = solve(residual, h, np.abs(p).max(axis=1, keepdims=True) + 1e-300)
    return Motion(p + change, end(change, h)[1]), found


def _newmark(moments, torque, t, h, motion):
    p, q = motion

    def turning(p):
        return np.cross(p, p / moments)

    rate = turning(p) + torque(t, q)
    there = multiply(q, exp(h / moments * (p + h / 2 * rate)))

    def residual(change, h):
        return change - h * (turning(p + (h * rate + change) / 2) + torque(t + h, there))

    change, found = solve(residual, h, np.abs(p).max(axis=1, keepdims=True) + 1e-300)
    return Motion(p + (h * rate + change) / 2, there), found


def _spiral(moments, torque, t, h, motion):
    def pushed(p, pull):
        def rate(p):
            return h / 2 * (np.cross(p, p / moments) + pull)

        one = rate(p)
        two = rate(p + one)
        return p + (one + two + 4 * rate(p + (one + two) / 4)) / 6

    p = pushed(motion.momentum, torque(t, motion.attitude))
    q = multiply(motion.attitude, exp(h * p / moments))
    return Motion(pushed(p, torque(t + h, q)), q), np.full(len(h), True)


def _explicit(change):
    """The step of a Runge-Kutta method; `change(rates, h, y)` is what it adds to y, momentum and pose side by side."""

    def step(moments, torque, t, h, motion):
        def rates(c, y):
            p, q = y[:, :3], y[:, 3:]
            omega = np.concatenate([0 * h, p / moments], axis=1)
            spin = multiply(q, omega) / 2
            return np.concatenate([np.cross(p, p / moments) + torque(t + LONG(c) * h, q), spin], axis=1)

        y = np.concatenate(motion, axis=1)
        y = y + change(rates, h, y)
        p, q = y[:, :3], y[:, 3:]
        return Motion(p, q * (1.5 - dot(q, q) / 2)), np.full(len(h), True)

    return step


def _tableau(table):
    def change(rates, h, y):
        found = []

        def total(weights):
            return h * sum((LONG(c) * found[j] for j, c in weights.items()), start=0 * y)

        for row in table.stages:
            found.append(rates(sum(row.values()), y + total(row)))
        return total(table.weights)

    return _explicit(change)


def _extrapolation(levels):
    """Gragg's midpoint rule by Aitken and Neville's scheme."""

    def change(rates, h, y):
        column = []
        for j in range(1, levels + 1):
            n = 2 * j
            before, now = y, y + h / n * rates(0, y)
            for i in range(1, n):
                before, now = now, before + 2 * h / n * rates(LONG(i) / n, now)
            column.insert(0, now - y)
            for k in range(1, j):
                column[k] = column[k - 1] + (column[k - 1] - column[k]) / ((LONG(n) / (n - 2 * k)) ** 2 - 1)
        return column[-1]

    return _explicit(change)


OTHERS = {
    "LIEMID[I]": _lie_midpoint_implicit,
    "SW": _simo_wong,
    "AKW": _akw,
    "NMB": _newmark,
    "SPIRAL": _spiral,
    "RK4": _tableau(tableau.RK4),
    "DOP853": _tableau(tableau.DOP853),
    "GBS8": _extrapolation(4),
    "GBS10": _extrapolation(5),
    "GBS12": _extrapolation(6),
}


def step_of(name: str):
    """The step of a method, by its name in the package."""
    if name in OTHERS:
        return OTHERS[name]
    flight, scheme = name.removesuffix("]").split("[")
    return splitting(flight, schemes.SCHEMES[scheme])


def composed(step, count: int):
    """So many steps of it."""

    def steps(moments, torque, t, h, motion):
        good = np.full(len(h), True)
        for n in range(count):
            motion, found = step(moments, torque, t + n * h, h, motion)
            good = good & found
        return motion, good

    return steps
