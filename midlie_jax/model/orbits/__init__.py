"""Orbits, and magnetic fields along an orbit: inputs of torques and step densities."""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
