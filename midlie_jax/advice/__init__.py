"""Advice before runs: stability of a step (`check`), effect of rounding, and the fastest method (`recommend`)."""

from .._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
