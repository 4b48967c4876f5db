"""Quantities of a state, and what a run saves instead of its states: `observe=` of the drivers.

The functions of this module, such as `energy` and `angular_velocity`, compute a quantity of states that you have. The
same functions are observables: `observe=ml.observe.energy`.

An *observable* is computed from the state of each body at each saved time, on the device, so that only its values leave
the device. It is a function of this module, a function of (t, state), an `Observable` such as `Axis()`, or a dict of
these. A *statistic* (`Mean`, `Histogram`) combines these values over all bodies with trustworthy values at that time. A
statistic of time (`Autocorrelation`, `Spectrum`, `Susceptibility`) combines all values of each body, and then the
bodies. A dict of statistics computes several in one run.

Modules: `observables` (definition of an observable), `quantities` (common observables), `statistics` (over bodies at
one time), `series` (over times), `correlations`, `spectra` and `susceptibility` (the series), `several` (a dict of
statistics), `spread` (means over bodies and their errors), `of_arrays` (the same for values in memory), `arguments`
(the argument of the drivers).
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
