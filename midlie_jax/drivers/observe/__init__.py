"""Quantities of a state, and what a run saves instead of its states: `observe=` of the drivers.

The functions of this module, such as `energy` and `angular_velocity`, compute a quantity of states that you have. An
*observable*, such as one of these functions, is computed from the state of each body at each saved time, on the device.
A *statistic* (`Mean`, `Histogram`) combines its values over all bodies with trustworthy values at that time; a
statistic of time (`Autocorrelation`, `Spectrum`, `Susceptibility`) combines all values of each body, and then the
bodies. A dict of observables, or of statistics, computes several in one run.
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
