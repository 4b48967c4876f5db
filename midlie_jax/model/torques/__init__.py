"""Torques. A torque is any callable of (t, state) that returns the body-frame torque (3,).

The torques of one application are in its folder: `asteroids`, `molecules`, `spacecraft`, `spins`.
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
