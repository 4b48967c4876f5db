"""Parameters of rigid bodies from measurements: `ml.fit` has an example.

Each file imports only earlier ones. `loss`, `parameters`, `measurements`, `instruments` and `sampling` (states at any
times) make the `problem` (the function to minimise). `noise` and `estimate` judge the optimum, `solve` finds it,
`search` finds all minima, and `report` describes the result in words; `checks` tests the arguments of `fit`.
"""

from .estimate import Estimate as Estimate
from .estimate import Result as Result
from .fit import fit as fit
from .fit import prepare as prepare
from .instruments import Accelerations as Accelerations
from .instruments import Attitudes as Attitudes
from .instruments import Directions as Directions
from .instruments import OfBody as OfBody
from .instruments import Positions as Positions
from .instruments import Rates as Rates
from .loss import Cauchy as Cauchy
from .loss import Huber as Huber
from .loss import Loss as Loss
from .measurements import Measurement as Measurement
from .measurements import Observed as Observed
from .parameters import Free as Free
from .parameters import InertiaTensor as InertiaTensor
from .parameters import Moments as Moments
from .parameters import Parameter as Parameter
from .parameters import Periodic as Periodic
from .parameters import Positive as Positive
from .parameters import UnitQuaternion as UnitQuaternion
from .parameters import UnitVector as UnitVector
from .report import Fit as Fit
from .report import UndeterminedError as UndeterminedError
from .sampling import states_at as states_at
from .search import Minimum as Minimum
from .solve import Plan as Plan
from .solve import fit_arrays as fit_arrays
