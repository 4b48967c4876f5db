"""What an ensemble saves instead of its states: `observe=` of `ensemble` and `simulate`.

An *observable* is computed from the state of each body at each saved time, on the device, so that only its values leave
the device. It is a function of (t, state), one of the classes of this module, or a dict of these. A *statistic*
(`Mean`, `Histogram`) combines these values over all bodies with trustworthy values at that time. A statistic of time
(`Autocorrelation`, `Spectrum`) combines all values of each body, and then the bodies.

Modules: `observables` (definition of an observable), `quantities` (common observables), `brightness` (of a surface in
sunlight), `statistics` (over bodies at one time), `series` (over times), `autocorrelation` and `spectrum` (the two
series), `spread` (means over bodies and their errors), `of_arrays` (the same for values in memory), `arguments` (the
argument of the drivers).
"""

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
from .quantities import AngularVelocity as AngularVelocity
from .quantities import Axis as Axis
from .quantities import Energy as Energy
from .quantities import EulerAngles as EulerAngles
from .quantities import Position as Position
from .quantities import SpatialMomentum as SpatialMomentum
from .quantities import Tumbling as Tumbling
from .quantities import Velocity as Velocity
from .spectrum import Density as Density
from .spectrum import Spectrum as Spectrum
from .statistics import Histogram as Histogram
from .statistics import Mean as Mean
from .statistics import Moments as Moments
from .statistics import Statistic as Statistic
