"""Explicit Runge-Kutta methods, which know nothing of rotations: the measure of what structure is worth."""

from .runge_kutta import DOP853 as DOP853
from .runge_kutta import RK4 as RK4
from .runge_kutta import RungeKutta as RungeKutta
