"""Torques. A torque is any callable of (t, state) that returns the body-frame torque (3,).

`base` defines the interface (potential energy, dependence on the body) and sums of torques. `reads_body` has torques
that read the body, `from_functions` custom torques from a function, and `fields` torques that depend on the attitude.
`friction` has damping and air drag. `travel` has torques on bodies that translate; they return a
`midlie_jax.torques.Wrench`, a torque and a force. `by_step` has controls and pulses, which are constant in each step.
The torques of one application are in its folder: `asteroids`, `molecules`, `spacecraft`, `spins`.
"""

from ..wrench import Wrench as Wrench
from .base import Sum as Sum
from .base import Torque as Torque
from .base import TorqueLike as TorqueLike
from .base import kept_terms as kept_terms
from .base import on_body as on_body
from .base import potential_of as potential_of
from .base import terms_of as terms_of
from .base import velocity_dependent as velocity_dependent
from .base import without_gravity as without_gravity
from .by_step import Held as Held
from .by_step import Pulses as Pulses
from .fields import DipoleInField as DipoleInField
from .fields import HeavyTop as HeavyTop
from .friction import Damping as Damping
from .friction import Drag as Drag
from .from_functions import FromPotential as FromPotential
from .from_functions import Prescribed as Prescribed
from .from_functions import VelocityDependent as VelocityDependent
from .on_each import OnEach as OnEach
from .reads_body import BodyTorque as BodyTorque
from .travel import Magnus as Magnus
from .travel import Oblateness as Oblateness
from .travel import PointMass as PointMass
from .travel import UniformGravity as UniformGravity
