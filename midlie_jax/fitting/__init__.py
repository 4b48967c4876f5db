"""Parameters of rigid bodies from measurements (extra `fit`).

    def model(values):
        body = ml.RigidBody(values["moments"])
        return body, None, ml.MomentumState(body.momentum(values["rate"]))

    guess = {"moments": fitting.Moments([1.0, 2.0, 2.5], scale="fixed"), "rate": fitting.Free([0.1, 0.2, 0.3])}
    print(ml.fit(model, guess, fitting.Rates(times, rates, sigma=1e-3), dt=0.1))

Modules: `parameters` (physical values from unconstrained numbers), `measurements` (residuals), `sampling` (states at
any times), `layout` (many parameters as one vector), `residuals` (what is minimised), `identifiability` (what the data
determine), `misfit` (whether the residuals can be noise), `estimate` (values with covariance), `solve` (the pure
function), `conventions` (attitudes against rates), `fit` (checks), `doubts`, `aliases` and `report` (the table).
optimistix solves the least-squares problem; only this folder imports it, and `import midlie_jax` does not import it.
"""

from .estimate import Estimate as Estimate
from .failure import UndeterminedError as UndeterminedError
from .fit import fit as fit
from .measurements import Accelerations as Accelerations
from .measurements import Attitudes as Attitudes
from .measurements import Directions as Directions
from .measurements import Measurement as Measurement
from .measurements import Observed as Observed
from .measurements import Positions as Positions
from .measurements import Rates as Rates
from .of_body import OfBody as OfBody
from .parameters import Free as Free
from .parameters import InertiaTensor as InertiaTensor
from .parameters import Moments as Moments
from .parameters import Parameter as Parameter
from .parameters import Positive as Positive
from .parameters import UnitQuaternion as UnitQuaternion
from .parameters import UnitVector as UnitVector
from .prepare import prepare as prepare
from .report import Fit as Fit
from .result import Result as Result
from .sampling import states_at as states_at
from .solve import Plan as Plan
from .solve import fit_arrays as fit_arrays
