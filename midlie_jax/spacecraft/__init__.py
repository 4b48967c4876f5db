"""Spacecraft: control torques, disturbance torques along an orbit, thrust, and attitude files."""

from .._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
