"""The kinds of state, one per file: a momentum alone, or with one direction, the attitude, or the axis of symmetry.

The last two can also translate; particles have positions only. `model/state.py` defines the interface of every state
for steps and torques.
"""

from .axis import AxisState as AxisState
from .compensated import CompensatedState as CompensatedState
from .coupled import Coupled as Coupled
from .coupled import CoupledAxisState as CoupledAxisState
from .coupled import CoupledFreeAxisState as CoupledFreeAxisState
from .coupled import CoupledRigidState as CoupledRigidState
from .coupled import CoupledState as CoupledState
from .direction import DirectionState as DirectionState
from .free import FreeAxisState as FreeAxisState
from .free import FreeState as FreeState
from .free import TravellingState as TravellingState
from .momentum import MomentumState as MomentumState
from .particles import ParticleState as ParticleState
from .rigid import RigidState as RigidState
from .rigid import attitude_of as attitude_of
from .rigid import with_attitude as with_attitude

# States that hold the angular momentum and an axis of the body in space.
OrientedState = RigidState | AxisState | TravellingState
