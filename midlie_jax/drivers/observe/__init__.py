"""Quantities of a state, and what a run saves instead of its states: `observe=` of the drivers.

The functions of this module, such as `energy` and `angular_velocity`, compute a quantity of states that you have. The
same functions are observables: `observe=ml.observe.energy`.

An *observable* is computed from the state of each body at each saved time, on the device, so that only its values leave
the device. It is a function of this module, a function of (t, state), an `Observable` such as `Axis()`, or a dict of
these. A *statistic* (`Mean`, `Histogram`) combines these values over all bodies with trustworthy values at that time. A
statistic of time (`Autocorrelation`, `Spectrum`, `Susceptibility`) combines all values of each body, and then the
bodies. A dict of statistics computes several in one run.

Modules: `observables` (definition of an observable), `quantities` (common observables), `statistics` (over bodies at
one time), `series` (over times), `autocorrelation`, `spectrum` and `susceptibility` (the series), `several` (a dict of
statistics), `spread` (means over bodies and their errors), `of_arrays` (the same for values in memory), `arguments`
(the argument of the drivers).
"""

from ...model.observables import angular_velocity as angular_velocity
from ...model.observables import kinetic_energy as kinetic_energy
from ...model.observables import linear_momentum as linear_momentum
from ...model.observables import linear_velocity as linear_velocity
from ...model.observables import position as position
from ...model.observables import spatial_angular_velocity as spatial_angular_velocity
from ...model.observables import spatial_momentum as spatial_momentum
from ..energy import energy as energy
from .arguments import Observe as Observe
from .arguments import as_observe as as_observe
from .arguments import as_observe_of_one as as_observe_of_one
from .arguments import observe_state as observe_state
from .autocorrelation import Autocorrelation as Autocorrelation
from .autocorrelation import Correlation as Correlation
from .observables import Function as Function
from .observables import Observable as Observable
from .observables import Together as Together
from .observables import as_observable as as_observable
from .of_arrays import autocorrelation as autocorrelation
from .of_arrays import spectrum as spectrum
from .quantities import Axis as Axis
from .quantities import EulerAngles as EulerAngles
from .spectrum import Density as Density
from .spectrum import Spectrum as Spectrum
from .statistics import Histogram as Histogram
from .statistics import Mean as Mean
from .statistics import Moments as Moments
from .statistics import Statistic as Statistic
from .susceptibility import Response as Response
from .susceptibility import Susceptibility as Susceptibility
