"""Asteroids: light curves, sunlight, mutual gravity, and tumbling described by periods and a pole."""

from .._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
